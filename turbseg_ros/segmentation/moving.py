"""What moves in a frame: measured by its flows, or propagated from an earlier frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import Map, Mask, Matrix
from turbseg_ros.segmentation.areas import SMEAR, MovingArea, moving_areas
from turbseg_ros.segmentation.clutter import in_cells
from turbseg_ros.segmentation.cropped_mask import Box, convex_hull, union_mask
from turbseg_ros.segmentation.geometry import corner_displacement, translation
from turbseg_ros.segmentation.motion import MotionEstimate, agree, merged
from turbseg_ros.segmentation.region_growing import Region
from turbseg_ros.segmentation.resolution import Resolution

# Pixels by which the camera may move a picture's corners for its maps to be taken as they are.
_STAYS = 0.5

Grow = Callable[[MotionEstimate, Mask], list[Region]]
"""Grows regions on a motion map, outside of what a mask, hxw, says is taken already."""


@dataclass(frozen=True)
class Moving:
    """What moves in a frame: the motion measured, the regions grown, where objects may be.

    Motion and regions are at processing resolution, areas at detail resolution; `measured` is
    False where all that was propagated from an earlier frame. `overlay` is which cells of the
    picture stand still while the scene moves, hxw; see `static_overlay`. None before it is asked.
    """

    motion: MotionEstimate
    regions: Sequence[Region]
    areas: Sequence[MovingArea]
    measured: bool = True
    overlay: Mask | None = None

    def where(self, objects: Mask) -> Moving:
        """Leave out the areas that hold none of the objects, HxW at detail resolution."""
        areas = [area for area in self.areas if area.search_mask.intersection_area(objects)]
        return replace(self, areas=areas)


def what_moves(motions: Sequence[MotionEstimate], grow: Grow, size: tuple[int, int]) -> Moving:
    """Grow regions over a short baseline, and over longer ones where what is slower moves.

    What the baseline before found is left out, with the smear beside it. What one before that
    found is not: if it moves as it did then, more of it may be seen now.

    :param motions: estimates over the short baseline and, if any, longer ones.
    :param grow: grows the regions of one estimate.
    :param size: width and height at detail resolution.
    """
    short = motions[0]
    regions = grow(short, np.zeros(short.motion_map.shape, bool))
    moving = Moving(short, regions, moving_areas(regions, short, size))
    for motion in motions[1:]:
        shape = short.motion_map.shape
        hulls = [convex_hull([region.outline]) for region in regions]
        taken = union_mask([hull.dilated(SMEAR, shape) for hull in hulls], shape)
        regions = grow(motion, taken | ~agree(short, motion))
        slow = union_mask([region.outline for region in regions], shape)
        moving = Moving(
            merged(moving.motion, motion, slow),
            [*moving.regions, *regions],
            [*moving.areas, *moving_areas(regions, motion, size)],
        )
    return moving


def propagated(
    moving: Moving, ego_motion: Matrix, resolution: Resolution, frames: int = 1
) -> Moving:
    """Propagate what moved in a frame to a later one: by the camera's motion, and each one's own.

    :param ego_motion: takes the frame's processing pixels to the later one's.
    :param frames: how many frames later that is.
    """
    detail_motion = resolution.to_detail(ego_motion)
    areas = [
        area.moved(detail_motion @ _own_motion(area.velocity, frames), resolution.detail[::-1])
        for area in moving.areas
    ]
    motion = moving.motion
    shape = motion.motion_map.shape
    # Of what moves the map goes with it, below; elsewhere it tells of noise.
    if corner_displacement(ego_motion, shape[::-1]) < _STAYS:
        velocity, motion_map = motion.velocity.copy(), motion.motion_map.copy()
    else:
        velocity, motion_map = (
            _moved(ego_motion, values) for values in (motion.velocity, motion.motion_map)
        )
    regions = []
    for region in moving.regions:
        to_later = ego_motion @ _own_motion(region.seed.velocity, frames)
        outline = region.outline.resampled(to_later, shape, cv2.INTER_NEAREST)
        regions.append(replace(region, outline=outline))
        if not outline.area:
            continue
        for values, before in ((velocity, motion.velocity), (motion_map, motion.motion_map)):
            there = _moved(to_later, before, outline.box)
            values[outline.box.slices][outline.mask] = there[outline.mask]
    clutter = None if motion.clutter is None else _moved(in_cells(ego_motion), motion.clutter)
    motion = replace(motion, velocity=velocity, motion_map=motion_map, clutter=clutter)
    return Moving(motion, regions, areas, measured=False, overlay=moving.overlay)


def _own_motion(velocity: tuple[float, float], frames: int) -> Matrix:
    return translation(velocity[0] * frames, velocity[1] * frames)


def _moved(transform: Matrix, values: Map, box: Box | None = None) -> Map:
    """Return what a transform makes of a map, within a box of the frame, all of it if None.

    Beyond its border the map goes on as there.
    """
    height, width = values.shape[:2] if box is None else box.shape
    if box is not None:
        transform = translation(-box.x0, -box.y0) @ transform
    moved: Map = cv2.warpAffine(
        values, transform[:2], (width, height), borderMode=cv2.BORDER_REPLICATE
    )
    return moved
