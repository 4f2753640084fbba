"""Puts the method together as its parameters say: node, replay and evaluation all ask here.

Networks are imported only when they are chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from turbseg_ros.learning.torch_import import require_torch
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.flow import FlowBackend
from turbseg_ros.segmentation.pipeline import MotionSegmenter
from turbseg_ros.segmentation.refinement import Refiner

if TYPE_CHECKING:
    from turbseg_ros.learning.clip_refinement import ClipRefiner


def motion_segmenter(parameters: Parameters) -> MotionSegmenter:
    """Return a new segmenter, with the networks that the parameters choose.

    Its own threads fill the cores: OpenCV's, which would only wait for them, are turned off.

    :raises ParameterError: when a network, its weights or its device can't be had, or one was
        chosen that is fitted to whole clips.
    """
    if parameters.refine.mode == "optimise":
        raise ParameterError(
            "parameter refine.mode is optimise, which needs the whole clip before it answers; "
            "set -p refine.mode:=pretrained, or segment a recorded bag with turbseg_replay"
        )
    cv2.setNumThreads(1)
    return MotionSegmenter(parameters, refiner(parameters), flow_backend(parameters))


def clip_segmenter(
    parameters: Parameters, shown: Callable[[range], Iterable[int]] = iter
) -> MotionSegmenter | ClipRefiner:
    """Return a new segmenter for a recorded clip.

    :param shown: hands epochs on while it shows how many a network has been fitted for.
    :raises ParameterError: when a network, its weights or its device can't be had.
    """
    refine = parameters.refine
    if refine.mode != "optimise":
        return motion_segmenter(parameters)
    require_torch("refine.mode optimise")
    from turbseg_ros.learning.clip_refinement import ClipRefiner

    segmenter = MotionSegmenter(parameters, flow=flow_backend(parameters))
    return ClipRefiner(segmenter, refine.epochs, refine.grouping, shown)


def refiner(parameters: Parameters) -> Refiner | None:
    """Return what draws the outlines of a live stream; None for the rules."""
    if parameters.refine.mode == "none":
        return None
    from turbseg_ros.learning.pretrained import PretrainedRefiner

    return PretrainedRefiner()


def flow_backend(parameters: Parameters) -> FlowBackend | None:
    """Return what computes optical flow; None for DIS.

    :raises ParameterError: when the network, its weights or its device can't be had.
    """
    chosen = parameters.flow.backend
    if chosen == "dis":
        return None
    require_torch(f"flow.backend {chosen}")
    from turbseg_ros.learning.raft import RaftFlow

    weights = Path(parameters.flow.weights) if parameters.flow.weights else None
    return RaftFlow(chosen, weights, parameters.device)
