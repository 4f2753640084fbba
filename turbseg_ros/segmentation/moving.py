"""What moves in a frame: found by its flows, or carried along from the frame before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation import region_growing
from turbseg_ros.segmentation.flow import Flow
from turbseg_ros.segmentation.geometry import pixel_grid, translation
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
from turbseg_ros.segmentation.silhouette import (
    SMEAR,
    MovingArea,
    convex_hull,
    dilated,
    moved,
    moving_areas,
    union,
)
from turbseg_ros.segmentation.stabilization import visible
from turbseg_ros.segmentation.window import Neighbourhood, Resolution

Mask = npt.NDArray[np.bool_]
Matrix = npt.NDArray[np.float64]

# Flow within this many pixels of another frame's border follows the border, not the scene.
_BORDER = 4.0
# Smallest region, in pixels at processing resolution.
_SMALLEST_REGION = 12


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
        taken = dilated(
            union([convex_hull(region.mask) for region in regions], short.motion_map.shape), SMEAR
        )
        regions = _regions(motion, taken | ~agree(short, motion), parameters)
        slow = union([region.mask for region in regions], taken.shape)
        moving = Moving(
            merged(moving.motion, motion, slow),
            [*moving.regions, *regions],
            [*moving.areas, *moving_areas(regions, motion, size)],
        )
    return moving


def carried(moving: Moving, ego_motion: Matrix, resolution: Resolution) -> Moving:
    """Carry what moved in a frame along to the next: the camera's motion, and each one's own.

    :param ego_motion: takes the frame's processing pixels to the next one's.
    """
    detail_motion = resolution.to_detail(ego_motion)
    areas = [_carried_area(area, detail_motion) for area in moving.areas]
    motion = moving.motion
    steps = np.zeros_like(motion.velocity)
    regions = []
    for region in moving.regions:
        mask = moved(region.mask, ego_motion @ translation(*region.seed.velocity))
        steps[mask] = region.seed.velocity
        regions.append(replace(region, mask=mask))
    height, width = motion.motion_map.shape
    before = cv2.transform(pixel_grid((height, width)), np.linalg.inv(ego_motion)[:2]) - steps
    velocity, motion_map = (
        cv2.remap(values, before, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for values in (motion.velocity, motion.motion_map)
    )
    return Moving(
        replace(motion, velocity=velocity, motion_map=motion_map), regions, areas, measured=False
    )


def _carried_area(area: MovingArea, ego_motion: Matrix) -> MovingArea:
    way = ego_motion @ translation(*area.velocity)
    mask, core, heart = (moved(mask, way) for mask in (area.mask, area.core, area.heart))
    return MovingArea(mask, core, heart, area.velocity)


def _regions(motion: MotionEstimate, taken: Mask, parameters: Parameters) -> list[Region]:
    seed, growing = parameters.seed, parameters.growing
    strength = region_growing.seed_strength(motion, seed.size, seed.delta1, seed.delta2)
    similarity = {
        "velocity": region_growing.similar_velocity,
        "magnitude": region_growing.similar_magnitude,
    }[growing.similarity]
    return region_growing.grow_regions(
        motion, strength, seed.size, growing.delta, similarity, _SMALLEST_REGION, taken
    )


def _interval_sets(widest: int) -> list[tuple[int, ...]]:
    """Give the symmetric sets K of eq. 1 that the authors' code uses, up to the widest interval.

    They are ±2, ±3, ±4, ±1 with ±2, and ±2 with ±3; for B = 1 only ±1 is left.
    """
    single: list[tuple[int, ...]] = [(k, -k) for k in range(2, widest + 1)]
    double: list[tuple[int, ...]] = [(k, -k, k + 1, -k - 1) for k in (1, 2) if k < widest]
    return (single + double) or [(1, -1)]
