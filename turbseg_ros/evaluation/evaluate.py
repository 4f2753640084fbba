"""The scores of one bag: of a segmenter at work, or of labels that were recorded."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.left_out import without_marked
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.evaluation.reliability import binned, judged
from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.evaluation.truth import Boxes, IgnoredRegions, Truth
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, Segmenter, segment
from turbseg_ros.segmentation.marked_regions import MarkedRegions

_LOGGER = logging.getLogger(__name__)
_NOTHING = MarkedRegions()


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
    marked: MarkedRegions = _NOTHING,
) -> BagScores:
    """Segment the frames of a bag and score the results.

    :param ignored: where truth says nothing.
    :param marked: regions of which a user wants nothing, whoever segments.
    :raises EvaluationError: when no frame has a truth, or one of another size.
    :raises ParameterError: when frames can't be the pictures that regions were marked in.
    """
    measured = _MeasuredSegmenter(segmenter)
    scorer = _TruthScorer(bag, truth, ignored, marked)
    sure: list[tuple[float, bool]] = []
    for result in segment(frames, measured):
        frame = result.frame
        prediction = StampedLabels(frame.stamp, result.labels, frame.received)
        held = scorer.add(prediction, frame.period, same_recording=True)
        if held.truth is not None:
            sure += judged(result, held.truth, held.ignored)
        for observer in observers:
            observer.add(result, held.truth, held.ignored)
    return replace(scorer.scores(measured.measurements), score_bins=binned(sure))


def evaluate_labels(
    bag: str,
    labels: Iterable[StampedLabels],
    truth: Truth,
    ignored: IgnoredRegions | None = None,
    marked: MarkedRegions = _NOTHING,
) -> BagScores:
    """Score labels that were recorded, from a live node for instance.

    :param ignored: where truth says nothing.
    :param marked: regions of which a user wants nothing.
    :raises EvaluationError: when no labels have a truth, or one of another size.
    :raises ParameterError: when they can't be of the pictures that regions were marked in.
    """
    scorer = _TruthScorer(bag, truth, ignored, marked)
    for prediction in labels:
        scorer.add(prediction)
    return scorer.scores(Measurements())


@dataclass(frozen=True)
class _Held:
    """What a frame's labels were held against: its truth, if any, and where nothing counts."""

    truth: Labels | Boxes | None
    ignored: Labels | None


class _TruthScorer:
    """Scores the label images of a bag against the truth with the same stamps.

    Where neither stamps nor times bring any together, and there are as many of both, the order in
    which they were recorded does.
    """

    def __init__(
        self, bag: str, truth: Truth, ignored: IgnoredRegions | None, marked: MarkedRegions
    ) -> None:
        self._bag = bag
        self._truth = truth
        self._ignored = ignored or IgnoredRegions()
        self._marked = marked
        self._mask = np.zeros((0, 0), bool)
        self._scorer = Scorer()
        self._frames = 0
        # Label images until some truth belongs to one; where stamps tell, none are needed.
        self._unmatched: LabelsByStamp | None = None if truth.stamps_tell else LabelsByStamp()

    def add(
        self,
        prediction: StampedLabels,
        period: float | None = None,
        same_recording: bool = False,
    ) -> _Held:
        """Score the next label image; return what it was held against.

        :param period: seconds from one frame to the next, where it is known.
        :param same_recording: whether it has the times of its frame, which lies beside the truth.
        """
        self._frames += 1
        stamp = prediction.stamp
        true = self._truth.at(stamp, prediction.recorded, period, same_recording)
        held = self._held(true, self._ignored.at(stamp), prediction.labels.shape)
        if held.truth is not None:
            self._unmatched = None
            self._score(prediction.labels, held)
        elif self._unmatched is not None:
            # By their number: their times are of no use.
            self._unmatched.add(StampedLabels(self._frames, prediction.labels))
        return held

    def _held(
        self, true: Labels | Boxes | None, ignored: Labels | None, shape: tuple[int, ...]
    ) -> _Held:
        if not self._marked.marked or true is None:
            return _Held(true, ignored)
        return _Held(*without_marked(true, ignored, self._marked_in(shape)))

    def _marked_in(self, shape: tuple[int, ...]) -> Mask:
        if self._mask.shape != shape:
            self._mask = self._marked.ignored((shape[1], shape[0]))
        return self._mask

    def _score(self, labels: Labels, held: _Held) -> None:
        try:
            if isinstance(held.truth, tuple):
                self._scorer.add_boxes(labels, held.truth, held.ignored)
            elif held.truth is not None:
                self._scorer.add(labels, held.truth, held.ignored)
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
            self._score(labels, self._held(true, self._ignored.at(number), labels.shape))

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
