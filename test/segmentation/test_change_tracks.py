"""Targets in the change of a picture: which are found to move, and where none is believed."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_sky import LAMPS, SHAPE, START, Place, sky_with_dots, straight
from turbseg_ros.segmentation.blobs import blobs_in
from turbseg_ros.segmentation.change_tracks import ChangeTracks
from turbseg_ros.segmentation.clutter import cells_of
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.target_tracks import TargetTracks


def changing(
    target: Place, frames: int, drift: float = 0.0, known: np.ndarray | None = None
) -> TargetTracks:
    """Return tracks of what changes: a target that is in no single picture, before lamps.

    :param drift: by which registration errs in each frame.
    :param known: cells of known objects.
    """
    standing = TargetTracks()
    tracks = ChangeTracks(standing, cells_of(SHAPE))
    cells = np.zeros(cells_of(SHAPE), bool) if known is None else known
    for index in range(frames):
        motion = translation(drift if index else 0.0, 0.0)
        standing.take(blobs_in(sky_with_dots(LAMPS, index)), motion)
        tracks.take(blobs_in(sky_with_dots([target(index)], index)), motion, known=cells)
    return tracks


def test_what_changes_moves_once_it_has_gone_for_half_a_second() -> None:
    assert changing(straight(1.0), 8).moving_at(0) == []
    (found,) = changing(straight(1.0), 24).moving_at(0)
    np.testing.assert_allclose(found.place, straight(1.0)(23), atol=0.7)
    assert found.by_change


@pytest.mark.parametrize("speed", [0.0, 0.06])
def test_what_changes_but_hardly_moves_is_no_target(speed: float) -> None:
    assert changing(straight(speed), 96).moving_at(0) == []


def test_what_changes_is_held_against_what_stands_in_the_picture() -> None:
    # It stands, and registration says that the scene moves.
    assert changing(straight(0.0), 48, drift=0.3).moving_at(0) == []
    (found,) = changing(straight(1.0), 48, drift=0.3).moving_at(0)
    np.testing.assert_allclose(found.place, straight(1.0)(47), atol=0.7)


def test_no_target_begins_where_known_objects_are_or_were() -> None:
    everywhere = np.ones(cells_of(SHAPE), bool)
    assert changing(straight(1.0), 24, known=everywhere).moving_at(0) == []


def test_no_target_is_believed_where_changes_keep_going_nowhere() -> None:
    def foam(index: int) -> tuple[float, float]:
        # A wave breaks here every eight frames, for six of them, and runs on for some pixels.
        wave, since = divmod(index, 8)
        x = START[0] + 2.0 * since + 3.0 * (wave % 4)
        return (x, START[1]) if since < 6 else (-50.0, -50.0)

    def then_a_boat(index: int) -> tuple[float, float]:
        return foam(index) if index < 200 else (START[0] + 0.5 * (index - 200), START[1])

    assert changing(then_a_boat, 224).moving_at(0) == []
    (found,) = changing(lambda index: then_a_boat(index + 200), 24).moving_at(0)
    assert found.place[0] > START[0] + 10
