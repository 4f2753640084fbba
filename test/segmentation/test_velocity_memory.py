"""What is learned of slow motion from one measurement to the next, on estimates that are drawn."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import pytest

from support.drawn_motion import drawn_motion
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.velocity_memory import VelocityMemory

SHAPE = (96, 128)
NOISE = 0.05
STILL = np.eye(3)
SQUARE = (slice(30, 60), slice(40, 70))
NOWHERE = (slice(0, 0), slice(0, 0))


def measured(
    velocity: tuple[float, float], where: tuple[slice, slice], seed: int, clutter: float = 0.0
) -> MotionEstimate:
    """Return motion in a place, and turbulence all over, another one for each seed."""
    rng = np.random.default_rng(seed)
    turbulence = cv2.GaussianBlur(rng.normal(0.0, 1.0, (*SHAPE, 2)), (0, 0), 3.0)
    field = (NOISE * turbulence / turbulence.std()).astype(np.float32)
    field[where] += velocity
    level = np.full((24, 32), clutter, np.float32)
    return drawn_motion(field, NOISE, clutter=level, intervals=(-12, -4, 4))


def averaged(
    memory: VelocityMemory, motions: Iterable[MotionEstimate], way: np.ndarray = STILL
) -> MotionEstimate | None:
    average = None
    for motion in motions:
        memory.propagate(way)
        average = memory.take(motion)
    return average


def drift(count: int = 15) -> list[MotionEstimate]:
    return [measured((0.08, 0.04), SQUARE, seed) for seed in range(count)]


def test_slow_motion_stands_out_from_turbulence_on_average() -> None:
    motions = drift()
    average = averaged(VelocityMemory(), motions)
    assert average is not None
    newest = motions[-1]
    assert average.velocity[SQUARE].mean(axis=(0, 1)) == pytest.approx([0.08, 0.04], abs=0.02)
    once, often = ((each.motion_map / each.noise)[SQUARE].mean() for each in (newest, average))
    assert often > 2.0 * once
    assert np.median(average.motion_map / average.noise) == pytest.approx(1.18, abs=0.1)


def test_the_average_is_of_the_neighbours_of_the_measurement_and_knows_less_clutter() -> None:
    average = averaged(VelocityMemory(), [measured((0, 0), NOWHERE, n, 0.1) for n in range(8)])
    assert average is not None
    assert average.clutter is not None
    assert average.intervals == (-12, -4, 4)
    assert 0.0 < average.clutter.max() < 0.05


def test_too_few_measurements_have_no_average() -> None:
    memory = VelocityMemory()
    assert averaged(memory, drift(3)) is None
    assert averaged(memory, drift(1)) is not None


def test_what_has_passed_leaves_no_trail() -> None:
    memory = VelocityMemory()
    averaged(memory, [measured((0, 0), NOWHERE, seed) for seed in range(6)])
    averaged(memory, [measured((3.0, 0.0), SQUARE, seed) for seed in range(6, 8)])
    average = averaged(memory, [measured((0, 0), NOWHERE, seed) for seed in range(8, 10)])
    assert average is not None
    trail = (average.motion_map > 5.0 * average.noise) & average.visible
    assert trail[SQUARE].mean() < 0.05


@pytest.mark.parametrize("step", [0.3, 0.8])
def test_it_follows_a_camera_that_drifts(step: float) -> None:
    memory, average = VelocityMemory(), None
    for n in range(12):
        memory.propagate(translation(step, 0.0))
        place = SQUARE[0], slice(round(40 + n * step), round(70 + n * step))
        average = memory.take(measured((0.2, 0.0), place, n))
    assert average is not None
    strong = average.velocity[45, :, 0] > 0.1
    left, right = np.flatnonzero(strong)[[0, -1]]
    assert left == pytest.approx(40 + 11 * step, abs=2.5)
    assert right == pytest.approx(69 + 11 * step, abs=2.5)


def test_a_camera_that_turns_has_no_average() -> None:
    memory = VelocityMemory()
    averaged(memory, drift(8))
    assert averaged(memory, drift(8), translation(3.0, 0.0)) is None


def test_a_camera_that_shakes_has_one() -> None:
    memory, average = VelocityMemory(), None
    for n, motion in enumerate(drift()):
        memory.propagate(translation(5.0 * (-1) ** n, 0.0))
        average = memory.take(motion)
    assert average is not None


def test_another_scene_begins_anew() -> None:
    memory = VelocityMemory()
    averaged(memory, drift(8))
    memory.propagate(None)
    assert averaged(memory, drift(3)) is None


def test_what_was_not_seen_begins_anew() -> None:
    memory = VelocityMemory()
    averaged(memory, drift(8))
    hidden = measured((0.08, 0.04), SQUARE, 8)
    hidden.visible[SQUARE] = False
    average = averaged(memory, [hidden, *drift(3)])
    assert average is not None
    assert not average.visible[SQUARE].any()
    assert average.visible.any()
