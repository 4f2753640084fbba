"""Targets drawn before a noisy sky: which are found to move, and which aren't."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_clip import segmented
from support.drawn_sky import LAMPS, SHAPE, START, Place, sky_with_dots, straight
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.blobs import NO_BLOBS, blobs_in
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.target_tracks import TargetTracks


def followed(
    target: Place, frames: int, lamps: list[tuple[float, float]], drift: float = 0.0
) -> TargetTracks:
    """Return tracks after so many frames, in each of which registration errs by a drift."""
    tracks = TargetTracks()
    for index in range(frames):
        seen = sky_with_dots([*lamps, target(index)], index)
        tracks.take(blobs_in(seen), translation(drift if index else 0.0, 0.0))
    return tracks


@pytest.mark.parametrize("speed", [0.06, 0.5, 3.0])
def test_a_target_is_found_to_move_at_any_speed(speed: float) -> None:
    frames = 16 if speed > 1.0 else 96
    (found,) = followed(straight(speed), frames, LAMPS).moving_at(0)
    np.testing.assert_allclose(found.place, straight(speed)(frames - 1), atol=0.7)
    np.testing.assert_allclose(found.velocity, (speed, 0.0), atol=0.1)


def test_what_stands_still_is_none() -> None:
    assert followed(straight(0.0), 96, LAMPS).moving_at(0) == []


def test_what_jitters_on_the_spot_is_none() -> None:
    rng = np.random.default_rng(3)
    jumps = rng.normal(0.0, 0.6, (96, 2)) + START
    assert followed(lambda index: tuple(jumps[index]), 96, LAMPS).moving_at(0) == []


def test_registration_that_drifts_makes_nothing_move() -> None:
    assert followed(straight(0.0), 60, LAMPS, drift=0.3).moving_at(0) == []


def test_a_target_is_told_from_a_registration_that_drifts() -> None:
    (found,) = followed(straight(0.3), 60, LAMPS, drift=0.1).moving_at(0)
    np.testing.assert_allclose(found.place, straight(0.3)(59), atol=0.7)


def test_a_scene_that_passes_what_registration_hangs_on_does_not_move() -> None:
    def passing(index: int) -> list[tuple[float, float]]:
        return [(x - 0.8 * index, y) for x, y in (*LAMPS, (170.0, 20.0), (160.0, 30.0))]

    tracks = TargetTracks()
    for index in range(40):
        dots = [START, (START[0] + 12.0, START[1]), *passing(index)]
        tracks.take(blobs_in(sky_with_dots(dots, index)), np.eye(3))
    assert tracks.moving_at(0) == []


def test_what_is_burnt_in_does_not_move_while_the_camera_does() -> None:
    tracks = TargetTracks()
    for index in range(40):
        lamps = [(x - 0.4 * index, y) for x, y in LAMPS]
        tracks.take(blobs_in(sky_with_dots([*lamps, START], index)), translation(-0.4, 0.0))
    assert tracks.moving_at(0) == []


def panning(target: Place, vouching: list[tuple[float, float]], fixed: bool) -> TargetTracks:
    """Return tracks of a target beside others, which the picture or else the scene holds fast."""
    tracks = TargetTracks()
    for index in range(40):
        shift = 0.0 if fixed else -0.5 * index
        others = [(x + shift, y) for x, y in vouching]
        seen = sky_with_dots([*others, target(index)], index, contrast=15.0)
        tracks.take(blobs_in(seen), translation(-0.5, 0.0))
    return tracks


@pytest.mark.parametrize(("fixed", "count"), [(True, 0), (False, 1)])
def test_what_is_burnt_in_does_not_vouch_for_a_scene(fixed: bool, count: int) -> None:
    # Registration errs, and the target is what stands still.
    tracks = panning(straight(0.3), LAMPS, fixed)
    assert len(tracks.moving_at(0)) == count


@pytest.mark.parametrize(
    ("state", "found"),
    [(CameraState.STILL, 1), (CameraState.LOST, 0), (CameraState.SLEWING, 0)],
)
def test_alone_in_the_sky_a_target_is_believed_while_the_camera_is_known(
    state: CameraState, found: int
) -> None:
    tracks = TargetTracks()
    for index in range(40):
        seen = sky_with_dots([straight(1.0)(index)], index)
        tracks.take(blobs_in(seen), np.eye(3), state)
    assert len(tracks.moving_at(0)) == found


@pytest.mark.parametrize(("turns", "count"), [(0.2, 0), (0.8, 1)])
def test_what_stands_in_the_picture_moves_only_if_the_camera_turns(
    turns: float, count: int
) -> None:
    # What turns more slowly than a camera that follows something is registration that drifts.
    tracks = TargetTracks()
    for index in range(round(20 / turns)):
        passing = [(x - turns * index, y) for x, y in (*LAMPS, (170.0, 20.0), (160.0, 30.0))]
        jitter = np.random.default_rng(index).normal(0.0, 0.4, 2)
        seen = sky_with_dots([*passing, (START[0] + jitter[0], START[1] + jitter[1])], index)
        tracks.take(blobs_in(seen), translation(-turns if index else 0.0, 0.0))
    assert len(tracks.moving_at(0)) == count


def test_a_target_has_the_same_number_in_all_its_frames() -> None:
    tracks = followed(straight(0.5), 60, LAMPS)
    numbers = {found.number for age in range(60) for found in tracks.moving_at(age)}
    assert len(numbers) == 1


def test_it_is_known_where_a_target_was_before_it_was_known_to_move() -> None:
    tracks = followed(straight(0.5), 60, LAMPS)
    (then,) = tracks.moving_at(50)
    np.testing.assert_allclose(then.place, straight(0.5)(9), atol=0.7)
    assert tracks.moving_at(1000) == []


def test_what_lies_in_burnt_in_cells_is_not_followed() -> None:
    overlay = np.zeros((SHAPE[0] // 4, SHAPE[1] // 4), bool)
    overlay[:15] = True
    tracks = TargetTracks()
    for index in range(30):
        seen = sky_with_dots([*LAMPS[:4], straight(1.0)(index)], index)
        tracks.take(blobs_in(seen), np.eye(3), overlay=overlay)
    assert tracks.moving_at(0) == []


def test_nothing_is_followed_in_a_frame_without_blobs() -> None:
    tracks = TargetTracks()
    tracks.take(NO_BLOBS, np.eye(3))
    assert tracks.moving_at(0) == []


@pytest.mark.parametrize("wanted", [True, False])
def test_small_targets_are_reported_only_when_they_are_wanted(wanted: bool) -> None:
    sizes = {"resolution.processing": 180, "resolution.detail": 180}
    parameters = Parameters.from_mapping({**sizes, "seed.small_targets": wanted})
    pictures = [sky_with_dots([*LAMPS, straight(0.5)(index)], index) for index in range(48)]
    found = [moving for result in segmented(pictures, parameters) for moving in result.objects]
    assert bool(found) is wanted
