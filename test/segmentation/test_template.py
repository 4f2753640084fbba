"""Where something is in the next frame, told by its picture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.drawn_scene import texture
from turbseg_ros.arrays import ByteImage, Matrix
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.template import Template

HEIGHT, WIDTH = 120, 160
STILL_CAMERA = np.eye(3)


def scene_with(thing: ByteImage, x: int, y: int, scene: ByteImage | None = None) -> ByteImage:
    """A frame, HxWx1, in which the upper left pixel of a thing is (x, y)."""
    frame = texture((HEIGHT, WIDTH), 1) if scene is None else scene.copy()
    frame[y : y + thing.shape[0], x : x + thing.shape[1]] = thing
    return frame[..., None]


def outline_of(thing: ByteImage, x: int, y: int) -> CroppedMask:
    height, width = thing.shape
    return CroppedMask(Box(x, y, x + width, y + height), np.ones((height, width), bool))


def displacement(
    before: ByteImage,
    outline: CroppedMask,
    after: ByteImage,
    ego_motion: Matrix = STILL_CAMERA,
) -> np.ndarray | None:
    return Template.of(outline, before).displacement(after, ego_motion)


@settings(max_examples=30, deadline=None)
@given(dx=st.integers(-9, 9), dy=st.integers(-9, 9))
def test_a_thing_is_found_where_it_went(dx: int, dy: int) -> None:
    thing = texture((14, 22), 2)
    found = displacement(
        scene_with(thing, 60, 50), outline_of(thing, 60, 50), scene_with(thing, 60 + dx, 50 + dy)
    )
    assert found is not None
    np.testing.assert_allclose(found, (dx, dy), atol=0.3)


def test_a_large_thing_is_found_within_a_pixel() -> None:
    thing = texture((60, 90), 2)
    found = displacement(
        scene_with(thing, 10, 20), outline_of(thing, 10, 20), scene_with(thing, 31, 27)
    )
    assert found is not None
    np.testing.assert_allclose(found, (21, 7), atol=1.0)


def test_the_displacement_is_against_the_scene_where_the_camera_turns() -> None:
    thing, scene = texture((14, 22), 2), texture((HEIGHT, WIDTH), 1)
    turned = np.roll(scene, (3, -8), axis=(0, 1))
    found = displacement(
        scene_with(thing, 60, 50, scene),
        outline_of(thing, 60, 50),
        scene_with(thing, 57, 54, turned),
        translation(-8.0, 3.0),
    )
    assert found is not None
    np.testing.assert_allclose(found, (5, 1), atol=0.3)


def test_other_light_changes_nothing() -> None:
    thing = texture((14, 22), 2)
    brighter = np.asarray(np.clip(thing * 0.7 + 40.0, 0, 255), np.uint8)
    found = displacement(
        scene_with(thing, 60, 50), outline_of(thing, 60, 50), scene_with(brighter, 66, 50)
    )
    assert found is not None
    np.testing.assert_allclose(found, (6, 0), atol=0.3)


def test_the_rim_tells_where_a_plain_thing_is() -> None:
    thing, road = np.full((14, 22), 40, np.uint8), np.full((HEIGHT, WIDTH), 120, np.uint8)
    found = displacement(
        scene_with(thing, 60, 50, road),
        outline_of(thing, 60, 50),
        scene_with(thing, 64, 53, road),
    )
    assert found is not None
    np.testing.assert_allclose(found, (4, 3), atol=0.3)


def test_what_has_become_something_else_is_not_found() -> None:
    before, after = (
        scene_with(texture((14, 22), 2), 60, 50),
        scene_with(texture((14, 22), 3), 60, 50),
    )
    assert displacement(before, outline_of(before[50:64, 60:82, 0], 60, 50), after) is None


@pytest.mark.parametrize("side", [1, 3, 20], ids=["one pixel", "few pixels", "plain"])
def test_what_is_plain_or_tiny_is_not_found(side: int) -> None:
    plain = np.full((HEIGHT, WIDTH, 1), 100, np.uint8)
    outline = CroppedMask(Box(40, 40, 40 + side, 40 + side), np.ones((side, side), bool))
    assert displacement(plain, outline, plain) is None


@settings(max_examples=60, deadline=None)
@given(
    x=st.integers(0, WIDTH - 12),
    y=st.integers(0, HEIGHT - 9),
    turn=st.tuples(st.floats(-300, 300), st.floats(-300, 300)),
)
def test_a_thing_at_the_border_or_out_of_view_does_no_harm(
    x: int, y: int, turn: tuple[float, float]
) -> None:
    thing = texture((9, 12), 2)
    frame = scene_with(thing, x, y)
    found = displacement(frame, outline_of(thing, x, y), frame, translation(*turn))
    assert found is None or np.isfinite(found).all()


def test_pictures_in_colour_are_followed() -> None:
    thing = texture((14, 22), 2)
    before, after = (np.repeat(scene_with(thing, x, 50), 3, axis=2) for x in (60, 68))
    found = displacement(before, outline_of(thing, 60, 50), after)
    assert found is not None
    np.testing.assert_allclose(found, (8, 0), atol=0.3)
