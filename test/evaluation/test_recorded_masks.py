"""Folders of masks that others made, as baselines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.evaluation.recorded_masks import RecordedMasks
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, segment

SHAPE = (30, 40)
FRAMES = 4


def mask(column: int, value: int = 255) -> np.ndarray:
    image = np.zeros(SHAPE, np.uint8)
    image[10:20, column : column + 5] = value
    return image


def written(folder: Path, masks: Sequence[np.ndarray], names: Sequence[str] = ()) -> Path:
    folder.mkdir(parents=True)
    for number, image in enumerate(masks):
        name = names[number] if names else f"{number:05}"
        cv2.imwrite(str(folder / f"{name}.png"), image)
    return folder


def results(method: RecordedMasks, clip: str, count: int = FRAMES) -> list[SegmentationResult]:
    frames = (Frame(number, np.zeros(SHAPE, np.uint8)) for number in range(count))
    return list(segment(frames, method.segmenter(clip, count)))


def test_each_clip_has_a_folder_and_its_masks_come_in_order(tmp_path: Path) -> None:
    written(tmp_path / "car", [mask(3 * n) for n in range(FRAMES)], ["f1", "f2", "f10", "f11"])
    written(tmp_path / "van", [mask(30)] * FRAMES)
    method = RecordedMasks.of("theirs", tmp_path)
    assert (method.name, method.keeps_ids, method.recorded) == ("theirs", False, True)
    for number, result in enumerate(results(method, "car")):
        assert np.array_equal(result.labels, mask(3 * number, 1))
        assert [each.id for each in result.objects] == [1]
    assert results(method, "van")[0].labels[15, 32] == 1


def test_a_folder_of_masks_alone_is_that_of_the_clip(tmp_path: Path) -> None:
    folder = written(tmp_path / "any", [mask(3)] * FRAMES)
    assert results(RecordedMasks.of("theirs", folder), "car")[0].labels.any()


def test_where_masks_are_missing_their_names_tell_the_frame(tmp_path: Path) -> None:
    written(tmp_path / "car", [mask(3), mask(9)], ["00001", "00003"])
    found = results(RecordedMasks.of("theirs", tmp_path), "car")
    assert [bool(result.labels.any()) for result in found] == [False, True, False, True]
    assert found[3].labels[15, 9]


@pytest.mark.parametrize("names", [["a", "b"], ["1", "9"]])
def test_names_that_do_not_tell_the_frame_are_refused(tmp_path: Path, names: list[str]) -> None:
    written(tmp_path / "car", [mask(3), mask(9)], names)
    with pytest.raises(ClipError, match=r"2 masks for 4 frames.*from 0"):
        RecordedMasks.of("theirs", tmp_path).segmenter("car", FRAMES)


def test_labels_keep_their_ids_and_unions_are_taken_apart(tmp_path: Path) -> None:
    two = [mask(3, 1) + mask(20, 2)] * FRAMES
    written(tmp_path / "labels" / "car", [np.zeros(SHAPE, np.uint8), *two[1:]])
    labelled = RecordedMasks.of("labels", tmp_path / "labels")
    assert labelled.keeps_ids
    assert np.array_equal(results(labelled, "car")[1].labels, two[0])
    written(tmp_path / "unions" / "car", [mask(3) + mask(20)] * FRAMES)
    union = RecordedMasks.of("unions", tmp_path / "unions")
    assert not union.keeps_ids
    assert [each.area for each in results(union, "car")[0].objects] == [50, 50]


def test_what_is_not_there_or_does_not_fit_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="no such folder"):
        RecordedMasks.of("theirs", tmp_path / "missing")
    with pytest.raises(ClipError, match="holds no masks"):
        RecordedMasks.of("theirs", tmp_path)
    written(tmp_path / "car", [mask(3)[:20]] * FRAMES)
    method = RecordedMasks.of("theirs", tmp_path)
    with pytest.raises(ClipError, match="no masks of van; name their folder van"):
        method.segmenter("van", FRAMES)
    with pytest.raises(ClipError, match="masks of 40x20 don't fit frames of 40x30"):
        results(method, "car")
