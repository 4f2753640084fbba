"""What stands out in the change of a picture from its past."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.drawn_clip import segmented
from support.drawn_scene import texture
from turbseg_ros.arrays import ByteImage
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.background import unmasked
from turbseg_ros.segmentation.blobs import blobs_in
from turbseg_ros.segmentation.camera_state import CameraState, CameraTrack
from turbseg_ros.segmentation.changes import Changes, SceneChanges, changed_blobs
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.preparation import PreparedFrame
from turbseg_ros.segmentation.registration import align
from turbseg_ros.segmentation.window import FrameWindow

SHAPE = (120, 160)
# Rough ground, on which much stands out.
GROUND = texture(SHAPE, 4)


def ground_with_car(x: float | None, seed: int = 0, width: int = 8) -> ByteImage:
    """Noisy ground, with a bright car of two rows that begins at a column, if any."""
    picture = GROUND.astype(np.float64)
    if x is not None:
        picture[60:62, round(x) : round(x) + width] = 230.0
    noise = np.random.default_rng(seed).normal(0.0, 1.0, SHAPE)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def window_of(
    frames: int,
    speed: float | None = 1.0,
    state: CameraState = CameraState.STILL,
    pan: float = 0.0,
    tilt: float = 0.0,
) -> FrameWindow:
    """A window in which a car, if any, drives from column 20 on, before a camera that may turn."""
    window = FrameWindow(12, 100, memory=48, key_step=3)
    for index in range(frames):
        car = None if speed is None else 20 + speed * index
        turn = translation(-pan * index, -tilt * index)
        seen = align(ground_with_car(car, index), turn)
        window.append(
            PreparedFrame(
                index=index,
                grey=seen,
                scene=unmasked(seen),
                from_previous=translation(pan, tilt),
                camera=CameraTrack(state),
                blobs=(blobs_in(seen),),
            )
        )
    return window


def test_a_car_on_rough_ground_stands_out_in_its_change_though_not_in_the_picture() -> None:
    found = changed_blobs(ground_with_car(80.0), ground_with_car(None, 1))
    np.testing.assert_allclose(found.points[0], (83.5, 60.5), atol=1.5)
    assert found.contrast[0] > 10
    strongest = blobs_in(ground_with_car(80.0)).points[:3]
    assert np.linalg.norm(strongest - (83.5, 60.5), axis=1).min() > 5


def test_where_nothing_changed_but_noise_nothing_stands_out() -> None:
    assert not len(changed_blobs(ground_with_car(None), ground_with_car(None, 1)).points)


def test_what_has_left_does_not_stand_out() -> None:
    found = changed_blobs(ground_with_car(80.0), ground_with_car(20.0, 1)).points
    assert len(found) == 1
    assert found[0][0] > 70


@pytest.mark.parametrize("pan", [0.0, 0.2])
def test_changes_are_told_in_the_newest_frame_of_a_window(pan: float) -> None:
    changes = SceneChanges().newest(window_of(40, pan=pan), [])
    np.testing.assert_allclose(changes.blobs.points[0], (62.5 + 39 * pan, 60.5), atol=2.0)
    assert changes.known is not None
    assert not changes.known.any()


def test_the_past_is_looked_at_anew_as_time_goes_on() -> None:
    changes = SceneChanges()
    whole = window_of(60, pan=0.2)
    window = FrameWindow(12, 100, memory=48, key_step=3)
    for index in range(60):
        window.append(whole[index])
        found = changes.newest(window, []).blobs
        if index >= 24:
            np.testing.assert_allclose(found.points[0], (23.5 + 1.2 * index, 60.5), atol=2.0)


@pytest.mark.parametrize(
    "window",
    [
        window_of(8),
        window_of(40, state=CameraState.SLEWING),
        window_of(40, state=CameraState.LOST),
        window_of(40, pan=2.0),
    ],
    ids=["too young", "slewing", "lost", "far away"],
)
def test_nothing_is_compared_where_the_past_does_not_tell(window: FrameWindow) -> None:
    assert SceneChanges().newest(window, []) == Changes()


def test_nothing_is_compared_where_no_blobs_are_looked_for() -> None:
    window = window_of(39)
    newest = window_of(40).newest
    assert newest is not None
    window.append(replace(newest, blobs=()))
    assert SceneChanges().newest(window, []) == Changes()


def test_known_are_the_cells_of_objects_now_and_in_the_frames_compared_with() -> None:
    window = window_of(40)
    before, now = (np.zeros(SHAPE, bool) for _ in range(2))
    before[40:48, 20:28] = True
    now[80:88, 100:108] = True
    for index in window.earlier(39, 36):
        window.mark_objects(index, [CroppedMask.of(before)])
    known = SceneChanges().newest(window, [CroppedMask.of(now)]).known
    assert known is not None
    assert known[11, 6]
    assert known[21, 26]
    assert not known[15, 15]


def test_the_scene_cancels_though_the_camera_moves() -> None:
    window = window_of(40, speed=None, pan=0.3, tilt=-0.1)
    # A car stands out by more than 10; by 5 a target is believed.
    assert (SceneChanges().newest(window, []).blobs.strength < 5.0).all()


@pytest.mark.parametrize("wanted", [True, False])
def test_a_car_of_few_pixels_on_rough_ground_becomes_an_object(wanted: bool) -> None:
    # A pixel a frame, eight by two of them: flow passes over it.
    parameters = Parameters().replace({"seed.small_targets": wanted, "refine.mode": "none"})
    frames = [ground_with_car(20.0 + index, index) for index in range(60)]
    results = segmented(frames, parameters)
    seen = [bool(result.labels[60:62, 20 + k : 28 + k].any()) for k, result in enumerate(results)]
    assert (sum(seen[30:]) > 20) == wanted
