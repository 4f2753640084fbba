"""Targets of several scales, before a camera that stands or pans."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.drawn_sky import Place
from turbseg_ros.segmentation.blobs import blob_pyramid
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.target_pyramid import TargetPyramid

SHAPE = (240, 320)


def boat_on_a_sea(places: Place, sea: float, frames: int) -> TargetPyramid:
    """Return what was followed of a dark boat on a plain sea before a camera that pans.

    :param places: where the boat is in the picture, by frames.
    :param sea: pixels that the sea moves by in the picture a frame.
    """
    targets = TargetPyramid(SHAPE)
    for index in range(frames):
        picture = np.random.default_rng(index).normal(120.0, 1.0, SHAPE)
        x, y = places(index)
        cv2.circle(picture, (round(x), round(y)), 10, 60.0, cv2.FILLED)
        seen = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        targets.take(blob_pyramid(seen), translation(sea if index else 0.0, 0.0))
    return targets


@pytest.mark.parametrize(
    ("speed", "sea", "moves"),
    [
        (1.0, 0.0, True),
        (-0.2, -1.5, True),
        (-0.5, -1.5, True),
        (-1.0, -1.5, False),
        (-1.5, -1.5, False),
    ],
    ids=["crosses", "followed", "followed worse", "parallax", "scene"],
)
def test_a_large_target_moves_unless_it_may_be_parallax(
    speed: float, sea: float, moves: bool
) -> None:
    def places(index: int) -> tuple[float, float]:
        return 200.0 + speed * index, 120.0

    found = boat_on_a_sea(places, sea, 40).moving_at(0)
    assert bool(found) is moves
    for target in found:
        assert target.scale > 1
        assert target.frames > 4
        np.testing.assert_allclose(target.place, places(39), atol=2.0)
        np.testing.assert_allclose(target.velocity, (speed - sea, 0.0), atol=0.3)


def test_targets_of_all_scales_have_numbers_of_their_own() -> None:
    targets = TargetPyramid(SHAPE)
    for index in range(40):
        picture = np.full(SHAPE, 120, np.uint8)
        cv2.circle(picture, (60 + 2 * index, 60), 10, 60, cv2.FILLED)
        cv2.circle(picture, (60 + 2 * index, 160), 1, 220, cv2.FILLED)
        targets.take(blob_pyramid(picture), np.eye(3))
    found = targets.moving_at(0)
    assert {1} < {target.scale for target in found}
    assert len({target.number for target in found}) == len(found)


def test_nothing_is_followed_where_no_blobs_are_looked_for() -> None:
    targets = TargetPyramid(SHAPE)
    targets.take((), np.eye(3))
    assert targets.moving_at(0) == []
