"""What a user has marked to be ignored is left out of scores: what is there, and what is found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.evaluation.truth import Boxes
from turbseg_ros.messages.detections import IGNORED, Box

# Share of an object that is marked, beyond which it isn't reported.
_MOSTLY = 0.5


def without_marked(
    truth: Labels | Boxes, ignored: Labels | None, marked: Mask
) -> tuple[Labels | Boxes, Labels | None]:
    """Return the truth of a frame, and where it says nothing, as it is to be scored.

    An object that mostly is marked is not to be found, so that the rest of it doesn't count
    either.

    :param ignored: non-zero where nothing counts anyway, HxW.
    :param marked: what the user has marked, HxW.
    """
    images = [ignored] if isinstance(truth, tuple) else [ignored, truth]
    if any(image is not None and image.shape != marked.shape for image in images):
        return truth, ignored  # who scores tells the sizes
    left_out = marked.copy()
    if isinstance(truth, tuple):
        truth = tuple(
            replace(each, class_id=IGNORED) if _share(marked, each.box) > _MOSTLY else each
            for each in truth
        )
    else:
        for part in _objects(truth, marked):
            if np.count_nonzero(marked[part]) > _MOSTLY * np.count_nonzero(part):
                left_out |= part
    if ignored is not None:
        left_out |= ignored != 0
    return truth, left_out.view(np.uint8)


def _share(marked: Mask, box: Box) -> float:
    """Return the share of a box, as far as it lies in the picture, that is marked."""
    left, top, width, height = box
    inside = marked[
        max(round(top), 0) : max(round(top + height), 0),
        max(round(left), 0) : max(round(left + width), 0),
    ]
    return float(inside.mean()) if inside.size else 0.0


def _objects(truth: Labels, marked: Mask) -> Iterator[Mask]:
    """Yield the true objects that touch what is marked, HxW each.

    Labels may tell objects apart or be one for all, so that an object is what hangs together.
    """
    for label in np.unique(truth[marked & (truth != 0)]).tolist():
        _, parts = cv2.connectedComponents((truth == label).view(np.uint8))
        for number in np.unique(parts[marked & (parts != 0)]).tolist():
            yield parts == number
