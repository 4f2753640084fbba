"""What a scene usually changes by, and when it changes by more."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_scene import texture
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.usual_change import UsualChange

SHAPE = (96, 160)
SCENE = texture(SHAPE, seed=1)
STILL = np.eye(3)
KNOWN = 10
FLICKERING = (slice(16, 48), slice(16, 48))


def seen(number: int) -> np.ndarray:
    """Return the scene with noise and a place that flickers."""
    rng = np.random.default_rng(number)
    image = SCENE + rng.normal(0.0, 2.0, SHAPE)
    image[FLICKERING] += rng.normal(0.0, 15.0, (32, 32))
    return np.clip(image, 0, 255).astype(np.uint8)


def compared(change: UsualChange, number: int, image: np.ndarray | None = None) -> bool:
    change.propagate(STILL)
    here = seen(2 * number) if image is None else image
    return change.is_exceeded(here, {-4: seen(2 * number + 1)})


def learned(count: int = KNOWN) -> UsualChange:
    change = UsualChange()
    for number in range(count):
        compared(change, number)
    return change


def test_nothing_is_usual_before_it_was_seen_for_a_while() -> None:
    change = UsualChange()
    answers = [compared(change, number) for number in range(2 * KNOWN)]
    assert all(answers[:8])
    assert not any(answers[8:])


@pytest.mark.parametrize(("y", "x", "by"), [(70, 90, 40), (0, 150, 60), (88, 0, -60)])
def test_what_comes_into_a_calm_place_exceeds_it(y: int, x: int, by: int) -> None:
    image = seen(1000).astype(int)
    image[y : y + 6, x : x + 6] += by
    assert compared(learned(), 500, np.clip(image, 0, 255).astype(np.uint8))


def test_what_flickers_always_may_flicker() -> None:
    # By as much as exceeds what is usual elsewhere.
    change = learned()
    rng = np.random.default_rng(7)
    image = seen(1000).astype(float)
    elsewhere = image.copy()
    image[FLICKERING] += rng.normal(0.0, 5.0, (32, 32))
    elsewhere[56:88, 80:112] += rng.normal(0.0, 15.0, (32, 32))
    assert not compared(change, 500, np.clip(image, 0, 255).astype(np.uint8))
    assert compared(change, 501, np.clip(elsewhere, 0, 255).astype(np.uint8))


def test_stronger_air_all_over_is_nothing_that_comes() -> None:
    change = learned()
    rng = np.random.default_rng(7)
    image = np.clip(seen(1000) + rng.normal(0.0, 4.0, SHAPE), 0, 255).astype(np.uint8)
    assert not compared(change, 500, image)


@pytest.mark.parametrize("known", [True, False])
def test_what_is_usual_moves_with_the_camera(known: bool) -> None:
    change = learned(2 * KNOWN)
    change.propagate(translation(32.0, 0.0) if known else STILL)
    image, other = (np.roll(seen(number), 32, axis=1) for number in (1000, 1001))
    # What has come into view was never seen.
    image[:, :32] = other[:, :32]
    assert change.is_exceeded(image, {-4: other}) is not known


def test_another_scene_has_to_be_learned() -> None:
    change = learned()
    change.propagate(None)
    assert compared(change, 500)


def test_other_neighbours_have_to_be_learned() -> None:
    change = learned()
    assert change.is_exceeded(seen(1000), {-4: seen(1001), 4: seen(1002)})
