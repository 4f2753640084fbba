"""How much a scene usually changes at each place, and whether it changes by more.

Air that shimmers changes edges, leaves change always: that is usual there. Something that comes
changes places by more than they usually do, before anybody has measured how it moves.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.geometry import corner_displacement, scaling

# Side in pixels of the cells that changes are told for.
_CELL = 8
# Comparisons after which it is known what is usual, and the share by which it follows the newest.
_KNOWN, _ADAPTATION = 8, 0.1
# Usual deviations beyond the usual change, of a place and those beside it, that are more than
# usual; and the least deviation, in grey values.
_UNUSUAL, _MIN_DEVIATION = 7.0, 0.25
# Displacement in cells from which they show other places.
_ELSEWHERE = 0.5
_AROUND = np.ones((3, 3), np.uint8)
_TO_CELLS = scaling(1 / _CELL, 1 / _CELL)
_FROM_CELLS = np.linalg.inv(_TO_CELLS)


class UsualChange:
    """By how much cells of a scene differ from one time to another while nothing is there."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start anew: another scene, or another view of it."""
        self._usual: dict[int, Map] = {}
        self._deviation: dict[int, Map] = {}
        self._count = 0
        self._transform: Matrix = np.eye(3)

    def propagate(self, ego_motion: Matrix | None) -> None:
        """Follow the camera to the frame that is compared next; to another scene if None.

        :param ego_motion: takes processing pixels of the frame before to those of the next.
        """
        if ego_motion is None:
            self.forget()
            return
        self._transform = _TO_CELLS @ ego_motion @ _FROM_CELLS @ self._transform
        shape = next((usual.shape for usual in self._usual.values()), None)
        if shape is None or corner_displacement(self._transform, shape[::-1]) < _ELSEWHERE:
            return
        for known in (self._usual, self._deviation):
            known.update({k: _moved(values, self._transform) for k, values in known.items()})
        self._transform = np.eye(3)

    def is_exceeded(self, grey: ByteImage, aligned: Mapping[int, ByteImage]) -> bool:
        """Whether a frame differs anywhere by more than is usual, or what is usual isn't known.

        It is learned from the frame, too.

        :param grey: HxW at processing resolution.
        :param aligned: {k: frame t+k as this one would show it, HxW}.
        """
        if self._usual.keys() != aligned.keys():
            self.forget()
        changes = {k: _change(grey, other) for k, other in aligned.items()}
        exceeded = self._count < _KNOWN or any(
            _exceeds(change, self._usual[k], self._deviation[k]) for k, change in changes.items()
        )
        self._learn(changes)
        return exceeded

    def _learn(self, changes: Mapping[int, Map]) -> None:
        self._count += 1
        share = np.float32(max(_ADAPTATION, 1.0 / self._count))
        for k, change in changes.items():
            usual = self._usual.setdefault(k, change)
            deviation = self._deviation.setdefault(k, np.zeros_like(change))
            self._deviation[k] = deviation + share * (np.abs(change - usual) - deviation)
            self._usual[k] = usual + share * (change - usual)


def _change(grey: ByteImage, other: ByteImage) -> Map:
    """Return the mean absolute difference in each cell, hxw in grey values."""
    height, width = (length // _CELL for length in grey.shape)
    difference = cv2.absdiff(grey, other)[: height * _CELL, : width * _CELL].astype(np.float32)
    change: Map = cv2.resize(difference, (width, height), interpolation=cv2.INTER_AREA)
    return change


def _exceeds(change: Map, usual: Map, deviation: Map) -> bool:
    """Whether a change goes beyond what is usual around it, stronger air all over apart."""
    stronger = max(float(np.median(change) / max(float(np.median(usual)), 1e-3)), 1.0)
    expected = np.float32(stronger) * cv2.dilate(usual, _AROUND)
    spread = np.maximum(cv2.dilate(deviation, _AROUND), np.float32(_MIN_DEVIATION))
    exceeding: Mask = change > expected + np.float32(_UNUSUAL) * spread
    return bool(exceeding.any())


def _moved(values: Map, transform: Matrix) -> Map:
    """Return what a transform makes of cells; beyond their border they go on as there."""
    moved: Map = cv2.warpAffine(
        values, transform[:2], values.shape[1::-1], borderMode=cv2.BORDER_REPLICATE
    )
    return moved
