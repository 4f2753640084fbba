"""The parts of the method that can be exchanged, chosen in `turbseg_ros.factory`."""

from __future__ import annotations

from dataclasses import dataclass

from turbseg_ros.segmentation.expansion import Expand
from turbseg_ros.segmentation.flow import FlowBackend
from turbseg_ros.segmentation.marked_regions import MarkedRegions
from turbseg_ros.segmentation.motion import MotionMeasure
from turbseg_ros.segmentation.outliner import OutlineMethod
from turbseg_ros.segmentation.region_growing import Similarity
from turbseg_ros.segmentation.track import Tracker


@dataclass(frozen=True)
class Strategies:
    """What computes flow, measures motion, grows regions, draws outlines and keeps ids.

    `regions` is where in the picture that is done.
    """

    flow: FlowBackend
    measure: MotionMeasure
    similarity: Similarity
    expand: Expand
    outlines: OutlineMethod
    tracker: Tracker
    regions: MarkedRegions
