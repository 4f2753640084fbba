"""Seeds on the motion map, and the regions that grow from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Map, Mask
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.motion import MotionEstimate

MIN_REGION = 12
"""Area of the smallest region, in pixels at processing resolution."""
_FREE, _TAKEN = 0, 1


@dataclass(frozen=True)
class Seed:
    """A place that moves significantly: pixel (x, y), velocity in pixels a frame, M/noise."""

    x: int
    y: int
    velocity: tuple[float, float]
    strength: float


@dataclass(frozen=True)
class Region:
    """Pixels grown from one seed, at processing resolution."""

    seed: Seed
    outline: CroppedMask


# Given the motion, a seed and the pixels still free, tells which pixels may join the seed.
Similarity = Callable[[MotionEstimate, Seed, float], Mask]


def seed_strength(motion: MotionEstimate, size: int, delta1: float, delta2: float) -> Map:
    """Score every window of size x size as a seed, 0 where it is none.

    A window is one when its mean of M exceeds δ1 times the noise and its variance stays below
    (δ2 · mean)²: the paper's two criteria, in units that the turbulence sets. Of windows that
    overlap the strongest counts: beside an object M only fades out.

    :param size: D, in pixels.
    """
    mean = cv2.blur(motion.motion_map, (size, size))
    strength = mean / motion.noise
    if not (strength > delta1).any():
        return np.zeros_like(strength)
    variance = cv2.blur(motion.motion_map**2, (size, size)) - mean**2
    peak = strength >= cv2.dilate(strength, np.ones((2 * size + 1, 2 * size + 1), np.uint8))
    accepted = (strength > delta1) & (variance < (delta2 * mean) ** 2) & peak & motion.visible
    scored: Map = np.where(accepted, strength, 0.0).astype(np.float32)
    return scored


def similar_magnitude(motion: MotionEstimate, seed: Seed, delta: float) -> Mask:
    """Accept pixels with |M(p) - M(seed)| < δ M(seed): the paper's eq. 3."""
    at_seed = motion.motion_map[seed.y, seed.x]
    accepted: Mask = np.abs(motion.motion_map - at_seed) < delta * at_seed
    return accepted


def similar_velocity(motion: MotionEstimate, seed: Seed, delta: float) -> Mask:
    """Accept pixels whose velocity keeps at least 1-δ of the seed's, and has little across it.

    It tells apart what eq. 3 would join: neighbours of one speed and different directions.
    """
    vx, vy = seed.velocity
    squared = max(vx * vx + vy * vy, 1e-12)
    # Shares of the seed's velocity along it and across it.
    shares = cv2.transform(motion.velocity, np.array([[vx, vy], [-vy, vx]]) / squared)
    along, across = cv2.split(shares)
    accepted: Mask = (along > 1.0 - delta) & (along < 1.0 + 2.0 * delta) & (abs(across) < delta)
    return accepted


def grow_regions(
    motion: MotionEstimate,
    strength: Map,
    size: int,
    delta: float,
    similarity: Similarity,
    smallest: int,
    taken: Mask | None = None,
) -> list[Region]:
    """Grow a region from each seed, strongest first; regions don't overlap.

    :param strength: HxW from :func:`seed_strength`.
    :param size: D, the window's size in pixels.
    :param delta: δ of eq. 3.
    :param smallest: regions below this area in pixels are dropped.
    :param taken: HxW, pixels that belong to other regions already.
    """
    if not strength.any():
        return []
    occupancy = np.full(strength.shape, _FREE, np.uint8)
    if taken is not None:
        occupancy[taken] = _TAKEN
    regions = []
    for seed in _seeds(motion, strength, occupancy, size):
        candidates = similarity(motion, seed, delta) & (occupancy == _FREE) & motion.visible
        grown = connected_to(seed.x, seed.y, candidates)
        occupancy[grown.box.slices][grown.mask] = _TAKEN
        if grown.area >= smallest:
            regions.append(Region(seed, grown))
    return regions


def _seeds(
    motion: MotionEstimate, strength: Map, occupancy: npt.NDArray[np.uint8], size: int
) -> Iterator[Seed]:
    """Return the strongest window that no region has reached yet, until none is left."""
    remaining = strength.copy()
    velocity = cv2.blur(motion.velocity, (size, size))
    reach = np.ones((size, size), np.uint8)
    while True:
        remaining[cv2.dilate(occupancy, reach) == _TAKEN] = 0.0
        _, peak, _, (x, y) = cv2.minMaxLoc(remaining)
        if peak <= 0.0:
            return
        remaining[y, x] = 0.0
        vx, vy = (float(value) for value in velocity[y, x])
        yield Seed(x, y, (vx, vy), peak)


def connected_to(x: int, y: int, candidates: Mask) -> CroppedMask:
    """Return which candidates, HxW, are connected to a pixel, itself with them."""
    filled = candidates.view(np.uint8)
    filled[y, x] = 1
    _, _, _, rectangle = cv2.floodFill(filled, None, (x, y), 2, flags=4)
    box = Box.of_rectangle(rectangle)
    return CroppedMask(box, filled[box.slices] == 2)
