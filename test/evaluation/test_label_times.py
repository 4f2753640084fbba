"""Truth finds its frame whatever the stamps say: of another clock, standing still or not set."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IMAGE_TOPIC, LABELS_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli import replay
from turbseg_ros.evaluation.evaluate import EvaluationError, evaluate_labels, evaluate_segmenter
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels, read_labels
from turbseg_ros.messages.images import message_from_image
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

FRAMES = 30
START = 1_700_000_000 * 10**9
# Repeated stamps, which may be the same message again until the third.
SKIPPED = 2
Stamps = Callable[[int], int]
KINDS: dict[str, Stamps] = {
    "epoch": lambda recorded: recorded,
    "not set": lambda _: 0,
    "standing still": lambda _: START - 5 * 10**9 + 7,
    "whole seconds": lambda recorded: recorded // 10**9 * 10**9,
    "since boot": lambda recorded: recorded - START + 3 * 10**9,
}


class BrightAreas:
    """What is brighter than 100 is the object with id 4."""

    def __init__(self, _parameters: Parameters | None = None) -> None:
        self.frames: list[Frame] = []

    def push(self, frame: Frame) -> list[SegmentationResult]:
        self.frames.append(frame)
        labels = np.where(frame.image > 100, 4, 0).astype(np.uint16)
        return [SegmentationResult(frame, labels, (), np.zeros((4, 5), np.float32), 0.1, "none")]

    def flush(self) -> list[SegmentationResult]:
        return []


def picture(number: int) -> np.ndarray:
    image = np.full((48, 120), 40, np.uint8)
    image[20:28, 3 * number : 3 * number + 8] = 200
    return image


def recorded(number: int, hz: float) -> int:
    return START + round(number * 1e9 / hz)


def write_bag(
    path: Path,
    image_stamp: Stamps,
    truth_stamp: Stamps | None = None,
    hz: float = 30.0,
    every: int = 1,
    delay: int = 0,
) -> BagReader:
    with BagWriter(path) as writer:
        for number in range(FRAMES):
            time = recorded(number, hz)
            image = message_from_image(picture(number), "mono8", image_stamp(time), "lens")
            writer.write(IMAGE_TOPIC, image, time)
            if number % every == 0:
                labels = (picture(number) > 100).astype(np.uint8)
                stamp = (truth_stamp or image_stamp)(time)
                writer.write(TRUTH_TOPIC, message_from_image(labels, "mono8", stamp), time + delay)
    return BagReader(path)


def skips(kind: str) -> int:
    return SKIPPED if kind in ("standing still", "whole seconds") else 0


def truth_of(reader: BagReader) -> LabelsByStamp:
    return LabelsByStamp(read_labels(reader, TRUTH_TOPIC))


@pytest.mark.parametrize("hz", [0.2, 30.0, 240.0])
@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("truth_stamp", KINDS)
@pytest.mark.parametrize("image_stamp", KINDS)
def test_each_truth_belongs_to_its_frame(
    tmp_path: Path, image_stamp: str, truth_stamp: str, every: int, hz: float
) -> None:
    if hz == 0.2 and "whole seconds" in (image_stamp, truth_stamp):
        pytest.skip("these are stamps like others")
    reader = write_bag(tmp_path / "bag", KINDS[image_stamp], KINDS[truth_stamp], hz, every)
    frames = BagFrames(reader, IMAGE_TOPIC)
    scores = evaluate_segmenter("bag", frames, BrightAreas(), truth_of(reader))
    skipped = skips(image_stamp)
    assert scores.frames == FRAMES - skipped
    assert scores.scored_frames == len(set(range(0, FRAMES, every)) - set(range(1, 1 + skipped)))
    assert scores.j == 1.0


@pytest.mark.parametrize("kind", ["not set", "standing still"])
def test_truth_that_was_recorded_a_little_later_belongs_to_its_frame(
    tmp_path: Path, kind: str
) -> None:
    reader = write_bag(tmp_path / "bag", KINDS[kind], delay=3_000_000)
    scores = evaluate_segmenter(
        "bag", BagFrames(reader, IMAGE_TOPIC), BrightAreas(), truth_of(reader)
    )
    assert (scores.scored_frames, scores.j) == (FRAMES - skips(kind), 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_replayed_labels_are_recorded_with_their_image_and_find_their_truth(
    tmp_path: Path,
    kind: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(replay, "clip_segmenter", lambda parameters, _: BrightAreas(parameters))
    reader = write_bag(tmp_path / "bag", KINDS[kind])
    with caplog.at_level(logging.WARNING):
        assert replay.main([str(tmp_path / "bag"), "-o", str(tmp_path / "out")]) == 0
    says_nothing = kind in ("not set", "standing still", "whole seconds")
    assert caplog.text.count("stamps are unusable") == says_nothing
    labels = list(read_labels(BagReader(tmp_path / "out"), LABELS_TOPIC))
    numbers = [0, *range(1 + skips(kind), FRAMES)]
    times = [recorded(number, 30.0) for number in numbers]
    assert [item.recorded for item in labels] == times
    if kind in ("epoch", "since boot"):
        assert [item.stamp for item in labels] == [KINDS[kind](time) for time in times]
    scores = evaluate_labels("bag", labels, truth_of(reader))
    assert (scores.scored_frames, scores.j) == (len(numbers), 1.0)


def test_labels_of_another_recording_without_stamps_go_by_their_order(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    truth = truth_of(write_bag(tmp_path / "bag", KINDS["not set"]))
    labels = [
        StampedLabels(0, (picture(n) > 100).astype(np.uint16), START // 2 + n * 33_000_000)
        for n in range(FRAMES)
    ]
    with caplog.at_level(logging.WARNING):
        assert evaluate_labels("bag", labels, truth).j == 1.0
    assert caplog.text.count("in their order") == 1
    with pytest.raises(EvaluationError, match="none of 29 frames"):
        evaluate_labels("bag", labels[1:], truth)


def test_frames_after_a_gap_or_a_jump_begin_a_stream(tmp_path: Path) -> None:
    times = [START + round(n * 1e9 / 30) for n in range(20)]
    later = [time + 20 * 10**9 for time in times]
    with BagWriter(tmp_path / "bag") as writer:
        for number, time in enumerate([*times, *later, *times]):
            image = message_from_image(picture(number % FRAMES), "mono8", time)
            writer.write(IMAGE_TOPIC, image, START + number * 33_000_000)
    frames = list(BagFrames(BagReader(tmp_path / "bag"), IMAGE_TOPIC))
    assert [number for number, frame in enumerate(frames) if frame.begins_stream] == [20, 40]
