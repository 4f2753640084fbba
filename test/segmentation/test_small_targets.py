"""Targets of a few pixels, drawn before a noisy sky: which are found to move, and which aren't."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from support.drawn_clip import segmented
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.small_targets import (
    NO_BLOBS,
    SmallTarget,
    TargetTracks,
    blobs_in,
    with_targets,
)
from turbseg_ros.segmentation.track import Detection

SHAPE = (120, 180)
# Lamps that stand still, and where the target begins (x, y).
LAMPS = [(20.0, 100.0), (60.0, 104.0), (100.0, 98.0), (150.0, 102.0), (130.0, 60.0)]
START = (40.0, 40.0)
RESOLUTION = Resolution(input=(180, 120), processing=(180, 120), detail=(180, 120))

Place = Callable[[int], tuple[float, float]]


def picture(dots: list[tuple[float, float]], seed: int, contrast: float = 40.0) -> np.ndarray:
    """Draw bright dots three pixels wide at (x, y) before a sky of noise 1."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sky = np.full(SHAPE, 90.0)
    for each in dots:
        sky += contrast * np.exp(-((x - each[0]) ** 2 + (y - each[1]) ** 2) / 3.0)
    noisy = sky + np.random.default_rng(seed).normal(0.0, 1.0, SHAPE)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def followed(
    target: Place, frames: int, lamps: list[tuple[float, float]], drift: float = 0.0
) -> TargetTracks:
    """Return tracks after so many frames, in each of which registration errs by a drift."""
    tracks = TargetTracks()
    for index in range(frames):
        seen = picture([*lamps, target(index)], index)
        tracks.take(blobs_in(seen), translation(drift if index else 0.0, 0.0))
    return tracks


def straight(speed: float) -> Place:
    return lambda index: (START[0] + speed * index, START[1])


def test_what_stands_out_is_found_where_it_is() -> None:
    blobs = blobs_in(picture([(50.3, 40.0)], 1))
    assert blobs.points.shape == (1, 2)
    np.testing.assert_allclose(blobs.points[0], (50.3, 40.0), atol=0.4)
    assert blobs.contrast[0] > 10.0


def test_a_darker_target_has_a_negative_contrast() -> None:
    blobs = blobs_in(picture([(50.0, 40.0)], 1, contrast=-40.0))
    assert len(blobs.contrast) == 1
    assert blobs.contrast[0] < -10.0


@pytest.mark.parametrize("part", [np.s_[:0], np.s_[70:], np.s_[20:23], np.s_[:, 80:83]], ids=str)
def test_noise_edges_and_wires_do_not_stand_out(part: tuple[slice, ...]) -> None:
    seen = picture([], 1)
    seen[part] += 50
    assert len(blobs_in(seen).points) == 0


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
        tracks.take(blobs_in(picture(dots, index)), np.eye(3))
    assert tracks.moving_at(0) == []


def test_what_is_burnt_in_does_not_move_while_the_camera_does() -> None:
    tracks = TargetTracks()
    for index in range(40):
        lamps = [(x - 0.4 * index, y) for x, y in LAMPS]
        tracks.take(blobs_in(picture([*lamps, START], index)), translation(-0.4, 0.0))
    assert tracks.moving_at(0) == []


def panning(target: Place, vouching: list[tuple[float, float]], fixed: bool) -> TargetTracks:
    """Return tracks of a target beside others, which the picture or else the scene holds fast."""
    tracks = TargetTracks()
    for index in range(40):
        shift = 0.0 if fixed else -0.5 * index
        others = [(x + shift, y) for x, y in vouching]
        seen = picture([*others, target(index)], index, contrast=15.0)
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
        seen = picture([straight(1.0)(index)], index)
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
        seen = picture([*LAMPS[:4], straight(1.0)(index)], index)
        tracks.take(blobs_in(seen), np.eye(3), overlay=overlay)
    assert tracks.moving_at(0) == []


def test_a_target_becomes_a_detection_of_its_size() -> None:
    image = picture([START], 1)[..., None]
    target = SmallTarget(START, (0.5, 0.0), 20.0, 7)
    (found,) = with_targets([], [target], image, RESOLUTION)
    assert found.targets == {7} and found.moving
    assert 9 <= found.area <= 40
    np.testing.assert_allclose(found.centroid, START, atol=0.7)


@pytest.mark.parametrize(("side", "shown"), [(8, {7}), (80, set())])
def test_an_outline_that_shows_the_target_stands_for_it(side: int, shown: set[int]) -> None:
    image = picture([START], 1)[..., None]
    mask = np.zeros(SHAPE, np.uint8)
    cv2.rectangle(mask, (36, 36), (36 + side, 36 + side), 1, cv2.FILLED)
    outline = CroppedMask.of(mask > 0)
    outlined = Detection(outline.box, outline.mask, (0.5, 0.0), moving=True)
    target = SmallTarget(START, (0.5, 0.0), 20.0, 7)
    (found,) = with_targets([outlined], [target], image, RESOLUTION)
    assert found.area == outlined.area
    assert found.targets == shown


def test_nothing_is_followed_in_a_frame_without_blobs() -> None:
    tracks = TargetTracks()
    tracks.take(NO_BLOBS, np.eye(3))
    assert tracks.moving_at(0) == []


@pytest.mark.parametrize("wanted", [True, False])
def test_small_targets_are_reported_only_when_they_are_wanted(wanted: bool) -> None:
    sizes = {"resolution.processing": 180, "resolution.detail": 180}
    parameters = Parameters.from_mapping({**sizes, "seed.small_targets": wanted})
    pictures = [picture([*LAMPS, straight(0.5)(index)], index) for index in range(48)]
    found = [moving for result in segmented(pictures, parameters) for moving in result.objects]
    assert bool(found) is wanted
