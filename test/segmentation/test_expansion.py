"""Regions of what comes closer, on motion that is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_motion import drawn_motion
from turbseg_ros.segmentation.cropped_mask import union_mask
from turbseg_ros.segmentation.expansion import as_grown, expanded
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import (
    MIN_REGION,
    Region,
    grow_regions,
    seed_strength,
    similar_velocity,
)

SHAPE = (80, 120)
OBJECT = (slice(20, 60), slice(30, 80))
NOTHING = np.zeros(SHAPE, bool)
DELTA = 0.6


def drawn(velocity: np.ndarray, noise: float = 0.02, seed: int = 1) -> MotionEstimate:
    velocity = velocity + np.random.default_rng(seed).normal(0.0, noise, velocity.shape)
    return drawn_motion(velocity, noise)


def coming(
    rate: float,
    middle: tuple[float, float] = (55.0, 40.0),
    place: tuple[slice, slice] = OBJECT,
) -> np.ndarray:
    """Return the motion of an object that grows by `rate` a frame about a point (x, y)."""
    rows, columns = np.indices(SHAPE)
    field = rate * np.stack([columns - middle[0], rows - middle[1]], axis=-1)
    inside = np.zeros((*SHAPE, 1))
    inside[place] = 1.0
    return field * inside


def grown(motion: MotionEstimate) -> list[Region]:
    strength = seed_strength(motion, 9, 5.0, 0.5)
    return grow_regions(motion, strength, 9, DELTA, similar_velocity, MIN_REGION)


def largest(regions: list[Region]) -> Region:
    return max(regions, key=lambda region: region.outline.area)


def share(region: Region) -> float:
    """Return how much of the object a region is, and nothing else."""
    mask = region.outline.in_frame(SHAPE)
    inside = np.zeros(SHAPE, bool)
    inside[OBJECT] = True
    assert np.count_nonzero(mask & ~inside) < 0.1 * inside.sum()
    return np.count_nonzero(mask & inside) / inside.sum()


@pytest.mark.parametrize("rate", [0.02, -0.02])
def test_what_comes_closer_or_goes_is_one_region(rate: float) -> None:
    motion = drawn(coming(rate))
    before = grown(motion)
    after = expanded(before, motion, NOTHING)
    assert share(largest(before)) < 0.5
    # Its middle stands still.
    assert share(largest(after)) > 0.75
    assert len(after) < len(before)


def test_an_object_that_comes_aslant_is_whole() -> None:
    motion = drawn(coming(0.02, (20.0, 80.0)))
    assert share(largest(expanded(grown(motion), motion, NOTHING))) > 0.9


def test_regions_of_one_velocity_stay_as_they_were_grown() -> None:
    field = np.zeros((*SHAPE, 2))
    field[OBJECT] = (0.8, -0.3)
    motion = drawn(field)
    before = grown(motion)
    after = expanded(before, motion, NOTHING)
    assert [region.outline.area for region in after] == [r.outline.area for r in before]


def test_neighbours_that_go_apart_are_not_joined() -> None:
    field = np.zeros((*SHAPE, 2))
    field[20:60, 20:50, 0], field[20:60, 70:100, 0] = -0.5, 0.5
    motion = drawn(field)
    after = expanded(grown(motion), motion, NOTHING)
    assert len(after) == 2
    assert all(region.outline.box.shape[1] < 40 for region in after)


def test_what_is_taken_or_not_visible_is_left_out() -> None:
    motion = drawn(coming(0.02))
    before = grown(motion)
    taken = NOTHING.copy()
    taken[:, 70:] = True
    motion.visible[50:] = False
    regions = expanded(before, motion, taken)
    mask = union_mask([region.outline for region in regions], SHAPE)
    assert mask.any()
    assert not (mask & (taken | ~motion.visible)).any()


def test_regions_do_not_overlap() -> None:
    beside = slice(20, 60), slice(80, 112)
    motion = drawn(coming(0.03) + coming(-0.03, (96.0, 40.0), beside))
    regions = expanded(grown(motion), motion, NOTHING)
    outlines = np.stack([region.outline.in_frame(SHAPE) for region in regions])
    assert len(outlines) > 1
    assert outlines.sum(axis=0).max() == 1


def test_as_grown_they_stay() -> None:
    motion = drawn(coming(0.02))
    before = grown(motion)
    assert as_grown(before, motion, NOTHING) == before
