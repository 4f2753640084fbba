"""What a place in the scene shows, where an object has stood."""

from __future__ import annotations

import numpy as np

from support.drawn_scene import texture
from turbseg_ros.segmentation.background import AlignedFrame, unmasked
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.exposure import ColourExposure
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.place import Place, Sight

GROUND = texture((96, 160), seed=1)[..., None]
SQUARE = (slice(36, 60), slice(70, 94))


def place() -> Place:
    """Return the place of a square that stands before the ground."""
    with_square = GROUND.copy()
    with_square[SQUARE] = texture((24, 24), seed=2, low=10, high=90)[..., None]
    mask = np.zeros(GROUND.shape[:2], bool)
    mask[SQUARE] = True
    view = AlignedFrame(unmasked(GROUND), np.eye(3), ColourExposure.as_it_is(1))
    found = Place.of(CroppedMask.of(mask), with_square, [view] * 8)
    assert found is not None
    return found


def test_a_place_shows_what_was_there_before_once_its_object_has_gone() -> None:
    sight, _ = place().look(GROUND, 0.5)
    assert sight is Sight.BEFORE


def test_a_place_that_has_left_the_view_shows_something_else() -> None:
    sight, seen = place().seen_from(translation(1000.0, 0.0)).look(GROUND, 0.5)
    assert sight is Sight.OTHER
    assert seen.exposure == place().exposure
