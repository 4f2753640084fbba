"""What goes along with a mover lies where it should, is as deep as asked for, and fades."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from turbseg_ros.arrays import Matrix
from turbseg_ros.simulation.companions import (
    Plume,
    PlumeLook,
    Sun,
    random_plume,
    random_sun,
)
from turbseg_ros.simulation.objects import Layer, PlacedSprite
from turbseg_ros.simulation.turbulence import Field

SHAPE = (90, 160)
HERE = np.eye(2, 3)
SUN = Sun(across=1.5, down=0.1, depth=0.2, strength=0.5, blue=0.0, softness=0.0)
DUST = PlumeLook(
    radius=0.3, growth=0.05, opacity=0.5, life=6.0, flat=0.8, light=0.9, drift=(0.0, 0.0)
)


def post() -> PlacedSprite:
    """Return a white post, 40 pixels high, whose foot is at (60 to 71, 69)."""
    layer = Layer(np.ones((40, 12, 3), np.float32), np.ones((40, 12), np.float32))
    return PlacedSprite(60, 30, layer, None)


def laid_over_grey(sprite: PlacedSprite | None) -> Field:
    picture = np.full((*SHAPE, 3), 0.5, np.float32)
    assert sprite is not None
    sprite.lay_over(picture)
    return picture


def straight_way(frames: int = 40) -> Matrix:
    return np.column_stack([np.linspace(10.0, 127.0, frames), np.full(frames, 70.0)])


def test_a_shadow_lies_on_the_ground_on_the_side_away_from_the_sun() -> None:
    dark = laid_over_grey(SUN.shadow_of(post()))[..., 0] < 0.4
    rows, columns = np.nonzero(dark)
    # Forty pixels high, so sixty to the right of the foot, at about whose level it lies.
    assert columns.min() >= 59
    assert 128 <= columns.max() <= 132
    assert rows.min() >= 60
    assert rows.max() <= 75
    other = replace(SUN, across=-1.5).shadow_of(post())
    assert np.nonzero(laid_over_grey(other)[..., 0] < 0.4)[1].max() <= 72


@pytest.mark.parametrize("strength", [0.3, 0.6])
def test_a_shadow_takes_the_same_share_of_whatever_it_falls_on(strength: float) -> None:
    shadow = replace(SUN, strength=strength).shadow_of(post())
    assert shadow is not None
    ground = np.random.default_rng(1).uniform(0.2, 0.9, (*SHAPE, 3)).astype(np.float32)
    picture = ground.copy()
    shadow.lay_over(picture)
    inside = (slice(65, 67), slice(75, 105))
    np.testing.assert_allclose(picture[inside] / ground[inside], 1 - strength, rtol=1e-5)


def test_what_does_not_show_throws_no_shadow() -> None:
    layer = Layer(np.zeros((5, 5, 3), np.float32), np.zeros((5, 5), np.float32))
    assert SUN.shadow_of(PlacedSprite(0, 0, layer, None)) is None


def test_dust_hangs_behind_its_mover_and_thins_with_age() -> None:
    plume = Plume(straight_way(), 20.0, DUST, np.random.default_rng(2))
    picture = laid_over_grey(plume.at(30, HERE, SHAPE))
    column_of_mover = int(straight_way()[30, 0])
    brightness = picture[..., 0].mean(axis=0) - 0.5
    assert brightness[column_of_mover + 12 :].max() < 0.01
    near, far = (brightness[column_of_mover - d - 8 : column_of_mover - d].mean() for d in (4, 50))
    assert near > 2 * far > 0


def test_dust_moves_with_the_picture_when_the_camera_turns() -> None:
    plume = Plume(straight_way(), 20.0, DUST, np.random.default_rng(2))
    turned = np.array([[1.0, 0.0, 12.0], [0.0, 1.0, 0.0]])
    seen, seen_turned = (
        plume.at(30, to_picture, SHAPE).layer.coverage for to_picture in (HERE, turned)
    )
    middle, middle_turned = (
        np.average(np.arange(SHAPE[1]), weights=each.sum(axis=0)) for each in (seen, seen_turned)
    )
    assert middle_turned - middle == pytest.approx(12, abs=3)


def test_drawn_ones_keep_a_picture_in_its_range() -> None:
    rng = np.random.default_rng(3)
    for _ in range(12):
        shadow = random_sun(rng).shadow_of(post())
        plume = Plume(straight_way(), 30.0, random_plume(rng), rng).at(20, HERE, SHAPE)
        for sprite in (shadow, plume):
            picture = laid_over_grey(sprite)
            assert picture.dtype == np.float32
            assert picture.min() >= 0.0
            assert picture.max() <= 1.0
            assert sprite is not None
            assert 0.05 < sprite.layer.coverage.max() <= 1.0
