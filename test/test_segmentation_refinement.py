"""Outlines drawn from a network's judgement, by a stand-in that knows the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from drawn_scene import DrawnScene, Mask, jaccard

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.pipeline import MotionSegmenter
from turbseg_ros.segmentation.silhouette import ObjectWindow

SCENE = DrawnScene()
FRAMES = [Frame(number, image) for number, image in enumerate(SCENE.images(20))]
PARAMETERS = Parameters.from_mapping({"resolution.processing": 160})


class Oracle:
    """Judges every pixel by its part of a mask that belongs to the frame."""

    def __init__(self, masks: Sequence[Mask]) -> None:
        self._masks = masks

    def refine(self, windows: Sequence[ObjectWindow]) -> list[np.ndarray]:
        return [self._masks[w.stamp][w.box.slices].astype(np.float32) for w in windows]


def refined(masks: Sequence[Mask]) -> list[SegmentationResult]:
    segmenter = MotionSegmenter(PARAMETERS, Oracle(masks))
    return [result for frame in FRAMES for result in segmenter.push(frame)] + segmenter.flush()


def test_objects_are_outlined_as_the_refiner_judges() -> None:
    truth = [SCENE.truth(number) for number in range(len(FRAMES))]
    results = refined(truth)
    assert [result.frame.stamp for result in results] == list(range(len(FRAMES)))
    for result, mask in zip(results[4:], truth[4:], strict=True):
        assert len(result.objects) == 1
        assert jaccard(result.labels > 0, mask) > 0.9


def test_nothing_is_found_where_the_refiner_sees_only_background() -> None:
    results = refined([np.zeros(SCENE.shape, bool)] * len(FRAMES))
    assert len(results) == len(FRAMES)
    assert not any(result.objects for result in results)
