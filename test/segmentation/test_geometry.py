"""Models of what a camera over a still scene shows, against known geometry and OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from turbseg_ros.segmentation.geometry import (
    affine_flow,
    fit_affine_flow,
    fit_fundamental_matrix,
    lengths,
    pixel_grid,
    sampson_distance,
    scaling,
    transformed_point,
    transformed_points,
    translation,
)

SHAPE = (48, 80)
SEEN = np.ones(SHAPE, np.float32)


def skew(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def two_views(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The flow between two views of a rugged scene, and their fundamental matrix."""
    K = np.array([[100.0, 0, 40], [0, 100, 24], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(np.array([0.01, -0.02, 0.03]))
    translation = np.array([0.3, 0.1, 0.2])
    depth = np.random.default_rng(seed).uniform(4.0, 8.0, SHAPE)
    pixels = np.dstack([pixel_grid(SHAPE), np.ones(SHAPE)])
    points = depth[..., None] * (pixels @ np.linalg.inv(K).T)
    moved = (points @ rotation.T + translation) @ K.T
    flow = moved[..., :2] / moved[..., 2:] - pixels[..., :2]
    F = np.linalg.inv(K).T @ skew(translation) @ rotation @ np.linalg.inv(K)
    return flow.astype(np.float32), F / np.linalg.norm(F)


def test_lengths_are_the_same_wherever_the_vectors_lie_in_memory() -> None:
    vectors = np.random.default_rng(0).normal(size=(2, 4096)).astype(np.float32)
    expected = lengths(*vectors)
    np.testing.assert_allclose(expected, np.hypot(*vectors), rtol=1e-6)
    for offset in range(0, 64, 4):
        room = np.empty(vectors.nbytes + 128, np.uint8)
        start = -room.ctypes.data % 64 + offset
        moved = room[start : start + vectors.nbytes].view(np.float32).reshape(vectors.shape)
        moved[:] = vectors
        np.testing.assert_array_equal(lengths(*moved), expected)


def test_a_transform_takes_a_point_where_it_takes_its_pixel() -> None:
    transform = translation(3.0, -2.0) @ scaling(2.0, 4.0)
    moved = transformed_point(transform, np.array([5.0, 7.0]))
    np.testing.assert_allclose(moved, (transform @ [5.0, 7.0, 1.0])[:2])
    one, other = transformed_points(transform, [np.array([5.0, 7.0]), np.array([0.0, 1.0])])
    np.testing.assert_allclose(one, moved)
    np.testing.assert_allclose(other, (transform @ [0.0, 1.0, 1.0])[:2])
    assert transformed_points(transform, []) == []


def test_pixel_grid_gives_x_before_y() -> None:
    assert pixel_grid((2, 3)).tolist() == [[[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 1], [2, 1]]]


def test_pixel_grid_takes_the_middles_of_its_cells() -> None:
    assert pixel_grid((8, 12), step=4)[..., 0].tolist() == [[2, 6, 10], [2, 6, 10]]


@pytest.mark.parametrize("seed", range(5))
def test_sampson_distance_is_opencvs_at_every_pixel(seed: int) -> None:
    random = np.random.default_rng(seed)
    flow = random.normal(0, 3, (6, 9, 2)).astype(np.float32)
    F = random.normal(size=(3, 3))
    distance = sampson_distance(flow, F)
    for y, x in np.ndindex(distance.shape):
        u, v = flow[y, x].astype(float)
        here, there = np.array([[x], [y], [1.0]]), np.array([[x + u], [y + v], [1.0]])
        assert distance[y, x] == pytest.approx(cv2.sampsonDistance(here, there, F), rel=1e-4)


def test_sampson_distance_vanishes_where_the_scene_is_still() -> None:
    flow, F = two_views()
    assert sampson_distance(flow, F).max() < 1e-6


def test_sampson_distance_shares_a_step_across_the_epipolar_line_between_both_views() -> None:
    # A camera that moves along its rows: F(x, x') = y' - y, and the squared distance is d²/2.
    F = skew(np.array([1.0, 0.0, 0.0]))
    flow = np.zeros((4, 5, 2), np.float32)
    flow[...] = (7.0, 2.0)
    np.testing.assert_allclose(sampson_distance(flow, F), 2.0, rtol=1e-6)


@pytest.mark.parametrize("share_of_outliers", [0.0, 0.3])
def test_fundamental_matrix_is_that_of_the_two_views(share_of_outliers: float) -> None:
    flow, F = two_views()
    random = np.random.default_rng(1)
    moving = random.uniform(size=SHAPE) < share_of_outliers
    seen = flow + np.where(moving[..., None], random.uniform(2, 8, (*SHAPE, 2)), 0.0)
    fitted = fit_fundamental_matrix(seen.astype(np.float32), SEEN)
    assert fitted is not None
    fitted = fitted / np.linalg.norm(fitted)
    assert min(np.abs(fitted - F).max(), np.abs(fitted + F).max()) < 1e-3
    assert sampson_distance(flow, fitted).max() < 1e-3


def test_fundamental_matrix_ignores_pixels_that_are_not_seen() -> None:
    flow, _ = two_views()
    hidden = np.zeros(SHAPE, bool)
    hidden[:, :56] = True
    spoilt = np.where(hidden[..., None], np.float32(9.0), flow)
    fitted = fit_fundamental_matrix(spoilt, (~hidden).astype(np.float32))
    assert fitted is not None
    assert sampson_distance(flow, fitted).max() < 1e-2


def test_fundamental_matrix_of_too_few_pixels_is_none() -> None:
    flow, _ = two_views()
    few = np.zeros(SHAPE, np.float32)
    few[:3, :5] = 1.0
    assert fit_fundamental_matrix(flow, few) is None


COEFFICIENTS = np.array([[1.5, -0.7], [0.01, -0.02], [0.03, 0.005]])


def test_affine_flow_is_what_its_coefficients_say() -> None:
    flow = affine_flow(COEFFICIENTS, SHAPE)
    x, y = 17, 31
    np.testing.assert_allclose(flow[y, x], [1, x, y] @ COEFFICIENTS, rtol=1e-5)


@pytest.mark.parametrize("shape", [(96, 160), (20, 30)])
def test_affine_fit_recovers_an_affine_flow(shape: tuple[int, int]) -> None:
    flow = affine_flow(COEFFICIENTS, shape)
    fitted = fit_affine_flow(flow, np.ones(shape, np.float32))
    np.testing.assert_allclose(affine_flow(fitted, shape), flow, atol=1e-3)


def test_affine_fit_leaves_out_forty_percent_of_moving_pixels() -> None:
    shape = (96, 160)
    still = affine_flow(COEFFICIENTS / 4, shape)
    noise = np.random.default_rng(0).normal(0, 0.1, (*shape, 2))
    flow = (still + noise).astype(np.float32)
    flow[:, :64] += (5.0, -3.0)
    fitted = fit_affine_flow(flow, np.ones(shape, np.float32))
    assert np.abs(affine_flow(fitted, shape) - still).max() < 0.1


def test_affine_fit_ignores_pixels_that_are_not_seen() -> None:
    shape = (96, 160)
    flow = affine_flow(COEFFICIENTS, shape)
    seen = np.ones(shape, np.float32)
    seen[:, 40:] = 0.0
    spoilt = np.where(seen[..., None] > 0, flow, np.float32(50.0))
    fitted = fit_affine_flow(spoilt, seen)
    np.testing.assert_allclose(affine_flow(fitted, shape), flow, atol=1e-2)


def test_affine_fit_to_almost_nothing_is_no_motion() -> None:
    flow = affine_flow(COEFFICIENTS, SHAPE)
    assert not fit_affine_flow(flow, np.zeros(SHAPE, np.float32)).any()
