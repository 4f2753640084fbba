"""Optical flow between a frame and its neighbours, and its stabilisation over time.

A flow is float32, HxWx2, in pixels: where (x, y) of one frame has moved to in the other, less
(x, y). With the neighbours aligned by the ego-motion, what remains is turbulence and objects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

Flow = npt.NDArray[np.float32]
GreyImage = npt.NDArray[np.uint8]


class FlowBackend(Protocol):
    """Computes the flows of a frame in another way than by `flows_to`."""

    @property
    def device(self) -> str:
        """Where it computes: cpu or cuda."""

    def flows_to(self, source: GreyImage, targets: Mapping[int, GreyImage]) -> dict[int, Flow]:
        """Give the flow F(t→t+k) for every neighbour, {k: image of frame t+k aligned to t}."""


def dis_flow(source: GreyImage, target: GreyImage, variational_iterations: int) -> Flow:
    """Give the flow from `source` to `target` by dense inverse search (Kroeger et al. 2016).

    :param source: HxW grey image.
    :param target: HxW grey image of the same size.
    :param variational_iterations: steps of variational refinement at each scale, 0 for none.
    """
    # The object holds its pyramids: one per call keeps calls in several threads apart.
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setVariationalRefinementIterations(variational_iterations)
    flow: Flow = dis.calc(source, target, None)
    return flow


def flows_to(
    source: GreyImage,
    targets: Mapping[int, GreyImage],
    variational_iterations: int,
    executor: Executor,
) -> dict[int, Flow]:
    """Give the flow F(t→t+k) for every neighbour, {k: image of frame t+k aligned to frame t}."""
    pending = {
        k: executor.submit(dis_flow, source, target, variational_iterations)
        for k, target in targets.items()
    }
    return {k: future.result() for k, future in pending.items()}


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


def slope_flow(flows: Mapping[int, Flow], weights: Mapping[int, npt.NDArray[np.float32]]) -> Flow:
    """Fit the velocity of every pixel to its flows: weighted least squares, in pixels a frame.

    The model is F(t→t+i) = i·v + c, where the intercept c takes up the tilt of frame t. With
    symmetric intervals c falls out and v = Σ i·F(i) / Σ i², which weighs long intervals, whose
    tilt counts for less, more than eq. 1 does. A pixel with fewer than two intervals is at rest.

    :param flows: {i: F(t→t+i)}, all HxWx2.
    :param weights: {i: HxW}, 0 where the pixel isn't seen in frame t+i, else 1.
    """
    s0, s1, s2 = (sum(weight * i**power for i, weight in weights.items()) for power in range(3))
    f0, f1 = (
        sum(flow * (weights[i] * np.float32(i**power))[..., None] for i, flow in flows.items())
        for power in range(2)
    )
    determinant = s0 * s2 - s1 * s1
    solvable = determinant > 0.5
    scale = np.where(solvable, 1.0 / np.where(solvable, determinant, 1.0), 0.0)
    slope: Flow = (s0[..., None] * f1 - s1[..., None] * f0) * scale[..., None]
    return slope
