"""Outlines cut out of drawn scenes whose objects are known."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.drawn_scene import Mask, jaccard, rectangle, scene_behind, texture
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import AlignedFrame, background_in
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.foreground import (
    Surroundings,
    foreground_masks,
    guided_filter,
    separated,
    without_shadow,
)
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.refinement import refined_masks

SHAPE = (96, 160)
EMPTY_MASK = np.zeros(SHAPE, bool)
STILL = MotionEstimate(
    velocity=np.zeros((48, 80, 2), np.float32),
    motion_map=np.zeros((48, 80), np.float32),
    noise=np.ones((48, 80), np.float32),
    tilt=0.05,
    visible=np.ones((48, 80), bool),
    ego_motion_model="affine",
)
TILT, THRESHOLD = 0.1, 2.5


def noisy(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, 2.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def ground_of(channels: int) -> np.ndarray:
    return np.dstack([texture(SHAPE, seed=20 + c, low=90, high=190) for c in range(channels)])


def still_views(ground: np.ndarray, objects: Mask = EMPTY_MASK) -> list[AlignedFrame]:
    return [
        AlignedFrame(scene_behind(noisy(ground, seed), objects), np.eye(3)) for seed in range(10)
    ]


def area_around(*objects: Mask, margin: int = 7) -> MovingArea:
    """What flow would show of objects: all of them, and a smear around."""
    smeared = EMPTY_MASK.copy()
    for found in objects:
        box = Box.around(found).padded(margin, SHAPE)
        smeared[box.slices] = True
    core = np.logical_or.reduce(objects)
    heart = EMPTY_MASK.copy()
    for found in objects:
        box = Box.around(found)
        heart[box.y0 + 7 : box.y1 - 7, box.x0 + 7 : box.x1 - 7] = True
    search, probable, certain = (CroppedMask.of(each) for each in (smeared, core, heart))
    return MovingArea(search, probable, certain, (3.0, 0.0))


def cut_out(image: np.ndarray, areas: list[MovingArea], views: list[AlignedFrame]) -> list[Mask]:
    """The outlines' masks, each of the whole frame."""
    windows = Surroundings(image, areas, views, STILL, TILT).crops
    return [outline.in_frame(SHAPE) for outline in foreground_masks(windows, THRESHOLD)]


CAR = rectangle(60, 30, 96, 54)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("grey", [30, 240])
def test_an_object_is_cut_out_of_its_moving_area(channels: int, grey: int) -> None:
    ground = ground_of(channels)
    image = ground.copy()
    image[CAR] = grey
    (found,) = cut_out(noisy(image, 99), [area_around(CAR)], still_views(ground))
    assert jaccard(found, CAR) > 0.9


def test_an_outline_follows_an_object_that_is_no_rectangle() -> None:
    y, x = np.indices(SHAPE)
    disk = np.hypot(x - 80, y - 48) < 18
    ground = ground_of(1)
    image = np.where(disk[..., None], 30, ground)
    (found,) = cut_out(noisy(image, 99), [area_around(disk)], still_views(ground))
    assert jaccard(found, disk) > 0.9


@pytest.mark.parametrize("channels", [1, 3])
def test_a_shadow_is_taken_off(channels: int) -> None:
    ground = ground_of(channels)
    shadow = rectangle(62, 54, 94, 61)
    image = ground.astype(float)
    image[shadow] *= 0.75
    image[CAR] = 10
    (found,) = cut_out(noisy(image, 99), [area_around(CAR | shadow)], still_views(ground))
    assert jaccard(found, CAR) > 0.9
    assert (found & shadow).sum() < 0.15 * shadow.sum()


def test_an_object_as_dark_as_a_shadow_stays_whole() -> None:
    ground = ground_of(1)
    image = ground.astype(float)
    image[CAR] *= 0.6
    (found,) = cut_out(noisy(image, 99), [area_around(CAR)], still_views(ground))
    assert jaccard(found, CAR) > 0.85


def test_nothing_is_found_where_nothing_stands_out() -> None:
    ground = ground_of(1)
    assert not cut_out(noisy(ground, 99), [area_around(CAR)], still_views(ground))


def test_nothing_is_found_where_nothing_moves() -> None:
    ground = ground_of(1)
    image = ground.copy()
    image[CAR] = 30
    assert not cut_out(noisy(image, 99), [], still_views(ground))


def test_what_stands_out_beside_a_moving_area_is_left_alone() -> None:
    ground = ground_of(1)
    parked = rectangle(110, 60, 140, 80)
    image = ground.copy()
    image[CAR | parked] = 30
    (found,) = cut_out(noisy(image, 99), [area_around(CAR)], still_views(ground))
    assert not (found & parked).any()


def test_two_objects_in_one_area_are_told_apart() -> None:
    left, right = rectangle(30, 30, 50, 54), rectangle(90, 34, 112, 56)
    ground = ground_of(1)
    image = ground.copy()
    image[left | right] = 30
    whole = area_around(left | right)
    found = cut_out(noisy(image, 99), [whole], still_views(ground))
    first, second = sorted(found, key=lambda mask: Box.around(mask).x0)
    assert jaccard(first, left) > 0.9
    assert jaccard(second, right) > 0.9


def test_areas_that_touch_are_one_object() -> None:
    front, rear = rectangle(60, 30, 78, 54), rectangle(78, 30, 96, 54)
    ground = ground_of(1)
    image = ground.copy()
    image[CAR] = 30
    areas = [area_around(front), area_around(rear)]
    (found,) = cut_out(noisy(image, 99), areas, still_views(ground))
    assert jaccard(found, CAR) > 0.9


def test_a_crop_leaves_what_is_nearer_to_another_area_to_that_ones_crop() -> None:
    upper, lower = rectangle(40, 20, 80, 40), rectangle(60, 46, 100, 66)
    areas = [area_around(each, margin=2) for each in (upper, lower)]
    ground = ground_of(1)
    crops = Surroundings(ground, areas, still_views(ground), STILL, TILT).crops
    assert crops[0].box.intersection(crops[1].box) is not None
    judged = [(upper | lower)[crop.box.slices].astype(np.float32) for crop in crops]
    found = refined_masks(crops, judged)
    assert sorted(outline.area for outline in found) == [800, 800]


def test_while_its_background_is_hidden_an_object_is_told_by_its_colour() -> None:
    ground = ground_of(3)
    image = ground.copy()
    image[CAR] = (30, 40, 200)
    hidden = area_around(CAR).search_mask.in_frame(SHAPE)
    (found,) = cut_out(noisy(image, 99), [area_around(CAR)], still_views(ground, hidden))
    assert jaccard(found, CAR) > 0.8


def test_outlines_are_the_same_each_time() -> None:
    ground = ground_of(3)
    image = ground.copy()
    image[CAR] = (30, 40, 200)
    views = still_views(ground, area_around(CAR).search_mask.in_frame(SHAPE))
    first = cut_out(noisy(image, 99), [area_around(CAR)], views)
    cv2.setRNGSeed(12345)
    second = cut_out(noisy(image, 99), [area_around(CAR)], views)
    np.testing.assert_array_equal(first, second)


def test_a_shadow_lies_below_its_object() -> None:
    ground = ground_of(1)
    views = still_views(ground)
    background = background_in(Box(0, 0, SHAPE[1], SHAPE[0]), views)
    image = ground.astype(float)
    above = rectangle(62, 23, 94, 30)
    image[above] *= 0.75
    image[CAR] = 10
    kept = without_shadow(CAR | above, noisy(image, 99), background)
    assert (kept & above).sum() > 0.9 * above.sum()


def test_an_empty_mask_has_no_shadow() -> None:
    ground = ground_of(1)
    background = background_in(Box(0, 0, SHAPE[1], SHAPE[0]), still_views(ground))
    assert not without_shadow(EMPTY_MASK, ground, background).any()


def test_parts_with_a_wide_gap_are_separate() -> None:
    left, right = rectangle(10, 10, 30, 30), rectangle(60, 10, 80, 30)
    parts = sorted(separated(left | right), key=lambda part: Box.around(part).x0)
    np.testing.assert_array_equal(parts, [left, right])


def test_a_narrow_gap_parts_nothing() -> None:
    both = rectangle(10, 10, 30, 30) | rectangle(33, 10, 53, 30)
    (whole,) = separated(both)
    np.testing.assert_array_equal(whole, both)


def test_a_row_of_vehicles_is_told_apart_by_gaps_that_would_part_none_of_them() -> None:
    row = [rectangle(10 + 19 * n, 40, 24 + 19 * n, 50) for n in range(7)]
    parts = sorted(separated(np.logical_or.reduce(row)), key=lambda part: Box.around(part).x0)
    np.testing.assert_array_equal(parts, row)


def test_debris_is_dropped() -> None:
    (kept,) = separated(rectangle(10, 10, 40, 40) | rectangle(55, 44, 59, 48))
    np.testing.assert_array_equal(kept, rectangle(10, 10, 40, 40))


def test_what_is_small_and_far_from_the_large_is_no_debris() -> None:
    large, small = rectangle(10, 10, 40, 40), rectangle(80, 60, 84, 64)
    np.testing.assert_array_equal(separated(large | small), [large, small])


def test_nothing_has_no_parts() -> None:
    assert separated(EMPTY_MASK) == []


@settings(max_examples=40, deadline=None)
@given(mask=hnp.arrays(np.bool_, (12, 17), elements=st.booleans()))
def test_parts_are_disjoint_and_of_the_mask(mask: Mask) -> None:
    total = np.sum([np.zeros(mask.shape, int), *separated(mask)], axis=0)
    assert total.max() <= 1
    assert not (total.astype(bool) & ~mask).any()


def test_the_guided_filter_smooths_where_its_guide_is_plain() -> None:
    noise = np.random.default_rng(0).normal(0, 1, SHAPE).astype(np.float32)
    smooth = guided_filter(np.full(SHAPE, 0.5, np.float32), noise, radius=2, epsilon=1e-3)
    assert smooth.std() < 0.3 * noise.std()


def test_the_guided_filter_keeps_the_edges_of_its_guide() -> None:
    guide = np.where(rectangle(0, 0, 80, 96), 0.2, 0.8).astype(np.float32)
    step = np.where(rectangle(0, 0, 80, 96), -1.0, 1.0).astype(np.float32)
    kept = guided_filter(guide, step, radius=2, epsilon=1e-3)
    np.testing.assert_allclose(kept, step, atol=0.1)
    blurred = guided_filter(np.full(SHAPE, 0.5, np.float32), step, radius=2, epsilon=1e-3)
    assert np.abs(blurred - step).max() > 0.5


def test_nothing_is_cut_out_where_no_other_frame_shows_the_scene() -> None:
    assert Surroundings(ground_of(1), [area_around(CAR)], [], STILL, TILT).crops == []


def test_the_motion_of_a_window_lies_where_the_picture_does() -> None:
    motion_map = np.zeros((48, 80), np.float32)
    motion_map[15:27, 30:48] = 3.0
    moved = dataclasses.replace(STILL, motion_map=motion_map, noise=np.full((48, 80), 0.5, "f4"))
    image = ground_of(1)
    (window,) = Surroundings(image, [area_around(CAR)], still_views(image), moved, TILT).crops
    assert window.motion.max() == 6.0
    expected = CAR[window.box.slices]
    assert jaccard(window.motion > 3.0, expected) > 0.98
