"""The front end of what the border cuts off."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.front import UNCUT, FrontPath, Sides
from turbseg_ros.segmentation.geometry import translation

LEFT, RIGHT, TOP = Sides(left=True), Sides(right=True), Sides(top=True)


def square(x0: int, x1: int, y0: int = 10, y1: int = 30) -> CroppedMask:
    """An outline of columns x0 to x1 - 1 and rows y0 to y1 - 1."""
    return CroppedMask.of(np.ones((y1 - y0, x1 - x0), bool), x0, y0)


@pytest.mark.parametrize(
    ("sides", "inward"),
    [
        (UNCUT, (0, 0)),
        (LEFT, (1, 0)),
        (RIGHT, (-1, 0)),
        (TOP, (0, 1)),
        (Sides(right=True, bottom=True), (-1, -1)),
        (Sides(left=True, right=True), (0, 0)),
    ],
)
def test_inward_leads_away_from_the_sides(sides: Sides, inward: tuple[int, int]) -> None:
    assert sides.inward == inward


def test_a_box_round_two_others_is_cut_where_one_of_them_is() -> None:
    assert LEFT.joined(TOP) == Sides(left=True, top=True)


def test_what_enters_has_come_as_far_as_its_front_end_not_as_its_middle() -> None:
    path = FrontPath()
    for frame in range(5):
        path = path.seen(square(0, 20 + 4 * frame), LEFT)
    # Its middle has come 8 pixels.
    assert path.displacement == pytest.approx([16, 0], abs=1)
    assert path.length == pytest.approx(path.distance)


def test_what_grows_along_the_border_has_not_come() -> None:
    path = FrontPath()
    for frame in range(5):
        path = path.seen(square(80, 100, 40 - 4 * frame, 60), RIGHT)
    assert path.distance == pytest.approx(0, abs=0.5)


def test_single_pixels_are_no_front_end() -> None:
    mask = square(0, 20).mask.copy()
    spike = np.zeros((20, 40), bool)
    spike[:, :20] = mask
    spike[7, 20:] = True
    path = FrontPath().seen(square(0, 20), LEFT).seen(CroppedMask.of(spike, 0, 10), LEFT)
    assert path.distance < 1.5


def test_what_goes_to_and_fro_has_a_long_path_and_no_displacement() -> None:
    path = FrontPath()
    for end in (20, 30, 20, 30, 20):
        path = path.seen(square(0, end), LEFT)
    assert path.distance == 0.0
    assert path.length > 35


def test_a_path_begins_anew_where_other_sides_are_cut_off_and_ends_where_none_is() -> None:
    path = FrontPath().seen(square(0, 20), LEFT).seen(square(0, 40), LEFT)
    assert path.distance > 15
    assert path.seen(square(0, 40, 0, 30), Sides(left=True, top=True)).distance == 0.0
    assert path.seen(square(20, 40), UNCUT) == FrontPath()


def test_the_camera_s_motion_is_no_way_that_it_has_come() -> None:
    path = FrontPath().seen(square(0, 20), LEFT)
    for frame in range(1, 4):
        path = path.propagated(translation(5.0, 0.0)).seen(square(0, 20 + 5 * frame), LEFT)
    assert path.distance == pytest.approx(0, abs=1)
