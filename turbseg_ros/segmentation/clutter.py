"""Clutter: how much each place moves without an object being there, learned as it is watched.

Turbulence is stronger over a roof than beside it, edges shimmer and lawns don't, leaves sway. What
tells them from objects is that their motion changes from one measurement to the next, while that
of an object stays nearly what it was: so the *change* of velocity is remembered, not the speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Flow, Map, Mask, Matrix
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import corner_displacement, resampled, scaling

CELL = 4
"""Side in pixels at processing resolution of the cells that the memory is kept in."""
# Frames over which what was seen is forgotten.
_MEMORY = 120
# Changes after which a cell's level counts by half: one change alone tells little.
_FEW = 4.0
# A change counts for no more than so many times what is usual at the place.
_MAX_CHANGE = 3.0
# Displacement in cells up to which the memory stays where it is and what is measured is brought
# to it; resampling it each time would blur it.
_DRIFT = 2.0


class ClutterMemory:
    """The clutter level of a scene, in pixels a frame, in cells that stay on the scene.

    The level of a cell is the root mean square of half the change of its velocity between
    measurements, which forgets slowly. Where objects are expected nothing is learned.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start anew: another scene."""
        self._velocity: Flow | None = None
        self._squared: Map = np.zeros((0, 0), np.float32)
        self._count: Map = np.zeros((0, 0), np.float32)
        self._transform: Matrix = np.eye(3)

    def propagate(self, ego_motion: Matrix | None) -> None:
        """Follow the camera to another frame; to another scene if None.

        :param ego_motion: takes processing pixels of the frame before to those of the next.
        """
        if ego_motion is None:
            self.forget()
            return
        if self._velocity is None:
            return
        self._transform = in_cells(ego_motion) @ self._transform
        height, width = self._count.shape
        if corner_displacement(self._transform, (width, height)) > _DRIFT:
            self._velocity, self._squared, self._count = (
                resampled(values, self._transform, backward=False)
                for values in (self._velocity, self._squared, self._count)
            )
            self._transform = np.eye(3)

    def take(self, velocity: Flow, noise: Map, visible: Mask, held: Mask, frames: int) -> Map:
        """Take in what was measured in the frame followed to; return what was known before.

        :param velocity: HxWx2, pixels a frame.
        :param noise: HxW, its standard deviation an axis where nothing moves.
        :param visible: HxW, where it was measured.
        :param held: hxw cells that objects are expected in: they don't count, and what is known
            of the place counts by half there.
        :param frames: frames since the measurement before.
        :return: the clutter level of each cell, hxw in pixels a frame.
        """
        height, width = cells_of(velocity.shape)
        measured: Flow = cv2.resize(velocity, (width, height), interpolation=cv2.INTER_AREA)
        if self._velocity is None:
            self._velocity = measured
            self._squared, self._count = (np.zeros((height, width), np.float32) for _ in range(2))
            return np.zeros((height, width), np.float32)
        level = self._level() * np.where(held, np.float32(0.5), np.float32(1.0))
        self._learn(measured, _middles(noise), _middles(visible) & ~held, frames)
        return level

    def _level(self) -> Map:
        shrunk = self._squared * (self._count / (self._count + np.float32(_FEW)))
        level: Map = np.sqrt(np.maximum(resampled(shrunk, self._transform, backward=False), 0.0))
        return level

    def _learn(self, measured: Flow, noise: Map, usable: Mask, frames: int) -> None:
        assert self._velocity is not None
        least = resampled(np.square(noise / 2), self._transform, backward=True)
        here = resampled(measured, self._transform, backward=True)
        counts = resampled(usable.astype(np.float32), self._transform, backward=True) > 0.99
        change = here - self._velocity
        squared = (change[..., 0] ** 2 + change[..., 1] ** 2) / 4
        usual = np.maximum(self._squared, least)
        squared = np.minimum(squared, _MAX_CHANGE**2 * usual)
        weight = np.maximum(1.0 / (self._count + 1.0), np.float32(min(frames / _MEMORY, 1.0)))
        self._squared += np.where(counts, weight * (squared - self._squared), np.float32(0.0))
        self._count += counts
        self._velocity = np.where(counts[..., None], here, np.float32(0.0))


def cells_of(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the rows and columns of cells that a frame at processing resolution has."""
    return max(shape[0] // CELL, 1), max(shape[1] // CELL, 1)


def in_cells(transform: Matrix) -> Matrix:
    """Return a transform of processing pixels as one of cells."""
    to_cells = scaling(1 / CELL, 1 / CELL)
    result: Matrix = to_cells @ transform @ np.linalg.inv(to_cells)
    return result


def at_points(cells: npt.NDArray[Any], points: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Return the values of the cells that points lie in, N; of the nearest for those outside.

    :param cells: hxw.
    :param points: Nx2 (x, y) at processing resolution.
    """
    column, row = (points.T // CELL).astype(int)
    rows, columns = cells.shape
    values: npt.NDArray[Any] = cells[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    return values


def enlarged(cells: Mask, shape: tuple[int, ...]) -> Mask:
    """Return cells, hxw, as pixels of a frame whose shape begins with rows and columns."""
    size = shape[1], shape[0]
    pixels: Mask = cv2.resize(cells.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return pixels


def cells_of_objects(
    objects: Sequence[CroppedMask], size: tuple[int, int], shape: tuple[int, ...]
) -> Mask:
    """Return which cells hold objects or the smear of flow beside them, hxw.

    :param objects: in a frame of `size`, width and height.
    :param shape: rows and columns at processing resolution.
    """
    height, width = cells_of(shape)
    if not objects:
        return np.zeros((height, width), bool)
    held = np.zeros((height, width), np.uint8)
    for outline in objects:
        rows, columns = np.nonzero(outline.mask)
        rows, columns = rows + outline.box.y0, columns + outline.box.x0
        held[rows * height // size[1], columns * width // size[0]] = 1
    return cv2.dilate(held, np.ones((5, 5), np.uint8)) > 0


def _middles(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the pixel in the middle of each cell, hxw."""
    height, width = cells_of(values.shape)
    return values[CELL // 2 :: CELL, CELL // 2 :: CELL][:height, :width]


def with_clutter(noise: Map, clutter: Map | None, factor: float) -> Map:
    """Return a motion map's noise, HxW, where it is less so many times what the place moves by.

    :param clutter: hxw cells, in pixels a frame as the noise; None where nothing is known.
    """
    if clutter is None or not clutter.any():
        return noise
    level = cv2.resize(clutter, noise.shape[::-1], interpolation=cv2.INTER_LINEAR)
    raised: Map = np.maximum(noise, np.float32(factor) * level)
    return raised
