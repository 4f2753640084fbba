"""The scores of one bag: of a segmenter at work, or of labels that were recorded."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.evaluation.reliability import binned, judged
from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.evaluation.truth import Boxes, IgnoredRegions, Truth
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, Segmenter, segment

_LOGGER = logging.getLogger(__name__)


class EvaluationError(Exception):
    """Labels and truth that don't go together; the text says why."""


class ResultObserver(Protocol):
    """Someone who is shown every result beside its truth, such as a draughtsman."""

    def add(
        self, result: SegmentationResult, truth: Labels | Boxes | None, ignored: Labels | None
    ) -> None:
        """Take the next result, and the truth of its frame where there is one.

        :param ignored: non-zero where truth says nothing, HxW.
        """


def evaluate_segmenter(
    bag: str,
    frames: Iterable[Frame],
    segmenter: Segmenter,
    truth: Truth,
    observers: Sequence[ResultObserver] = (),
    ignored: IgnoredRegions | None = None,
) -> BagScores:
    """Segment the frames of a bag and score the results.

    :param ignored: where truth says nothing.
    :raises EvaluationError: when no frame has a truth, or one of another size.
    """
    measured = _MeasuredSegmenter(segmenter)
    scorer = _TruthScorer(bag, truth, ignored)
    sure: list[tuple[float, bool]] = []
    for result in segment(frames, measured):
        frame = result.frame
        prediction = StampedLabels(frame.stamp, result.labels, frame.received)
        found = scorer.add(prediction, frame.period, same_recording=True)
        if found is not None:
            sure += judged(result, found, scorer.ignored_at(frame.stamp))
        for observer in observers:
            observer.add(result, found, scorer.ignored_at(frame.stamp))
    return replace(scorer.scores(measured.measurements), score_bins=binned(sure))


def evaluate_labels(
    bag: str,
    labels: Iterable[StampedLabels],
    truth: Truth,
    ignored: IgnoredRegions | None = None,
) -> BagScores:
    """Score labels that were recorded, from a live node for instance.

    :param ignored: where truth says nothing.
    :raises EvaluationError: when no labels have a truth, or one of another size.
    """
    scorer = _TruthScorer(bag, truth, ignored)
    for prediction in labels:
        scorer.add(prediction)
    return scorer.scores(Measurements())


class _TruthScorer:
    """Scores the label images of a bag against the truth with the same stamps.

    Where neither stamps nor times bring any together, and there are as many of both, the order in
    which they were recorded does.
    """

    def __init__(self, bag: str, truth: Truth, ignored: IgnoredRegions | None = None) -> None:
        self._bag = bag
        self._truth = truth
        self._ignored = ignored or IgnoredRegions()
        self._scorer = Scorer()
        self._frames = 0
        # Label images until some truth belongs to one; where stamps tell, none are needed.
        self._unmatched: LabelsByStamp | None = None if truth.stamps_tell else LabelsByStamp()

    def add(
        self,
        prediction: StampedLabels,
        period: float | None = None,
        same_recording: bool = False,
    ) -> Labels | Boxes | None:
        """Score the next label image; return the truth that it was held against.

        :param period: seconds from one frame to the next, where it is known.
        :param same_recording: whether it has the times of its frame, which lies beside the truth.
        """
        self._frames += 1
        stamp = prediction.stamp
        true = self._truth.at(stamp, prediction.recorded, period, same_recording)
        if true is not None:
            self._unmatched = None
            self._score(prediction.labels, true, self.ignored_at(stamp))
        elif self._unmatched is not None:
            # By their number: their times are of no use.
            self._unmatched.add(StampedLabels(self._frames, prediction.labels))
        return true

    def ignored_at(self, stamp: int) -> Labels | None:
        """Return where truth says nothing in the frame with this stamp, HxW; None without."""
        return self._ignored.at(stamp)

    def _score(self, labels: Labels, true: Labels | Boxes, ignored: Labels | None) -> None:
        try:
            if isinstance(true, tuple):
                self._scorer.add_boxes(labels, true, ignored)
            else:
                self._scorer.add(labels, true, ignored)
        except ValueError as error:
            raise EvaluationError(f"{self._bag}: {error}") from error

    def _score_in_order(self) -> None:
        unmatched = self._unmatched
        if unmatched is None or len(unmatched) != len(self._truth):
            return
        _LOGGER.warning(
            "%s: stamps are unusable, and times are of another recording: labels and truth are "
            "held together in their order",
            self._bag,
        )
        truth: Iterable[Labels | Boxes] = self._truth.in_order()
        for number, (labels, true) in enumerate(zip(unmatched.in_order(), truth, strict=True)):
            self._score(labels, true, self._ignored.at(number))

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
