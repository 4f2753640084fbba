"""Regions of what comes closer or goes: their motion has a scale besides its velocity.

Seen along its way a vehicle's sides move apart, and its middle stands: pixels that share a seed's
velocity are one side of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Flow, Mask
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import pixel_grid, upper_median
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import MIN_REGION, Region, connected_to

# Share of a region's own motion, squared, that a scale must explain.
_EXPLAINED = 0.3
# Share of the speed by which a pixel may differ from the motion fitted, and how many times the
# noise that speed must be.
_DIFFERS, _MOVES = 0.5, 2.0
# By how much of its size a region is looked beyond, and how many pixels at least; by how much it
# must grow to be looked beyond again, and how often that is done.
_BEYOND, _LEAST_BEYOND = 0.5, 8
_GROWN, _TIMES = 1.05, 3
# Pixels that a scale is fitted to, and how many times outliers are weighed anew.
_SAMPLES, _REWEIGHTED = 600, 4

Expand = Callable[[Sequence[Region], MotionEstimate, Mask], list[Region]]
"""Lets regions go on beyond what was grown; its parameters are those of `expanded`."""

Vectors = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Expansion:
    """A motion v(p) = velocity + rate (p - middle), in pixels a frame."""

    middle: Vectors
    velocity: Vectors
    rate: float

    def at(self, points: Vectors) -> Vectors:
        """Return the velocity of points, ...x2."""
        motion: Vectors = self.velocity + self.rate * (points - self.middle)
        return motion


def expanded(regions: Sequence[Region], motion: MotionEstimate, taken: Mask) -> list[Region]:
    """Let regions go on where their motion does, with a scale of its own; the first ones first.

    A region whose seed another takes is part of that one, and so is one of which too little is
    left. Regions don't overlap.

    :param taken: HxW, pixels that belong to other regions already.
    """
    free = motion.visible & ~taken
    kept = []
    for region in regions:
        here = region.outline.box.slices
        outline = CroppedMask(region.outline.box, region.outline.mask & free[here])
        if not free[region.seed.y, region.seed.x] or outline.area < MIN_REGION:
            continue
        whole = _gone_on(replace(region, outline=outline), motion, free)
        free[whole.box.slices] &= ~whole.mask
        kept.append(replace(region, outline=whole))
    return kept


def as_grown(regions: Sequence[Region], motion: MotionEstimate, taken: Mask) -> list[Region]:
    """Return regions as they were grown."""
    return list(regions)


def _gone_on(region: Region, motion: MotionEstimate, free: Mask) -> CroppedMask:
    """Return a region with what goes on as it does, pixel by pixel from its seed."""
    outline = region.outline
    for _ in range(_TIMES):
        expansion = _fitted(motion.velocity, outline)
        if expansion is None:
            return outline
        beyond = max(int(_BEYOND * max(outline.box.shape)), _LEAST_BEYOND)
        box = outline.box.padded(beyond, free.shape)
        here = box.slices
        wanted = expansion.at(pixel_grid(free.shape)[here].astype(np.float64))
        speed = np.linalg.norm(wanted, axis=-1)
        difference = np.linalg.norm(motion.velocity[here] - wanted, axis=-1)
        alike = (difference < _DIFFERS * speed) & (speed > _MOVES * motion.noise[here])
        alike &= free[here]
        x, y = region.seed.x - box.x0, region.seed.y - box.y0
        grown = connected_to(x, y, alike | outline.within(box))
        grown = CroppedMask(grown.box.moved(box.x0, box.y0), grown.mask)
        if grown.area <= _GROWN * outline.area:
            return outline
        outline = grown
    return outline


def _fitted(velocity: Flow, outline: CroppedMask) -> _Expansion | None:
    """Fit a motion with a scale to a region by least squares, outliers weighed down.

    :return: None where a velocity alone explains the region as well.
    """
    rows, columns = np.nonzero(outline.mask)
    every = max(len(rows) // _SAMPLES, 1)
    rows, columns = rows[::every] + outline.box.y0, columns[::every] + outline.box.x0
    # A vector is a complex number here.
    points = columns + 1j * rows
    motion = velocity[rows, columns].astype(np.float64) @ [1, 1j]
    weight = np.ones(len(rows))
    for _ in range(_REWEIGHTED):
        total = weight.sum()
        middle, mean = weight @ points / total, weight @ motion / total
        way, change = points - middle, motion - mean
        rate = weight @ (way.conj() * change).real / max(weight @ np.abs(way) ** 2, 1e-9)
        left = np.abs(change - rate * way)
        weight = 1.0 / (1.0 + (left / (2.0 * _deviation(left))) ** 2)
    if weight @ left**2 > (1.0 - _EXPLAINED) * (weight @ np.abs(change) ** 2):
        return None
    return _Expansion(_vector(middle), _vector(mean), float(rate))


def _deviation(lengths: npt.NDArray[np.float64]) -> float:
    return 1.48 * upper_median(lengths) + 1e-6


def _vector(number: complex) -> Vectors:
    return np.array([number.real, number.imag])
