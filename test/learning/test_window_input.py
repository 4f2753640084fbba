"""What the network is shown of light and colour says what it should of shadows and objects."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.arrays import ByteImage
from turbseg_ros.learning.window_input import colour_change, light_ratio, likeness

SHAPE = (32, 40)
OWN = np.zeros(SHAPE, bool)
OWN[8:24, 10:30] = True


def ground(channels: int = 3) -> ByteImage:
    rng = np.random.default_rng(4)
    base = np.array([90, 130, 160][:channels])
    return (base + rng.integers(-8, 9, (*SHAPE, channels))).astype(np.uint8)


def test_light_tells_a_shadow_by_its_share_whatever_it_falls_on() -> None:
    background = np.linspace(60, 240, 1280, dtype=np.float32).reshape(SHAPE)
    ratio = light_ratio(0.5 * background, background)
    assert ratio.dtype == np.float32
    # Dark noise is lifted a little, so not quite an octave.
    assert ratio.min() >= -1.0
    assert ratio.max() < -0.8


def test_light_stays_within_its_range_in_the_dark() -> None:
    dark, bright = np.zeros(SHAPE, np.float32), np.full(SHAPE, 255, np.float32)
    np.testing.assert_array_equal(light_ratio(bright, dark), 1.0)
    np.testing.assert_array_equal(light_ratio(dark, bright), -1.0)
    np.testing.assert_array_equal(light_ratio(dark, dark), 0.0)


def test_a_shadow_changes_colour_less_than_an_object_does() -> None:
    background = ground().astype(np.float32)
    shadow = (0.5 * background).astype(np.uint8)
    painted = ground()[..., ::-1].copy()
    by_shadow = colour_change(shadow, background)
    by_object = colour_change(painted, background)
    assert by_shadow.max() < by_object.min()
    assert by_object.max() <= 1.0


def test_a_grey_camera_shows_no_colour() -> None:
    grey = ground(1)
    assert not colour_change(grey, 255 - grey.astype(np.float32)).any()


@pytest.mark.parametrize("channels", [1, 3])
def test_likeness_tells_the_colours_of_a_part_from_those_around(channels: int) -> None:
    image = ground(channels)
    image[OWN] = image[OWN] // 3
    # Half of the object alone is known to be one.
    known = OWN.copy()
    known[16:] = False
    seen = likeness(image, known, ~OWN)
    assert seen.dtype == np.float32
    assert seen[OWN].mean() > 0.5
    assert seen[~OWN].mean() < -0.5
    assert np.abs(seen).max() <= 1.0


def test_likeness_says_nothing_where_a_part_is_empty_or_all_is_alike() -> None:
    nothing = np.zeros(SHAPE, bool)
    assert not likeness(ground(), nothing, ~nothing).any()
    assert not likeness(ground(), OWN, nothing).any()
    plain = np.full((*SHAPE, 3), 77, np.uint8)
    assert np.abs(likeness(plain, OWN, ~OWN)).max() < 0.05
