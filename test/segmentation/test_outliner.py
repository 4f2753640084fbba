"""What is outlined, and where: the parts of the picture in which objects are looked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from support.drawn_clip import assert_sound, segmented
from support.drawn_scene import ByteImage, jaccard, texture

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
