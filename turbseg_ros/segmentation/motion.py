"""From flows to the motion feature map: how fast each pixel moves against the scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Flow, Map, Mask
from turbseg_ros.segmentation import flow as optical_flow
from turbseg_ros.segmentation import geometry
from turbseg_ros.segmentation.average import Average, MeanAverage

# Temporal correlation of tilt at lags 1 to 8, at 30 Hz, as seen on a real clip; beyond, it is 0.1.
_TILT_CORRELATION = (1.0, 0.6, 0.35, 0.25, 0.2, 0.17, 0.15, 0.12, 0.1)
# The median length of a two-axis normal variable, in standard deviations of an axis.
_RAYLEIGH_MEDIAN = 1.1774
# Estimates over a short and a long time agree within so many standard deviations of the short one.
_AGREEMENT = 3.0
# Flow can't be trusted to be steadier than this from frame to frame, in pixels a frame.
_MIN_NOISE = 0.015
# No turbulence tilts a picture by so many pixels: the camera moves past things near and far, too
# fast for the flow. Below the second it stands still again.
BEYOND_TURBULENCE = 2.0
_WITHIN_TURBULENCE = 0.4
# Tilt in pixels from which on it is asked whether flow follows the picture, or is smear.
_DOUBTFUL = 1.0
# Medians over a map are taken from about so many pixels.
_SAMPLES = 10000


@dataclass(frozen=True)
class MotionEstimate:
    """Motion of every pixel against the scene, at processing resolution.

    `velocity` is HxWx2 and `motion_map` M its measure, HxW, both in pixels a frame; `noise` is
    HxW, the standard deviation of M's axes where nothing moves; `tilt` is the rms turbulent
    motion an axis in pixels, NaN where no pair of intervals allows to measure it; `visible` tells
    which pixels had enough neighbours. `clutter` is by how much each cell of the scene is known to
    move without anything being there, hxw in pixels a frame, see `clutter.ClutterMemory`; None
    where nothing is known. `disorder` is what the tilt would be if flow followed the picture
    everywhere: more than that where it fails; NaN as well where it isn't measured. `intervals` are
    those to the neighbours that it was measured with.
    """

    velocity: Flow
    motion_map: Map
    noise: Map
    tilt: float
    visible: npt.NDArray[np.bool_]
    ego_motion_model: str
    clutter: Map | None = None
    disorder: float = float("nan")
    intervals: Sequence[int] = ()


class MotionMeasure(Protocol):
    """Measures how far each pixel breaks the camera's own motion: the motion feature map M."""

    def intervals(self, interval: int) -> list[int]:
        """Return the intervals k whose flows F(t→t+k) are wanted, `interval` being in use."""

    def motions(
        self, flows: Mapping[int, Flow], valid: Mapping[int, Map], interval: int
    ) -> list[MotionEstimate]:
        """Return estimates of the motion, over a short baseline first, then longer ones, if any.

        :param flows: {k: F(t→t+k)} to neighbours that are roughly aligned, HxWx2 in pixels; some
            of the intervals wanted may be missing.
        :param valid: {k: HxW}, 1 where the pixel is seen in frame t+k, else 0.
        """


@dataclass(frozen=True)
class AffineMotion:
    """M is what a robust affine ego-motion leaves of the averaged flow, in place of eq. 2.

    :param followed: tells where flow surely follows the picture, HxW, None where it is too little.
        It is asked where more seems to be tilt than turbulence makes.
    """

    average: Average
    followed: Callable[[], Mask | None] = lambda: None

    def intervals(self, interval: int) -> list[int]:
        """Return those of the average."""
        return self.average.intervals(interval)

    def motions(
        self, flows: Mapping[int, Flow], valid: Mapping[int, Map], interval: int
    ) -> list[MotionEstimate]:
        """Measure over each baseline of the average; see `MotionMeasure`."""
        residuals = _residuals(flows, valid)
        disorder = measured_tilt(residuals, valid)
        found = _estimates(residuals, disorder, valid, self.average, interval, "affine")
        followed = self.followed() if disorder > _DOUBTFUL else None
        if followed is None:
            return found
        told = {k: seen * followed for k, seen in valid.items()}
        tilt = measured_tilt(_residuals(flows, told), told)
        return [replace(each, tilt=tilt) for each in found]


@dataclass(frozen=True)
class UncheckedMotion:
    """M is the averaged flow itself, as in the paper's ablation of eq. 2.

    Only what the alignment of the neighbours took out is missing from it.
    """

    average: Average

    def intervals(self, interval: int) -> list[int]:
        """Return those of the average."""
        return self.average.intervals(interval)

    def motions(
        self, flows: Mapping[int, Flow], valid: Mapping[int, Map], interval: int
    ) -> list[MotionEstimate]:
        """Measure over each baseline of the average; see `MotionMeasure`."""
        tilt = measured_tilt(_residuals(flows, valid), valid)
        return _estimates(flows, tilt, valid, self.average, interval, "none")


@dataclass(frozen=True)
class SampsonMotion:
    """M as the paper has it: eq. 1 for each set of intervals, then eq. 2, averaged.

    It is the root of the averaged squared distance, so that it stays in pixels a frame.

    :param widest: B, the largest interval.
    :param causal: whether frames to come are out of reach.
    """

    widest: int
    causal: bool = False

    def intervals(self, interval: int) -> list[int]:
        """Return those of the paper's eq. 1, whatever interval is in use."""
        return MeanAverage(self.widest, self.causal).intervals(interval)

    def motions(
        self, flows: Mapping[int, Flow], valid: Mapping[int, Map], interval: int
    ) -> list[MotionEstimate]:
        """Measure over all baselines at once; see `MotionMeasure`."""
        return [sampson_motion(flows, valid, interval_sets(self.widest))]


@dataclass(frozen=True)
class MotionAgainstPicture:
    """M where nothing tells the camera's motion: flow as it is, where there is anything to follow.

    Before a plain sky flow smears a target's motion over half the picture, where a fit would find
    a camera's motion, and noise.

    :param textured: HxW, where flow has something to hold on to.
    """

    average: Average
    textured: Mask

    def intervals(self, interval: int) -> list[int]:
        """Return those of the average."""
        return self.average.intervals(interval)

    def motions(
        self, flows: Mapping[int, Flow], valid: Mapping[int, Map], interval: int
    ) -> list[MotionEstimate]:
        """Measure over each baseline of the average; see `MotionMeasure`."""
        followed = {k: flow * self.textured[..., None] for k, flow in flows.items()}
        tilt = measured_tilt(followed, valid)
        return _estimates(followed, tilt, valid, self.average, interval, "none")


def measure_for(
    measure: MotionMeasure, textured: Mask | None, followed: Callable[[], Mask | None]
) -> MotionMeasure:
    """Return what measures motion in a frame: the one chosen, if the camera's motion is known.

    :param textured: HxW, where flow has something to hold on to; None where the camera's motion
        is known.
    :param followed: tells where flow follows the picture, HxW, None where it is too little.
    """
    if type(measure) is not AffineMotion:
        return measure
    if textured is not None:
        return MotionAgainstPicture(measure.average, textured)
    return replace(measure, followed=followed)


def _estimates(
    flows: Mapping[int, Flow],
    tilt: float,
    valid: Mapping[int, Map],
    average: Average,
    interval: int,
    ego_motion_model: str,
) -> list[MotionEstimate]:
    """Average flows over each baseline of the average."""
    return [
        _estimate(*average(_of(flows, those), _of(valid, those)), tilt, ego_motion_model, those)
        for those in average.baselines(list(flows), interval)
    ]


def _of(maps: Mapping[int, Map], intervals: Sequence[int]) -> dict[int, Map]:
    return {i: maps[i] for i in intervals}


def _estimate(
    velocity: Flow,
    uncertainty: Map,
    tilt: float,
    ego_motion_model: str,
    intervals: Sequence[int],
) -> MotionEstimate:
    visible = np.isfinite(uncertainty)
    motion_map = geometry.lengths(*cv2.split(velocity))
    unit = noise_deviation(motion_map, uncertainty, visible)
    uncertainty = np.where(visible, uncertainty, np.float32(1.0))
    noise = np.maximum(np.float32(unit) * uncertainty, np.float32(_MIN_NOISE))
    return MotionEstimate(
        velocity=velocity,
        motion_map=motion_map,
        noise=noise,
        tilt=tilt,
        visible=visible,
        ego_motion_model=ego_motion_model,
        disorder=tilt,
        intervals=intervals,
    )


def noise_deviation(motion_map: Map, noise: Map, visible: Mask) -> float:
    """Return what a map's noise must be taken by to be that of most of what is visible.

    :param motion_map: HxW lengths of vectors, most of which are noise.
    :param noise: HxW, their standard deviation an axis, in units unknown.
    """
    return _robust_deviation((_sample(motion_map) / _sample(noise))[_sample(visible)])


def agree(motion: MotionEstimate, other: MotionEstimate) -> Mask:
    """Return in which pixels two estimates give one velocity, within the first one's noise, HxW.

    Where an object has passed within the longer time, flow finds nothing and means nothing.
    """
    change = motion.velocity - other.velocity
    same: Mask = geometry.lengths(*cv2.split(change)) < _AGREEMENT * motion.noise
    return same


def merged(motion: MotionEstimate, other: MotionEstimate, where: Mask) -> MotionEstimate:
    """Return `motion` with the velocity, map and noise of `other` in some pixels, HxW."""
    if not where.any():
        return motion
    return replace(
        motion,
        velocity=np.where(where[..., None], other.velocity, motion.velocity),
        motion_map=np.where(where, other.motion_map, motion.motion_map),
        noise=np.where(where, other.noise, motion.noise),
    )


def sampson_motion(
    flows: Mapping[int, Flow],
    valid: Mapping[int, Map],
    sets: Sequence[Sequence[int]],
) -> MotionEstimate:
    """Measure motion as the paper does; see `SampsonMotion`.

    :param flows: {k: F(t→t+k)}, HxWx2 in pixels.
    :param valid: {k: HxW}, 1 where the pixel is seen in frame t+k, else 0.
    :param sets: the sets K of eq. 1; those with an interval that `flows` lacks are left
        out.
    """
    kept = [chosen for chosen in sets if all(i in flows for i in chosen)]
    if not kept:
        kept = [tuple(flows)]
    shape = next(iter(flows.values())).shape[:2]
    visible = np.minimum.reduce(list(valid.values())) > 0
    distances = []
    for chosen in kept:
        stabilised = optical_flow.mean_flow(flows, chosen)
        matrix = geometry.fit_fundamental_matrix(stabilised, visible.astype(np.float32))
        if matrix is not None:
            distances.append(geometry.sampson_distance(stabilised, matrix))
    motion_map: Map = (
        np.sqrt(np.mean(distances, axis=0)) if distances else np.zeros(shape, np.float32)
    )
    motion_map[~visible] = 0.0
    residuals = _residuals(flows, valid)
    tilt = measured_tilt(residuals, valid)
    noise = max(_robust_deviation(_sample(motion_map)[_sample(visible)]), _MIN_NOISE)
    return MotionEstimate(
        velocity=optical_flow.slope_flow(residuals, valid),
        motion_map=motion_map,
        noise=np.full(shape, noise, np.float32),
        tilt=tilt,
        visible=visible,
        ego_motion_model="fundamental",
        disorder=tilt,
        intervals=tuple(flows),
    )


def interval_sets(widest: int) -> list[tuple[int, ...]]:
    """Return the symmetric sets K of eq. 1 that the authors' code uses, up to the widest interval.

    They are ±2, ±3, ±4, ±1 with ±2, and ±2 with ±3; for B = 1 only ±1 is left.
    """
    single: list[tuple[int, ...]] = [(k, -k) for k in range(2, widest + 1)]
    double: list[tuple[int, ...]] = [(k, -k, k + 1, -k - 1) for k in (1, 2) if k < widest]
    return (single + double) or [(1, -1)]


def measured_tilt(residuals: Mapping[int, Flow], valid: Mapping[int, Map]) -> float:
    """Measure the rms turbulent tilt an axis, in pixels, from two flows that share a velocity.

    Of F(t→t+k) and F(t→t+m), weighted so that k and m cancel, no constant velocity is left, but a
    sum of tilts, whose variance their temporal correlation gives. Two sides count before one, and
    the widest pair; the median over the picture leaves objects out. NaN without one.

    :param residuals: {k: F(t→t+k) less the ego-motion}, HxWx2.
    :param valid: {k: HxW}, 0 where the pixel isn't seen in frame t+k, else 1.
    """
    pairs = [(k, m) for k in residuals for m in residuals if m < 0 < k]
    pairs = pairs or [(k, 2 * k) for k in residuals if 2 * k in residuals]
    if not pairs:
        return float("nan")
    k, m = max(pairs, key=lambda pair: (min(abs(pair[0]), abs(pair[1])), -abs(pair[0] + pair[1])))
    shares = (m / (m - k), k / (k - m)) if m < 0 < k else (1.0, -0.5)
    left = np.float32(shares[0]) * _sample(residuals[k])
    left += np.float32(shares[1]) * _sample(residuals[m])
    left = left[(_sample(valid[k]) > 0) & (_sample(valid[m]) > 0)]
    if not len(left):
        return float("nan")
    times, weights = np.array([k, m, 0]), np.array([*shares, -sum(shares)])
    correlation = [[_tilt_correlation(one - other) for one in times] for other in times]
    gain = float(weights @ correlation @ weights)
    return _robust_deviation(np.hypot(left[:, 0], left[:, 1])) / float(np.sqrt(gain))


def next_interval(interval: int, widest: int, tilt: float) -> int:
    """Choose the interval of the next frame: half the widest where what is left is no turbulence.

    :param interval: the one that `tilt` was measured over.
    :param tilt: what all flow has for tilt, in pixels; NaN changes nothing.
    """
    if tilt > BEYOND_TURBULENCE:
        return max(widest // 2, 1)
    return widest if tilt < _WITHIN_TURBULENCE else interval


def _tilt_correlation(lag: int) -> float:
    return _TILT_CORRELATION[min(abs(lag), len(_TILT_CORRELATION) - 1)]


def _residuals(flows: Mapping[int, Flow], valid: Mapping[int, Map]) -> dict[int, Flow]:
    return {i: _less_ego_motion(flow, valid[i]) for i, flow in flows.items()}


def _less_ego_motion(flow: Flow, valid: Map) -> Flow:
    coefficients = geometry.fit_affine_flow(flow, valid)
    ego_motion = geometry.affine_flow(coefficients, (flow.shape[0], flow.shape[1]))
    residual: Flow = cv2.subtract(flow, ego_motion)
    return residual


def _sample(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return every n-th row and column of a map, enough of them for its median."""
    step = max(1, int(np.sqrt(values.shape[0] * values.shape[1] / _SAMPLES)))
    return values[::step, ::step]


def _robust_deviation(lengths: npt.NDArray[np.float32]) -> float:
    return float(np.median(lengths)) / _RAYLEIGH_MEDIAN if lengths.size else 0.0
