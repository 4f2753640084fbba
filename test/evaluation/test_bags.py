"""Bags through a segmenter, and against their truth; the segmenter here is a threshold."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import Image

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IMAGE_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.evaluation.evaluate import (
    EvaluationError,
    evaluate_labels,
    evaluate_segmenter,
)
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels, read_labels
from turbseg_ros.messages.images import message_from_image
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, segment

MILLISECOND = 1_000_000


class BrightAreas:
    """Answers each frame two frames late: what is brighter than 100 is the object with id 4."""

    def __init__(self) -> None:
        self._waiting: deque[Frame] = deque()

    def push(self, frame: Frame) -> list[SegmentationResult]:
        self._waiting.append(frame)
        return [self._result(self._waiting.popleft())] if len(self._waiting) > 2 else []

    def flush(self) -> list[SegmentationResult]:
        return [self._result(self._waiting.popleft()) for _ in range(len(self._waiting))]

    @staticmethod
    def _result(frame: Frame) -> SegmentationResult:
        labels = np.where(frame.image > 100, 4, 0).astype(np.uint16)
        tilt = math.nan if frame.stamp == 0 else 0.4
        return SegmentationResult(frame, labels, (), np.zeros((4, 5), np.float32), tilt, "affine")


def picture(number: int) -> np.ndarray:
    """A bright 8x8 square on 48x64 that moves to the right, 3 pixels a frame."""
    image = np.full((48, 64), 40, np.uint8)
    image[20:28, 3 * number : 3 * number + 8] = 200
    return image


def write_bag(path: Path, frames: int = 6, truth: Iterable[int] | None = None) -> Path:
    """Frames 10 ms apart, and the exact truth of those that are listed (of all by default)."""
    known = range(frames) if truth is None else truth
    with BagWriter(path) as writer:
        for number in range(frames):
            stamp = number * 10 * MILLISECOND
            image = picture(number)
            writer.write(IMAGE_TOPIC, message_from_image(image, "mono8", stamp, "lens"), stamp)
            if number in known:
                labels = (image > 100).astype(np.uint8)
                writer.write(TRUTH_TOPIC, message_from_image(labels, "mono8", stamp), stamp)
    return path


def test_every_frame_gets_its_result_in_order(tmp_path: Path) -> None:
    frames = BagFrames(BagReader(write_bag(tmp_path / "bag")), IMAGE_TOPIC)
    results = list(segment(frames, BrightAreas()))
    assert len(frames) == 6
    assert [result.frame.stamp for result in results] == [n * 10 * MILLISECOND for n in range(6)]
    assert {result.frame.frame_id for result in results} == {"lens"}
    np.testing.assert_array_equal(results[5].frame.image, picture(5))


def test_unreadable_images_are_skipped_and_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        for number in range(5):
            message = message_from_image(picture(number), "mono8", number)
            if number in (1, 2, 4):
                message.encoding = "no_such_encoding"
            writer.write(IMAGE_TOPIC, message, number)
        writer.write_serialized(IMAGE_TOPIC, "sensor_msgs/msg/Image", b"\0\1\0\0\7", 5)
    frames = BagFrames(BagReader(path), IMAGE_TOPIC)
    with caplog.at_level(logging.WARNING):
        assert [frame.stamp for frame in frames] == [0, 3]
    assert frames.skipped == 4
    # Of each kind, the first is told.
    unknown, broken = (record.getMessage() for record in caplog.records)
    assert unknown.startswith("image 1 of /camera/image_raw skipped")
    assert "no_such_encoding" in unknown
    assert broken.startswith("image 5 of /camera/image_raw skipped")


def test_a_perfect_segmenter_scores_one(tmp_path: Path) -> None:
    reader = BagReader(write_bag(tmp_path / "bag"))
    truth = LabelsByStamp(read_labels(reader, TRUTH_TOPIC))
    scores = evaluate_segmenter("bag", BagFrames(reader, IMAGE_TOPIC), BrightAreas(), truth)
    assert (scores.frames, scores.scored_frames, scores.id_switches) == (6, 6, 0)
    assert scores.j == scores.dice == scores.g == scores.boundary_f == 1.0
    assert scores.tilt_px == 0.4
    assert scores.fps is not None
    assert scores.fps > 0
    assert scores.ms_p50 is not None


def test_frames_without_truth_are_left_out(tmp_path: Path) -> None:
    reader = BagReader(write_bag(tmp_path / "bag", truth=(2, 4)))
    truth = LabelsByStamp(read_labels(reader, TRUTH_TOPIC))
    scores = evaluate_segmenter("bag", BagFrames(reader, IMAGE_TOPIC), BrightAreas(), truth)
    assert (scores.frames, scores.scored_frames) == (6, 2)


def test_truth_scored_against_itself_is_perfect(tmp_path: Path) -> None:
    reader = BagReader(write_bag(tmp_path / "bag"))
    scores = evaluate_labels(
        "bag", read_labels(reader, TRUTH_TOPIC), LabelsByStamp(read_labels(reader, TRUTH_TOPIC))
    )
    assert (scores.j, scores.dice, scores.boundary_f, scores.id_switches) == (1.0, 1.0, 1.0, 0)
    assert scores.fps is None


def test_truth_keeps_labels_of_16_bits() -> None:
    labels = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 20
    truth = LabelsByStamp(iter([StampedLabels(7, labels)]))
    kept = truth.at(7)
    assert kept is not None
    assert kept.dtype == np.uint16
    np.testing.assert_array_equal(kept, labels)
    assert truth.at(8) is None


def test_labels_that_no_truth_belongs_to_are_an_error(tmp_path: Path) -> None:
    truth = LabelsByStamp(read_labels(BagReader(write_bag(tmp_path / "bag")), TRUTH_TOPIC))
    late = StampedLabels(77, np.zeros((48, 64), np.uint16))
    with pytest.raises(EvaluationError, match="none of 1 frames has a truth"):
        evaluate_labels("bag", [late], truth)


def test_truth_of_another_size_is_an_error(tmp_path: Path) -> None:
    truth = LabelsByStamp(read_labels(BagReader(write_bag(tmp_path / "bag")), TRUTH_TOPIC))
    small = StampedLabels(0, np.zeros((24, 32), np.uint16))
    with pytest.raises(EvaluationError, match=r"bag: truth of 64x48 doesn't fit labels of 32x24"):
        evaluate_labels("bag", [small], truth)


def test_a_bag_without_truth_names_its_topics(tmp_path: Path) -> None:
    reader = BagReader(write_bag(tmp_path / "bag", truth=()))
    with pytest.raises(BagError, match="has no /ground_truth/labels; its topics: /camera/image"):
        list(read_labels(reader, TRUTH_TOPIC))


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (message_from_image(np.zeros((4, 4, 3), np.uint8), "bgr8", 0), "holds bgr8 images"),
        (message_from_image(np.zeros((4, 4), np.float32), "32FC1", 0), "holds 32FC1 images"),
        (Image(width=4, height=4, encoding="mono8", step=4), "data is too short"),
    ],
)
def test_truth_must_be_label_images(tmp_path: Path, message: Image, text: str) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(TRUTH_TOPIC, message, 0)
    with pytest.raises(BagError, match=text):
        list(read_labels(BagReader(tmp_path / "bag"), TRUTH_TOPIC))
