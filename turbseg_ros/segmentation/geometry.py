"""What a camera over a still scene would show, and by how much each pixel breaks it.

Models map pixels of one frame to the next; residuals are in pixels.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Flow, Map, Matrix, Point

_GRID = 8
_SAMPLES = 2000
_REWEIGHTINGS = 6
# Pixels by which a reweighting must still change the flow somewhere to be followed by another.
_SETTLED = 2e-3
# Tukey's biweight reaches 95 % efficiency at this many standard deviations.
_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826


@functools.lru_cache(maxsize=8)
def pixel_grid(shape: tuple[int, int], step: int = 1) -> npt.NDArray[np.float32]:
    """Return the coordinates (x, y) of every `step`-th pixel, hxwx2, not to be written to."""
    start = step // 2
    y, x = np.mgrid[start : shape[0] : step, start : shape[1] : step]
    grid = np.stack([x, y], axis=-1).astype(np.float32)
    grid.flags.writeable = False
    return grid


def lengths(x: Map, y: Map) -> Map:
    """Return the lengths of the vectors (x, y).

    The same vectors always have the same lengths. Those of cv2.magnitude differ in the last bit
    with where an array happens to lie in memory.
    """
    squared: Map = x * x + y * y
    return np.sqrt(squared, out=squared)


def upper_median(values: npt.NDArray[np.floating[Any]]) -> float:
    """Return the upper median of values in one row; NumPy's takes four times as long for few."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def translation(x: float, y: float) -> Matrix:
    """Return the transform that moves pixels by (x, y)."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def scaling(x: float, y: float) -> Matrix:
    """Return the transform to the pixels of a picture that is so many times as wide and high."""
    # Pixel centres lie at whole numbers, so the scaled grid is shifted by half a pixel.
    return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


def resampled(values: Map, transform: Matrix, backward: bool = False) -> Map:
    """Return what a transform makes of a map, 0 beyond its border; or what its inverse does."""
    if np.array_equal(transform, np.eye(3)):
        return values
    flags = cv2.INTER_LINEAR | (cv2.WARP_INVERSE_MAP if backward else 0)
    moved: Map = cv2.warpAffine(values, transform[:2], values.shape[1::-1], flags=flags)
    return moved


def transformed_point(transform: Matrix, point: Point) -> Point:
    """Return where an affine transform takes a point (x, y)."""
    return np.asarray(transform[:2, :2] @ point + transform[:2, 2])


def transformed_points(transform: Matrix, points: Sequence[Point]) -> list[Point]:
    """Return where an affine transform takes points (x, y)."""
    if not points:
        return []
    return list(np.asarray(points) @ transform[:2, :2].T + transform[:2, 2])


def corner_displacement(transform: Matrix, size: tuple[int, int]) -> float:
    """Return how far a transform moves corners of a picture, width and height, at most.

    That is in x or y, whichever is more.
    """
    width, height = size
    corners = np.array([[0, width, 0, width], [0, 0, height, height], [1, 1, 1, 1]])
    return float(np.abs((transform @ corners - corners)[:2]).max())


def middle_displacement(transform: Matrix, size: tuple[int, int]) -> Point:
    """Return by how much a transform moves the middle of a picture, width and height: (x, y)."""
    middle = np.array([size[0] / 2, size[1] / 2, 1.0])
    moved: Point = (transform @ middle - middle)[:2]
    return moved


def fit_affine_flow(flow: Flow, weights: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Fit (u, v) = (a + bx + cy, d + ex + fy) to a flow, robustly: Tukey's biweight on a grid.

    It starts from the median flow, so that objects that cover less than half of what is seen
    leave the fit.

    :param weights: HxW, 0 for pixels without a valid flow.
    :return: 3x2 coefficients of (1, x, y), x and y in pixels.
    """
    step = _GRID if min(flow.shape[:2]) >= 8 * _GRID else 1
    start = step // 2
    sampled = flow[start::step, start::step].reshape(-1, 2)
    usable = weights[start::step, start::step].ravel() > 0
    if np.count_nonzero(usable) < 12:
        return np.zeros((3, 2))
    samples = sampled[usable].astype(np.float64)
    points = pixel_grid((flow.shape[0], flow.shape[1]), step).reshape(-1, 2)[usable]
    basis = np.column_stack([np.ones(len(points)), points.astype(np.float64)])
    coefficients = np.zeros((3, 2))
    coefficients[0] = np.median(samples, axis=0)
    reach = np.array([[1.0], [flow.shape[1]], [flow.shape[0]]])
    for _ in range(_REWEIGHTINGS):
        residual = samples - basis @ coefficients
        squared = residual[:, 0] ** 2 + residual[:, 1] ** 2
        # For two independent normal axes the median distance is 1.177 standard deviations.
        variance = max(upper_median(squared) / 1.177**2, 1e-6)
        trust = np.maximum(1.0 - squared / (_TUKEY**2 * variance), 0.0) ** 2
        weighted = basis * trust[:, None]
        before = coefficients
        _, coefficients = cv2.solve(weighted.T @ basis, weighted.T @ samples, flags=cv2.DECOMP_SVD)
        if np.abs((coefficients - before) * reach).max() < _SETTLED:
            break
    return np.asarray(coefficients)


def affine_flow(coefficients: npt.NDArray[np.float64], shape: tuple[int, int]) -> Flow:
    """Return the flow, HxWx2, that `coefficients` of :func:`fit_affine_flow` describe."""
    flow: Flow = cv2.transform(pixel_grid(shape), np.roll(coefficients, -1, axis=0).T)
    return flow


def fit_fundamental_matrix(flow: Flow, weights: npt.NDArray[np.float32]) -> Matrix | None:
    """Estimate the fundamental matrix of a flow by least median of squares, as the paper does.

    It is fitted to a regular sample of the flow. None when the sample determines none.
    """
    height, width = flow.shape[:2]
    step = max(1, int(np.sqrt(height * width / _SAMPLES)))
    start = step // 2
    usable = weights[start::step, start::step].ravel() > 0
    source = pixel_grid((height, width), step).reshape(-1, 2)[usable]
    target = source + flow[start::step, start::step].reshape(-1, 2)[usable]
    if len(source) < 16:
        return None
    matrix, _ = cv2.findFundamentalMat(source, target, cv2.FM_LMEDS)
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return None
    return np.asarray(matrix, dtype=np.float64)


def sampson_distance(flow: Flow, fundamental_matrix: Matrix) -> Map:
    """Return every pixel's squared Sampson distance in pixels²: the paper's eq. 2.

    The correspondence is p2 = p1 + flow(p1) (Hartley and Zisserman 2004, eq. 11.9).
    """
    height, width = flow.shape[:2]
    x1 = np.arange(width, dtype=np.float64)[None, :]
    y1 = np.arange(height, dtype=np.float64)[:, None]
    x2 = x1 + flow[..., 0]
    y2 = y1 + flow[..., 1]
    F = fundamental_matrix
    line2 = [F[row, 0] * x1 + F[row, 1] * y1 + F[row, 2] for row in range(3)]
    line1 = [F[0, column] * x2 + F[1, column] * y2 + F[2, column] for column in range(2)]
    error = x2 * line2[0] + y2 * line2[1] + line2[2]
    scale = line2[0] ** 2 + line2[1] ** 2 + line1[0] ** 2 + line1[1] ** 2
    distance: Map = (error**2 / np.maximum(scale, 1e-12)).astype(np.float32)
    return distance
