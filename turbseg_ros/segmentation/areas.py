"""Where objects are to be looked for: regions grown on the motion map, made areas of the frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import Flow, Map, Matrix
from turbseg_ros.segmentation.cropped_mask import CroppedMask, convex_hull
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import Region, Seed

SMEAR = 7
"""Pixels at processing resolution by which flow smears past an edge."""
# Share of a seed's velocity from which a pixel is hardly another's smear.
_CORE = 0.75
# Two regions are one object's when their velocities differ by less than this fraction, and their
# gap is less than that fraction of the root of the smaller one's area.
_ALIKE = 0.3
_NEAR = 0.5


@dataclass(frozen=True)
class MovingArea:
    """Where objects of one motion are to be looked for; `velocity` is in pixels a frame.

    `search_mask` holds all of them and more, for flow smears past edges; `probable` is where
    motion is so strong that it is hardly smear; `certain` lies so deep in that part that it
    surely is object.
    """

    search_mask: CroppedMask
    probable: CroppedMask
    certain: CroppedMask
    velocity: tuple[float, float]

    def moved(self, transform: Matrix, shape: tuple[int, int]) -> MovingArea:
        """Return the area where a transform takes it, what is left of it in a frame of `shape`."""
        mask, probable, certain = (
            outline.resampled(transform, shape, cv2.INTER_NEAREST)
            for outline in (self.search_mask, self.probable, self.certain)
        )
        return MovingArea(mask, probable, certain, self.velocity)


def moving_areas(
    regions: Sequence[Region], motion: MotionEstimate, size: tuple[int, int]
) -> list[MovingArea]:
    """Enlarge grown regions to detail resolution, regions of one object made one area.

    Flow fails within plain objects, so that only their ends may have grown: an area is the convex
    hull of neighbours with one velocity.

    :param size: width and height at detail resolution.
    """
    height, width = motion.motion_map.shape
    frame = (width, height)
    areas = []
    for group in _of_one_velocity(regions):
        seed = max((region.seed for region in group), key=lambda seed: seed.strength)
        probable_parts = [_probable_part(region, motion, seed) for region in group]
        probable = convex_hull(probable_parts)
        certain = probable.eroded(SMEAR, (height, width))
        areas.append(
            MovingArea(
                search_mask=convex_hull([region.outline for region in group]).resized(size, frame),
                probable=probable.resized(size, frame),
                certain=certain.resized(size, frame),
                velocity=(seed.velocity[0] * size[0] / width, seed.velocity[1] * size[1] / height),
            )
        )
    return areas


def _probable_part(region: Region, motion: MotionEstimate, seed: Seed) -> CroppedMask:
    """Return what of a region shares most of a seed's velocity."""
    within = region.outline.box
    share = _share_of_velocity(motion.velocity[within.slices], seed)
    return CroppedMask(within, region.outline.mask & (share > _CORE))


def _of_one_velocity(regions: Sequence[Region]) -> list[list[Region]]:
    """Group regions that move alike and lie close for their size."""
    groups: list[list[Region]] = []
    for region in regions:
        near = [group for group in groups if any(_alike(region, other) for other in group)]
        joined = [region, *(member for group in near for member in group)]
        groups = [group for group in groups if group not in near] + [joined]
    return groups


def _alike(region: Region, other: Region) -> bool:
    change = np.subtract(region.seed.velocity, other.seed.velocity)
    speed = max(np.hypot(*region.seed.velocity), np.hypot(*other.seed.velocity))
    if np.hypot(*change) > _ALIKE * speed:
        return False
    reach = _NEAR * np.sqrt(min(region.outline.area, other.outline.area))
    return region.outline.box.gap(other.outline.box) < reach


def _share_of_velocity(velocity: Flow, seed: Seed) -> Map:
    """Return how much of the seed's velocity each pixel of a flow shares, hxw: 1 for all of it."""
    vx, vy = seed.velocity
    squared = max(vx * vx + vy * vy, 1e-12)
    share: Map = cv2.transform(velocity, np.array([[vx, vy]]) / squared)
    return share
