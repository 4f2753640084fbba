"""What is outlined, and where: the parts of the picture in which objects are looked for."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import AbstractContextManager

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from support.drawn_clip import assert_sound, segmented
from support.drawn_scene import ByteImage, jaccard, texture
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, segment
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.observer import StageObserver

SHAPE = (120, 320)
SIDE, TOP = 24, 48
# A place out of view.
NOWHERE = -100


def image(place: int, seed: int) -> ByteImage:
    """Draw a square at a place along x before a textured ground, with the noise of a camera."""
    drawn = np.pad(texture(SHAPE, seed=1).astype(np.float32), ((0, 0), (100, 100)))
    drawn[TOP : TOP + SIDE, 100 + place : 100 + place + SIDE] = texture(
        (SIDE, SIDE), seed=2, low=10, high=60
    )
    noise = np.random.default_rng(seed).normal(0.0, 2.0, SHAPE)
    return np.clip(drawn[:, 100:-100] + noise, 0, 255).astype(np.uint8)


def truth(place: int) -> npt.NDArray[np.bool_]:
    mask = np.zeros(SHAPE, bool)
    mask[TOP : TOP + SIDE, max(place, 0) : max(place + SIDE, 0)] = True
    return mask


@pytest.mark.parametrize(
    ("places", "least"),
    [
        # Flow follows it at no time; or until it is three times as fast, of a sudden.
        pytest.param(list(range(-20, 340, 13)), 0.8, id="fast"),
        pytest.param([*range(-20, 100, 6), *range(114, 340, 20)], 0.82, id="ever faster"),
    ],
)
def test_what_goes_faster_than_flow_follows_is_outlined_whole(
    places: Sequence[int], least: float
) -> None:
    # Before it comes the scene is seen without it.
    places = [*([NOWHERE] * 30), *places]
    results = segmented(image(place, number) for number, place in enumerate(places))
    assert_sound(results)
    whole = [n for n, place in enumerate(places) if 0 <= place <= SHAPE[1] - SIDE]
    overlaps = [jaccard(results[n].labels > 0, truth(places[n])) for n in whole]
    assert np.mean(overlaps) > least
    # An object and no ghost of it.
    assert all(len(result.objects) <= 1 for result in results)


class Looks(StageObserver):
    """Remembers the frames, by stamp, in which what stands out was looked for."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self._stamp = 0

    def motion(self, stamp: int, moving: Moving) -> None:
        self._stamp = stamp

    def stage(self, name: str) -> AbstractContextManager[object]:
        if name == "what stands out":
            self.stamps.append(self._stamp)
        return contextlib.nullcontext()


def test_a_calm_scene_is_looked_at_in_every_other_frame_until_something_comes() -> None:
    looks = Looks()
    comes = 60
    places = [*([NOWHERE] * comes), *range(-20, 340, 13)]
    frames = (Frame(number, image(place, number)) for number, place in enumerate(places))
    results = list(segment(frames, motion_segmenter(Parameters(), looks)))
    assert any(result.objects for result in results)
    steps = np.diff([stamp for stamp in looks.stamps if stamp < comes])
    assert set(steps) <= {1, 2}
    assert np.mean(steps == 2) > 0.5
    # It enters within a frame or two, and then is looked at in each.
    entered = [stamp for stamp in looks.stamps if stamp > comes + 2]
    assert entered == list(range(comes + 3, entered[-1] + 1))


def closer(number: int) -> tuple[ByteImage, npt.NDArray[np.bool_]]:
    """Draw what comes straight towards the camera, and where it is: its top stays in its place."""
    shape, height, width = (240, 432), 60, 44
    ground = texture(shape, seed=1).astype(np.float32)
    drawn = texture((height, width), seed=2, low=10, high=110).astype(np.float32)
    scale = 1.0 + 0.004 * number
    left = 200.0 - 0.05 * number - width / 2 * (scale - 1.0)
    to_image = np.array([[scale, 0.0, left], [0.0, scale, 80.0]])
    size = shape[::-1]
    inside = cv2.warpAffine(np.ones_like(drawn), to_image, size) > 0.5
    ground[inside] = cv2.warpAffine(drawn, to_image, size)[inside]
    noise = np.random.default_rng(number).normal(0.0, 2.0, shape)
    return np.clip(ground + noise, 0, 255).astype(np.uint8), inside


def test_what_comes_closer_on_the_spot_is_soon_outlined_whole() -> None:
    # Its upper edge never moves, and its background is never seen.
    clip = [closer(number) for number in range(70)]
    frames = (Frame(n * 33_333_333, drawn, period=1 / 30) for n, (drawn, _) in enumerate(clip))
    results = list(segment(frames, motion_segmenter(Parameters())))
    overlaps = [
        jaccard(result.labels > 0, inside)
        for result, (_, inside) in zip(results, clip, strict=True)
    ]
    assert min(overlaps[46:]) > 0.75
    assert {found.id for result in results for found in result.objects} == {1}
