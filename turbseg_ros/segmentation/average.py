"""One velocity for each pixel of its flows over several intervals: the paper's eq. 1, or a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from turbseg_ros.arrays import Flow, Map
from turbseg_ros.segmentation.flow import mean_flow, slope_fit

LONG_BASELINE = 3
"""Flow is also taken so many times the interval back, for what is slow."""
SHORT_BASELINE = 2
"""The largest interval of a short baseline, in intervals."""


class Average(Protocol):
    """Makes one velocity of a pixel's flows, and says which flows it needs for that."""

    def intervals(self, interval: int) -> list[int]:
        """Return the intervals k whose flows F(t→t+k) are wanted, `interval` being in use."""

    def baselines(self, intervals: Sequence[int], interval: int) -> list[list[int]]:
        """Return which of the intervals at hand make an estimate each, short baselines first."""

    def __call__(self, flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> tuple[Flow, Map]:
        """Return the velocity, HxWx2 in pixels a frame, and its error.

        The error, HxW, is the standard error for flows of unit variance, inf where too few see
        the pixel.

        :param flows: {k: F(t→t+k)}, HxWx2 in pixels.
        :param valid: {k: HxW}, 1 where the pixel is seen in frame t+k, else 0.
        """


class SlopeAverage:
    """A line through the flows: short flows to both sides, and a long one back for what is slow.

    It stands in for eq. 1: tilt, which has no trend, counts for less over long intervals.
    """

    def intervals(self, interval: int) -> list[int]:
        """Return -3B, -B and B for an interval B."""
        return [-LONG_BASELINE * interval, -interval, interval]

    def baselines(self, intervals: Sequence[int], interval: int) -> list[list[int]]:
        """Return the short intervals, then all; all at once where either is no baseline."""
        short = [k for k in intervals if abs(k) <= SHORT_BASELINE * interval]
        if len(short) in (len(intervals), 0, 1):
            return [list(intervals)]
        return [short, list(intervals)]

    def __call__(self, flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> tuple[Flow, Map]:
        """Fit the line; see `flow.slope_fit`."""
        return slope_fit(flows, valid)


@dataclass(frozen=True)
class MeanAverage:
    """The paper's eq. 1, over what a pixel has of the intervals.

    :param widest: B, the largest interval.
    :param causal: whether frames to come are out of reach; earlier ones up to 2B stand in.
    """

    widest: int
    causal: bool = False

    def intervals(self, interval: int) -> list[int]:
        """Return ±1 to ±B, or -1 to -2B, whatever interval is in use."""
        reach = range(1, self.widest + 1)
        if self.causal:
            return [-k for k in reach] + [-k - self.widest for k in reach]
        return [*(-k for k in reach), *reach]

    def baselines(self, intervals: Sequence[int], interval: int) -> list[list[int]]:
        """Return all of them as one."""
        return [list(intervals)]

    def __call__(self, flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> tuple[Flow, Map]:
        """Average the flows a frame: eq. 1; a pixel with fewer than two flows is at rest."""
        count = np.sum(list(valid.values()), axis=0)
        enough = count > 1
        velocity = mean_flow(flows, list(flows), valid) * enough[..., None]
        squares = np.sum([seen / k**2 for k, seen in valid.items()], axis=0)
        error = np.sqrt(squares) / np.maximum(count, 1.0)
        return velocity, np.where(enough, error, np.inf).astype(np.float32)
