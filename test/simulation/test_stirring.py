"""What stirs in a picture stays where it is and in the picture's range."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from support.drawn_scene import texture
from turbseg_ros.simulation.stirring import (
    Leaves,
    PassingLight,
    Ripples,
    Smoke,
    Stir,
    random_stir,
)
from turbseg_ros.simulation.textures import fractal_noise

SHAPE = (48, 64)
GREY = texture(SHAPE, 1).astype(np.float32) / 255
PICTURE = np.asarray(np.dstack([GREY, GREY, GREY]), np.float32)
LEFT = np.zeros(SHAPE, np.float32)
LEFT[:, :32] = 1.0
NOISE = fractal_noise((64, 64), np.random.default_rng(2), exponent=1.4)

STIRS: dict[str, Stir] = {
    "leaves": Leaves(LEFT, 1.5, 20.0, 30.0, 0.0),
    "ripples": Ripples(LEFT, NOISE, 1.0, 0.1, 0.8),
    "smoke": Smoke(0.8 * LEFT, (NOISE, NOISE.T), 0.9, (1.0, 0.3)),
}


@pytest.mark.parametrize("name", STIRS)
def test_it_moves_where_it_is_and_nothing_else(name: str) -> None:
    seen = [STIRS[name].at(PICTURE, frame) for frame in range(4)]
    for before, after in itertools.pairwise(seen):
        assert np.abs(after - before)[:, :28].mean() > 0.005
        np.testing.assert_allclose(after[:, 36:], PICTURE[:, 36:], atol=1e-5)


def test_leaves_come_back_to_where_they_were() -> None:
    seen = np.mean([STIRS["leaves"].at(PICTURE, frame) for frame in range(200)], axis=0)
    # Averaged over long, what sways is blurred but not displaced.
    shifted = [np.corrcoef(np.roll(GREY, k, axis=1)[:, 4:24].ravel(),
                           seen[:, 4:24, 0].ravel())[0, 1] for k in (-2, 0, 2)]  # fmt: skip
    assert np.argmax(shifted) == 1


def test_a_passing_light_changes_brightness_alone() -> None:
    light = PassingLight(NOISE, 0.2, (2.0, 0.0))
    gains = light.at(PICTURE, 5) / PICTURE
    assert gains.std() > 0.005
    assert gains.min() >= 0.8 - 1e-5
    assert gains.max() <= 1.2 + 1e-5


def test_drawn_ones_keep_the_picture_in_its_range_and_kind() -> None:
    rng = np.random.default_rng(5)
    kinds = set()
    for _ in range(24):
        stir = random_stir(SHAPE, rng)
        kinds.add(type(stir))
        seen = stir.at(PICTURE, 3)
        assert (seen.shape, seen.dtype) == (PICTURE.shape, np.float32)
        assert seen.min() >= 0.0
        assert seen.max() <= 1.0
    assert kinds == {Leaves, Ripples, Smoke, PassingLight}
