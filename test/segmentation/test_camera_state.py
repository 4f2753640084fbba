"""What the camera does, as the motions of its frames tell."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from turbseg_ros.segmentation.camera_state import CameraState, CameraTrack
from turbseg_ros.segmentation.geometry import scaling, translation
from turbseg_ros.segmentation.registration import EgoMotionModel, Registration

SIZE = (432, 243)
HALF_A_SECOND = 15


def pan(pixels: float, frames: int) -> list[Registration | None]:
    return [Registration(translation(-pixels, 0.0), EgoMotionModel.AFFINE)] * frames


def zoom(factor: float, frames: int) -> list[Registration | None]:
    middle = translation(SIZE[0] / 2, SIZE[1] / 2)
    motion = middle @ scaling(factor, factor) @ np.linalg.inv(middle)
    return [Registration(motion, EgoMotionModel.AFFINE)] * frames


def shake(pixels: float, frames: int) -> list[Registration | None]:
    """A hand that is pulled back to where it was, with steps of so many pixels rms an axis."""
    random = np.random.default_rng(0)
    places = np.zeros((frames + 1, 2))
    for number in range(frames):
        places[number + 1] = 0.88 * places[number] + random.normal(0.0, pixels, 2)
    return [
        Registration(translation(*step), EgoMotionModel.AFFINE) for step in np.diff(places, axis=0)
    ]


def held(frames: int) -> list[Registration | None]:
    return [Registration(np.eye(3), EgoMotionModel.HELD)] * frames


def tracks(registrations: Iterable[Registration | None]) -> list[CameraTrack]:
    track, found = CameraTrack(), []
    for registration in registrations:
        track = track.after(registration, SIZE)
        found.append(track)
    return found


def states(registrations: Iterable[Registration | None]) -> list[CameraState]:
    return [track.state for track in tracks(registrations)]


@pytest.mark.parametrize("pixels", [0.0, 0.3, 3.0, 5.0])
def test_a_camera_that_stands_or_shakes_is_still(pixels: float) -> None:
    assert set(states(shake(pixels, 200))) == {CameraState.STILL}


@pytest.mark.parametrize("motion", [pan(1.2, 40), pan(2.5, 40), pan(7.5, 40), zoom(1.02, 40)])
def test_a_steady_motion_is_one_that_follows(motion: list[Registration | None]) -> None:
    assert set(states(motion)[12:]) == {CameraState.FOLLOWING}


@pytest.mark.parametrize("motion", [pan(20.0, 20), pan(-60.0, 5), zoom(1.09, 10)])
def test_what_is_too_fast_to_be_compared_is_a_slew(motion: list[Registration | None]) -> None:
    assert set(states(shake(0.3, 30) + motion)[32:]) == {CameraState.SLEWING}


@pytest.mark.parametrize("motion", [pan(20.0, 20), pan(52.0, 5)])
def test_after_a_slew_the_camera_is_still_within_half_a_second(
    motion: list[Registration | None],
) -> None:
    after = states(motion + shake(0.3, 40))[len(motion) :]
    assert set(after[HALF_A_SECOND // 3 :]) == {CameraState.STILL}


def test_a_new_view_begins_when_a_slew_has_ended() -> None:
    found = tracks(pan(2.0, 20) + pan(30.0, 10) + pan(2.0, 20))
    assert {track.view for track in found if track.state is CameraState.SLEWING} == {0}
    assert [track.view for track in found[-15:]] == [1] * 15


@pytest.mark.parametrize("lost", [held(1), [None]], ids=["held", "nothing in common"])
def test_without_support_the_camera_is_lost_until_there_is_some(
    lost: list[Registration | None],
) -> None:
    found = states(shake(0.3, 20) + lost * 5 + shake(0.3, 5))
    assert found[20:25] == [CameraState.LOST] * 5
    assert CameraState.LOST not in found[25:]


def test_a_frame_that_cannot_be_told_does_not_end_a_slew() -> None:
    found = tracks(pan(30.0, 6) + held(1) + pan(30.0, 6))
    assert {track.state for track in found[2:]} == {CameraState.SLEWING}
    assert found[-1].view == 0


def test_a_steady_motion_is_expected_to_go_on_for_a_while() -> None:
    found = tracks(pan(5.0, 20) + held(40))
    np.testing.assert_allclose(found[21].expected, translation(-5.0, 0.0))
    np.testing.assert_array_equal(found[-1].expected, np.eye(3))


def test_a_shake_is_not_expected_to_go_on() -> None:
    for track in tracks(shake(3.0, 60) + held(10)):
        np.testing.assert_array_equal(track.expected, np.eye(3))


def test_the_poorer_model_tells_the_motion() -> None:
    measured = "fundamental"
    assert tracks(pan(1.0, 1))[0].model_beside(measured) == measured
    assert CameraTrack().model_beside(measured) == measured
    assert tracks(held(1))[0].model_beside(measured) == "held"


def stood(registrations: Iterable[Registration | None]) -> bool:
    return tracks(registrations)[-1].has_stood(SIZE)


def test_a_camera_has_stood_when_it_was_seen_to_for_a_while() -> None:
    assert stood(pan(0.0, HALF_A_SECOND))
    assert stood(shake(0.3, HALF_A_SECOND))
    assert not stood(pan(0.0, 4))
    assert not stood(held(HALF_A_SECOND))
    assert not stood([*pan(0.0, HALF_A_SECOND), *pan(7.5, 1)])


def test_what_is_burnt_in_holds_a_camera_for_a_second_only() -> None:
    outvoted = [Registration(np.eye(3), EgoMotionModel.TRANSLATION, outvoted=True)]
    assert stood([*pan(0.0, HALF_A_SECOND), *29 * outvoted])
    assert not stood([*pan(0.0, HALF_A_SECOND), *30 * outvoted])
    assert stood([*pan(0.0, HALF_A_SECOND), *30 * outvoted, *pan(0.0, 1)])
