"""Flow and its stabilisation over time, on flows that are written down."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.drawn_scene import texture
from turbseg_ros.segmentation.flow import dis_flow, mean_flow, slope_flow

SHAPE = (6, 7)
SYMMETRIC = [(1, -1), (2, -2), (4, -4), (1, -1, 2, -2), (2, -2, 4, -4)]


def constant(u: float, v: float = 0.0) -> np.ndarray:
    return np.full((*SHAPE, 2), (u, v), np.float32)


def moving(velocity: np.ndarray, tilt: np.ndarray, intervals: tuple[int, ...]) -> dict:
    """Flows from a frame that turbulence has tilted to others that it has not."""
    return {i: (i * velocity - tilt).astype(np.float32) for i in intervals}


def random_field(seed: int) -> np.ndarray:
    # Eighths are exact in float32, also when divided by the intervals 1, 2 and 4.
    return np.random.default_rng(seed).integers(-40, 40, (*SHAPE, 2)) / 8.0


def seen(*intervals: int) -> dict[int, np.ndarray]:
    return {i: np.ones(SHAPE, np.float32) for i in intervals}


def test_mean_flow_divides_each_flow_by_its_interval() -> None:
    flows = {1: constant(2.0, -1.0), -2: constant(3.0, 4.0)}
    np.testing.assert_allclose(mean_flow(flows, (1, -2)), constant(0.25, -1.5))


def test_mean_flow_takes_the_chosen_intervals_only() -> None:
    flows = {1: constant(2.0), 2: constant(99.0)}
    np.testing.assert_allclose(mean_flow(flows, (1,)), constant(2.0))


@pytest.mark.parametrize("intervals", SYMMETRIC, ids=str)
def test_symmetric_sets_cancel_the_tilt_of_the_frame_exactly(intervals: tuple[int, ...]) -> None:
    velocity, tilt = random_field(1), random_field(2)
    assert (mean_flow(moving(velocity, tilt, intervals), intervals) == velocity).all()


def test_one_sided_sets_leave_tilt_in_the_mean() -> None:
    velocity, tilt = random_field(1), random_field(2)
    mean = mean_flow(moving(velocity, tilt, (1, 2)), (1, 2))
    np.testing.assert_allclose(mean, velocity - 0.75 * tilt, atol=1e-5)


@pytest.mark.parametrize("intervals", [(), (1, 0)], ids=str)
def test_mean_over_no_interval_or_none_at_all_is_refused(intervals: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="intervals"):
        mean_flow({0: constant(1.0), 1: constant(1.0)}, intervals)


def test_stabilising_leaves_the_flows_as_they_are() -> None:
    flows = {1: constant(2.0), -1: constant(3.0)}
    mean_flow(flows, (1, -1))
    slope_flow(flows, seen(1, -1))
    assert (flows[1] == constant(2.0)).all()
    assert (flows[-1] == constant(3.0)).all()


@pytest.mark.parametrize("intervals", [(-4, -2, 2, 4), (-1, 1), (-3, -2, 2, 3)], ids=str)
def test_slope_over_symmetric_intervals_weighs_flows_by_their_interval(
    intervals: tuple[int, ...],
) -> None:
    flows = {i: random_field(i + 10).astype(np.float32) for i in intervals}
    expected = sum(i * flows[i] for i in intervals) / sum(i * i for i in intervals)
    np.testing.assert_allclose(slope_flow(flows, seen(*intervals)), expected, atol=1e-4)


@pytest.mark.parametrize("intervals", [(-8, -6, -4, -2), (1, 2), (-2, 4), (-4, 4)], ids=str)
def test_the_intercept_takes_up_the_tilt_of_the_frame(intervals: tuple[int, ...]) -> None:
    velocity, tilt = random_field(1), random_field(2)
    slope = slope_flow(moving(velocity, tilt, intervals), seen(*intervals))
    np.testing.assert_allclose(slope, velocity, atol=1e-4)


@given(
    intervals=st.lists(st.integers(-8, 8).filter(bool), min_size=2, max_size=6, unique=True),
    seed=st.integers(0, 1000),
)
def test_slope_is_the_least_squares_line(intervals: list[int], seed: int) -> None:
    random = np.random.default_rng(seed)
    flows = {i: random.normal(0, 3, (1, 1, 2)).astype(np.float32) for i in intervals}
    weights = {i: np.ones((1, 1), np.float32) for i in intervals}
    measured = np.array([flows[i][0, 0] for i in intervals], float)
    line = np.polyfit(intervals, measured, 1)[0]
    np.testing.assert_allclose(slope_flow(flows, weights)[0, 0], line, atol=1e-3)


def test_a_frame_that_does_not_see_a_pixel_has_no_say_there() -> None:
    velocity, tilt = random_field(1), random_field(2)
    flows = moving(velocity, tilt, (-4, -2, 2, 4))
    weights = seen(-4, -2, 2, 4)
    weights[4][:, :3] = 0.0
    flows[4][:, :3] = 1000.0
    np.testing.assert_allclose(slope_flow(flows, weights), velocity, atol=1e-4)


def test_a_pixel_that_fewer_than_two_frames_see_is_at_rest() -> None:
    flows = moving(random_field(1), random_field(2), (-2, 2))
    weights = seen(-2, 2)
    weights[2][0, 0] = weights[-2][0, 1] = weights[2][0, 1] = 0.0
    slope = slope_flow(flows, weights)
    assert not slope[0, :2].any()
    assert slope[0, 2:].any()


def test_dis_flow_finds_how_far_a_texture_has_moved() -> None:
    ground = texture((96, 160), seed=3, grain=2.0)
    flow = dis_flow(ground, np.roll(ground, (2, 3), axis=(0, 1)), variational_iterations=1)
    inside = flow[12:-12, 12:-12]
    np.testing.assert_allclose(np.median(inside, axis=(0, 1)), (3, 2), atol=0.05)
    assert np.percentile(np.abs(inside - (3, 2)), 95) < 0.3


def test_flows_computed_at_once_are_those_computed_alone() -> None:
    ground = texture((64, 96), seed=3, grain=2.0)
    targets = {k: np.roll(ground, k, axis=1) for k in (-4, -2, 2, 4)}
    with ThreadPoolExecutor(2) as executor:
        flows = list(executor.map(lambda target: dis_flow(ground, target, 1), targets.values()))
    for flow, target in zip(flows, targets.values(), strict=True):
        np.testing.assert_array_equal(flow, dis_flow(ground, target, 1))
