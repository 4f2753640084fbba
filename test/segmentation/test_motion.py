"""The motion map, on flows of scenes, objects and turbulence that are known."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from turbseg_ros.segmentation.average import Average, MeanAverage, SlopeAverage
from turbseg_ros.segmentation.geometry import affine_flow, pixel_grid, sampson_distance
from turbseg_ros.segmentation.motion import (
    AffineMotion,
    MotionAgainstPicture,
    MotionEstimate,
    SampsonMotion,
    UncheckedMotion,
    agree,
    measure_for,
    measured_tilt,
    merged,
    next_interval,
    sampson_motion,
)

SHAPE = (96, 160)
CENTRED = (-4, -2, 2, 4)
OBJECT = (slice(30, 60), slice(40, 90))
PAN = np.array([[3.0, -2.0], [0.01, 0.002], [-0.003, 0.008]])
SLOPE, MEAN = SlopeAverage(), MeanAverage(widest=4)
PAPER_SETS = [(2, -2), (3, -3), (4, -4), (1, -1, 2, -2), (2, -2, 3, -3)]


def affine_motion(
    flows: dict[int, np.ndarray],
    weights: dict[int, np.ndarray],
    average: Average = SLOPE,
) -> MotionEstimate:
    """Measure over one baseline: all the intervals."""
    (motion,) = AffineMotion(average).motions(flows, weights, max(map(abs, flows)))
    return motion


def tilts(rms: float, correlation: float, lags: range, seed: int = 0) -> dict[int, np.ndarray]:
    """Tilt of each frame as a first-order autoregressive process at every pixel."""
    random = np.random.default_rng(seed)
    state = random.normal(0, rms, (*SHAPE, 2))
    fields = {}
    for lag in lags:
        fields[lag] = state
        innovation = random.normal(0, rms * np.sqrt(1 - correlation**2), state.shape)
        state = correlation * state + innovation
    return fields


def turbulent_residuals(rms: float, intervals: tuple[int, ...]) -> dict[int, np.ndarray]:
    tilt = tilts(rms, 0.6, range(-8, 9))
    return {i: (tilt[i] - tilt[0]).astype(np.float32) for i in intervals}


def nowhere() -> None:
    """Where flow follows the picture: too little to tell."""


def everywhere(intervals: Iterable[int]) -> dict[int, np.ndarray]:
    return {i: np.ones(SHAPE, np.float32) for i in intervals}


SEEN = everywhere(range(-20, 21))


# The process decorrelates a little faster than the real tilt that the gains were taken from: 4 %.
@pytest.mark.parametrize(
    "intervals",
    [(-4, -2, 2, 4), (-2, 2), (-1, 1), (-8, -4, 4, 8), (-8, -4, -2, -1), (-6, 2), (-5, 3)],
    ids=str,
)
@pytest.mark.parametrize("rms", [0.13, 0.5, 2.0])
def test_tilt_is_measured_within_a_tenth(intervals: tuple[int, ...], rms: float) -> None:
    residuals = turbulent_residuals(rms, intervals)
    assert measured_tilt(residuals, SEEN) == pytest.approx(rms, rel=0.1)


def test_tilt_is_told_where_flow_follows_the_picture() -> None:
    residuals = turbulent_residuals(0.3, CENTRED)
    followed = np.zeros(SHAPE, bool)
    followed[:, :60] = True
    # Elsewhere what goes too fast for flow smears, never twice alike.
    random = np.random.default_rng(1)
    flows = {
        k: np.where(followed[..., None], flow, random.normal(0.0, 8.0, flow.shape))
        for k, flow in residuals.items()
    }
    flows = {k: flow.astype(np.float32) for k, flow in flows.items()}
    (all_told,) = AffineMotion(SLOPE).motions(flows, SEEN, 4)
    (motion,) = AffineMotion(SLOPE, lambda: followed).motions(flows, SEEN, 4)
    assert motion.tilt == pytest.approx(0.3, rel=0.1)
    assert all_told.tilt > 2.0
    assert motion.disorder == all_told.disorder == all_told.tilt
    np.testing.assert_array_equal(motion.velocity, all_told.velocity)


def test_tilt_is_taken_from_the_widest_pair() -> None:
    residuals = turbulent_residuals(0.3, (-4, -3, -2, 2, 4))
    widest = {i: residuals[i] for i in (-4, 4)}
    assert measured_tilt(residuals, SEEN) == measured_tilt(widest, SEEN)


def test_of_a_pair_that_is_shifted_back_the_most_even_one_tells_the_tilt() -> None:
    residuals = turbulent_residuals(0.3, (-8, -6, 2))
    pair = {i: residuals[i] for i in (-6, 2)}
    assert measured_tilt(residuals, SEEN) == measured_tilt(pair, SEEN)
    velocity = np.random.default_rng(3).normal(0, 5, (*SHAPE, 2))
    moving = {i: (flow + i * velocity).astype(np.float32) for i, flow in pair.items()}
    assert measured_tilt(moving, SEEN) == pytest.approx(measured_tilt(pair, SEEN), rel=1e-3)


def test_constant_velocities_are_no_tilt() -> None:
    residuals = turbulent_residuals(0.3, CENTRED)
    velocity = np.random.default_rng(3).normal(0, 5, (*SHAPE, 2))
    moving = {i: (flow + i * velocity).astype(np.float32) for i, flow in residuals.items()}
    assert measured_tilt(moving, SEEN) == pytest.approx(measured_tilt(residuals, SEEN), rel=1e-3)


def test_objects_that_accelerate_hardly_change_the_tilt() -> None:
    residuals = turbulent_residuals(0.3, CENTRED)
    for flow in residuals.values():
        flow[OBJECT] += 6.0
    assert measured_tilt(residuals, SEEN) == pytest.approx(0.3, rel=0.25)


def test_tilt_is_unknown_without_a_pair_of_intervals() -> None:
    assert np.isnan(measured_tilt(turbulent_residuals(0.3, (-8, -6, -1)), SEEN))


def test_tilt_is_unknown_where_nothing_is_seen() -> None:
    residuals = turbulent_residuals(0.3, CENTRED)
    assert np.isnan(measured_tilt(residuals, {i: np.zeros(SHAPE, np.float32) for i in CENTRED}))


def scene_flows(intervals: tuple[int, ...], tilt: float = 0.2) -> dict[int, np.ndarray]:
    """An affine camera motion, turbulence, and an object that moves by (1.5, -0.5) a frame."""
    flows = {
        i: flow + i * affine_flow(PAN, SHAPE)
        for i, flow in turbulent_residuals(tilt, intervals).items()
    }
    for i, flow in flows.items():
        flow[OBJECT] += (1.5 * i, -0.5 * i)
    return flows


@pytest.mark.parametrize("intervals", [CENTRED, (-8, -6, -4, -2), (2, 4, 6, 8)], ids=str)
def test_an_objects_velocity_is_measured_against_the_scene(intervals: tuple[int, ...]) -> None:
    motion = affine_motion(scene_flows(intervals), everywhere(intervals))
    np.testing.assert_allclose(
        np.median(motion.velocity[OBJECT], axis=(0, 1)), (1.5, -0.5), atol=0.05
    )
    assert np.median(motion.motion_map[OBJECT]) == pytest.approx(np.hypot(1.5, 0.5), rel=0.05)
    assert np.median(motion.motion_map[:20]) < 0.15
    assert motion.ego_motion_model == "affine"


def test_tilt_is_measured_beside_an_object_and_under_ego_motion() -> None:
    motion = affine_motion(scene_flows(CENTRED), everywhere(CENTRED))
    assert motion.tilt == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("rms", [0.1, 0.5])
def test_noise_is_the_deviation_of_the_velocity_where_nothing_moves(rms: float) -> None:
    residuals = turbulent_residuals(rms, CENTRED)
    motion = affine_motion(residuals, everywhere(CENTRED))
    assert np.median(motion.noise) == pytest.approx(motion.velocity.std(), rel=0.05)


def test_velocity_is_less_certain_where_fewer_frames_see_it() -> None:
    weights = everywhere(CENTRED)
    weights[4][:, 100:] = 0.0
    motion = affine_motion(turbulent_residuals(0.3, CENTRED), weights)
    assert motion.noise[:, 100:].min() > 1.2 * motion.noise[:, :100].max()


@pytest.mark.parametrize("average", [SLOPE, MEAN])
def test_an_average_states_its_own_error(average: Average) -> None:
    rng = np.random.default_rng(0)
    flows = {i: rng.standard_normal((*SHAPE, 2)).astype(np.float32) for i in CENTRED}
    weights = everywhere(CENTRED)
    weights[4][:, 100:] = 0.0
    velocity, error = average(flows, weights)
    for part in (np.s_[:, :100], np.s_[:, 100:]):
        assert velocity[part].std() == pytest.approx(float(error[part].mean()), rel=0.05)


def test_each_baseline_gives_the_motion_that_its_flows_alone_give() -> None:
    flows, weights, near = scene_flows(CENTRED), everywhere(CENTRED), (-2, 2)
    short, long = AffineMotion(SLOPE).motions(flows, weights, interval=1)
    alone = affine_motion({i: flows[i] for i in near}, {i: weights[i] for i in near})
    np.testing.assert_array_equal(short.velocity, alone.velocity)
    np.testing.assert_array_equal(long.velocity, affine_motion(flows, weights).velocity)


def test_the_mean_is_that_of_the_flows_a_frame() -> None:
    intervals = (-2, -1, 1, 2)
    motion = affine_motion(scene_flows(intervals), everywhere(intervals), MEAN)
    fitted = affine_motion(scene_flows(intervals), everywhere(intervals))
    np.testing.assert_allclose(
        np.median(motion.velocity[OBJECT], axis=(0, 1)), (1.5, -0.5), atol=0.05
    )
    assert np.abs(motion.velocity - fitted.velocity).max() > 0.01


def test_unchecked_motion_keeps_the_motion_of_the_camera() -> None:
    (motion,) = UncheckedMotion(MEAN).motions(scene_flows(CENTRED), everywhere(CENTRED), 4)
    still = np.ones(SHAPE, bool)
    still[OBJECT] = False
    error = np.abs(motion.velocity - affine_flow(PAN, SHAPE))[still]
    assert np.median(error) < 0.05
    assert motion.tilt == pytest.approx(0.2, rel=0.1)
    assert motion.ego_motion_model == "none"


def test_a_still_scene_has_noise_all_the_same() -> None:
    still = {i: np.zeros((*SHAPE, 2), np.float32) for i in CENTRED}
    motion = affine_motion(still, everywhere(CENTRED))
    assert motion.noise.min() > 0.0
    assert not motion.motion_map.any()


def test_what_too_few_frames_see_does_not_move() -> None:
    weights = everywhere(CENTRED)
    for i in (-2, 2, 4):
        weights[i][:, :10] = 0.0
    motion = affine_motion(scene_flows(CENTRED), weights)
    assert not motion.visible[:, :10].any()
    assert motion.visible[:, 10:].all()
    assert not motion.motion_map[:, :10].any()
    assert np.isfinite(motion.noise).all()


def forward_flows(intervals: tuple[int, ...]) -> dict[int, np.ndarray]:
    """A camera that goes straight towards a rugged scene, and an object that goes sideways."""
    nearness = np.random.default_rng(0).uniform(0.01, 0.03, (*SHAPE, 1))
    velocity = nearness * (pixel_grid(SHAPE) - EPIPOLE)
    velocity[OBJECT] = (0.0, 2.0)
    return {i: (i * velocity).astype(np.float32) for i in intervals}


EPIPOLE = np.array([150.0, 40.0])
FORWARD = np.array([[0, -1.0, EPIPOLE[1]], [1.0, 0, -EPIPOLE[0]], [-EPIPOLE[1], EPIPOLE[0], 0]])


def test_sampson_motion_is_the_distance_from_the_known_geometry() -> None:
    intervals = (-4, -3, -2, -1, 1, 2, 3, 4)
    flows = forward_flows(intervals)
    motion = sampson_motion(flows, everywhere(intervals), PAPER_SETS)
    expected = np.sqrt(sampson_distance(flows[1], FORWARD))
    assert np.median(expected[OBJECT]) > 1.0
    np.testing.assert_allclose(motion.motion_map, expected, atol=0.1)
    assert motion.ego_motion_model == "fundamental"
    assert motion.visible.all()


def test_sampson_motion_leaves_out_sets_that_lack_an_interval() -> None:
    intervals = (-2, -1, 1, 2)
    flows = forward_flows(intervals)
    weights = everywhere(intervals)
    known = sampson_motion(flows, weights, [(2, -2), (1, -1, 2, -2)])
    asked = sampson_motion(flows, weights, PAPER_SETS)
    np.testing.assert_array_equal(asked.motion_map, known.motion_map)


def test_sampson_motion_makes_do_with_any_intervals() -> None:
    intervals = (1, 2, 3, 4)
    flows = forward_flows(intervals)
    motion = sampson_motion(flows, everywhere(intervals), PAPER_SETS)
    expected = np.sqrt(sampson_distance(flows[1], FORWARD))
    np.testing.assert_allclose(motion.motion_map, expected, atol=0.1)


def test_sampson_motion_asks_that_every_frame_sees_a_pixel() -> None:
    intervals = (-2, -1, 1, 2)
    weights = everywhere(intervals)
    weights[1][:, :10] = 0.0
    motion = sampson_motion(forward_flows(intervals), weights, PAPER_SETS)
    assert not motion.visible[:, :10].any()
    assert not motion.motion_map[:, :10].any()


@settings(max_examples=25, deadline=None)
@given(
    scale=st.sampled_from([0.0, 1e-3, 1.0, 100.0]),
    intervals=st.lists(st.integers(-8, 8).filter(bool), min_size=2, max_size=5, unique=True),
    hidden=st.sampled_from([0.0, 0.5, 1.0]),
    seed=st.integers(0, 100),
)
def test_any_flows_give_finite_motion(
    scale: float, intervals: list[int], hidden: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    flows = {i: (scale * random.normal(size=(24, 32, 2))).astype(np.float32) for i in intervals}
    weights = {i: (random.uniform(size=(24, 32)) >= hidden).astype(np.float32) for i in intervals}
    for motion in (affine_motion(flows, weights), sampson_motion(flows, weights, PAPER_SETS)):
        assert np.isfinite(motion.motion_map).all()
        assert np.isfinite(motion.velocity).all()
        assert np.isfinite(motion.noise).all()
        assert (motion.noise > 0).all()


def test_the_interval_is_halved_while_the_camera_moves_past_things_near_and_far() -> None:
    intervals = [4]
    for tilt in (0.3, 1.5, 2.5, 1.5, float("nan"), 0.9, 0.2, 1.9):
        intervals.append(next_interval(intervals[-1], widest=4, tilt=tilt))
    assert intervals == [4, 4, 4, 2, 2, 2, 2, 4, 4]
    assert next_interval(1, widest=1, tilt=3.0) == 1


def test_estimates_are_merged_where_they_are_said_to_be() -> None:
    x = np.arange(64, dtype=np.float32)
    flow = np.zeros((48, 64, 2), np.float32)
    flow[..., 0] = 0.3 * np.sin(x / 5)
    weights = {k: np.ones((48, 64), np.float32) for k in (-4, 4)}
    still = affine_motion(dict.fromkeys((-4, 4), 0 * flow), weights)
    moving = affine_motion({k: k * flow for k in (-4, 4)}, weights)
    assert agree(still, still).all()
    assert not agree(still, moving).all()
    where = np.zeros((48, 64), bool)
    where[10:20, 10:20] = True
    both = merged(still, moving, where)
    np.testing.assert_array_equal(both.velocity[where], moving.velocity[where])
    np.testing.assert_array_equal(both.motion_map[~where], still.motion_map[~where])


def test_before_a_plain_sky_only_what_stands_out_moves() -> None:
    """Flow smears a target's motion over most of the picture, and no camera's motion is fitted."""
    flows = {k: np.full((*SHAPE, 2), (1.5 * k, 0.0), np.float32) for k in CENTRED}
    textured = np.zeros(SHAPE, bool)
    textured[OBJECT] = True
    measure = measure_for(AffineMotion(SLOPE), textured, nowhere)
    assert isinstance(measure, MotionAgainstPicture)
    assert measure.intervals(4) == AffineMotion(SLOPE).intervals(4)
    (motion,) = measure.motions(flows, SEEN, 4)
    np.testing.assert_allclose(motion.motion_map[OBJECT], 1.5, rtol=1e-5)
    assert not motion.motion_map[~textured].any()
    assert motion.ego_motion_model == "none"


@pytest.mark.parametrize("measure", [AffineMotion(SLOPE), SampsonMotion(4)])
def test_where_the_cameras_motion_is_known_the_chosen_measure_measures(
    measure: AffineMotion | SampsonMotion,
) -> None:
    assert type(measure_for(measure, None, nowhere)) is type(measure)


def test_the_papers_measure_stays_where_nothing_tells_the_cameras_motion() -> None:
    measure = SampsonMotion(4)
    assert measure_for(measure, np.ones(SHAPE, bool), nowhere) is measure
