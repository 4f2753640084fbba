"""Puts the method together as its parameters say: node, replay and evaluation all ask here.

Every strategy is chosen in one place, by a name that is built in or by `package.module:Class`,
which is called with the `Parameters`. Networks are imported only when they are chosen.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from turbseg_ros.learning.torch_import import NetworkError, require_torch
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.region_file import marked_regions
from turbseg_ros.segmentation.average import MeanAverage, SlopeAverage
from turbseg_ros.segmentation.expansion import as_grown, expanded
from turbseg_ros.segmentation.flow import DisFlow, FlowBackend
from turbseg_ros.segmentation.kalman_tracker import KalmanTracker
from turbseg_ros.segmentation.kmeans_ids import KMeansIds
from turbseg_ros.segmentation.motion import AffineMotion, SampsonMotion, UncheckedMotion
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.outliner import (
    BackgroundDifference,
    GrownRegions,
    OutlineMethod,
    RefinedDifference,
)
from turbseg_ros.segmentation.refinement import Refiner
from turbseg_ros.segmentation.region_growing import similar_magnitude, similar_velocity
from turbseg_ros.segmentation.strategies import Strategies

if TYPE_CHECKING:
    from turbseg_ros.learning.clip_refinement import ClipRefiner

Choices = Mapping[str, Callable[[Parameters], Any]]


def motion_segmenter(
    parameters: Parameters, observer: StageObserver | None = None
) -> MotionSegmenter:
    """Return a new segmenter, with the strategies that the parameters choose.

    Its own threads fill the cores: OpenCV's, which would only wait for them, are turned off.

    :param observer: looks at what the stages make of each frame.
    :raises ParameterError: when a network, its weights or its device can't be had, a class that
        was named can't be loaded, regions can't be read, or a network was chosen that is fitted
        to whole clips.
    """
    if parameters.refine.mode == "optimise":
        raise ParameterError(
            "parameter refine.mode is optimise, which needs the whole clip before it answers; "
            "set -p refine.mode:=pretrained, or segment a recorded bag with turbseg_replay"
        )
    cv2.setNumThreads(1)
    return MotionSegmenter(parameters, strategies, observer)


def clip_segmenter(
    parameters: Parameters, shown: Callable[[range], Iterable[int]] = iter
) -> MotionSegmenter | ClipRefiner:
    """Return a new segmenter for a recorded clip.

    :param shown: hands epochs on while it shows how many a network has been fitted for.
    :raises ParameterError: when a network, its weights or its device can't be had, or a class
        that was named can't be loaded.
    """
    refine = parameters.refine
    if refine.mode != "optimise":
        return motion_segmenter(parameters)
    require_torch("refine.mode optimise")
    from turbseg_ros.learning.clip_refinement import ClipRefiner

    by_rules = motion_segmenter(parameters.replace({"refine.mode": "none"}))
    return ClipRefiner(by_rules, refine.epochs, refine.grouping, shown)


def strategies(parameters: Parameters) -> Strategies:
    """Return the strategies that the parameters choose.

    :raises ParameterError: see `motion_segmenter`.
    """
    p = parameters
    return Strategies(
        flow=_chosen("flow.backend", p, _FLOWS),
        measure=_chosen("motion.measure", p, _MEASURES),
        similarity=_chosen("growing.similarity", p, _SIMILARITIES),
        # Only regions of one velocity can have a scale besides.
        expand=expanded
        if p.growing.expansion and p.growing.similarity == "velocity"
        else as_grown,
        outlines=_chosen("outline.method", p, _OUTLINES),
        tracker=_chosen("tracking.mode", p, _TRACKERS),
        regions=marked_regions(p.regions),
    )


def loaded_class(role: str, name: str) -> Callable[..., Any]:
    """Import what `package.module:Class` names.

    :param role: what it is to be, for messages.
    :raises ParameterError: when there is no such module or class.
    """
    module_name, _, class_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ParameterError(f"{role} is {name}: {error}; is its folder in PYTHONPATH?") from error
    found = getattr(module, class_name, None)
    if not callable(found):
        raise ParameterError(f"{role} is {name}: {module_name} has no class {class_name}")
    return found  # type: ignore[no-any-return]


def _chosen(parameter: str, parameters: Parameters, choices: Choices) -> Any:
    """Return the strategy that a parameter names: one of the choices, or a class of the user's."""
    name = str(parameters.as_mapping()[parameter])
    if ":" not in name:
        return choices[name](parameters)
    made = loaded_class(f"parameter {parameter}", name)
    try:
        return made(parameters)
    except TypeError as error:
        raise ParameterError(
            f"parameter {parameter} is {name}, which can't be made with the parameters: {error}"
        ) from error


def _slope(_: Parameters) -> SlopeAverage:
    return SlopeAverage()


def _mean(parameters: Parameters) -> MeanAverage:
    return MeanAverage(parameters.flow.interval, parameters.is_causal)


def _outlines_by_background(parameters: Parameters) -> OutlineMethod:
    refiner: Refiner | None = _chosen("refine.mode", parameters, _REFINERS)
    if refiner is None:
        return BackgroundDifference(parameters.outline.threshold)
    return RefinedDifference(refiner)


def _kalman_tracker(parameters: Parameters) -> KalmanTracker:
    tracking = parameters.tracking
    return KalmanTracker(
        min_hits=tracking.min_hits,
        false_alarms_per_hour=tracking.false_alarms_per_hour,
        max_age=tracking.max_age,
        slots=parameters.max_objects,
        every=parameters.flow.every,
    )


def _raft(parameters: Parameters) -> FlowBackend:
    return _raft_flow(parameters.flow.backend, parameters.flow.weights, parameters.device)


# Networks take long to load, and parameters may change while the node runs.
@functools.lru_cache(maxsize=1)
def _raft_flow(backend: str, weights: str, device: str) -> FlowBackend:
    require_torch(f"flow.backend {backend}")
    from turbseg_ros.learning.raft import RaftFlow

    return RaftFlow(backend, Path(weights) if weights else None, device)


def _pretrained_refiner(parameters: Parameters) -> Refiner:
    from turbseg_ros.learning.pretrained import SHIPPED, PretrainedRefiner

    weights = parameters.refine.weights
    if not weights:
        return PretrainedRefiner(SHIPPED)
    try:
        return PretrainedRefiner(Path(weights))
    except NetworkError as error:
        raise NetworkError(f"refine.weights {error}") from error


_AVERAGES: Choices = {"slope": _slope, "mean": _mean}
_FLOWS: Choices = {
    "dis": lambda p: DisFlow(p.threads, p.flow.variational_iterations),
    "raft_small": _raft,
    "raft_large": _raft,
}
_MEASURES: Choices = {
    "affine": lambda p: AffineMotion(_chosen("flow.average", p, _AVERAGES)),
    "sampson": lambda p: SampsonMotion(p.flow.interval, p.is_causal),
    "none": lambda p: UncheckedMotion(_chosen("flow.average", p, _AVERAGES)),
}
_SIMILARITIES: Choices = {
    "velocity": lambda p: similar_velocity,
    "magnitude": lambda p: similar_magnitude,
}
_OUTLINES: Choices = {"background": _outlines_by_background, "none": lambda p: GrownRegions()}
_REFINERS: Choices = {"pretrained": _pretrained_refiner, "none": lambda p: None}
_TRACKERS: Choices = {"kalman": _kalman_tracker, "kmeans": lambda p: KMeansIds(p.max_objects)}
