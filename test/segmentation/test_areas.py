"""Grown regions made areas to look for objects in."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_scene import jaccard, rectangle
from turbseg_ros.segmentation.areas import moving_areas
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import Region, Seed

Mask = np.ndarray

SHAPE = (96, 160)
MOVING_SHAPE = (48, 80)


def region(mask: Mask, velocity: tuple[float, float], strength: float = 20.0) -> Region:
    y, x = (int(v.mean()) for v in np.nonzero(mask))
    return Region(Seed(x, y, velocity, strength), CroppedMask.of(mask))


def motion_of(*regions: Region) -> MotionEstimate:
    velocity = np.zeros((*MOVING_SHAPE, 2), np.float32)
    for moving in regions:
        velocity[moving.outline.box.slices][moving.outline.mask] = moving.seed.velocity
    return MotionEstimate(
        velocity=velocity,
        motion_map=np.linalg.norm(velocity, axis=2),
        noise=np.full(MOVING_SHAPE, 0.1, np.float32),
        tilt=0.1,
        visible=np.ones(MOVING_SHAPE, bool),
        ego_motion_model="affine",
    )


def small(x0: int, y0: int, x1: int, y1: int) -> Mask:
    return rectangle(x0, y0, x1, y1, MOVING_SHAPE)


def test_a_region_is_enlarged_to_where_outlines_are_drawn() -> None:
    moving = region(small(20, 10, 50, 34), (2.0, -1.0))
    (area,) = moving_areas([moving], motion_of(moving), (160, 96))
    assert jaccard(area.search_mask.in_frame(SHAPE), rectangle(40, 20, 100, 68)) > 0.95
    assert area.velocity == (4.0, -2.0)


def test_a_heart_lies_in_its_core_and_a_core_in_its_area() -> None:
    moving = region(small(20, 10, 50, 34), (2.0, 0.0))
    (area,) = moving_areas([moving], motion_of(moving), (160, 96))
    mask, core, heart = (
        each.in_frame(SHAPE) for each in (area.search_mask, area.probable, area.certain)
    )
    assert heart.any()
    assert not (heart & ~core).any()
    assert not (core & ~mask).any()


def test_slow_pixels_are_not_the_core_of_an_area() -> None:
    moving = region(small(20, 10, 50, 34), (2.0, 0.0))
    motion = motion_of(moving)
    motion.velocity[:, 40:50] /= 2
    (area,) = moving_areas([moving], motion, (160, 96))
    assert jaccard(area.probable.in_frame(SHAPE), rectangle(40, 20, 80, 68)) > 0.9
    assert jaccard(area.search_mask.in_frame(SHAPE), rectangle(40, 20, 100, 68)) > 0.9


def test_both_ends_of_an_object_are_one_area() -> None:
    front, rear = (region(small(x, 20, x + 12, 32), (2.0, 0.1)) for x in (20, 36))
    (area,) = moving_areas([front, rear], motion_of(front, rear), (160, 96))
    assert jaccard(area.search_mask.in_frame(SHAPE), rectangle(40, 40, 96, 64)) > 0.9


@pytest.mark.parametrize(
    ("gap", "velocity"), [(4, (-2.0, 0.0)), (4, (2.0, 2.0)), (24, (2.0, 0.0))], ids=str
)
def test_what_moves_otherwise_or_far_away_is_another_area(
    gap: int, velocity: tuple[float, float]
) -> None:
    one = region(small(10, 20, 22, 32), (2.0, 0.0))
    other = region(small(22 + gap, 20, 34 + gap, 32), velocity)
    assert len(moving_areas([one, other], motion_of(one, other), (160, 96))) == 2


def test_no_regions_are_no_areas() -> None:
    assert not moving_areas([], motion_of(), (160, 96))
