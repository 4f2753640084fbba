"""Outlines drawn from a network's judgement, by a stand-in that knows the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from support.drawn_scene import DrawnScene, Mask, jaccard
from support.segmenters import ObservingRefiner, segmenter_refined_by
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.cropped_mask import Box
from turbseg_ros.segmentation.foreground import AreaMasks, ObjectCrop
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.refinement import refined_masks

SCENE = DrawnScene()
FRAMES = [Frame(number, image) for number, image in enumerate(SCENE.images(20))]
PARAMETERS = Parameters.from_mapping({"resolution.processing": 160})


class Oracle(ObservingRefiner):
    """Judges every pixel by its part of a mask that belongs to the frame."""

    def __init__(self, masks: Sequence[Mask]) -> None:
        self._masks = masks
        self._mask = masks[0]
        self.asked: set[int] = set()

    def crops(self, stamp: int, crops: Sequence[ObjectCrop]) -> None:
        self._mask = self._masks[stamp]
        if crops:
            self.asked.add(stamp)

    def refine(self, crops: Sequence[ObjectCrop]) -> list[np.ndarray]:
        return [self._mask[crop.box.slices].astype(np.float32) for crop in crops]


def refined(masks: Sequence[Mask]) -> list[SegmentationResult]:
    segmenter = segmenter_refined_by(Oracle(masks), PARAMETERS)
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


def test_where_nothing_is_outlined_nothing_is_looked_for_until_motion_is_measured_again() -> None:
    blind = Oracle([np.zeros(SCENE.shape, bool)] * len(FRAMES))
    parameters = PARAMETERS.replace({"seed.standing_out": False})
    segmenter = segmenter_refined_by(blind, parameters)
    for frame in FRAMES:
        segmenter.push(frame)
    segmenter.flush()
    assert blind.asked == {0, 4, 8, 12, 16}


def test_the_outline_of_what_rests_stays_where_it_is_expected() -> None:
    shape = (40, 60)
    expected, nothing = np.zeros(shape, bool), np.zeros(shape, bool)
    expected[10:30, 20:40] = True
    window = ObjectCrop(
        box=Box(0, 0, 60, 40),
        image=np.zeros((*shape, 1), np.uint8),
        views=[],
        area=AreaMasks(expected, probable=nothing, certain=nothing, nearest=~nothing),
        motion=np.zeros(shape, np.float32),
        tilt=0.5,
    )
    wide = np.zeros(shape, np.float32)
    wide[5:35, 10:50] = 1.0
    (resting,) = refined_masks([window], [wide])
    assert resting.box == Box(20, 10, 40, 30)
    moving = replace(window, area=replace(window.area, probable=expected))
    (outline,) = refined_masks([moving], [wide])
    assert outline.box == Box(10, 5, 50, 35)
