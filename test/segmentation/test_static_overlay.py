"""Telling what is burnt into the picture from scene and from what the camera follows."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from support.segmenters import segmenter_by_rules
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.clutter import CELL
from turbseg_ros.segmentation.frame import Frame, MovingObject, segment
from turbseg_ros.segmentation.registration import align
from turbseg_ros.segmentation.static_overlay import OverlayMemory

SHAPE = (120, 160)
INTERVALS = (-4, 4)


def scene() -> np.ndarray:
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (240, 480)), (0, 0), 2.0)
    return 120.0 + 30.0 * texture / texture.std()


def view(frame: float, pan: float) -> np.ndarray:
    way = np.array([[1.0, 0.0, -120.0 - pan * frame], [0.0, 1.0, -60.0]])
    seen = cv2.warpAffine(scene(), way, SHAPE[::-1])
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def with_text(picture: np.ndarray) -> np.ndarray:
    return cv2.putText(picture.copy(), "AZ 213", (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)


def with_bars(picture: np.ndarray) -> np.ndarray:
    barred = picture.copy()
    barred[:, :24] = barred[:, -24:] = 0
    return barred


def with_followed(picture: np.ndarray, frame: int) -> np.ndarray:
    """A target in the middle that the camera follows, but for a jitter of half a pixel."""
    x, y = np.random.default_rng(frame + 100).normal(0.0, 0.5, 2)
    patch = np.full(SHAPE, 0.0, np.float32)
    cv2.ellipse(patch, (80, 60), (16, 8), 0.0, 0.0, 360.0, 1.0, -1)
    patch = cv2.GaussianBlur(patch, (0, 0), 1.0)
    patch = cv2.warpAffine(patch, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), SHAPE[::-1])
    return np.rint(picture * (1 - patch) + 240.0 * patch).astype(np.uint8)


def with_saturated(picture: np.ndarray, frame: int) -> np.ndarray:
    """A target as with_followed, so hot that all of it but its rim is white, and larger."""
    x, y = np.random.default_rng(frame + 100).normal(0.0, 0.4, 2)
    body = np.zeros(SHAPE, np.float32)
    for centre, axes in (((80, 60), (30, 12)), ((105, 52), (16, 3)), ((60, 50), (3, 14))):
        cv2.ellipse(body, centre, axes, 10.0, 0.0, 360.0, 1.0, -1)
    body = cv2.GaussianBlur(body, (0, 0), 1.5)
    body = cv2.warpAffine(body, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), SHAPE[::-1])
    return np.clip(np.rint(picture * (1 - body) + 500.0 * body), 0, 255).astype(np.uint8)


def after(pictures: dict[int, np.ndarray], centres: range, pan: float) -> np.ndarray:
    memory = OverlayMemory()
    for centre in centres:
        neighbours = {k: pictures[centre + k] for k in INTERVALS}
        transforms = {k: np.array([[1, 0, -pan * k], [0, 1, 0], [0, 0, 1.0]]) for k in INTERVALS}
        aligned = {k: align(neighbours[k], transforms[k]) for k in INTERVALS}
        still = memory.take(pictures[centre], neighbours, aligned, transforms)
    return still


def frames(
    count: int, pan: float, draw: Callable[[np.ndarray, int], np.ndarray]
) -> dict[int, np.ndarray]:
    return {k: draw(view(k, pan), k) for k in range(count)}


def cells(picture_region: np.ndarray) -> np.ndarray:
    size = SHAPE[1] // CELL, SHAPE[0] // CELL
    return cv2.resize(picture_region.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.2


@pytest.mark.parametrize("pan", [1.5, -0.8])
def test_text_is_found_while_the_camera_pans(pan: float) -> None:
    still = after(frames(24, pan, lambda p, k: with_text(p)), range(4, 20, 4), pan)
    letters = cells(with_text(np.zeros(SHAPE, np.uint8)) > 0)
    assert still[letters].mean() > 0.8
    far = cv2.dilate(letters.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    assert still[far].mean() < 0.02


def test_black_bars_are_found_as_far_as_the_scene_would_reach_into_them() -> None:
    still = after(frames(24, 1.5, lambda p, k: with_bars(p)), range(4, 20, 4), 1.5)
    assert still[:, 5].mean() > 0.7
    assert still[:, -6].mean() > 0.7
    assert not still[:, 9:-9].any()


def test_a_still_camera_tells_nothing() -> None:
    still = after(frames(24, 0.0, lambda p, k: with_text(p)), range(4, 20, 4), 0.0)
    assert not still.any()


def test_text_is_found_when_a_camera_that_stood_still_moves_at_last() -> None:
    pictures = {k: with_text(view(max(k - 16, 0), 1.5)) for k in range(40)}
    memory = OverlayMemory()
    for centre in range(4, 36, 4):
        shifts = {k: 1.5 * (max(centre + k - 16, 0) - max(centre - 16, 0)) for k in INTERVALS}
        transforms = {k: np.array([[1, 0, -x], [0, 1, 0], [0, 0, 1.0]]) for k, x in shifts.items()}
        neighbours = {k: pictures[centre + k] for k in INTERVALS}
        aligned = {k: align(neighbours[k], transforms[k]) for k in INTERVALS}
        still = memory.take(pictures[centre], neighbours, aligned, transforms)
    assert still[cells(with_text(np.zeros(SHAPE, np.uint8)) > 0)].mean() > 0.8


@pytest.mark.parametrize("draw", [with_followed, with_saturated])
def test_what_the_camera_follows_is_no_overlay(
    draw: Callable[[np.ndarray, int], np.ndarray],
) -> None:
    still = after(frames(40, 1.5, draw), range(4, 36, 4), 1.5)
    assert still.mean() < 0.01


def test_an_overlay_that_goes_is_forgotten() -> None:
    def draw(picture: np.ndarray, k: int) -> np.ndarray:
        return with_text(picture) if k < 24 else picture

    still = after(frames(120, 1.5, draw), range(4, 100, 4), 1.5)
    assert still.mean() < 0.01


def objects_in_a_pan(
    burnt_in: Callable[[np.ndarray], np.ndarray], parameters: Parameters
) -> list[MovingObject]:
    pictures = [cv2.resize(view(k, 1.5), None, fx=2, fy=2) for k in range(36)]
    frames = [Frame(k * 10**9 // 30, burnt_in(each)) for k, each in enumerate(pictures)]
    results = segment(frames, segmenter_by_rules(parameters))
    return [moving for result in results for moving in result.objects]


@pytest.mark.parametrize("burnt_in", [with_text, with_bars])
def test_what_is_burnt_in_is_no_object_while_the_camera_pans(
    burnt_in: Callable[[np.ndarray], np.ndarray],
) -> None:
    assert not objects_in_a_pan(burnt_in, Parameters())


def test_what_is_burnt_in_is_an_object_where_it_is_taken_for_scene() -> None:
    as_scene = Parameters.from_mapping({"regions.static_overlays": False})
    assert objects_in_a_pan(with_text, as_scene)
