"""Whether scores are what they say: of objects with a score of 0.9, nine in ten should be true."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from turbseg_ros.evaluation.boxes import box_overlaps
from turbseg_ros.evaluation.metrics import Labels, false_ids, object_overlaps, true_components
from turbseg_ros.evaluation.truth import Boxes
from turbseg_ros.segmentation.frame import MovingObject, SegmentationResult

EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)
"""Where the bins of scores begin and end."""


@dataclass(frozen=True)
class ScoreBin:
    """Objects, frame by frame, whose scores lie in one bin.

    `objects` counts them, `true` those of them that are; `total` is the sum of their scores.
    """

    objects: int = 0
    true: int = 0
    total: float = 0.0

    @property
    def mean_score(self) -> float | None:
        """The share of them that should be true, None where there are none."""
        return self.total / self.objects if self.objects else None

    @property
    def share_true(self) -> float | None:
        """The share of them that is true, None where there are none."""
        return self.true / self.objects if self.objects else None


def judged(
    result: SegmentationResult, truth: Labels | Boxes, ignored: Labels | None = None
) -> Iterable[tuple[float, bool]]:
    """Yield each object's score and whether it is true; those that don't count are left out.

    :param truth: labels or boxes of its frame.
    :param ignored: non-zero where nothing counts.
    """
    if isinstance(truth, tuple):
        overlaps = box_overlaps(result.labels, truth, ignored)
        touched = overlaps.shared.sum(axis=0).tolist()
        wrong = [i for i, area in zip(overlaps.predicted_ids, touched, strict=True) if not area]
    else:
        overlaps = object_overlaps(result.labels, truth)
        if not overlaps.tells_objects_apart:
            overlaps = object_overlaps(result.labels, true_components(truth))
        wrong = list(false_ids(overlaps))
    for found in result.objects:
        if found.label in overlaps.predicted_ids and not _is_ignored(found, result, ignored):
            yield found.score, found.label not in wrong


def binned(scores: Iterable[tuple[float, bool]]) -> tuple[ScoreBin, ...]:
    """Count scores, and whether they were of true objects, in the bins between `EDGES`."""
    bins = [ScoreBin() for _ in EDGES[1:]]
    for score, true in scores:
        number = sum(score >= edge for edge in EDGES[1:-1])
        known = bins[number]
        bins[number] = ScoreBin(known.objects + 1, known.true + int(true), known.total + score)
    return tuple(bins)


def pooled(bags: Sequence[Sequence[ScoreBin]]) -> tuple[ScoreBin, ...]:
    """Return the bins of several bags as one's."""
    return tuple(
        ScoreBin(
            sum(each.objects for each in bins),
            sum(each.true for each in bins),
            sum(each.total for each in bins),
        )
        for bins in zip(*bags, strict=True)
    )


def _is_ignored(found: MovingObject, result: SegmentationResult, ignored: Labels | None) -> bool:
    if ignored is None:
        return False
    there = ignored[result.labels == found.label]
    return bool(there.any()) and 2 * int((there != 0).sum()) >= there.size
