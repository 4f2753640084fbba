"""Targets drawn before a noisy sky: which are found to move, and which aren't."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from support.drawn_clip import segmented
from support.drawn_sky import SHAPE, sky_with_dots
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.blobs import NO_BLOBS, blob_pyramid, blobs_in
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.target_tracks import TargetPyramid, TargetTracks

# Lamps that stand still, and where the target begins (x, y).
LAMPS = [(20.0, 100.0), (60.0, 104.0), (100.0, 98.0), (150.0, 102.0), (130.0, 60.0)]
START = (40.0, 40.0)

Place = Callable[[int], tuple[float, float]]


def followed(
    target: Place, frames: int, lamps: list[tuple[float, float]], drift: float = 0.0
) -> TargetTracks:
    """Return tracks after so many frames, in each of which registration errs by a drift."""
    tracks = TargetTracks()
    for index in range(frames):
        seen = sky_with_dots([*lamps, target(index)], index)
        tracks.take(blobs_in(seen), translation(drift if index else 0.0, 0.0))
    return tracks


def straight(speed: float) -> Place:
    return lambda index: (START[0] + speed * index, START[1])


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


def boat_on_a_sea(places: Place, sea: float, frames: int) -> TargetPyramid:
    """Return what was followed of a dark boat on a plain sea before a camera that pans.

    :param places: where the boat is in the picture, by frames.
    :param sea: pixels that the sea moves by in the picture a frame.
    """
    targets = TargetPyramid()
    for index in range(frames):
        picture = np.random.default_rng(index).normal(120.0, 1.0, (240, 320))
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
    targets = TargetPyramid()
    for index in range(40):
        picture = np.full((240, 320), 120, np.uint8)
        cv2.circle(picture, (60 + 2 * index, 60), 10, 60, cv2.FILLED)
        cv2.circle(picture, (60 + 2 * index, 160), 1, 220, cv2.FILLED)
        targets.take(blob_pyramid(picture), np.eye(3))
    found = targets.moving_at(0)
    assert {1} < {target.scale for target in found}
    assert len({target.number for target in found}) == len(found)


def test_nothing_is_followed_where_no_blobs_are_looked_for() -> None:
    targets = TargetPyramid()
    targets.take((), np.eye(3))
    assert targets.moving_at(0) == []


def changing(
    target: Place, frames: int, drift: float = 0.0, known: np.ndarray | None = None
) -> TargetTracks:
    """Return tracks of what changes: a target that is in no single picture, before lamps.

    :param drift: by which registration errs in each frame.
    :param known: cells of known objects.
    """
    standing = TargetTracks()
    tracks = TargetTracks(standing=standing)
    cells = np.zeros((SHAPE[0] // 4, SHAPE[1] // 4), bool) if known is None else known
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
    everywhere = np.ones((SHAPE[0] // 4, SHAPE[1] // 4), bool)
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
