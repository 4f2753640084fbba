"""Masks in boxes against masks of whole frames."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.drawn_scene import jaccard, rectangle
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, Box, CroppedMask, convex_hull
from turbseg_ros.segmentation.geometry import translation

Mask = np.ndarray

SHAPE = (96, 160)


def test_an_outline_is_no_larger_than_what_it_holds() -> None:
    outline = CroppedMask.of(rectangle(5, 7, 20, 30), x0=100, y0=50)
    assert outline.box == Box(105, 57, 120, 80)
    assert outline.mask.shape == (23, 15)
    assert outline.mask.all()


def test_a_mask_is_enlarged_to_the_same_place() -> None:
    large = CroppedMask.of(rectangle(20, 10, 50, 34, (48, 80))).resized((160, 96), (80, 48))
    assert jaccard(large.in_frame(SHAPE), rectangle(40, 20, 100, 68)) > 0.97


def test_a_hull_fills_what_its_mask_embraces() -> None:
    ell = rectangle(10, 10, 14, 40) | rectangle(10, 36, 40, 40)
    hull = convex_hull([CroppedMask.of(ell)]).in_frame(SHAPE)
    assert not (ell & ~hull).any()
    assert hull[35, 15]
    assert not hull[12, 38]


def test_the_hull_of_two_parts_spans_them() -> None:
    parts = [CroppedMask.of(rectangle(x, 10, x + 10, 20)) for x in (10, 60)]
    hull = convex_hull(parts)
    np.testing.assert_array_equal(hull.in_frame(SHAPE), rectangle(10, 10, 70, 20))


def test_nothing_has_an_empty_hull() -> None:
    assert convex_hull([EMPTY_MASK]) is convex_hull([]) is EMPTY_MASK


MASKS = hnp.arrays(np.bool_, (24, 30), elements=st.booleans())


@settings(max_examples=40, deadline=None)
@given(mask=MASKS, radius=st.integers(1, 9))
def test_it_widens_and_erodes_as_the_mask_of_the_whole_frame_does(mask: Mask, radius: int) -> None:
    outline, image = CroppedMask.of(mask), mask.astype(np.uint8)
    size = (2 * radius + 1, 2 * radius + 1)
    widened = cv2.dilate(image, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size)) > 0
    np.testing.assert_array_equal(
        outline.dilated(radius, mask.shape).in_frame(mask.shape), widened
    )
    eroded = cv2.erode(image, np.ones(size, np.uint8)) > 0
    found = outline.eroded(radius, mask.shape)
    np.testing.assert_array_equal(found.in_frame(mask.shape), eroded)


@settings(max_examples=40, deadline=None)
@given(mask=MASKS, other=MASKS)
def test_what_it_has_in_common_with_a_mask_is_counted(mask: Mask, other: Mask) -> None:
    assert CroppedMask.of(mask).intersection_area(other) == np.count_nonzero(mask & other)


def test_nothing_stays_nothing() -> None:
    for nothing in (EMPTY_MASK, CroppedMask.of(np.zeros(SHAPE, bool))):
        there = nothing.resampled(translation(5.0, 5.0), SHAPE, cv2.INTER_NEAREST)
        for each in (there, nothing.dilated(3, SHAPE), nothing.eroded(3, SHAPE)):
            assert not each.in_frame(SHAPE).any()
