"""Measures of a segmentation against truth: region, boundary and identity.

Masks are HxW, true or non-zero on the foreground; label images are HxW integers, 0 background and
k the object with id k. What two empty masks have in common is 1, as in the DAVIS benchmark.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

Mask = npt.NDArray[Any]
Labels = npt.NDArray[np.integer[Any]]

# Share of the image's diagonal by which a boundary may be off (Perazzi et al. 2016).
BOUNDARY_TOLERANCE = 0.008
# Least IoU at which a predicted object passes for a true one. Low, because identity is to be
# judged apart from how tight an outline is.
MATCH_IOU = 0.2
# Share of its pixels that a predicted object has on true ones at least, unless it is false.
TRUE_SHARE = 0.5
# Least share of its frames in which a true object is found, or else it is missed.
FOUND_SHARE = 0.1
# A truth that holds only this value tells foreground from background, not object from object.
_UNION_VALUE = 255


def jaccard(prediction: Mask, truth: Mask) -> float:
    """Return J, the intersection over the union of two masks."""
    intersection, union, _ = _overlap(prediction, truth)
    return intersection / union if union else 1.0


def dice(prediction: Mask, truth: Mask) -> float:
    """Return Dice's coefficient (F1) of two masks, 2 |P ∩ T| / (|P| + |T|)."""
    intersection, _, total = _overlap(prediction, truth)
    return 2.0 * intersection / total if total else 1.0


def boundary_f(prediction: Mask, truth: Mask, tolerance: float = BOUNDARY_TOLERANCE) -> float:
    """Return the F measure of the boundaries of two masks.

    Precision is the share of predicted boundary within `tolerance` (of the image's diagonal,
    rounded up to pixels) of the true one, recall the other way round. As in Perazzi et al.,
    "A Benchmark Dataset and Evaluation Methodology for Video Object Segmentation", CVPR 2016.
    """
    radius = math.ceil(tolerance * math.hypot(*truth.shape))
    predicted, true = _cropped_to_foreground(prediction, truth, margin=radius + 1)
    predicted_boundary, true_boundary = _boundary(predicted), _boundary(true)
    if not (predicted_boundary.any() and true_boundary.any()):
        return float(predicted_boundary.any() == true_boundary.any())
    precision = float(_near(true_boundary, radius)[predicted_boundary].mean())
    recall = float(_near(predicted_boundary, radius)[true_boundary].mean())
    return 2.0 * precision * recall / (precision + recall) if precision + recall else 0.0


def foreground_fraction(mask: Mask) -> float:
    """Return the share of an image that is foreground."""
    return float(np.count_nonzero(mask)) / mask.size


@dataclass(frozen=True)
class ObjectOverlaps:
    """How the objects of a label image lie over those of its truth, in pixels.

    `shared` holds a row for each of `true_ids`, a column for each of `predicted_ids`;
    `true_areas` and `predicted_areas` are those of whole objects.
    """

    true_ids: tuple[int | str, ...]
    predicted_ids: tuple[int, ...]
    shared: npt.NDArray[np.float64]
    true_areas: npt.NDArray[np.float64]
    predicted_areas: npt.NDArray[np.float64]

    @property
    def iou(self) -> npt.NDArray[np.float64]:
        """Intersection over union of each true object with each predicted one."""
        union = self.true_areas[:, None] + self.predicted_areas[None] - self.shared
        return self.shared / np.maximum(union, 1.0)

    @property
    def tells_objects_apart(self) -> bool:
        """Whether the truth isn't a union, 0 and 255; also where it is empty."""
        return self.true_ids != (_UNION_VALUE,)


def object_overlaps(prediction: Labels, truth: Labels) -> ObjectOverlaps:
    """Compare the objects of two label images of one size."""
    foreground = (prediction != 0) | (truth != 0)
    true_ids, rows = np.unique(truth[foreground], return_inverse=True)
    predicted_ids, columns = np.unique(prediction[foreground], return_inverse=True)
    shared = np.zeros((true_ids.size, predicted_ids.size))
    np.add.at(shared, (rows.ravel(), columns.ravel()), 1.0)
    is_true, is_predicted = true_ids != 0, predicted_ids != 0
    return ObjectOverlaps(
        true_ids=tuple(true_ids[is_true].tolist()),
        predicted_ids=tuple(predicted_ids[is_predicted].tolist()),
        shared=shared[is_true][:, is_predicted],
        true_areas=shared.sum(1)[is_true],
        predicted_areas=shared.sum(0)[is_predicted],
    )


def false_ids(overlaps: ObjectOverlaps) -> tuple[int, ...]:
    """Return the ids of the predicted objects in a frame where there is none.

    An object is a label's region. It is false when its IoU with every true object is below
    `MATCH_IOU` and less than `TRUE_SHARE` of its pixels lie on true objects of any id: neither
    one that was found badly, nor a fragment. For a union truth see `true_components`.
    """
    if not overlaps.predicted_ids:
        return ()
    matched = (overlaps.iou >= MATCH_IOU).any(axis=0)
    share = overlaps.shared.sum(axis=0) / overlaps.predicted_areas
    false = ~matched & (share < TRUE_SHARE)
    return tuple(i for i, its in zip(overlaps.predicted_ids, false, strict=True) if its)


def true_components(truth: Labels) -> Labels:
    """Return a union truth, 0 and 255, with each connected part (of 8 neighbours) as an object."""
    _, components = cv2.connectedComponents((truth != 0).astype(np.uint8))
    return np.asarray(components)


class PixelCounter:
    """Counts a sequence's true positive, false positive and false negative pixels, as CDnet does.

    Goyette et al., "Changedetection.net: A new change detection benchmark dataset", CVPRW 2012.
    """

    def __init__(self) -> None:
        self._shared = self._total = 0
        self._has_truth = False

    def add(self, prediction: Mask, truth: Mask) -> None:
        """Take the next frame."""
        shared, _, total = _overlap(prediction, truth)
        self._shared += shared
        self._total += total
        self._has_truth = self._has_truth or bool(truth.any())

    @property
    def f_measure(self) -> float | None:
        """F1 of the pixels of all frames together; None when none was true."""
        return 2.0 * self._shared / self._total if self._has_truth else None


class FoundCounter:
    """Counts in how many of its frames each true object of a sequence was found."""

    def __init__(self) -> None:
        self._frames: Counter[int | str] = Counter()
        self._found: Counter[int | str] = Counter()

    def add(self, true_ids: Sequence[int | str], found: Sequence[bool]) -> None:
        """Take the next frame, and which of its true objects were found."""
        self._frames.update(true_ids)
        self._found.update(i for i, its in zip(true_ids, found, strict=True) if its)

    @property
    def frames(self) -> Mapping[int | str, int]:
        """How many frames each true object is in."""
        return self._frames

    def share(self, true_id: int | str) -> float:
        """Return the share of its frames in which a true object was found."""
        return self._found[true_id] / self._frames[true_id]

    @property
    def missed(self) -> float | None:
        """The share of true objects found in less than `FOUND_SHARE` of their frames."""
        if not self._frames:
            return None
        return float(np.mean([self.share(true_id) < FOUND_SHARE for true_id in self._frames]))


class FalseIdCounter:
    """Counts the ids of a sequence that were false whenever they were there."""

    def __init__(self) -> None:
        self._false: set[int] = set()
        self._true: set[int] = set()

    def add(self, predicted_ids: Sequence[int], false: Sequence[int]) -> None:
        """Take the next frame's ids, and which of them are false."""
        self._false.update(false)
        self._true.update(set(predicted_ids) - set(false))

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._false - self._true)


class ObjectJaccard:
    """Scores each true object of a sequence by the one predicted object that stands for it.

    As in DAVIS-2017's unsupervised track (Caelles et al., "The 2019 DAVIS Challenge on VOS:
    Unsupervised Multi-Object Segmentation"): J of each pair of a true and a predicted id is its
    mean over frames, and the Hungarian method gives each true id a predicted one for the whole
    sequence. Frames are here those in which the true object exists: false ones have a figure of
    their own. A pixel that one object takes from another counts against both.
    """

    def __init__(self) -> None:
        self._frames: Counter[int | str] = Counter()
        self._sums: defaultdict[tuple[int | str, int], float] = defaultdict(float)
        self._dice_sums: defaultdict[tuple[int | str, int], float] = defaultdict(float)

    def add(self, overlaps: ObjectOverlaps) -> None:
        """Take the next frame."""
        self._frames.update(overlaps.true_ids)
        iou = overlaps.iou
        for row, column in zip(*np.nonzero(iou), strict=True):
            pair = overlaps.true_ids[row], overlaps.predicted_ids[column]
            self._sums[pair] += float(iou[row, column])
            self._dice_sums[pair] += 2.0 * float(iou[row, column] / (1.0 + iou[row, column]))

    @property
    def by_object(self) -> dict[int | str, float] | None:
        """Mean J of each true id.

        None without a true object, or when the truth doesn't tell objects apart.
        """
        partners = self._partners
        if partners is None:
            return None
        return {
            true_id: self._sums.get((true_id, partner), 0.0) / self._frames[true_id]
            for true_id, partner in partners.items()
        }

    @property
    def dice_by_object(self) -> dict[int | str, float] | None:
        """Mean Dice's coefficient of each true id, beside the same predicted ids."""
        partners = self._partners
        if partners is None:
            return None
        return {
            true_id: self._dice_sums.get((true_id, partner), 0.0) / self._frames[true_id]
            for true_id, partner in partners.items()
        }

    @property
    def _partners(self) -> dict[int | str, int] | None:
        """The predicted id that stands for each true one, 0 where none does.

        None without a true object, or when the truth doesn't tell objects apart.
        """
        if not self._frames or set(self._frames) == {_UNION_VALUE}:
            return None
        true_ids = sorted(self._frames, key=str)
        predicted_ids = sorted({predicted for _, predicted in self._sums})
        means = np.zeros((len(true_ids), len(predicted_ids)))
        for (true_id, predicted_id), total in self._sums.items():
            pair = true_ids.index(true_id), predicted_ids.index(predicted_id)
            means[pair] = total / self._frames[true_id]
        partners = dict.fromkeys(true_ids, 0)
        for row, column in zip(*linear_sum_assignment(means, maximize=True), strict=True):
            partners[true_ids[row]] = predicted_ids[column]
        return partners

    @property
    def mean(self) -> float | None:
        """The mean over the true objects; None where there is none to tell."""
        by_object = self.by_object
        return None if by_object is None else float(np.mean(list(by_object.values())))


class IdSwitchCounter:
    """Counts how often a true object's predicted id changes, over the frames of one sequence.

    As in CLEAR MOT (Bernardin and Stiefelhagen 2008): objects keep their partner of the frame
    before while it still fits; the rest are paired for the largest overlap. A pair that
    contradicts the true object's last pair, however long ago, is a switch.

    `match_iou` is the least IoU of a pair.
    """

    def __init__(self, match_iou: float = MATCH_IOU) -> None:
        self._match_iou = match_iou
        self._partner: dict[int | str, int] = {}
        self._partners: defaultdict[int | str, set[int]] = defaultdict(set)
        self._true_ids: set[int | str] = set()
        self._switches = 0

    @property
    def switches(self) -> int | None:
        """The switches so far; None when the truth doesn't tell objects apart (0/255 masks)."""
        return None if self._true_ids == {_UNION_VALUE} else self._switches

    @property
    def ids_per_object(self) -> float | None:
        """The mean number of ids that a true object had, of those that were found at all."""
        if self._true_ids == {_UNION_VALUE} or not self._partners:
            return None
        return float(np.mean([len(ids) for ids in self._partners.values()]))

    def add(self, overlaps: ObjectOverlaps) -> None:
        """Take the next frame."""
        true_ids, predicted_ids, iou = overlaps.true_ids, overlaps.predicted_ids, overlaps.iou
        self._true_ids.update(true_ids)
        kept_pairs = self._kept_pairs(true_ids, predicted_ids, iou)
        for row, column in _pairs(iou, kept_pairs, self._match_iou):
            true_id, predicted_id = true_ids[row], predicted_ids[column]
            if self._partner.get(true_id, predicted_id) != predicted_id:
                self._switches += 1
            self._partner[true_id] = predicted_id
            self._partners[true_id].add(predicted_id)

    def _kept_pairs(
        self,
        true_ids: Sequence[int | str],
        predicted_ids: Sequence[int],
        iou: npt.NDArray[np.float64],
    ) -> list[tuple[int, int]]:
        columns = {predicted_id: column for column, predicted_id in enumerate(predicted_ids)}
        kept: dict[int, int] = {}
        for row, true_id in enumerate(true_ids):
            column = columns.get(self._partner.get(true_id, 0))
            if column is not None and iou[row, column] >= self._match_iou:
                # Two objects whose last partner is the same can't both keep it.
                baseline = kept.get(column)
                if baseline is None or iou[row, column] > iou[baseline, column]:
                    kept[column] = row
        return [(row, column) for column, row in kept.items()]


def _pairs(
    iou: npt.NDArray[np.float64], kept: list[tuple[int, int]], match_iou: float
) -> list[tuple[int, int]]:
    """Complete `kept` to the pairing of rows and columns with the largest overlap."""
    free = np.where(iou >= match_iou, iou, 0.0)
    for row, column in kept:
        free[row, :] = 0.0
        free[:, column] = 0.0
    rows, columns = linear_sum_assignment(free, maximize=True)
    found = [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if free[r, c] > 0.0]
    return kept + found


def _overlap(prediction: Mask, truth: Mask) -> tuple[int, int, int]:
    """Return the pixels of the intersection, of the union and of both masks summed."""
    predicted, true = prediction != 0, truth != 0
    intersection = int(np.count_nonzero(predicted & true))
    total = int(np.count_nonzero(predicted)) + int(np.count_nonzero(true))
    return intersection, total - intersection, total


def _cropped_to_foreground(
    prediction: Mask, truth: Mask, margin: int
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Cut both masks to the box of what either holds, to save time; `margin` pixels stay."""
    predicted, true = prediction != 0, truth != 0
    x, y, width, height = cv2.boundingRect((predicted | true).astype(np.uint8))
    window = (
        slice(max(y - margin, 0), y + height + margin),
        slice(max(x - margin, 0), x + width + margin),
    )
    return predicted[window], true[window]


def _boundary(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Mark the pixels that differ from their right, lower or lower right neighbour."""
    wider = np.pad(mask, ((0, 1), (0, 1)), mode="edge")
    right, below, diagonal = wider[:-1, 1:], wider[1:, :-1], wider[1:, 1:]
    boundary: npt.NDArray[np.bool_] = (mask ^ right) | (mask ^ below) | (mask ^ diagonal)
    return boundary


def _near(boundary: npt.NDArray[np.bool_], radius: int) -> npt.NDArray[np.bool_]:
    """Mark the pixels within `radius` of a boundary: a dilation by a disk, only faster."""
    away = (~boundary).astype(np.uint8)
    distance = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    near: npt.NDArray[np.bool_] = distance < radius + 1e-3
    return near
