"""Optical flow between a frame and its neighbours, and its stabilisation over time.

A flow is float32, HxWx2, in pixels: where (x, y) of one frame has moved to in the other, less
(x, y). With the neighbours aligned by the ego-motion, what remains is turbulence and objects.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Flow, Map

Shares = npt.NDArray[np.float32]

# Below this sum of squared distances between intervals, which are whole numbers, there is one.
_MIN_SPREAD = 0.25


class FlowBackend(Protocol):
    """Computes the optical flow of a frame."""

    @property
    def device(self) -> str:
        """Where it computes: cpu or cuda."""

    def flows_to(self, source: ByteImage, targets: Mapping[int, ByteImage]) -> dict[int, Flow]:
        """Return the flow F(t→t+k) for every neighbour, {k: grey image of frame t+k aligned to t}.

        It is called in one thread at a time.
        """

    def close(self) -> None:
        """End what it started."""


class DisFlow:
    """Dense inverse search, each neighbour's flow in a thread.

    :param threads: flows computed at the same time.
    :param variational_iterations: see :func:`dis_flow`.
    """

    device = "cpu"

    def __init__(self, threads: int, variational_iterations: int) -> None:
        self._executor = ThreadPoolExecutor(threads, thread_name_prefix="flow")
        self._iterations = variational_iterations

    def flows_to(self, source: ByteImage, targets: Mapping[int, ByteImage]) -> dict[int, Flow]:
        """Return the flow F(t→t+k) for every neighbour; see `FlowBackend`."""
        flows = self._executor.map(
            lambda target: dis_flow(source, target, self._iterations), targets.values()
        )
        return dict(zip(targets, flows, strict=True))

    def close(self) -> None:
        """End its threads."""
        self._executor.shutdown()


def dis_flow(source: ByteImage, target: ByteImage, variational_iterations: int) -> Flow:
    """Return the flow from `source` to `target` by dense inverse search (Kroeger et al. 2016).

    :param source: HxW grey image.
    :param target: HxW grey image of the same size.
    :param variational_iterations: steps of variational refinement at each scale, 0 for none.
    """
    # The object holds its pyramids: one per call keeps calls in several threads apart.
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setVariationalRefinementIterations(variational_iterations)
    flow: Flow = dis.calc(source, target, None)
    return flow


def mean_flow(
    flows: Mapping[int, Flow], intervals: Sequence[int], valid: Mapping[int, Map] | None = None
) -> Flow:
    """Average flows a frame over a set K of intervals: the paper's eq. 1, in pixels a frame.

    F̂ = 1/|K| Σ F(t→t+i)/i for i in K. In a symmetric set the tilt of frame t cancels.

    :param flows: {i: F(t→t+i)}, all HxWx2.
    :param valid: {i: HxW}, 0 where the pixel isn't seen in frame t+i, else 1: K is then what a
        pixel has of it. Without it, every pixel has all of K.
    :raises ValueError: when K is empty or holds a 0.
    """
    if not intervals or 0 in intervals:
        raise ValueError(f"intervals must hold something and no 0, not {list(intervals)}")
    total = np.zeros_like(flows[intervals[0]])
    for i in intervals:
        seen = flows[i] if valid is None else flows[i] * valid[i][..., None]
        cv2.scaleAdd(seen, 1.0 / i, total, dst=total)
    if valid is None:
        total /= len(intervals)
    else:
        total /= np.maximum(sum(valid[i] for i in intervals), 1.0)[..., None]
    return total


def slope_flow(flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> Flow:
    """Fit the velocity of every pixel to its flows: weighted least squares, in pixels a frame.

    The model is F(t→t+i) = i·v + c, where the intercept c takes up the tilt of frame t. With
    symmetric intervals c falls out and v = Σ i·F(i) / Σ i², which weighs long intervals, whose
    tilt counts for less, more than eq. 1 does. A pixel with fewer than two intervals is at rest.

    :param flows: {i: F(t→t+i)}, all HxWx2.
    :param valid: {i: HxW}, 0 where the pixel isn't seen in frame t+i, else 1.
    """
    return slope_fit(flows, valid)[0]


def slope_fit(flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> tuple[Flow, Map]:
    """Fit the velocity of every pixel to its flows; see :func:`slope_flow`.

    :return: velocity, HxWx2, and its standard error for flows of unit variance, HxW: the root of
        Σ s² over the flows' shares s, inf where too few flows see the pixel.
    """
    intervals = np.array(list(flows), np.float32)[:, None]
    shares = _slope_shares(intervals, np.ones_like(intervals))
    velocity = np.zeros_like(next(iter(flows.values())))
    for flow, share in zip(flows.values(), shares[:, 0], strict=True):
        cv2.scaleAdd(flow, float(share), velocity, dst=velocity)
    error = np.full(velocity.shape[:2], _error(shares)[0], np.float32)
    # Along the borders some neighbours are missing.
    rest = np.nonzero(functools.reduce(np.minimum, valid.values()) == 0)
    shares = _slope_shares(intervals, np.stack([valid[i][rest] for i in flows]))
    velocity[rest] = sum(
        flow[rest] * share[:, None] for flow, share in zip(flows.values(), shares, strict=True)
    )
    error[rest] = _error(shares)
    return velocity, error


def _slope_shares(intervals: Shares, seen: Shares) -> Shares:
    """Return how much each flow has of the slope of a line through those that see a pixel, KxN.

    The shares of a pixel that fewer than two flows see are 0.

    :param intervals: the K intervals, Kx1.
    :param seen: which of them see each of N pixels, KxN, 1 or 0.
    """
    count = np.maximum(seen.sum(axis=0), 1.0)
    distance = (intervals - (intervals * seen).sum(axis=0) / count) * seen
    spread = (distance**2).sum(axis=0)
    shares: Shares = distance / np.where(spread > _MIN_SPREAD, spread, np.inf)
    return shares


def _error(shares: Shares) -> Map:
    squares = (shares**2).sum(axis=0)
    error: Map = np.where(squares > 0.0, np.sqrt(squares), np.float32(np.inf))
    return error
