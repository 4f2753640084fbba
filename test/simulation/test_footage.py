"""Parts of footage, and what is cut out of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from turbseg_ros.simulation.footage import Crop, Cutout, CutoutLook
from turbseg_ros.simulation.objects import PlacedSprite, Pose

SHAPE = (60, 80)
RED, GREEN = (0, 0, 200), (0, 200, 0)
AIR = np.full(3, 0.5, np.float32)
HERE = Pose(40.0, 50.0)
STILL = np.eye(2, 3)


def frames(count: int = 3) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """A red block on green, 20 wide and 30 high, that becomes 10 wide in the last frame."""
    pictures, masks = [], []
    for number in range(count):
        mask = np.zeros(SHAPE, bool)
        mask[10:40, 30 : 40 if number == count - 1 else 50] = True
        picture = np.empty((*SHAPE, 3), np.uint8)
        picture[:] = GREEN
        picture[mask] = RED
        pictures.append(picture)
        masks.append(mask)
    return pictures, masks


def placed(size: float, frame: int = 0, pose: Pose = HERE, **look: object) -> list[PlacedSprite]:
    cutout = Cutout(*frames(), size, dataclasses.replace(CutoutLook(), **look))  # type: ignore[arg-type]
    return cutout.place(frame, pose, STILL, AIR)


def coverage(sprite: PlacedSprite) -> np.ndarray:
    """Where a sprite is in the picture."""
    whole = np.zeros(SHAPE, np.float32)
    inside = sprite.clip(SHAPE)
    assert inside is not None
    whole[inside[0]] = inside[1].coverage
    return whole


def extent(sprite: PlacedSprite) -> tuple[int, int]:
    """Width and height of what is more there than not."""
    rows, columns = np.nonzero(coverage(sprite) > 0.5)
    return int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


@pytest.mark.parametrize("size", [9, 15, 30])
def test_a_cutout_stands_on_its_foot_in_the_size_asked_for(size: int) -> None:
    (sprite,) = placed(size)
    rows, columns = np.nonzero(coverage(sprite) > 0.5)
    assert extent(sprite) == pytest.approx((size * 2 / 3, size), abs=1)
    assert (columns.min() + columns.max()) / 2 == pytest.approx(HERE.x, abs=1)
    assert rows.max() == pytest.approx(HERE.y, abs=2)


def test_small_footage_is_not_blown_up() -> None:
    assert extent(placed(200)[0])[1] == pytest.approx(45, abs=1)


def test_it_keeps_its_own_motion_and_goes_back_when_its_frames_end() -> None:
    widths = [extent(placed(30, frame)[0])[0] for frame in range(6)]
    assert widths == pytest.approx([20, 20, 10, 20, 20, 20], abs=1)


def test_none_of_what_was_behind_it_comes_along() -> None:
    (sprite,) = placed(30)
    picture = np.zeros((*SHAPE, 3), np.float32)
    sprite.lay_over(picture)
    green, red = picture[..., 1], picture[..., 2]
    assert green.max() < 0.02
    assert red[35, 40] == pytest.approx(200 / 255, abs=0.01)


def test_haze_brings_it_towards_the_light_of_the_air() -> None:
    (clear,), (hazy,) = placed(30), placed(30, haze=0.5)
    middle = tuple(length // 2 for length in clear.layer.coverage.shape)
    expected = 0.5 * clear.layer.colour[middle] + 0.5 * AIR
    np.testing.assert_allclose(hazy.layer.colour[middle], expected, atol=0.01)


def test_what_is_sunk_is_hidden_below_and_the_mirage_is_no_part_of_it() -> None:
    body, mirage = placed(30, sunk=0.4, mirage=0.6)
    assert extent(body)[1] == pytest.approx(18, abs=1)
    assert np.nonzero(coverage(body) > 0.5)[0].max() == pytest.approx(HERE.y, abs=2)
    below = coverage(mirage)
    assert below.max() == pytest.approx(0.6, abs=0.02)
    assert np.nonzero(below > 0.3)[0].min() == pytest.approx(HERE.y + 1, abs=2)


def test_masks_without_an_object_are_refused() -> None:
    pictures, masks = frames()
    with pytest.raises(ValueError, match="nothing"):
        Cutout(pictures, [np.zeros_like(mask) for mask in masks], 20, CutoutLook())


def test_a_crop_shows_picture_and_mask_alike() -> None:
    pictures, masks = frames(1)
    rng = np.random.default_rng(3)
    for _ in range(8):
        crop = Crop.drawn(SHAPE, (30, 30), least=0.8, rng=rng)
        red = crop.of(pictures[0])[..., 2] > 100
        covered = crop.of(masks[0].astype(np.float32)) > 0.5
        assert red.any()
        assert (red != covered).mean() < 0.05
