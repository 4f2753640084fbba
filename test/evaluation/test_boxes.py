"""Labels against true boxes: frame by frame, and by whole bags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IGNORED_TOPIC, TRUTH_BOXES_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.evaluation.boxes import box_overlaps
from turbseg_ros.evaluation.evaluate import EvaluationError, evaluate_labels
from turbseg_ros.evaluation.labels import StampedLabels
from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.evaluation.truth import read_ignored, read_truth
from turbseg_ros.messages.detections import (
    IGNORED,
    TYPE_NAME,
    Box,
    Detection,
    serialised_detections,
)
from turbseg_ros.messages.images import message_from_image

SHAPE = (40, 50)
MILLISECOND = 1_000_000


def found(*boxes: Box, first: int = 1) -> np.ndarray:
    """Return labels of filled boxes, numbered from `first`."""
    labels = np.zeros(SHAPE, np.uint16)
    for number, box in enumerate(boxes, start=first):
        left, top, width, height = map(int, box)
        labels[top : top + height, left : left + width] = number
    return labels


def true(*boxes: Box) -> list[Detection]:
    return [Detection(box, str(number)) for number, box in enumerate(boxes, start=1)]


def scored(
    *frames: tuple[np.ndarray, Sequence[Detection]], ignored: np.ndarray | None = None
) -> BagScores:
    scorer = Scorer()
    for labels, boxes in frames:
        scorer.add_boxes(labels, boxes, ignored)
    return scorer.scores("one", len(frames), Measurements())


def test_overlaps_are_those_of_the_boxes_around_objects() -> None:
    labels = found((10, 10, 10, 10))
    labels[12:18, 12:18] = 0  # a ring has the box of a disk
    overlaps = box_overlaps(labels, true((10, 10, 10, 10), (15, 10, 10, 10), (40, 30, 5, 5)))
    assert overlaps.iou[:, 0] == pytest.approx([1.0, 1 / 3, 0.0])
    assert overlaps.true_ids == ("1", "2", "3")
    assert overlaps.predicted_ids == (1,)


def test_hits_are_shares_of_true_boxes() -> None:
    box = (10, 10, 10, 10)
    scores = scored(
        (found(box), true(box)),
        (found((17, 10, 10, 10)), true(box)),
        (found(), true(box)),
        (found((30, 30, 5, 5)), []),
    )
    assert (scores.scored_frames, scores.j) == (4, None)
    assert (scores.hits, scores.hits_50) == pytest.approx((2 / 3, 1 / 3))
    assert scores.box_iou == pytest.approx((1 + 30 / 170) / 3)
    assert scores.false_objects == pytest.approx(1 / 4)
    assert (scores.false_object_frames, scores.false_alarm_frames) == (1, 1)
    assert scores.false_alarm_area == pytest.approx(25 / 2000)


def test_what_touches_a_loose_box_is_not_false_and_no_id_switch() -> None:
    loose = (5, 5, 30, 30)
    scores = scored((found((6, 6, 3, 3)), true(loose)), (found((9, 6, 3, 3)), true(loose)))
    assert (scores.hits, scores.false_objects, scores.id_switches) == (1.0, 0.0, 0)
    other = scored((found((6, 6, 3, 3)), true(loose)), (found((9, 6, 3, 3), first=2), true(loose)))
    assert (other.id_switches, other.ids_per_object) == (1, 2.0)


def test_beside_a_partial_truth_nothing_is_false() -> None:
    labels = found((10, 10, 10, 10), (30, 30, 5, 5))
    everywhere = np.full(SHAPE, 255, np.uint8)
    whole, part = (
        scored((labels, true((10, 10, 10, 10))), ignored=ignored) for ignored in (None, everywhere)
    )
    assert (whole.false_objects, whole.false_ids, whole.mota) == (1.0, 1, 0.0)
    assert (part.false_objects, part.false_ids, part.mota) == (0.0, 0, 1.0)
    assert part.hits == 1.0


def test_alarms_count_in_still_regions_only() -> None:
    moving = np.zeros(SHAPE, np.uint8)
    moving[:, 25:] = 1
    labels = found((5, 5, 5, 5), (22, 5, 10, 5), (40, 5, 5, 5))
    scores = scored((labels, []), (found(), []), ignored=moving)
    assert (scores.false_objects, scores.false_object_frames, scores.false_ids) == (0.5, 1, 1)
    assert scores.hits is None
    assert scores.false_alarm_area == pytest.approx(25 / 2000 / 2)


def test_boxes_to_be_ignored_hide_what_lies_in_them() -> None:
    beside = [Detection((30, 30, 5, 5), "9", IGNORED)]
    scores = scored((found((30, 30, 5, 5), (40, 5, 5, 5)), beside))
    assert (scores.false_objects, scores.hits, scores.missed) == (1.0, None, None)


def test_an_ignored_region_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="25x40 doesn't fit labels of 50x40"):
        scored((found(), []), ignored=np.zeros((40, 25), np.uint8))


def write_truth(
    path: Path, boxes: Sequence[Sequence[Detection]], ignored: np.ndarray | None = None
) -> Path:
    with BagWriter(path) as bag:
        for number, its in enumerate(boxes, start=1):
            stamp = number * 10 * MILLISECOND
            bag.write_serialized(
                TRUTH_BOXES_TOPIC, TYPE_NAME, serialised_detections(its, stamp), stamp
            )
            if ignored is not None and number == 1:
                message = message_from_image(ignored, "mono8", stamp)
                bag.write(IGNORED_TOPIC, message, stamp)
    return path


def test_a_bag_of_boxes_is_scored_by_stamp(tmp_path: Path) -> None:
    box = (10, 10, 10, 10)
    everywhere = np.full(SHAPE, 255, np.uint8)
    reader = BagReader(write_truth(tmp_path / "bag", [true(box), [], true(box)], everywhere))
    labels = [
        StampedLabels(10 * MILLISECOND, found(box)),
        StampedLabels(20 * MILLISECOND, found((30, 30, 5, 5))),
        StampedLabels(30 * MILLISECOND, found()),
        StampedLabels(40 * MILLISECOND, found(box)),  # of which no truth tells
    ]
    scores = evaluate_labels("bag", labels, read_truth(reader, TRUTH_TOPIC), read_ignored(reader))
    assert (scores.frames, scores.scored_frames) == (4, 3)
    assert (scores.hits, scores.false_objects) == (0.5, 0.0)


def test_labels_that_no_boxes_belong_to_are_an_error(tmp_path: Path) -> None:
    reader = BagReader(write_truth(tmp_path / "bag", [[], []]))
    with pytest.raises(EvaluationError, match="none of 1 frames has a truth"):
        evaluate_labels("bag", [StampedLabels(7, found())], read_truth(reader, TRUTH_TOPIC))


def test_damaged_boxes_are_an_error(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_serialized(TRUTH_BOXES_TOPIC, TYPE_NAME, b"\0\1\0\0\1", 1)
    with pytest.raises(BagError, match="/ground_truth/detections"):
        read_truth(BagReader(tmp_path / "bag"), TRUTH_TOPIC)
