"""The scores of one bag: of a segmenter at work, or of labels that were recorded."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.replay import Segmenter, segment
from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.segmentation.frame import Frame, SegmentationResult


class EvaluationError(Exception):
    """Labels and truth that don't go together; the text says why."""


def evaluate_segmenter(
    bag: str, frames: Iterable[Frame], segmenter: Segmenter, truth: LabelsByStamp
) -> BagScores:
    """Segment the frames of a bag and score the results.

    :raises EvaluationError: when no frame has a truth, or one of another size.
    """
    measured = _MeasuredSegmenter(segmenter)
    labels = (
        StampedLabels(result.frame.stamp, result.labels) for result in segment(frames, measured)
    )
    return _evaluate(bag, labels, truth, measured.measurements)


def evaluate_labels(bag: str, labels: Iterable[StampedLabels], truth: LabelsByStamp) -> BagScores:
    """Score labels that were recorded, from a live node for instance.

    :raises EvaluationError: when no labels have a truth, or one of another size.
    """
    return _evaluate(bag, labels, truth, Measurements())


def _evaluate(
    bag: str,
    predictions: Iterable[StampedLabels],
    truth: LabelsByStamp,
    measurements: Measurements,
) -> BagScores:
    scorer = Scorer()
    frames = 0
    for prediction in predictions:
        frames += 1
        true_labels = truth.at(prediction.stamp)
        if true_labels is not None:
            try:
                scorer.add(prediction.labels, true_labels)
            except ValueError as error:
                raise EvaluationError(f"{bag}: {error}") from error
    scores = scorer.scores(bag, frames, measurements)
    if not scores.scored_frames:
        raise EvaluationError(
            f"{bag}: none of {frames} frames has a truth with its stamp ({len(truth)} in the bag)"
        )
    return scores


class _MeasuredSegmenter:
    """A segmenter that is timed and whose results' tilts are noted."""

    def __init__(self, segmenter: Segmenter) -> None:
        self._segmenter = segmenter
        self.measurements = Measurements()

    def push(self, frame: Frame) -> Sequence[SegmentationResult]:
        start = time.perf_counter()
        results = self._segmenter.push(frame)
        self.measurements.push_seconds.append(time.perf_counter() - start)
        return self._noted(results)

    def flush(self) -> Sequence[SegmentationResult]:
        start = time.perf_counter()
        results = self._segmenter.flush()
        self.measurements.flush_seconds = time.perf_counter() - start
        return self._noted(results)

    def _noted(self, results: Sequence[SegmentationResult]) -> Sequence[SegmentationResult]:
        self.measurements.tilts += [result.tilt for result in results]
        return results
