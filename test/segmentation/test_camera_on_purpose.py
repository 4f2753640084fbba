"""The whole method while the camera is moved on purpose, or has nothing to hold on to."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from support.drawn_clip import assert_sound, ids, segmented
from support.drawn_scene import ByteImage, Mask, jaccard, texture
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.pipeline import Pipeline
from turbseg_ros.segmentation.track import Track

SHAPE = (144, 240)
PARAMETERS = Parameters.from_mapping({"resolution.processing": 240})
GROUND = texture((400, 1200), seed=1)
SQUARE = texture((24, 24), seed=2, low=10, high=90)
HALF_A_SECOND = 15


def view(x: float, zoom: float, seed: int, square: tuple[int, int] | None = None) -> ByteImage:
    """Draw what a camera sees of the ground that looks at (x, 200), with a sensor's noise.

    :param square: where in the picture the square is, (x, y), in a view that doesn't zoom.
    """
    height, width = SHAPE
    to_view = np.array([[zoom, 0.0, width / 2 - zoom * x], [0.0, zoom, height / 2 - zoom * 200.0]])
    picture = cv2.warpAffine(GROUND, to_view, (width, height), flags=cv2.INTER_CUBIC)
    if square is not None:
        left, top = square
        picture[top : top + 24, left : left + 24] = SQUARE
    noise = np.random.default_rng(seed).normal(0.0, 2.0, SHAPE)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def states(results: Sequence[SegmentationResult]) -> list[CameraState]:
    return [result.camera for result in results]


# The camera slews for twenty frames, then stands; a square goes over the ground all the while.
SLEW = [
    view(200.0 + 7.0 * min(number, 20), 1.0, number, (190 + 3 * number - 7 * min(number, 20), 60))
    for number in range(40)
]


def test_nothing_new_is_an_object_while_the_camera_slews() -> None:
    results = segmented(SLEW, PARAMETERS)
    slewing = [k for k, state in enumerate(states(results)) if state is CameraState.SLEWING]
    assert set(range(3, 20)) <= set(slewing)
    assert all(not results[k].objects for k in slewing)
    # Back within half a second.
    assert set(states(results)[25:]) == {CameraState.STILL}
    assert all(len(result.objects) == 1 for result in results[20 + HALF_A_SECOND :])
    assert_sound(results)


def test_without_that_rule_it_would_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Track, "goes_with_scene", lambda _: False)
    assert any(result.objects for result in segmented(SLEW, PARAMETERS)[3:20])


@pytest.mark.parametrize("speed", [4.0, 7.0])
def test_what_the_camera_turns_to_follow_is_found(speed: float) -> None:
    # It drifts a little in the picture, as nobody follows anything without that.
    places = [(100 + round(6 * np.sin(number / 6)), 60) for number in range(40)]
    clip = [view(200.0 + speed * n, 1.0, n, place) for n, place in enumerate(places)]
    results = segmented(clip, PARAMETERS)
    state = CameraState.SLEWING if speed > 6.0 else CameraState.FOLLOWING
    assert set(states(results)[15:]) == {state}
    overlaps = []
    for result, (left, top) in zip(results[10:], places[10:], strict=True):
        square = np.zeros(SHAPE, bool)
        square[top : top + 24, left : left + 24] = True
        overlaps.append(jaccard(result.labels > 0, square))
    assert np.mean(overlaps) > 0.6
    assert len(ids(results)) == 1


def test_a_zoom_is_the_cameras_motion_and_no_object() -> None:
    zooms = [1.02 ** min(max(number - 10, 0), 20) for number in range(45)]
    results = segmented(
        [view(600.0, zoom, number) for number, zoom in enumerate(zooms)], PARAMETERS
    )
    assert ids(results) == set()
    assert CameraState.FOLLOWING in states(results)
    assert set(states(results)) <= {CameraState.STILL, CameraState.FOLLOWING}
    assert {result.ego_motion_model for result in results} == {"affine"}


def test_a_leap_to_another_view_leaves_no_objects_behind() -> None:
    """Sixty per cent of the view in five frames, and nothing that moves by itself."""
    xs = [300.0 + 0.12 * SHAPE[1] * min(max(number - 15, 0), 5) for number in range(45)]
    results = segmented([view(x, 1.0, number) for number, x in enumerate(xs)], PARAMETERS)
    assert ids(results) == set()
    assert CameraState.SLEWING in states(results)[15:22]
    assert set(states(results)[20 + HALF_A_SECOND :]) == {CameraState.STILL}


def sky(number: int, velocity: float) -> tuple[ByteImage, Mask]:
    """Draw a plain sky with a sensor's noise, and a square before it; with where that is."""
    picture, truth = np.full(SHAPE, 190, np.uint8), np.zeros(SHAPE, bool)
    left = round(30 + velocity * number)
    truth[50:74, left : left + 24] = True
    picture[truth] = SQUARE.ravel()
    noise = np.random.default_rng(number).normal(0.0, 1.5, SHAPE)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8), truth


def test_a_target_before_a_plain_sky_is_found_and_the_camera_said_to_be_lost() -> None:
    drawn = [sky(number, 3.0) for number in range(40)]
    results = segmented([picture for picture, _ in drawn], PARAMETERS)
    assert set(states(results[1:])) == {CameraState.LOST}
    assert {result.ego_motion_model for result in results[1:]} == {"held"}
    overlaps = [
        jaccard(result.labels > 0, truth)
        for result, (_, truth) in zip(results, drawn, strict=True)
    ]
    assert np.mean(overlaps[12:]) > 0.5
    assert_sound(results)


def test_a_large_known_object_has_no_vote(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Mask | None] = []
    voteless = Pipeline.voteless

    def noting(pipeline: Pipeline) -> Mask | None:
        asked.append(voteless(pipeline))
        return asked[-1]

    monkeypatch.setattr(Pipeline, "voteless", noting)
    lorry = texture((84, 84), seed=3, low=10, high=90)
    clip = [view(600.0, 1.0, number) for number in range(40)]
    for number, picture in enumerate(clip):
        picture[30:114, 10 + 3 * number : 94 + 3 * number] = lorry
    results = segmented(clip, PARAMETERS)
    assert ids(results) == {1}
    assert asked[0] is None
    for number, cells in enumerate(asked[35:], start=34):
        # Of the frame before the one that is registered; a cell is four pixels wide.
        assert cells is not None
        assert cells[72 // 4, (52 + 3 * number) // 4]
        assert not cells[:, : 3 * number // 4 - 4].any()
