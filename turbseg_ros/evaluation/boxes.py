"""Objects that were found beside true boxes, which may be drawn loosely."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from turbseg_ros.evaluation.metrics import Labels, ObjectOverlaps
from turbseg_ros.messages.detections import IGNORED, Detection

_Boxes = npt.NDArray[np.float64]

# Share of an object that lies where nothing counts, from which on it doesn't count either.
_IGNORED_SHARE = 0.5


def box_overlaps(
    prediction: Labels, truth: Sequence[Detection], ignored: Labels | None = None
) -> ObjectOverlaps:
    """Compare the boxes around the objects of a label image, HxW, with true ones.

    What lies on no true box, but by half in an ignored one or in the region `ignored` (HxW,
    non-zero there), is left out.

    :raises ValueError: when the region is of another size than the labels.
    """
    if ignored is not None and ignored.shape != prediction.shape:
        raise ValueError(
            f"ignored region of {ignored.shape[1]}x{ignored.shape[0]} doesn't fit labels of "
            f"{prediction.shape[1]}x{prediction.shape[0]} pixels"
        )
    slices = ndimage.find_objects(prediction)
    ids = [number for number, found in enumerate(slices, start=1) if found is not None]
    boxes = np.array([_box(slices[number - 1]) for number in ids]).reshape(-1, 4)
    true = [detection for detection in truth if detection.class_id != IGNORED]
    beside = [detection for detection in truth if detection.class_id == IGNORED]
    shared = _shared(_array(true), boxes)
    in_ignored = _shared(_array(beside), boxes).max(axis=0, initial=0.0) / _areas(boxes)
    if ignored is not None:
        in_region = [
            float(np.mean(ignored[slices[i - 1]][prediction[slices[i - 1]] == i] != 0))
            for i in ids
        ]
        in_ignored = np.maximum(in_ignored, in_region)
    counts = shared.any(axis=0) | (in_ignored < _IGNORED_SHARE)
    return ObjectOverlaps(
        true_ids=tuple(detection.id for detection in true),
        predicted_ids=tuple(int(i) for i, its in zip(ids, counts, strict=True) if its),
        shared=shared[:, counts],
        true_areas=_areas(_array(true)),
        predicted_areas=_areas(boxes[counts]),
    )


def _box(found: tuple[slice, ...]) -> tuple[float, float, float, float]:
    rows, columns = found
    return columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start


def _array(detections: Sequence[Detection]) -> _Boxes:
    return np.array([detection.box for detection in detections], np.float64).reshape(-1, 4)


def _areas(boxes: _Boxes) -> npt.NDArray[np.float64]:
    areas: npt.NDArray[np.float64] = boxes[:, 2] * boxes[:, 3]
    return areas


def _shared(true: _Boxes, predicted: _Boxes) -> npt.NDArray[np.float64]:
    """Return the area that each true box shares with each predicted one."""
    start = np.maximum(true[:, None, :2], predicted[None, :, :2])
    end = np.minimum((true[:, :2] + true[:, 2:])[:, None], (predicted[:, :2] + predicted[:, 2:]))
    sides = np.maximum(end - start, 0.0)
    shared: npt.NDArray[np.float64] = sides[..., 0] * sides[..., 1]
    return shared
