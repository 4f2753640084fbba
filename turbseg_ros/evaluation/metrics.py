"""Measures of a segmentation against truth: region, boundary and identity.

Masks are HxW, true or non-zero on the foreground; label images are HxW integers, 0 background and
k the object with id k. What two empty masks have in common is 1, as in the DAVIS benchmark.
"""

from __future__ import annotations

import math
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


class IdSwitchCounter:
    """Counts how often a true object's predicted id changes, over the frames of one sequence.

    As in CLEAR MOT (Bernardin and Stiefelhagen 2008): objects keep their partner of the frame
    before while it still fits; the rest are paired for the largest overlap. A pair that
    contradicts the true object's last pair, however long ago, is a switch.
    """

    def __init__(self) -> None:
        self._partner: dict[int, int] = {}
        self._true_ids: set[int] = set()
        self._switches = 0

    @property
    def switches(self) -> int | None:
        """The switches so far; None when the truth doesn't tell objects apart (0/255 masks)."""
        return None if self._true_ids == {_UNION_VALUE} else self._switches

    def add(self, prediction: Labels, truth: Labels) -> None:
        """Take the next frame's label images."""
        true_ids, predicted_ids, iou = _object_overlaps(prediction, truth)
        self._true_ids.update(true_ids)
        for row, column in _pairs(iou, self._kept_pairs(true_ids, predicted_ids, iou)):
            true_id, predicted_id = true_ids[row], predicted_ids[column]
            if self._partner.get(true_id, predicted_id) != predicted_id:
                self._switches += 1
            self._partner[true_id] = predicted_id

    def _kept_pairs(
        self, true_ids: list[int], predicted_ids: list[int], iou: npt.NDArray[np.float64]
    ) -> list[tuple[int, int]]:
        columns = {predicted_id: column for column, predicted_id in enumerate(predicted_ids)}
        kept: dict[int, int] = {}
        for row, true_id in enumerate(true_ids):
            column = columns.get(self._partner.get(true_id, 0))
            if column is not None and iou[row, column] >= MATCH_IOU:
                # Two objects whose last partner is the same can't both keep it.
                baseline = kept.get(column)
                if baseline is None or iou[row, column] > iou[baseline, column]:
                    kept[column] = row
        return [(row, column) for column, row in kept.items()]


def _pairs(iou: npt.NDArray[np.float64], kept: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Complete `kept` to the pairing of rows and columns with the largest overlap."""
    free = np.where(iou >= MATCH_IOU, iou, 0.0)
    for row, column in kept:
        free[row, :] = 0.0
        free[:, column] = 0.0
    rows, columns = linear_sum_assignment(free, maximize=True)
    found = [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if free[r, c] > 0.0]
    return kept + found


def _object_overlaps(
    prediction: Labels, truth: Labels
) -> tuple[list[int], list[int], npt.NDArray[np.float64]]:
    """Return the ids in the truth, those in the prediction and the IoU of each with each."""
    foreground = (prediction != 0) | (truth != 0)
    true_ids, rows = np.unique(truth[foreground], return_inverse=True)
    predicted_ids, columns = np.unique(prediction[foreground], return_inverse=True)
    shared = np.zeros((true_ids.size, predicted_ids.size))
    np.add.at(shared, (rows.ravel(), columns.ravel()), 1.0)
    union = shared.sum(1, keepdims=True) + shared.sum(0, keepdims=True) - shared
    iou = (shared / np.maximum(union, 1.0))[true_ids != 0][:, predicted_ids != 0]
    return true_ids[true_ids != 0].tolist(), predicted_ids[predicted_ids != 0].tolist(), iou


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
