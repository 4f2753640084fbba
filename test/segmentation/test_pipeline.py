"""The whole method on small drawn clips."""

from __future__ import annotations

import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.drawn_clip import (
    CLIP,
    PAPER,
    PARAMETERS,
    SCENE,
    SHAPE,
    assert_sound,
    frames,
    ids,
    segmented,
    stamps,
)
from support.drawn_scene import ByteImage, jaccard, texture
from support.segmenters import segmenter_by_rules
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Parameters, Value
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.observer import StageObserver

# So few images may wait that none does so at no price; see `Load`.
IMPATIENT = PARAMETERS.replace({"queue_size": 2})


@pytest.fixture(scope="module")
def results() -> list[SegmentationResult]:
    return segmented(CLIP)


def test_a_moving_square_is_found_and_keeps_its_id(results: list[SegmentationResult]) -> None:
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(results)]
    assert np.mean(overlap) > 0.7
    assert np.mean(overlap[8:]) > 0.75
    assert ids(results) == {1}
    assert all(len(result.objects) == 1 for result in results[4:])
    assert_sound(results)


def test_a_frame_that_cannot_be_prepared_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ValueError("broken")

    segmenter = segmenter_by_rules(PARAMETERS)
    first, second, third = frames(CLIP[:3], first=40)
    segmenter.push(first)
    with monkeypatch.context() as patch:
        patch.setattr("turbseg_ros.segmentation.preparation.prepare", broken)
        segmenter.push(second)
        with pytest.raises(RuntimeError, match="the frame of 41 ns"):
            segmenter.push(third)
    # As the worker does.
    segmenter.reset()
    assert segmenter.push(first) == []
    assert stamps(segmenter.flush()) == [40]


def test_labels_of_images_decoded_in_part_have_the_whole_size() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    found = []
    whole = (2 * SHAPE[0], 2 * SHAPE[1])
    for number, frame in enumerate(frames(CLIP)):
        large = cv2.resize(frame.image, whole[::-1], interpolation=cv2.INTER_CUBIC)
        # Now and then somebody looks.
        decoded = replace(frame, image=large)
        in_part = replace(frame, image_wanted=False, whole=whole)
        found += segmenter.push(decoded if number in (0, 9) else in_part)
    found += segmenter.flush()
    assert stamps(found) == list(range(len(CLIP)))
    truth = [np.kron(SCENE.truth(k), np.ones((2, 2), bool)) for k in range(len(CLIP))]
    overlap = [jaccard(r.labels > 0, true) for r, true in zip(found, truth, strict=True)]
    assert np.mean(overlap) > 0.7
    assert ids(found) == {1}
    assert {result.frame.image.shape for result in found} == {whole}


def test_images_that_nobody_wants_are_not_kept(results: list[SegmentationResult]) -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    lean = []
    for frame in frames(CLIP):
        lean += segmenter.push(replace(frame, image_wanted=False))
    lean += segmenter.flush()
    for result, full in zip(lean, results, strict=True):
        assert result.frame.image.shape == full.frame.image.shape
        assert result.frame.image.dtype == full.frame.image.dtype
        assert not result.frame.image.any()
        # A pixel stands for all of them.
        assert result.frame.image.strides == (0,) * result.frame.image.ndim
        np.testing.assert_array_equal(result.labels, full.labels)


def test_under_load_the_square_coasts_between_measurements() -> None:
    segmenter = segmenter_by_rules(IMPATIENT)
    waiting = PARAMETERS.latency.coast_from
    results = [result for frame in frames(CLIP) for result in segmenter.push(frame, waiting)]
    results += segmenter.flush(lambda: waiting)
    assert_sound(results)
    every = PARAMETERS.flow.every
    coasted = [result.frame.stamp for result in results if result.coasted]
    assert coasted == [stamp for stamp in stamps(results) if stamp % every]
    assert len(ids(results)) == 1
    for number, result in enumerate(results[10:-2], 10):
        assert jaccard(result.labels > 0, SCENE.truth(number)) > 0.7


def test_what_has_piled_up_is_worked_off_when_there_is_time_for_it() -> None:
    sooner = {"latency.warm_up": 16, "flow.every": 1, "tracking.min_hits": 2}

    def answered(waiting: int) -> list[int]:
        segmenter = segmenter_by_rules(PARAMETERS.replace(sooner))
        return [len(segmenter.push(frame, waiting)) for frame in frames(CLIP)]

    assert answered(waiting=1) == [0] * 18 + [1] * 12
    assert answered(waiting=0) == [0] * 17 + [2] * 11 + [1] * 2


def test_what_is_left_coasts_while_frames_wait() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    for frame in frames(CLIP):
        segmenter.push(frame)
    asked = []

    def waiting() -> int:
        asked.append(len(asked))
        return PARAMETERS.latency.coast_from if len(asked) > 2 else 0

    results = segmenter.flush(waiting)
    every = PARAMETERS.flow.every
    left = stamps(results)[-len(asked) :]
    coasted = [result.frame.stamp for result in results if result.coasted]
    assert coasted == [stamp for stamp in left[2:] if stamp % every]
    assert len(coasted) > 3
    assert len(ids(results)) == 1


def test_to_coast_or_not_is_chosen_frame_by_frame() -> None:
    segmenter = segmenter_by_rules(PARAMETERS.replace({"latency.warm_up": 0}))
    results = []
    for number, frame in enumerate(frames(CLIP)):
        results += segmenter.push(frame, PARAMETERS.latency.coast_from if number >= 20 else 0)
    results += segmenter.flush(lambda: PARAMETERS.latency.coast_from)
    coasted = [result.frame.stamp for result in results if result.coasted]
    # What is segmented when a frame comes is one so many frames before it.
    first = 20 - PARAMETERS.latency.look_ahead + 1
    expected = [number for number in range(first, 30) if number % PARAMETERS.flow.every]
    assert coasted == expected
    assert len(ids(results)) == 1


def test_always_coasting_by_parameter() -> None:
    results = segmented(CLIP, PARAMETERS.replace({"latency.coast_from": 0}))
    assert any(result.coasted for result in results)


def test_when_to_hurry_can_be_changed() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    segmenter.reconfigure(PARAMETERS.replace({"latency.coast_from": 0}))
    results = [result for frame in frames(CLIP) for result in segmenter.push(frame)]
    assert any(result.coasted for result in results)


def measured(results: list[SegmentationResult]) -> list[int]:
    """Where all coasts, what did not: where motion was measured."""
    return [result.frame.stamp for result in results if not result.coasted]


def test_motion_is_measured_half_as_often_while_very_many_frames_wait() -> None:
    every = PARAMETERS.flow.every
    segmenter = segmenter_by_rules(IMPATIENT)
    waiting = PARAMETERS.latency.sparse_from
    results = [result for frame in frames(CLIP) for result in segmenter.push(frame, waiting)]
    results += segmenter.flush(lambda: waiting)
    assert_sound(results)
    assert measured(results) == list(range(0, len(results), 2 * every))
    for number, result in enumerate(results[16:-2], 16):
        assert jaccard(result.labels > 0, SCENE.truth(number)) > 0.5


def test_after_the_rush_motion_is_measured_as_often_as_before() -> None:
    every, latency = PARAMETERS.flow.every, PARAMETERS.latency
    segmenter = segmenter_by_rules(PARAMETERS.replace({"latency.warm_up": 0}))
    results = []
    for number, frame in enumerate(frames(CLIP)):
        rush = number < segmenter.look_ahead + every
        results += segmenter.push(frame, latency.sparse_from if rush else latency.coast_from)
    results += segmenter.flush(lambda: latency.coast_from)
    answers = range(0, len(results), every)
    assert measured(results) == [number for number in answers if number != every]


def test_an_empty_result_has_the_sizes_of_all_others(results: list[SegmentationResult]) -> None:
    empty = segmenter_by_rules(PARAMETERS).empty_result(frames(CLIP)[0])
    assert empty.motion_map.shape == results[-1].motion_map.shape
    assert empty.labels.shape == results[-1].labels.shape
    assert not empty.labels.any()
    assert empty.objects == ()


def test_closing_ends_all_threads_it_started() -> None:
    before = set(threading.enumerate())
    with segmenter_by_rules(PARAMETERS) as segmenter:
        for frame in frames(CLIP):
            segmenter.push(frame)
        assert set(threading.enumerate()) - before
    assert not set(threading.enumerate()) - before


def test_an_object_is_described_as_it_is_labelled(results: list[SegmentationResult]) -> None:
    for result in results[4:]:
        (moving,) = result.objects
        y, x = np.nonzero(result.labels == moving.id)
        assert moving.area == len(x)
        np.testing.assert_allclose(moving.centroid, (x.mean(), y.mean()), atol=1e-6)
        left, top, width, height = moving.box
        assert (left, top) == (x.min(), y.min())
        assert (left + width - 1, top + height - 1) == (x.max(), y.max())
        assert moving.slot == 0


def test_velocity_and_trail_are_in_pixels_of_the_input(results: list[SegmentationResult]) -> None:
    for number, result in enumerate(results[12:26], start=12):
        (moving,) = result.objects
        np.testing.assert_allclose(moving.velocity, (3.0, 0.0), atol=0.4)
        middle = (20 + 3 * number + 11.5, 36 + 11.5)
        np.testing.assert_allclose(moving.trail[-1], middle, atol=3.0)
        assert np.diff(np.array(moving.trail)[:, 0]).min() > 0.0


def test_the_motion_map_is_in_pixels_of_the_input_a_frame(
    results: list[SegmentationResult],
) -> None:
    result = results[15]
    motion = cv2.resize(result.motion_map, SHAPE[::-1])
    truth = SCENE.truth(15)
    assert np.median(motion[truth]) == pytest.approx(3.0, abs=0.3)
    far = cv2.dilate(truth.astype(np.uint8), np.ones((41, 41))) == 0
    assert np.percentile(motion[far], 95) < 0.3
    assert result.ego_motion_model == "affine"


def test_a_picture_is_worked_on_smaller_and_answered_at_its_own_size() -> None:
    doubled = [cv2.resize(image, None, fx=2, fy=2) for image in CLIP[:18]]
    found = segmented(doubled, PARAMETERS.replace({"resolution.detail": 160}))
    assert_sound(found)
    for number in range(12, 15):
        truth = cv2.resize(SCENE.truth(number).astype(np.uint8), None, fx=2, fy=2) > 0
        (moving,) = found[number].objects
        assert jaccard(found[number].labels > 0, truth) > 0.7
        np.testing.assert_allclose(moving.velocity, (6.0, 0.0), atol=0.8)
        np.testing.assert_allclose(moving.trail[-1], moving.centroid, atol=3.0)
        motion = cv2.resize(found[number].motion_map, truth.shape[::-1])
        assert np.median(motion[truth]) == pytest.approx(6.0, abs=0.6)


def test_results_carry_their_frames(results: list[SegmentationResult]) -> None:
    assert stamps(results) == list(range(30))
    assert all(r.frame.image is image for r, image in zip(results, CLIP, strict=True))
    assert all(r.frame.frame_id == "lens" for r in results)


@pytest.mark.parametrize("count", [1, 2, 5, 9, 30])
@pytest.mark.parametrize("mode", ["centred", "causal"])
def test_every_frame_gets_one_result_in_order(count: int, mode: str) -> None:
    parameters = PARAMETERS.replace({"latency.mode": mode, "resolution.processing": 128})
    found = segmented(CLIP[:count], parameters)
    assert stamps(found) == list(range(count))
    assert_sound(found)


@pytest.mark.parametrize(
    ("chosen", "look_ahead"),
    [
        *(({"latency.look_ahead": frames}, frames) for frames in (3, 4, 6, 10, 15)),
        ({"flow.interval": 8, "tracking.min_hits": 9}, Parameters().latency.look_ahead),
        ({"latency.mode": "causal"}, 0),
    ],
    ids=str,
)
def test_frames_wait_for_the_announced_look_ahead(
    chosen: dict[str, Value], look_ahead: int
) -> None:
    quickly = {"latency.warm_up": 0, "resolution.processing": 128, **chosen}
    segmenter = segmenter_by_rules(PARAMETERS.replace(quickly))
    assert segmenter.look_ahead == look_ahead
    given_out = 0
    for number, frame in enumerate(frames(CLIP[:20]), start=1):
        given_out += len(segmenter.push(frame))
        assert given_out == max(number - look_ahead, 0)
    assert len(segmenter.flush()) == look_ahead


@pytest.mark.parametrize(("look_ahead", "late"), [(3, 2), (4, 1), (6, 0), (15, 0)])
def test_motion_is_measured_late_only_where_too_few_frames_follow(
    look_ahead: int, late: int
) -> None:
    always = {"latency.look_ahead": look_ahead, "latency.coast_from": 0, "latency.warm_up": 0}
    answers = measured(segmented(CLIP, PARAMETERS.replace(always)))
    every = PARAMETERS.flow.every
    # Before, there is nothing to propagate.
    steady = [number for number in answers if number >= 2 * every]
    assert steady == [number + late for number in range(2 * every, 30 - late, every)]


def test_the_first_results_wait_longer_to_be_sure_for_they_are_late_anyway() -> None:
    seldom = PARAMETERS.replace({"tracking.min_hits": 9, "latency.look_ahead": 6})
    segmenter = segmenter_by_rules(seldom)
    answered, results = [], []
    for frame in frames(CLIP):
        answers = segmenter.push(frame)
        answered.append(len(answers))
        results += answers
    results += segmenter.flush()
    assert_sound(results)
    # It is known only in the twelfth frame, when one result waits as a rule.
    assert all(len(result.objects) == 1 for result in results[4:])
    # Frame 24 ends the warm-up, from when on two are segmented for each that comes.
    assert answered[:25] == [0] * 25
    assert max(answered) <= 3


@pytest.mark.parametrize("mode", ["centred", "causal"])
def test_motion_may_be_measured_less_often_than_frames_are_compared_over(mode: str) -> None:
    seldom = {"latency.mode": mode, "flow.interval": 1, "flow.every": 8, "outline.key_step": 5}
    found = segmented(CLIP, PARAMETERS.replace(seldom))
    assert stamps(found) == list(range(len(CLIP)))
    assert_sound(found)


def test_without_look_ahead_the_square_is_found_all_the_same() -> None:
    found = segmented(CLIP, PARAMETERS.replace({"latency.mode": "causal"}))
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(found)]
    assert np.mean(overlap[14:]) > 0.5


class MeasuredFrames(StageObserver):
    """Notes the stamps of the frames for which motion was measured."""

    def __init__(self) -> None:
        self.stamps: list[int] = []

    def motion(self, stamp: int, moving: Moving) -> None:
        if moving.measured:
            self.stamps.append(stamp)


def answered_at_once(
    change: dict[str, object], waiting: int = 0
) -> tuple[list[SegmentationResult], list[int]]:
    """Return the results of the clip without look-ahead, and where motion was measured."""
    chosen = {"latency.mode": "causal", "refine.mode": "none"} | change
    measured_in = MeasuredFrames()
    with motion_segmenter(PARAMETERS.replace(chosen), measured_in) as segmenter:
        found = [result for frame in frames(CLIP) for result in segmenter.push(frame, waiting)]
        found += segmenter.flush()
    return found, measured_in.stamps


def test_without_look_ahead_motion_is_measured_more_often_until_all_is_decided() -> None:
    found, answers = answered_at_once({})
    every = PARAMETERS.flow.every
    first = next(number for number, result in enumerate(found) if result.objects)
    assert first <= 8
    # The first ones have nothing to be compared with; what is measured is a frame or two late.
    undecided = [number for number in answers if every // 2 < number <= first]
    assert set(np.diff(undecided)) == {every // 2}
    decided = [number for number in answers if number > first + every]
    assert set(np.diff(decided)) == {every}


def test_without_look_ahead_motion_is_measured_no_more_often_while_frames_wait() -> None:
    every, waiting = PARAMETERS.flow.every, PARAMETERS.latency.coast_from
    _, answers = answered_at_once({}, waiting)
    assert set(np.diff([number for number in answers if number > every])) == {every}


def test_without_look_ahead_motion_may_be_measured_in_every_frame() -> None:
    _, answers = answered_at_once({"flow.every": 1})
    assert set(np.diff([number for number in answers if number > 4])) == {1}


def test_a_flushed_stream_goes_on() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    assert segmenter.flush() == []
    found = []
    for part in (range(7), range(7, 8), range(8, 22)):
        for frame in frames([CLIP[k] for k in part], first=part.start):
            found += segmenter.push(frame)
        found += segmenter.flush()
        assert segmenter.flush() == []
    assert stamps(found) == list(range(22))
    assert_sound(found)
    assert len(ids(found[12:])) == 1


def test_two_runs_give_the_same_labels(results: list[SegmentationResult]) -> None:
    cv2.setRNGSeed(12345)
    for first, second in zip(results, segmented(CLIP), strict=True):
        np.testing.assert_array_equal(first.labels, second.labels)
        assert first.objects == second.objects
        # OpenCV's magnitude may differ in the last bit, as memory happens to lie.
        np.testing.assert_allclose(first.motion_map, second.motion_map, rtol=1e-5)


def sixteen_bits(image: ByteImage) -> np.ndarray:
    return image.astype(np.uint16) * 20 + 2000


def in_colour(image: ByteImage) -> ByteImage:
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize(
    "convert",
    [sixteen_bits, in_colour, lambda image: image.astype(np.float32) / 255],
    ids=["uint16", "colour", "float32"],
)
def test_any_kind_of_image_will_do(convert) -> None:
    found = segmented(map(convert, CLIP[:16]))
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(found)]
    assert np.mean(overlap[5:]) > 0.7
    assert_sound(found)


def test_images_may_be_views_that_can_not_be_written(results: list[SegmentationResult]) -> None:
    padded = []
    for image in CLIP[:12]:
        wide = np.zeros((SHAPE[0], SHAPE[1] + 13), np.uint8)
        wide[:, : SHAPE[1]] = image
        wide.flags.writeable = False
        padded.append(wide[:, : SHAPE[1]])
    for first, second in zip(segmented(CLIP[:12]), segmented(padded), strict=True):
        np.testing.assert_array_equal(first.labels, second.labels)


@pytest.mark.parametrize(
    "change",
    [lambda image: image[8:-8, 12:-12], sixteen_bits, in_colour],
    ids=["size", "depth", "colour"],
)
def test_a_change_of_the_image_in_mid_stream_starts_a_new_window(change) -> None:
    found = segmented([*CLIP[:8], *map(change, CLIP[8:26])])
    assert stamps(found) == list(range(26))
    assert_sound(found)
    before, after = ids(found[:8]), ids(found[8:])
    assert before == {1}
    assert after
    assert min(after) > max(before)


def pushed(segmenter: MotionSegmenter) -> list[SegmentationResult]:
    """Push the clip; return the results of its first frames, the others not being due yet."""
    return [result for frame in frames(CLIP) for result in segmenter.push(frame)]


def test_ids_go_on_after_a_reset_and_other_parameters() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    assert ids(pushed(segmenter)) == {1}
    segmenter.reset()
    assert segmenter.flush() == []
    assert ids(pushed(segmenter)) == {2}
    segmenter.reconfigure(PARAMETERS.replace({"seed.delta1": 6.0}))
    assert segmenter.flush() == []
    assert ids(pushed(segmenter)) == {3}


def test_other_parameters_are_followed() -> None:
    # A target that was followed is an object at once, however often that asks for it to be seen.
    parameters = PARAMETERS.replace({"seed.small_targets": False})
    segmenter = segmenter_by_rules(parameters)
    pushed(segmenter)
    segmenter.reconfigure(parameters.replace({"tracking.min_hits": 30}))
    assert not ids(pushed(segmenter) + segmenter.flush())


def shimmering(rms: float, count: int, shift: tuple[int, int] = (0, 0)) -> list[ByteImage]:
    """A scene with nothing in it through turbulence: tilt that is smooth in space and time.

    :param shift: by how many pixels the camera pans from frame to frame.
    """
    random = np.random.default_rng(3)
    ground = texture((SHAPE[0] + 60, SHAPE[1] + 100), seed=1)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32) + np.float32(30)
    tilt = np.zeros((2, *SHAPE), np.float32)
    images = []
    for number in range(count):
        fresh = np.stack([cv2.GaussianBlur(f, (0, 0), 8) for f in random.normal(size=tilt.shape)])
        tilt = 0.6 * tilt + 0.8 * rms * fresh / fresh.std()
        at = [
            (p + number * s + t).astype(np.float32)
            for p, s, t in zip((x, y), shift, tilt, strict=True)
        ]
        image = cv2.remap(ground, at[0], at[1], cv2.INTER_LINEAR)
        images.append(np.clip(image + random.normal(0, 2, SHAPE), 0, 255).astype(np.uint8))
    return images


@pytest.mark.parametrize("rms", [0.2, 1.0])
def test_an_empty_scene_that_shimmers_has_no_objects(rms: float) -> None:
    found = segmented(shimmering(rms, 20))
    assert not any(result.labels.any() for result in found)
    assert not ids(found)
    assert_sound(found)


def test_an_empty_scene_that_the_camera_pans_over_has_no_objects() -> None:
    found = segmented(shimmering(0.3, 16, shift=(2, -1)))
    assert not any(result.labels.any() for result in found)


def test_more_turbulence_is_measured_as_more() -> None:
    # At this resolution flow smooths a part of the tilt away.
    for rms in (0.2, 0.6):
        tilt = np.nanmedian([result.tilt for result in segmented(shimmering(rms, 12))])
        assert 0.5 * rms < tilt < 1.2 * rms


RANDOM = np.random.default_rng(0)
EMPTY_CLIPS = {
    "constant": [np.full(SHAPE, 90, np.uint8)] * 10,
    "black": [np.zeros(SHAPE, np.uint8)] * 10,
    "saturated": [np.full(SHAPE, 255, np.uint8)] * 10,
    "flashing": [np.full(SHAPE, 255 * (k % 2), np.uint8) for k in range(10)],
    "noise": list(RANDOM.integers(0, 256, (10, *SHAPE)).astype(np.uint8)),
    "noise, 16 bits": list(RANDOM.integers(0, 65536, (10, *SHAPE)).astype(np.uint16)),
    "no number": [np.full(SHAPE, np.nan, np.float32)] * 10,
}


@pytest.mark.parametrize("clip", EMPTY_CLIPS.values(), ids=EMPTY_CLIPS.keys())
def test_pictures_that_show_nothing_give_no_objects_and_no_nonsense(clip: list) -> None:
    found = segmented(clip)
    assert_sound(found)
    assert not any(result.labels.any() for result in found)


@pytest.mark.parametrize("shape", [(16, 16), (20, 200), (200, 20), (65, 97)], ids=str)
def test_any_shape_of_picture_is_answered(shape: tuple[int, int]) -> None:
    images = [np.roll(texture(shape, seed=1), k, axis=1) for k in range(10)]
    found = segmented(images, PARAMETERS.replace({"resolution.processing": 128}))
    assert stamps(found) == list(range(10))
    assert_sound(found)


@pytest.mark.parametrize("grey", [0, 255], ids=["black", "burnt"])
def test_one_frame_that_shows_nothing_spoils_no_other(grey: int) -> None:
    images = [*CLIP[:14], np.full(SHAPE, grey, np.uint8), *CLIP[15:]]
    found = segmented(images)
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(found)]
    assert np.mean(overlap[19:]) > 0.7
    assert ids(found) == {1}


def test_the_papers_preset_gives_disjoint_objects_at_the_end() -> None:
    segmenter = segmenter_by_rules(PAPER)
    for frame in frames(CLIP[:10]):
        assert segmenter.push(frame) == []
    found = segmenter.flush()
    assert stamps(found) == list(range(10))
    assert_sound(found)
    assert all(result.ego_motion_model == "fundamental" for result in found)
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(found)]
    assert max(overlap) > 0.5
    assert ids(found)
