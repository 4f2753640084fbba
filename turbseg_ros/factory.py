"""Puts the method together as its parameters say: node, replay and evaluation all ask here.

Networks are imported only when they are chosen.
"""

from __future__ import annotations

from pathlib import Path

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.flow import FlowBackend
from turbseg_ros.segmentation.pipeline import MotionSegmenter


def motion_segmenter(parameters: Parameters) -> MotionSegmenter:
    """Give a new segmenter, with the networks that the parameters choose.

    :raises ParameterError: when a network, its weights or its device can't be had.
    """
    return MotionSegmenter(parameters, flow=_flow(parameters))


def _flow(parameters: Parameters) -> FlowBackend | None:
    chosen = parameters.flow.backend
    if chosen == "dis":
        return None
    from turbseg_ros.learning.torch_import import require_torch

    require_torch(f"flow.backend {chosen}")
    from turbseg_ros.learning.raft import RaftFlow

    weights = Path(parameters.flow.weights) if parameters.flow.weights else None
    return RaftFlow(chosen, weights, parameters.device)
