"""What stands out from all of its surroundings in a single frame, small and large.

It is looked for in the picture as it is and in smaller ones, in which what is large is a few
pixels wide, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Mask

Points = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.float64]
_Levels = npt.NDArray[np.uint16]

SCALES = (1, 4, 8)
"""By how many times the pictures in which blobs are looked for are smaller."""
RING = 5
"""Pixels, of such a picture, in which what stands out ends."""
SMALL = 3
"""Pixels, of such a picture, that a blob is told from; less apart it is the same one."""
MOST = 24
"""Blobs of a picture, the strongest."""
# Points on the ring.
_RING_POINTS = 8
# By so many times what pixels differ from their neighbours nearby a blob stands out.
_STANDS_OUT = 2.5
# Side in pixels of the cells that what is usual is told for, and of the square of cells nearby.
_CELL, _NEARBY = 4, 5
# What lies within such a square is one blob.
_APART = np.ones((9, 9), np.uint8)
# Grey values that a picture is taken to differ by at least.
_ROUNDING = 0.5
# Parts of a grey value that are told apart.
_FRACTIONS = 16
# Pixels from the border of the picture within which there is no ring.
_MARGIN = 6
# Pixels within which a blob's middle is told.
_REACH = 4


@dataclass(frozen=True)
class Blobs:
    """What stands out in a picture: `points`, Nx2 (x, y) in its pixels.

    `contrast`, N, is by how many grey values, negative where darker, `strength`, N, by how many
    times what pixels nearby differ from their neighbours.
    """

    points: Points
    contrast: Numbers
    strength: Numbers

    def chosen(self, which: Mask) -> Blobs:
        """Return some of them; `which` is N."""
        return Blobs(self.points[which], self.contrast[which], self.strength[which])


NO_BLOBS = Blobs(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def blob_pyramid(grey: ByteImage) -> tuple[Blobs, ...]:
    """Return what stands out in a picture and in smaller ones, by `SCALES`.

    :param grey: HxW at processing resolution.
    """
    return tuple(blobs_in(picture) for picture in _pyramid(grey))


def _pyramid(grey: ByteImage) -> Iterator[ByteImage]:
    """Give a picture by whole numbers smaller each time; what is left over is cut off."""
    before = 1
    for scale in SCALES:
        times = scale // before
        height, width = (side // times for side in grey.shape)
        if times > 1:
            whole = grey[: height * times, : width * times]
            grey = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
        before = scale
        yield grey


def blobs_in(grey: ByteImage) -> Blobs:
    """Return what stands out from all its surroundings, the strongest first.

    :param grey: HxW.
    """
    if min(grey.shape) <= 2 * _MARGIN:
        return NO_BLOBS
    # Grey values in sixteenths, for means of small squares are no whole numbers.
    values = grey.astype(np.uint16)
    values *= np.uint16(_FRACTIONS)
    mean = cv2.blur(values, (SMALL, SMALL))
    size = _standing_out(mean, _AROUND)
    least = _STANDS_OUT * _ROUNDING * _FRACTIONS
    peaks = cv2.compare(size, cv2.dilate(size, _APART), cv2.CMP_GE)
    peaks &= cv2.compare(size, least, cv2.CMP_GT)
    inner = np.ascontiguousarray(peaks[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])
    found = cv2.findNonZero(inner)
    if found is None:
        return NO_BLOBS
    x, y = (found.reshape(-1, 2).astype(np.intp) + _MARGIN).T
    # How much pixels differ from their neighbours is told for coarse cells.
    differ = cv2.absdiff(values, mean)
    differ = cv2.resize(differ, None, fx=1 / _CELL, fy=1 / _CELL, interpolation=cv2.INTER_AREA)
    usual = cv2.blur(differ, (_NEARBY, _NEARBY))
    last_row, last_column = usual.shape[0] - 1, usual.shape[1] - 1
    rows, columns = np.minimum(y // _CELL, last_row), np.minimum(x // _CELL, last_column)
    strength = size[y, x] / (usual[rows, columns] + _ROUNDING * _FRACTIONS)
    order = np.argsort(-strength)[:MOST]
    order = order[strength[order] > _STANDS_OUT]
    if not len(order):
        return NO_BLOBS
    y, x = y[order], x[order]
    around = _windows(mean, x, y, RING)
    brighter = mean[y, x] > np.median(around.reshape(len(x), -1), axis=1)
    contrast = np.where(brighter, 1.0, -1.0) * size[y, x]
    return Blobs(_middles(mean, x, y, contrast), contrast / _FRACTIONS, strength[order])


def _ring(radius: int, points: int) -> npt.NDArray[np.uint8]:
    angles = 2.0 * np.pi * np.arange(points) / points
    ring = np.zeros((2 * radius + 1, 2 * radius + 1), np.uint8)
    rows, columns = np.rint(radius * np.sin(angles)), np.rint(radius * np.cos(angles))
    ring[radius + rows.astype(int), radius + columns.astype(int)] = 1
    return ring


_AROUND = _ring(RING, _RING_POINTS)


def _standing_out(values: _Levels, ring: npt.NDArray[np.uint8]) -> _Levels:
    """Return by how much each pixel lies above or below all of a ring round it, 0 if within."""
    above = cv2.subtract(values, cv2.dilate(values, ring))
    below = cv2.subtract(cv2.erode(values, ring), values)
    return np.asarray(cv2.max(above, below))


def _windows(
    values: _Levels, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], reach: int
) -> _Levels:
    """Return the values around pixels that lie further than that from the border, Nxnxn."""
    around = np.arange(-reach, reach + 1)
    return values[y[:, None, None] + around[:, None], x[:, None, None] + around]


def _middles(
    mean: _Levels, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], contrast: Numbers
) -> Points:
    """Return the middles (x, y) of what stands out around pixels, Nx2."""
    around = np.arange(-_REACH, _REACH + 1)
    sign, size = np.sign(contrast)[:, None, None], np.abs(contrast)[:, None, None]
    excess = _windows(mean, x, y, _REACH) - mean[y, x].astype(np.float64)[:, None, None]
    weight = np.maximum(excess * sign + size / 2, 0.0)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-6)
    across = (weight.sum(axis=1) * around).sum(axis=1) / total
    down = (weight.sum(axis=2) * around).sum(axis=1) / total
    return np.stack([x + across, y + down], axis=1)
