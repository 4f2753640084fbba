"""Whether scores are held against what was found in earnest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from turbseg_ros.evaluation.reliability import EDGES, ScoreBin, binned, judged, pooled
from turbseg_ros.messages.detections import Detection
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult


def result(**scores: float) -> SegmentationResult:
    """Two squares, `first` and `second`, with scores."""
    labels = np.zeros((40, 60), np.uint16)
    labels[5:15, 5:15], labels[20:30, 40:50] = 1, 2
    objects = tuple(
        MovingObject.from_mask(labels == number, number, score=score)
        for number, score in enumerate(scores.values(), start=1)
    )
    empty = SegmentationResult.empty(Frame(0, np.zeros(labels.shape, np.uint8)))
    return replace(empty, labels=labels, objects=objects)


@pytest.mark.parametrize("true_id", [7, 255])
def test_objects_are_true_where_the_truths_labels_are(true_id: int) -> None:
    found = result(first=0.9, second=0.3)
    truth = np.where(found.labels == 1, true_id, 0).astype(np.uint16)
    assert list(judged(found, truth)) == [(0.9, True), (0.3, False)]
    nothing_counts = np.where(found.labels == 2, 255, 0).astype(np.uint16)
    assert list(judged(found, truth, nothing_counts)) == [(0.9, True)]


def test_objects_are_true_where_a_box_is_touched() -> None:
    found = result(first=0.9, second=0.3)
    assert list(judged(found, (Detection((38.0, 18.0, 5.0, 5.0), "a"),))) == [
        (0.9, False),
        (0.3, True),
    ]


def test_scores_are_counted_in_their_bins() -> None:
    bins = binned([(0.2, False), (0.9, True), (0.93, False), (1.0, True)])
    assert len(bins) == len(EDGES) - 1
    assert sum(each.objects for each in bins) == 4
    (nineties,) = [each for each in bins if each.objects == 2]
    assert (nineties.true, nineties.share_true) == (1, 0.5)
    assert nineties.mean_score == pytest.approx(0.915)
    assert bins[-1] == ScoreBin(1, 1, 1.0)
    assert bins[1].mean_score is None
    doubled = pooled([bins, bins])
    assert [each.objects for each in doubled] == [2 * each.objects for each in bins]
