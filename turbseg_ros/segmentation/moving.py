"""What moves in a frame: found by its flows, or carried along from the frame before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation import region_growing
from turbseg_ros.segmentation.areas import SMEAR, MovingArea, moving_areas
from turbseg_ros.segmentation.cropped_mask import Box, convex_hull, union_mask
from turbseg_ros.segmentation.flow import Flow
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.motion import (
    MotionEstimate,
    affine_motions,
    agree,
    mean_velocity,
    merged,
    sampson_motion,
    slope_velocity,
    unchecked_motions,
)
from turbseg_ros.segmentation.region_growing import Region
from turbseg_ros.segmentation.registration import visible
from turbseg_ros.segmentation.window import Neighbourhood, Resolution

Mask = npt.NDArray[np.bool_]
Map = npt.NDArray[np.float32]
Matrix = npt.NDArray[np.float64]

# Flow within this many pixels of another frame's border follows the border, not the scene.
_BORDER = 4.0
# Smallest region, in pixels at processing resolution.
_MIN_REGION = 12


@dataclass(frozen=True)
class Moving:
    """What moves in a frame: the motion measured, the regions grown, where objects may be.

    Motion and regions are at processing resolution, areas at detail resolution; `measured` is
    False where all that was carried along from an earlier frame.
    """

    motion: MotionEstimate
    regions: Sequence[Region]
    areas: Sequence[MovingArea]
    measured: bool = True

    def where(self, objects: Mask) -> Moving:
        """Leave out the areas that hold none of the objects, HxW at detail resolution."""
        areas = [area for area in self.areas if area.search_mask.intersection_area(objects)]
        return replace(self, areas=areas)


def measured_motions(
    neighbourhood: Neighbourhood, flows: Mapping[int, Flow], near: int, parameters: Parameters
) -> list[MotionEstimate]:
    """Measure the motion in a frame over a short time and, where there is one, a long time.

    :param flows: {k: F(t→t+k)} to the frame's aligned neighbours.
    :param near: the largest interval of the short time.
    """
    shape = (neighbourhood.grey.shape[0], neighbourhood.grey.shape[1])
    weights = {
        k: visible(shape, transform, _BORDER).astype(np.float32)
        for k, transform in neighbourhood.transforms.items()
    }
    intervals = list(flows)
    if parameters.motion.measure == "sampson":
        return [sampson_motion(flows, weights, _interval_sets(parameters.flow.interval))]
    measure = affine_motions if parameters.motion.measure == "affine" else unchecked_motions
    if parameters.flow.average == "mean":
        return measure(flows, weights, [intervals], mean_velocity)
    short = [k for k in intervals if abs(k) <= near]
    one = len(short) in (len(intervals), 0, 1)
    spans = [intervals] if one else [short, intervals]
    return measure(flows, weights, spans, slope_velocity)


def what_moves(
    motions: Sequence[MotionEstimate], parameters: Parameters, size: tuple[int, int]
) -> Moving:
    """Grow regions over a short time, and over a long one where what is slower moves.

    :param motions: estimates over the short time and, if any, longer ones.
    :param size: width and height at detail resolution.
    """
    short = motions[0]
    regions = _regions(short, np.zeros(short.motion_map.shape, bool), parameters)
    moving = Moving(short, regions, moving_areas(regions, short, size))
    for motion in motions[1:]:
        shape = short.motion_map.shape
        hulls = [convex_hull([region.outline]) for region in regions]
        taken = union_mask([hull.dilated(SMEAR, shape) for hull in hulls], shape)
        regions = _regions(motion, taken | ~agree(short, motion), parameters)
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
    """Carry what moved in a frame along to a later one: the camera's motion, and each one's own.

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
    velocity, motion_map = (
        _moved(ego_motion, values) for values in (motion.velocity, motion.motion_map)
    )
    regions = []
    for region in moving.regions:
        way = ego_motion @ _own_motion(region.seed.velocity, frames)
        outline = region.outline.resampled(way, shape, cv2.INTER_NEAREST)
        regions.append(replace(region, outline=outline))
        if not outline.area:
            continue
        for values, before in ((velocity, motion.velocity), (motion_map, motion.motion_map)):
            there = _moved(way, before, outline.box)
            values[outline.box.slices][outline.mask] = there[outline.mask]
    return Moving(
        replace(motion, velocity=velocity, motion_map=motion_map), regions, areas, measured=False
    )


def _own_motion(velocity: tuple[float, float], frames: int) -> Matrix:
    return translation(velocity[0] * frames, velocity[1] * frames)


def _moved(way: Matrix, values: Map, box: Box | None = None) -> Map:
    """Return what a transform makes of a map, within a box of the frame, all of it if None.

    Beyond its border the map goes on as there.
    """
    height, width = values.shape[:2] if box is None else box.shape
    if box is not None:
        way = translation(-box.x0, -box.y0) @ way
    moved: Map = cv2.warpAffine(values, way[:2], (width, height), borderMode=cv2.BORDER_REPLICATE)
    return moved


def _regions(motion: MotionEstimate, taken: Mask, parameters: Parameters) -> list[Region]:
    seed, growing = parameters.seed, parameters.growing
    strength = region_growing.seed_strength(motion, seed.size, seed.delta1, seed.delta2)
    similarity = {
        "velocity": region_growing.similar_velocity,
        "magnitude": region_growing.similar_magnitude,
    }[growing.similarity]
    return region_growing.grow_regions(
        motion, strength, seed.size, growing.delta, similarity, _MIN_REGION, taken
    )


def _interval_sets(widest: int) -> list[tuple[int, ...]]:
    """Return the symmetric sets K of eq. 1 that the authors' code uses, up to the widest interval.

    They are ±2, ±3, ±4, ±1 with ±2, and ±2 with ±3; for B = 1 only ±1 is left.
    """
    single: list[tuple[int, ...]] = [(k, -k) for k in range(2, widest + 1)]
    double: list[tuple[int, ...]] = [(k, -k, k + 1, -k - 1) for k in (1, 2) if k < widest]
    return (single + double) or [(1, -1)]
