"""Seeds and regions on motion maps that are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from support.drawn_motion import drawn_motion
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import (
    Region,
    Seed,
    Similarity,
    grow_regions,
    seed_strength,
    similar_magnitude,
    similar_velocity,
)

SHAPE = (60, 90)
SQUARE = (slice(20, 40), slice(30, 50))


def mask_of(region: Region) -> np.ndarray:
    return region.outline.in_frame(SHAPE)


def drawn_map(magnitude: np.ndarray, **known: Any) -> MotionEstimate:
    """Motion to the right with the given speed at each pixel."""
    return drawn_motion(np.dstack([magnitude, np.zeros_like(magnitude)]), **known)


def square(speed: float, place: tuple[slice, slice] = SQUARE) -> np.ndarray:
    magnitude = np.zeros(SHAPE)
    magnitude[place] = speed
    return magnitude


def regions_of(
    motion: MotionEstimate, similarity: Similarity, delta: float = 0.3, smallest: int = 4
) -> list[Region]:
    strength = seed_strength(motion, size=5, delta1=5.0, delta2=0.5)
    return grow_regions(motion, strength, 5, delta, similarity, smallest)


def seeds(motion: MotionEstimate, size: int = 9, delta1: float = 5.0, delta2: float = 0.5):
    return seed_strength(motion, size, delta1, delta2) > 0


def test_a_window_that_moves_significantly_is_a_seed() -> None:
    found = seeds(drawn_map(square(2.0)))
    assert found[SQUARE].any()
    assert found.sum() == found[SQUARE].sum()


def test_strength_is_the_mean_in_units_of_the_noise() -> None:
    strength = seed_strength(drawn_map(square(2.0), noise=0.25), 9, 5.0, 0.5)
    assert strength.max() == pytest.approx(8.0, rel=1e-4)


@pytest.mark.parametrize(("speed", "delta1", "moves"), [(0.4, 5.0, False), (0.4, 3.0, True)])
def test_delta1_is_the_least_mean_in_units_of_the_noise(
    speed: float, delta1: float, moves: bool
) -> None:
    assert seeds(drawn_map(square(speed), noise=0.1), delta1=delta1).any() == moves


def test_what_moves_no_more_than_the_noise_is_no_seed() -> None:
    assert not seeds(drawn_map(square(2.0), noise=0.5)).any()


@pytest.mark.parametrize(("delta2", "moves"), [(0.5, False), (2.0, True)])
def test_delta2_is_the_largest_deviation_as_a_share_of_the_mean(
    delta2: float, moves: bool
) -> None:
    flicker = 4.0 * (np.indices(SHAPE).sum(axis=0) % 2)
    assert seeds(drawn_map(flicker), delta2=delta2).any() == moves


@pytest.mark.parametrize(("size", "moves"), [(15, False), (5, True)])
def test_a_window_must_fit_into_what_moves(size: int, moves: bool) -> None:
    small = square(2.0, (slice(20, 27), slice(30, 37)))
    assert seeds(drawn_map(small), size=size).any() == moves


def test_what_too_few_frames_see_is_no_seed() -> None:
    assert not seeds(drawn_map(square(2.0), visible=square(1.0) == 0)).any()


def test_each_of_two_objects_has_a_seed() -> None:
    magnitude = square(2.0, (slice(10, 30), slice(5, 25))) + square(
        3.0, (slice(30, 50), slice(60, 80))
    )
    regions = regions_of(drawn_map(magnitude), similar_magnitude)
    assert [region.seed.velocity[0] for region in regions] == pytest.approx([3.0, 2.0])


def cone(peak: float, slope: float) -> np.ndarray:
    y, x = np.indices(SHAPE)
    return np.maximum(peak - slope * np.hypot(x - 30, y - 30), 0.0)


@pytest.mark.parametrize("delta", [0.1, 0.2, 0.5])
def test_equation_3_accepts_exactly_the_connected_pixels_of_like_magnitude(delta: float) -> None:
    magnitude = cone(4.0, 0.15)
    # As fast as the seed, but apart from it, and a hole too fast within.
    magnitude[5:15, 75:85] = 4.0
    magnitude[33:35, 33:35] = 9.0
    motion = drawn_map(magnitude)
    strength = np.zeros(SHAPE, np.float32)
    strength[30, 30] = 40.0
    (region,) = grow_regions(motion, strength, 5, delta, similar_magnitude, 1)

    M = motion.motion_map
    accepted = np.abs(M - M[30, 30]) < delta * M[30, 30]
    components, _ = ndimage.label(accepted)
    np.testing.assert_array_equal(mask_of(region), components == components[30, 30])
    assert 4 < region.outline.area < accepted.sum()


def test_equation_3_leaves_out_the_limit_itself() -> None:
    magnitude = np.full(SHAPE, 2.0)
    magnitude[:, 0:2] = 1.0, 3.0
    magnitude[:, 2:4] = 1.01, 2.99
    accepted = similar_magnitude(drawn_map(magnitude), Seed(20, 20, (2.0, 0.0), 20.0), 0.5)
    assert not accepted[:, :2].any()
    assert accepted[:, 2:].all()


def test_corners_do_not_connect() -> None:
    magnitude = np.zeros(SHAPE)
    magnitude[10:20, 10:20] = magnitude[20:30, 20:30] = 2.0
    regions = regions_of(drawn_map(magnitude), similar_magnitude)
    assert [region.outline.area for region in regions] == [100, 100]


def two_that_pass() -> np.ndarray:
    velocity = np.zeros((*SHAPE, 2))
    velocity[20:40, 20:40] = (2.0, 0.0)
    velocity[20:40, 40:60] = (-2.0, 0.0)
    return velocity


def test_velocity_tells_objects_apart_that_touch_and_go_opposite_ways() -> None:
    regions = regions_of(drawn_motion(two_that_pass()), similar_velocity)
    left, right = sorted((mask_of(region) for region in regions), key=lambda mask: mask[30, 50])
    np.testing.assert_array_equal(left, two_that_pass()[..., 0] > 0)
    np.testing.assert_array_equal(right, two_that_pass()[..., 0] < 0)


def test_magnitude_joins_objects_that_touch_and_go_opposite_ways() -> None:
    (region,) = regions_of(drawn_motion(two_that_pass()), similar_magnitude)
    np.testing.assert_array_equal(mask_of(region), two_that_pass()[..., 0] != 0)


@pytest.mark.parametrize(
    ("velocity", "similar"),
    [
        ((3.0, 4.0), True),
        ((2.4, 3.2), True),
        ((1.2, 1.6), False),
        ((-3.0, -4.0), False),
        ((3.0 - 3.2, 4.0 + 2.4), False),
        ((0.0, 0.0), False),
    ],
    ids=str,
)
def test_velocity_similarity_asks_for_the_seeds_speed_and_direction(
    velocity: tuple[float, float], similar: bool
) -> None:
    motion = drawn_motion(np.full((*SHAPE, 2), velocity))
    accepted = similar_velocity(motion, Seed(5, 5, (3.0, 4.0), 50.0), 0.6)
    assert (accepted == similar).all()


def test_regions_smaller_than_the_smallest_are_dropped() -> None:
    motion = drawn_map(square(2.0))
    (region,) = regions_of(motion, similar_magnitude, smallest=400)
    assert region.outline.area == 400
    assert not regions_of(motion, similar_magnitude, smallest=401)


def test_regions_stay_within_what_is_visible() -> None:
    visible = np.ones(SHAPE, bool)
    visible[:, 45:] = False
    (region,) = regions_of(drawn_map(square(2.0), visible=visible), similar_magnitude)
    np.testing.assert_array_equal(mask_of(region), (square(1.0) > 0) & visible)


def test_a_still_map_has_no_region() -> None:
    assert not regions_of(drawn_map(np.zeros(SHAPE)), similar_velocity)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    delta=st.floats(0.05, 1.0),
    similarity=st.sampled_from([similar_magnitude, similar_velocity]),
)
def test_regions_are_disjoint_and_connected(
    seed: int, delta: float, similarity: Similarity
) -> None:
    noise = np.random.default_rng(seed).normal(size=(*SHAPE, 2))
    velocity = 20.0 * ndimage.gaussian_filter(noise, (4, 4, 0))
    regions = regions_of(drawn_motion(velocity, noise=0.05), similarity, delta)
    taken = np.zeros(SHAPE, int)
    for region in regions:
        taken += mask_of(region)
        assert mask_of(region)[region.seed.y, region.seed.x]
        assert region.outline.area >= 4
        assert ndimage.label(mask_of(region))[1] == 1
    assert taken.max(initial=0) <= 1
    strengths = [region.seed.strength for region in regions]
    assert strengths == sorted(strengths, reverse=True)
