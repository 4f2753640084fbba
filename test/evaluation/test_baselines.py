"""Background subtraction as a segmenter, on a drawn scene; and the choice of baselines."""

from __future__ import annotations

import math
import types
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.evaluation import CONTRIB_BASELINES
from turbseg_ros.evaluation.baselines import (
    BackgroundSubtraction,
    TurbsegMethod,
    UnknownBaselineError,
    background_subtractions,
    baselines,
)
from turbseg_ros.evaluation.labels import result_from_labels
from turbseg_ros.evaluation.metrics import jaccard
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, Segmenter, segment

FRAMES = 40
SHAPE = (140, 200)
ALGORITHMS = ("mog2", "knn")


def ground() -> np.ndarray:
    """Blurred noise, larger than a frame by 20 pixels on every side."""
    noise = np.random.default_rng(4).standard_normal((SHAPE[0] + 40, SHAPE[1] + 40))
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(110 + 45 * soft / soft.std(), 0, 255).astype(np.uint8)


def clip(shake: int) -> list[tuple[Frame, np.ndarray]]:
    """A white square crosses the ground, 4 pixels a frame; the camera jumps by up to `shake`."""
    jumps = np.random.default_rng(5).integers(-shake, shake + 1, (FRAMES, 2))
    frames = []
    for number, (dx, dy) in enumerate(jumps):
        scene, truth = ground(), np.zeros(ground().shape, bool)
        square = np.s_[80:104, 20 + 4 * number : 44 + 4 * number]
        scene[square], truth[square] = 255, True
        view = np.s_[20 + dy : 20 + dy + SHAPE[0], 20 + dx : 20 + dx + SHAPE[1]]
        frames.append((Frame(number, scene[view].copy()), truth[view]))
    return frames


def results(segmenter: Segmenter, shake: int = 0) -> list[SegmentationResult]:
    return list(segment((frame for frame, _ in clip(shake)), segmenter))


def mean_j(segmenter: Segmenter, shake: int) -> float:
    """The mean over the second half, when the background has been learnt."""
    pairs = zip(results(segmenter, shake), clip(shake), strict=True)
    scores = [jaccard(result.labels, truth) for result, (_, truth) in pairs]
    return float(np.mean(scores[FRAMES // 2 :]))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_frame_is_answered_at_once(algorithm: str) -> None:
    segmenter = BackgroundSubtraction(algorithm, stabilised=False).segmenter()
    for frame, _ in clip(0):
        (result,) = segmenter.push(frame)
        assert result.frame is frame
        assert (result.labels.shape, result.labels.dtype) == (SHAPE, np.uint16)
        assert math.isnan(result.tilt)
    assert not segmenter.flush()


@pytest.mark.parametrize("stabilised", [False, True])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_crosses_a_still_picture_is_found(algorithm: str, stabilised: bool) -> None:
    assert mean_j(BackgroundSubtraction(algorithm, stabilised).segmenter(), shake=0) > 0.8


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_shaking_camera_is_what_stabilisation_is_for(algorithm: str) -> None:
    raw = mean_j(BackgroundSubtraction(algorithm, stabilised=False).segmenter(), shake=6)
    stabilised = mean_j(BackgroundSubtraction(algorithm, stabilised=True).segmenter(), shake=6)
    assert raw < 0.6
    assert stabilised > 0.8


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_objects_describe_their_labels(algorithm: str) -> None:
    answers = results(BackgroundSubtraction(algorithm, stabilised=False).segmenter(), shake=3)
    assert any(len(result.objects) > 1 for result in answers)
    for result in answers:
        assert set(np.unique(result.labels)) - {0} == {found.id for found in result.objects}
        for found in result.objects:
            rows, columns = np.nonzero(result.labels == found.id)
            assert found.area == rows.size
            assert found.centroid == pytest.approx((columns.mean(), rows.mean()))
            x, y, width, height = found.box
            assert (x, y) == (columns.min(), rows.min())
            assert (x + width - 1, y + height - 1) == (columns.max(), rows.max())


@pytest.mark.parametrize("stabilised", [False, True])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_answers_do_not_depend_on_what_ran_before(algorithm: str, stabilised: bool) -> None:
    method = BackgroundSubtraction(algorithm, stabilised)
    first, second = (results(method.segmenter(), shake=2) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.labels, other.labels)


def test_a_new_reference_is_taken_where_the_camera_pans_away() -> None:
    panorama = np.hstack([ground()] * 3)
    segmenter = BackgroundSubtraction("knn", stabilised=True).segmenter()
    for number in range(60):
        left = 5 * number
        frame = Frame(number, panorama[: SHAPE[0], left : left + SHAPE[1]].copy())
        (result,) = segmenter.push(frame)
        assert np.count_nonzero(result.labels) < 0.1 * result.labels.size


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("colours", [1, 3])
def test_every_kind_of_image_is_taken(dtype: type, colours: int) -> None:
    segmenter = BackgroundSubtraction("mog2", stabilised=True).segmenter()
    for frame, _ in clip(0)[:3]:
        image = frame.image.astype(dtype)
        image = image if colours == 1 else np.dstack([image] * colours)
        (result,) = segmenter.push(Frame(frame.stamp, image))
        assert result.labels.shape == SHAPE


def test_frames_of_another_size_start_anew() -> None:
    segmenter = BackgroundSubtraction("knn", stabilised=True).segmenter()
    for frame, _ in clip(0)[:5]:
        segmenter.push(frame)
    (result,) = segmenter.push(Frame(99, ground()))
    assert result.labels.shape == ground().shape
    assert not result.labels.any()


def test_opencvs_rivals_come_raw_and_stabilised() -> None:
    names = [method.name for method in baselines(["mog2", "knn"])]
    assert names == ["mog2", "mog2 stabilised", "knn", "knn stabilised"]
    assert not any(method.keeps_ids for method in baselines(["mog2", "knn"]))


def test_the_paper_is_the_method_with_the_papers_parameters() -> None:
    (paper,) = baselines(["paper"])
    assert isinstance(paper, TurbsegMethod)
    values = paper.parameters.as_mapping()
    assert values["motion.measure"] == "sampson"
    assert values["growing.similarity"] == "magnitude"
    assert values["outline.method"] == "none"
    assert values["tracking.mode"] == "kmeans"


@pytest.mark.parametrize(
    ("name", "hint"),
    [("mogg2", "did you mean mog2"), ("sam", "there are mog2, knn, gsoc, lsbp, cnt, paper")],
)
def test_an_unknown_rival_is_refused(name: str, hint: str) -> None:
    with pytest.raises(UnknownBaselineError, match=f"no baseline '{name}'; {hint}"):
        baselines(["knn", name])


def test_what_only_contrib_has_is_one_line_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "bgsegm", raising=False)
    with pytest.raises(UnknownBaselineError, match=r"baseline gsoc needs .*opencv"):
        baselines(["gsoc"])


@pytest.mark.skipif(not hasattr(cv2, "bgsegm"), reason="OpenCV has no contrib modules")
@pytest.mark.parametrize("name", CONTRIB_BASELINES)
def test_those_of_contrib_find_what_crosses_a_still_picture(name: str) -> None:
    raw, stabilised = background_subtractions(name)
    assert [each.name for each in (raw, stabilised)] == [name, f"{name} stabilised"]
    assert mean_j(raw.segmenter(), shake=0) > 0.3
    assert mean_j(stabilised.segmenter(), shake=6) > 0.3


def test_those_of_contrib_are_made_and_applied_as_the_others_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in CONTRIB_BASELINES:
        made = f"createBackgroundSubtractor{name.upper()}"
        stand_in = types.SimpleNamespace(
            **{made: lambda: cv2.createBackgroundSubtractorKNN(detectShadows=False)}
        )
        monkeypatch.setattr(cv2, "bgsegm", stand_in, raising=False)
        assert mean_j(background_subtractions(name)[1].segmenter(), shake=0) > 0.8


class Bright:
    """Finds what is white; made with the parameters, as strategies are."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters

    def push(self, frame: Frame) -> list[SegmentationResult]:
        return [result_from_labels(frame, (frame.image == 255).astype(np.uint16))]

    def flush(self) -> list[SegmentationResult]:
        return []


def test_a_segmenter_of_ones_own_is_named_by_its_class() -> None:
    parameters = Parameters.from_mapping({"max_objects": 3})
    (own,) = baselines([f"{__name__}:Bright"], parameters)
    assert (own.name, own.keeps_ids, own.recorded) == ("Bright", True, False)
    segmenter = own.segmenter()
    assert isinstance(segmenter, Bright) and segmenter.parameters == parameters
    assert mean_j(segmenter, shake=0) > 0.95


def test_a_file_of_parameters_is_the_method_under_them(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("/**:\n  ros__parameters:\n    max_objects: 5\n")
    (mine,) = baselines([f"mine={file}"])
    assert isinstance(mine, TurbsegMethod)
    assert (mine.name, mine.parameters.max_objects) == ("mine", 5)


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("no_such_module:Class", "baseline is no_such_module:Class: .*PYTHONPATH"),
        (f"{__name__}:Dark", "has no class Dark"),
    ],
)
def test_a_segmenter_that_cannot_be_had_is_refused(name: str, complaint: str) -> None:
    with pytest.raises(ParameterError, match=complaint):
        baselines([name])


def test_a_segmenter_that_takes_no_parameters_is_told_so() -> None:
    (own,) = baselines(["builtins:object"])
    with pytest.raises(ParameterError, match="builtins:object can't be made with the parameters"):
        own.segmenter()


def test_a_method_is_what_its_parameters_make_it() -> None:
    one, other = TurbsegMethod("one", Parameters()), TurbsegMethod("other", Parameters())
    assert one == other
    assert hash(one) == hash(other)
    assert one != TurbsegMethod("one", Parameters.from_mapping({"flow.interval": 2}))
