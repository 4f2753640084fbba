"""How well ids follow the true objects of a sequence: MOTA, IDF1 and HOTA.

They are computed here because the benchmark's own code (`trackeval`) asks for OpenCV with windows,
which takes the place of the one without, and for NumPy 2 only, and `motmetrics` for pandas, with
no release since 2022. The tests hold them against figures that `trackeval` gave.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

_Matrix = npt.NDArray[np.float64]

# Least IoU of a match for MOTA and IDF1, as in the MOTChallenge.
_MATCH_IOU = 0.5
# HOTA is the mean over these.
_ALPHAS = np.arange(0.05, 0.99, 0.05)
_EPSILON = float(np.finfo(np.float64).eps)
# Keeps a match of the frame before, whatever else overlaps more.
_KEPT = 1000.0


@dataclass(frozen=True)
class TrackingScores:
    """MOTA (Bernardin and Stiefelhagen 2008), IDF1 (Ristani et al. 2016), HOTA (Luiten 2021)."""

    mota: float
    idf1: float
    hota: float


@dataclass(frozen=True)
class _FrameOverlaps:
    """A frame: which true and which predicted objects are in it, and the IoU of each pair."""

    true: npt.NDArray[np.intp]
    predicted: npt.NDArray[np.intp]
    iou: _Matrix


_Value = Callable[[_FrameOverlaps], npt.NDArray[Any]]


class TrackingScorer:
    """Scores the ids of one sequence; frames are added in order."""

    def __init__(self) -> None:
        self._frames: list[_FrameOverlaps] = []
        self._true_numbers: dict[object, int] = {}
        self._predicted_numbers: dict[object, int] = {}

    def add(
        self, true_ids: Sequence[object], predicted_ids: Sequence[object], iou: _Matrix
    ) -> None:
        """Take the next frame; `iou` has a row for each true id, a column for each predicted."""
        true = [self._true_numbers.setdefault(i, len(self._true_numbers)) for i in true_ids]
        predicted = [
            self._predicted_numbers.setdefault(i, len(self._predicted_numbers))
            for i in predicted_ids
        ]
        self._frames.append(
            _FrameOverlaps(np.array(true, np.intp), np.array(predicted, np.intp), iou)
        )

    def scores(self) -> TrackingScores | None:
        """Return the scores; None when there was no true object."""
        if not self._true_numbers:
            return None
        return TrackingScores(self._mota(), self._idf1(), self._hota())

    def _mota(self) -> float:
        """Return 1 - (missed + false + exchanged) / true, over all frames."""
        last = np.full(len(self._true_numbers), -1)
        before = last.copy()
        true = matched = false = switches = 0
        for frame in self._frames:
            score = _KEPT * (before[frame.true][:, None] == frame.predicted) + frame.iou
            score[frame.iou < _MATCH_IOU - _EPSILON] = 0
            rows, columns = _assigned(score)
            its, theirs = frame.true[rows], frame.predicted[columns]
            switches += int(np.count_nonzero((last[its] >= 0) & (last[its] != theirs)))
            before[:] = -1
            before[its] = last[its] = theirs
            true += frame.true.size
            matched += rows.size
            false += frame.predicted.size - rows.size
        return (matched - false - switches) / max(true, 1)

    def _idf1(self) -> float:
        """Return F1 of the best pairing of ids for the whole sequence."""
        together = self._pairs_summed(lambda frame: frame.iou >= _MATCH_IOU)
        right = float(together[linear_sum_assignment(together, maximize=True)].sum())
        return 2 * right / max(float(self._true_counts.sum() + self._predicted_counts.sum()), 1.0)

    def _hota(self) -> float:
        """Return the mean over thresholds of sqrt(detection x association accuracy)."""
        true, predicted = self._true_counts[:, None], self._predicted_counts[None]
        potential = self._pairs_summed(lambda frame: _relative(frame.iou))
        alignment = potential / np.maximum(true + predicted - potential, _EPSILON)
        together = np.zeros((_ALPHAS.size, *alignment.shape))
        for frame in self._frames:
            rows, columns = _assigned(
                alignment[frame.true[:, None], frame.predicted] * frame.iou, keep_all=True
            )
            over = frame.iou[rows, columns] >= _ALPHAS[:, None] - _EPSILON
            together[:, frame.true[rows], frame.predicted[columns]] += over
        matched = together.sum(axis=(1, 2))
        detection = matched / (true.sum() + predicted.sum() - matched)
        share = together / np.maximum(true + predicted - together, 1)
        association = (together * share).sum(axis=(1, 2)) / np.maximum(matched, 1)
        return float(np.sqrt(detection * association).mean())

    def _pairs_summed(self, value: _Value) -> _Matrix:
        summed = np.zeros((len(self._true_numbers), len(self._predicted_numbers)))
        for frame in self._frames:
            summed[frame.true[:, None], frame.predicted] += value(frame)
        return summed

    @property
    def _true_counts(self) -> _Matrix:
        return _counts([frame.true for frame in self._frames], len(self._true_numbers))

    @property
    def _predicted_counts(self) -> _Matrix:
        return _counts([frame.predicted for frame in self._frames], len(self._predicted_numbers))


def _counts(numbers: Sequence[npt.NDArray[np.intp]], length: int) -> _Matrix:
    return np.bincount(np.concatenate(numbers), minlength=length).astype(np.float64)


def _relative(iou: _Matrix) -> _Matrix:
    """Return each IoU's share of all that its row and its column have."""
    whole = iou.sum(axis=0)[None] + iou.sum(axis=1)[:, None] - iou
    return np.divide(iou, whole, out=np.zeros_like(iou), where=whole > _EPSILON)


def _assigned(
    score: _Matrix, keep_all: bool = False
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the rows and columns of the best assignment; those that score nothing on demand."""
    rows, columns = linear_sum_assignment(score, maximize=True)
    kept = score[rows, columns] > (-1.0 if keep_all else _EPSILON)
    return rows[kept], columns[kept]
