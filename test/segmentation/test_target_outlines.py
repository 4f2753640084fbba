"""The outlines of targets, and what of the outlines beside them shows them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.drawn_sky import SHAPE, sky_with_dots
from turbseg_ros.arrays import ByteImage, Mask
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.target_outlines import (
    OutlinedTarget,
    outlined_targets,
    target_areas,
    with_targets,
)
from turbseg_ros.segmentation.target_tracks import Target
from turbseg_ros.segmentation.track import Detection

START = (40.0, 40.0)
RESOLUTION = Resolution(input=(180, 120), processing=(180, 120), detail=(180, 120))
# Where a large target is (x, y), how large, and for how long it has moved.
BOAT, RADIUS, LONG = (90, 60), 10, 8


def test_a_target_becomes_a_detection_of_its_size() -> None:
    image = sky_with_dots([START], 1)[..., None]
    target = Target(START, (0.5, 0.0), 20.0, 7)
    (found,) = with_targets([], outlined_targets([target], image, RESOLUTION), [], SHAPE)
    assert found.targets == {7} and found.moving
    assert 9 <= found.area <= 40
    np.testing.assert_allclose(found.centroid, START, atol=0.7)


@pytest.mark.parametrize(("side", "shown"), [(8, {7}), (80, set())])
def test_an_outline_that_shows_the_target_stands_for_it(side: int, shown: set[int]) -> None:
    image = sky_with_dots([START], 1)[..., None]
    mask = np.zeros(SHAPE, np.uint8)
    cv2.rectangle(mask, (36, 36), (36 + side, 36 + side), 1, cv2.FILLED)
    outline = CroppedMask.of(mask > 0)
    outlined = Detection(outline.box, outline.mask, (0.5, 0.0), moving=True)
    target = Target(START, (0.5, 0.0), 20.0, 7)
    (found,) = with_targets([outlined], outlined_targets([target], image, RESOLUTION), [], SHAPE)
    assert found.area == outlined.area
    assert found.targets == shown


def boat(frames: int = LONG, scale: int = 4) -> OutlinedTarget:
    """Return the target that a boat is, which has moved for so many frames."""
    middle = (float(BOAT[0]), float(BOAT[1]))
    target = Target(middle, (1.0, 0.0), 60.0, 7, scale, frames)
    (found,) = outlined_targets([target], sea(), RESOLUTION)
    return found


def sea() -> ByteImage:
    """Draw a boat above its wake, which is nearly as bright, HxWx1."""
    image = np.full(SHAPE, 60, np.uint8)
    cv2.rectangle(image, (20, BOAT[1] + RADIUS - 2), (160, BOAT[1] + RADIUS + 5), 105, cv2.FILLED)
    cv2.circle(image, BOAT, RADIUS, 150, cv2.FILLED)
    return image[..., None]


def disc(radius: int = RADIUS) -> Mask:
    return cv2.circle(np.zeros(SHAPE, np.uint8), BOAT, radius, 1, cv2.FILLED) > 0


def outlined(mask: Mask, targets: frozenset[int] = frozenset()) -> Detection:
    outline = CroppedMask.of(mask)
    return Detection(outline.box, outline.mask, (1.0, 0.0), moving=False, targets=targets)


def is_boat(detection: Detection) -> bool:
    own = boat().detection
    return detection.outline.iou(own.outline) == 1.0 and detection.targets == own.targets


def test_a_large_target_is_outlined_without_what_is_beside_it() -> None:
    assert boat().detection.outline.iou(CroppedMask.of(disc())) > 0.8


def test_a_target_without_contrast_has_no_outline() -> None:
    target = Target((90.0, 60.0), (1.0, 0.0), 60.0, 7, 4)
    assert outlined_targets([target], np.full((*SHAPE, 1), 60, np.uint8), RESOLUTION) == []


def test_one_thing_that_is_a_target_at_two_scales_is_outlined_once() -> None:
    middle = (float(BOAT[0]), float(BOAT[1]))
    targets = [Target(middle, (1.0, 0.0), 60.0, scale, scale) for scale in (4, 8)]
    (found,) = outlined_targets(targets, sea(), RESOLUTION)
    assert found.target.scale == 8


def test_objects_are_looked_for_around_a_large_target_that_no_flow_shows() -> None:
    (area,) = target_areas([boat()], np.zeros(SHAPE, bool), RESOLUTION)
    assert area.search_mask.common_area(CroppedMask.of(disc())) > 0.9 * disc().sum()
    assert target_areas([boat()], area.search_mask.in_frame(SHAPE), RESOLUTION) == []


def test_a_large_target_beside_nothing_is_a_detection() -> None:
    (found,) = with_targets([], [boat(frames=1)], [], SHAPE)
    assert is_boat(found)


def test_an_outline_that_is_not_much_larger_shows_a_large_target() -> None:
    (found,) = with_targets([outlined(disc(12))], [boat(frames=1)], [], SHAPE)
    assert found.area == disc(12).sum()
    assert found.targets == {7} and found.moving


@pytest.mark.parametrize(("frames", "count"), [(LONG - 1, 1), (LONG, 2)])
def test_a_large_target_is_cut_out_of_a_wave_once_it_has_moved_for_long(
    frames: int, count: int
) -> None:
    found = with_targets([outlined(disc(40))], [boat(frames)], [], SHAPE)
    assert len(found) == count
    assert not found[0].targets
    assert all(is_boat(each) for each in found[1:])


def test_what_a_known_object_shows_is_no_target() -> None:
    whole = outlined(disc(30))
    assert with_targets([whole], [boat()], [whole], SHAPE) == [whole]


@pytest.mark.parametrize(("radius", "shows"), [(30, True), (55, False)])
def test_an_object_that_is_a_target_grows_no_more_than_twice(radius: int, shows: bool) -> None:
    known = outlined(disc(25), frozenset({7}))
    found = with_targets([outlined(disc(radius))], [boat(frames=1)], [known], SHAPE)
    assert found[0].targets == (frozenset({7}) if shows else frozenset())
    assert len(found) == (1 if shows else 2)
