"""The scores of one bag: of a segmenter at work, or of labels that were recorded."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from typing import Protocol

from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, Segmenter, segment

_LOGGER = logging.getLogger(__name__)


class EvaluationError(Exception):
    """Labels and truth that don't go together; the text says why."""


class ResultObserver(Protocol):
    """Someone who is shown every result beside its truth, such as a draughtsman."""

    def add(self, result: SegmentationResult, truth: Labels | None) -> None:
        """Take the next result, and the truth of its frame where there is one."""


def evaluate_segmenter(
    bag: str,
    frames: Iterable[Frame],
    segmenter: Segmenter,
    truth: LabelsByStamp,
    observers: Sequence[ResultObserver] = (),
) -> BagScores:
    """Segment the frames of a bag and score the results.

    :raises EvaluationError: when no frame has a truth, or one of another size.
    """
    measured = _MeasuredSegmenter(segmenter)
    scorer = _TruthScorer(bag, truth)
    for result in segment(frames, measured):
        frame = result.frame
        prediction = StampedLabels(frame.stamp, result.labels, frame.received)
        true_labels = scorer.add(prediction, frame.period, same_recording=True)
        for observer in observers:
            observer.add(result, true_labels)
    return scorer.scores(measured.measurements)


def evaluate_labels(bag: str, labels: Iterable[StampedLabels], truth: LabelsByStamp) -> BagScores:
    """Score labels that were recorded, from a live node for instance.

    :raises EvaluationError: when no labels have a truth, or one of another size.
    """
    scorer = _TruthScorer(bag, truth)
    for prediction in labels:
        scorer.add(prediction)
    return scorer.scores(Measurements())


class _TruthScorer:
    """Scores the label images of a bag against the truth with the same stamps.

    Where neither stamps nor times bring any together, and there are as many of both, the order in
    which they were recorded does.
    """

    def __init__(self, bag: str, truth: LabelsByStamp) -> None:
        self._bag = bag
        self._truth = truth
        self._scorer = Scorer()
        self._frames = 0
        # Label images until some truth belongs to one; where stamps tell, none are needed.
        self._unmatched: LabelsByStamp | None = None if truth.stamps_tell else LabelsByStamp()

    def add(
        self,
        prediction: StampedLabels,
        period: float | None = None,
        same_recording: bool = False,
    ) -> Labels | None:
        """Score the next label image; return the truth that it was held against.

        :param period: seconds from one frame to the next, where it is known.
        :param same_recording: whether it has the times of its frame, which lies beside the truth.
        """
        self._frames += 1
        true_labels = self._truth.at(prediction.stamp, prediction.recorded, period, same_recording)
        if true_labels is not None:
            self._unmatched = None
            self._score(prediction.labels, true_labels)
        elif self._unmatched is not None:
            # By their number: their times are of no use.
            self._unmatched.add(StampedLabels(self._frames, prediction.labels))
        return true_labels

    def _score(self, labels: Labels, true_labels: Labels) -> None:
        try:
            self._scorer.add(labels, true_labels)
        except ValueError as error:
            raise EvaluationError(f"{self._bag}: {error}") from error

    def _score_in_order(self) -> None:
        unmatched = self._unmatched
        if unmatched is None or len(unmatched) != len(self._truth):
            return
        _LOGGER.warning(
            "%s: stamps say nothing, and times are of another recording: labels and truth are "
            "held together in their order",
            self._bag,
        )
        for labels, true_labels in zip(unmatched.in_order(), self._truth.in_order(), strict=True):
            self._score(labels, true_labels)

    def scores(self, measurements: Measurements) -> BagScores:
        self._score_in_order()
        scores = self._scorer.scores(self._bag, self._frames, measurements)
        if not scores.scored_frames:
            raise EvaluationError(
                f"{self._bag}: none of {self._frames} frames has a truth with its stamp "
                f"({len(self._truth)} in the bag)"
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
