"""What moves in a frame, propagated to the next, against where it has gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.drawn_scene import jaccard
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.moving import Moving, propagated, what_moves
from turbseg_ros.segmentation.region_growing import (
    Region,
    grow_regions,
    seed_strength,
    similar_velocity,
)
from turbseg_ros.segmentation.resolution import Resolution

SHAPE = (90, 160)
# Outlines are drawn at twice the resolution of the flow.
RESOLUTION = Resolution(input=(320, 180), processing=(160, 90), detail=(320, 180))
DETAIL = (180, 320)


def grow(motion: MotionEstimate, taken: np.ndarray) -> list[Region]:
    strength = seed_strength(motion, 9, 5.0, 0.5)
    return grow_regions(motion, strength, 9, 0.6, similar_velocity, 12, taken)


VELOCITY = (3.0, -1.0)


def square(dx: float = 0.0, dy: float = 0.0, scale: int = 1) -> np.ndarray:
    mask = np.zeros((SHAPE[0] * scale, SHAPE[1] * scale), bool)
    left, top = round((60 + dx) * scale), round((30 + dy) * scale)
    mask[top : top + 24 * scale, left : left + 24 * scale] = True
    return mask


def estimate(mask: np.ndarray, velocity: tuple[float, float] = VELOCITY) -> MotionEstimate:
    field = np.zeros((*SHAPE, 2), np.float32)
    field[mask] = velocity
    speed = np.linalg.norm(field, axis=2).astype(np.float32)
    noise = np.full(SHAPE, 0.05, np.float32)
    return MotionEstimate(field, speed, noise, 0.3, np.ones(SHAPE, bool), "affine")


@pytest.fixture
def moving() -> Moving:
    return what_moves([estimate(square())], grow, RESOLUTION.detail)


def test_what_moves_is_a_region_and_an_area_around_it(moving: Moving) -> None:
    (region,), (area,) = moving.regions, moving.areas
    assert moving.measured
    assert jaccard(region.outline.in_frame(SHAPE), square()) > 0.9
    assert jaccard(area.search_mask.in_frame(DETAIL), square(scale=2)) > 0.9
    assert area.velocity == pytest.approx((6.0, -2.0), rel=0.1)


def test_over_a_long_time_what_is_slower_is_added(moving: Moving) -> None:
    slow = np.zeros(SHAPE, bool)
    slow[60:80, 110:140] = True
    short, long = estimate(square()), estimate(square() | slow)
    long = replace(long, noise=long.noise / np.float32(10))
    field = long.velocity.copy()
    field[slow] = (0.1, 0.0)
    long = replace(long, velocity=field, motion_map=np.linalg.norm(field, axis=2))
    both = what_moves([short, long], grow, RESOLUTION.detail)
    assert len(both.regions) == len(moving.regions) + 1
    assert jaccard(both.regions[-1].outline.in_frame(SHAPE), slow) > 0.8
    np.testing.assert_allclose(both.motion.motion_map[70, 125], 0.1, rtol=1e-5)


@pytest.mark.parametrize("ego", [(0.0, 0.0), (5.0, 2.0)])
def test_it_is_carried_along_by_its_own_motion_and_the_cameras(
    moving: Moving, ego: tuple[float, float]
) -> None:
    there = propagated(moving, translation(*ego), RESOLUTION)
    way = VELOCITY[0] + ego[0], VELOCITY[1] + ego[1]
    assert not there.measured
    assert jaccard(there.regions[0].outline.in_frame(SHAPE), square(*way)) > 0.9
    assert jaccard(there.areas[0].search_mask.in_frame(DETAIL), square(*way, scale=2)) > 0.9
    assert jaccard(there.areas[0].probable.in_frame(DETAIL), square(*way, scale=2)) > 0.8
    # Where it comes from, motion lingers for its step.
    assert (there.motion.motion_map > 1.5)[square(*way)].all()
    assert jaccard(there.motion.motion_map > 1.5, square(*way)) > 0.8


def test_over_several_frames_it_goes_as_far_as_frame_by_frame(moving: Moving) -> None:
    ego_motion, there = translation(2.0, 1.0), moving
    for _ in range(3):
        there = propagated(there, ego_motion, RESOLUTION)
    at_once = propagated(moving, translation(6.0, 3.0), RESOLUTION, frames=3)
    assert (
        jaccard(
            at_once.areas[0].search_mask.in_frame(DETAIL),
            there.areas[0].search_mask.in_frame(DETAIL),
        )
        > 0.95
    )
    assert jaccard(at_once.motion.motion_map > 1.5, there.motion.motion_map > 1.5) > 0.7


def test_areas_are_left_out_that_hold_no_object(moving: Moving) -> None:
    assert moving.where(square(scale=2)).areas == moving.areas
    assert moving.where(square(dx=-40.0, scale=2)).areas == []


def test_what_leaves_the_view_is_carried_out_of_it(moving: Moving) -> None:
    gone = propagated(moving, translation(300.0, 0.0), RESOLUTION)
    assert not gone.areas[0].search_mask.area
    assert not gone.regions[0].outline.area


def test_nothing_stays_nothing() -> None:
    nothing = what_moves([estimate(np.zeros(SHAPE, bool))], grow, RESOLUTION.detail)
    there = propagated(nothing, translation(5.0, 2.0), RESOLUTION)
    assert (there.regions, there.areas) == ([], [])
    assert not there.motion.motion_map.any()
