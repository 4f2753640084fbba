"""What is learned of places that move without anything being there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from turbseg_ros.segmentation.clutter import CELL, ClutterMemory, cells_of_objects, with_clutter
from turbseg_ros.segmentation.cropped_mask import CroppedMask

SHAPE = (96, 128)
CELLS = SHAPE[0] // CELL, SHAPE[1] // CELL
STILL = np.eye(3)
EVERY = 4
NOTHING = np.zeros(CELLS, bool)
SEEN = np.ones(SHAPE, bool)
NOISE = np.full(SHAPE, 0.05, np.float32)
LEFT = np.zeros(SHAPE, bool)
LEFT[:, :64] = True


def moving_by(velocity: Sequence[float] | np.ndarray, where: np.ndarray) -> np.ndarray:
    field = np.zeros((*SHAPE, 2), np.float32)
    field[where] = velocity
    return field


def taught(
    memory: ClutterMemory,
    fields: list[np.ndarray],
    way: np.ndarray = STILL,
    held: np.ndarray = NOTHING,
) -> np.ndarray:
    for field in fields:
        memory.propagate(way)
        level = memory.take(field, NOISE, SEEN, held, EVERY)
    return level


def cluttered(count: int, strength: float, where: np.ndarray = LEFT) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [moving_by(rng.normal(0.0, strength, 2), where) for _ in range(count)]


def test_the_level_of_a_cluttered_place_is_the_rms_of_its_velocity_an_axis() -> None:
    level = taught(ClutterMemory(), cluttered(80, 0.1))
    assert level[:, 2:14].mean() == pytest.approx(0.1, rel=0.35)
    assert level[:, 18:].max() == 0.0


def test_what_moves_steadily_is_no_clutter() -> None:
    level = taught(ClutterMemory(), [moving_by([1.0, 0.5], LEFT)] * 40)
    assert level.max() < 1e-3


def test_one_change_tells_little() -> None:
    fields = [moving_by([0.0, 0.0], LEFT)] * 3 + [moving_by([1.0, 0.0], LEFT)] * 2
    assert taught(ClutterMemory(), fields).max() < 0.6 * NOISE.max()


def test_what_was_cluttered_is_forgotten_slowly() -> None:
    memory = ClutterMemory()
    before = taught(memory, cluttered(60, 0.1))[:, 2:14].mean()
    calm = [moving_by([0.0, 0.0], LEFT)]
    soon = taught(memory, calm * 8)[:, 2:14].mean()
    late = taught(memory, calm * 150)[:, 2:14].mean()
    assert soon > 0.6 * before
    assert late < 0.15 * before


def test_objects_are_not_learned_and_what_is_known_of_their_place_counts_by_half() -> None:
    held = np.zeros(CELLS, bool)
    held[:, :16] = True
    memory = ClutterMemory()
    assert taught(memory, cluttered(40, 0.1), held=held).max() == 0.0
    known = taught(memory, cluttered(40, 0.1))
    memory.propagate(STILL)
    halved = memory.take(moving_by([0, 0], LEFT), NOISE, SEEN, held, EVERY)
    assert halved[:, 4:12].mean() < 0.6 * known[:, 4:12].mean()


@pytest.mark.parametrize("step", [0.7, 3.0])
def test_it_stays_on_the_scene_when_the_camera_pans(step: float) -> None:
    memory = ClutterMemory()
    taught(memory, cluttered(60, 0.1, LEFT))
    pan = np.array([[1.0, 0.0, step], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for _ in range(round(24 / step)):
        memory.propagate(pan)
    level = memory.take(moving_by([0, 0], LEFT), NOISE, SEEN, NOTHING, EVERY)
    # The cluttered half has moved by six cells to the right.
    assert level[4:-4, 8:20].mean() > 0.07
    assert level[4:-4, 24:].max() < 0.02


def test_a_new_scene_is_learned_anew() -> None:
    memory = ClutterMemory()
    taught(memory, cluttered(40, 0.1))
    memory.forget()
    memory.propagate(STILL)
    assert memory.take(moving_by([0, 0], LEFT), NOISE, SEEN, NOTHING, EVERY).max() == 0.0


def test_objects_hold_their_cells_and_those_beside_them() -> None:
    mask = np.zeros((192, 256), bool)
    mask[80:100, 120:150] = True
    held = cells_of_objects([CroppedMask.of(mask)], (256, 192), SHAPE)
    assert held[45 // CELL, 67 // CELL]
    assert not held[10 // CELL].any()
    assert held.mean() < 0.1


def test_noise_is_raised_to_what_a_cluttered_place_moves_by_and_nowhere_lowered() -> None:
    level = np.zeros(CELLS, np.float32)
    level[:, :10] = 0.2
    raised = with_clutter(NOISE, level, 1.5)
    assert raised[48, 8] == pytest.approx(0.3)
    assert raised[48, 100] == NOISE[48, 100]
    assert with_clutter(NOISE, None, 1.5) is NOISE
