"""Segmenters put together as a test wants them."""

from __future__ import annotations

import dataclasses

from turbseg_ros.factory import motion_segmenter, strategies
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.outliner import RefinedDifference
from turbseg_ros.segmentation.refinement import Refiner


def segmenter_by_rules(parameters: Parameters) -> MotionSegmenter:
    """Return the method with outlines drawn by rules, whatever the parameters say of networks."""
    return motion_segmenter(parameters.replace({"refine.mode": "none"}))


class ObservingRefiner(Refiner, StageObserver):
    """A refiner that is told, as an observer, of which frame the crops are."""


def segmenter_refined_by(refiner: ObservingRefiner, parameters: Parameters) -> MotionSegmenter:
    """Return the method with a refiner of the test's own."""
    by_rules = parameters.replace({"refine.mode": "none"})
    outlines = RefinedDifference(refiner)
    return MotionSegmenter(
        by_rules, lambda p: dataclasses.replace(strategies(p), outlines=outlines), refiner
    )
