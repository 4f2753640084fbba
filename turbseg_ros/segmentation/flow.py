"""Optical flow between a frame and its neighbours, and its stabilisation over time.

A flow is float32, HxWx2, in pixels: where (x, y) of one frame has moved to in the other, less
(x, y). With the neighbours aligned by the ego-motion, what remains is turbulence and objects.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

Flow = npt.NDArray[np.float32]
Map = npt.NDArray[np.float32]
GreyImage = npt.NDArray[np.uint8]
Shares = npt.NDArray[np.float32]

Rule = Callable[[Shares, Shares], Shares]
"""Tells how much each flow has of a pixel's velocity, 0 all over where too few see the pixel.

It takes K intervals as Kx1 and, KxN, which of them see each of N pixels (1, else 0); it gives KxN.
"""

# Below this sum of squared distances between intervals, which are whole numbers, there is one.
_MIN_SPREAD = 0.25


class FlowBackend(Protocol):
    """Computes the flows of a frame in another way than by `dis_flow`."""

    @property
    def device(self) -> str:
        """Where it computes: cpu or cuda."""

    def flows_to(self, source: GreyImage, targets: Mapping[int, GreyImage]) -> dict[int, Flow]:
        """Return the flow F(t→t+k) for every neighbour, {k: image of frame t+k aligned to t}."""


def dis_flow(source: GreyImage, target: GreyImage, variational_iterations: int) -> Flow:
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


def mean_flow(flows: Mapping[int, Flow], intervals: Sequence[int]) -> Flow:
    """Average flows a frame over a set K of intervals: the paper's eq. 1, in pixels a frame.

    F̂ = 1/|K| Σ F(t→t+i)/i for i in K. In a symmetric set the tilt of frame t cancels.
    """
    if not intervals or 0 in intervals:
        raise ValueError(f"intervals must hold something and no 0, not {list(intervals)}")
    total = np.zeros_like(flows[intervals[0]])
    for i in intervals:
        cv2.scaleAdd(flows[i], 1.0 / i, total, dst=total)
    total /= len(intervals)
    return total


def slope_flow(flows: Mapping[int, Flow], weights: Mapping[int, Map]) -> Flow:
    """Fit the velocity of every pixel to its flows: weighted least squares, in pixels a frame.

    The model is F(t→t+i) = i·v + c, where the intercept c takes up the tilt of frame t. With
    symmetric intervals c falls out and v = Σ i·F(i) / Σ i², which weighs long intervals, whose
    tilt counts for less, more than eq. 1 does. A pixel with fewer than two intervals is at rest.

    :param flows: {i: F(t→t+i)}, all HxWx2.
    :param weights: {i: HxW}, 0 where the pixel isn't seen in frame t+i, else 1.
    """
    return combined(flows, weights, slope_shares)[0]


def combined(
    flows: Mapping[int, Flow], weights: Mapping[int, Map], rule: Rule
) -> tuple[Flow, Map]:
    """Make one velocity of a pixel's flows: Σ s(i)·F(t→t+i), the shares s by a rule.

    :return: velocity, HxWx2, and its standard error for flows of unit variance, HxW: the root of
        Σ s², inf where all shares are 0.
    """
    intervals = np.array(list(flows), np.float32)[:, None]
    shares = rule(intervals, np.ones_like(intervals))
    velocity = np.zeros_like(next(iter(flows.values())))
    for flow, share in zip(flows.values(), shares[:, 0], strict=True):
        cv2.scaleAdd(flow, float(share), velocity, dst=velocity)
    error = np.full(velocity.shape[:2], _error(shares)[0], np.float32)
    # Along the borders some neighbours are missing.
    rest = np.nonzero(functools.reduce(np.minimum, weights.values()) == 0)
    shares = rule(intervals, np.stack([weights[i][rest] for i in flows]))
    velocity[rest] = sum(
        flow[rest] * share[:, None] for flow, share in zip(flows.values(), shares, strict=True)
    )
    error[rest] = _error(shares)
    return velocity, error


def slope_shares(intervals: Shares, seen: Shares) -> Shares:
    """Return the shares that fit a line through the flows: a `Rule`."""
    count = np.maximum(seen.sum(axis=0), 1.0)
    distance = (intervals - (intervals * seen).sum(axis=0) / count) * seen
    spread = (distance**2).sum(axis=0)
    shares: Shares = distance / np.where(spread > _MIN_SPREAD, spread, np.inf)
    return shares


def mean_shares(intervals: Shares, seen: Shares) -> Shares:
    """Return the shares of the paper's eq. 1, over what a pixel has: a `Rule`."""
    count = seen.sum(axis=0)
    shares: Shares = seen / (intervals * np.where(count > 1, count, np.inf))
    return shares


def _error(shares: Shares) -> Map:
    squares = (shares**2).sum(axis=0)
    error: Map = np.where(squares > 0.0, np.sqrt(squares), np.float32(np.inf))
    return error
