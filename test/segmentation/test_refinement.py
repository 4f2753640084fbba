"""Outlines drawn from a network's judgement, by a stand-in that knows the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from support.drawn_motion import drawn_motion
from support.drawn_scene import DrawnScene, Mask, jaccard, rectangle
from support.segmenters import ObservingRefiner, segmenter_refined_by
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import AlignedFrame, unmasked
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, Box, CroppedMask
from turbseg_ros.segmentation.foreground import AreaMasks, ObjectCrop, Surroundings
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.refinement import refined_masks, whole_crops

SCENE = DrawnScene()
FRAMES = [Frame(number, image) for number, image in enumerate(SCENE.images(20))]
# What is followed has an outline of its own, whatever the network judges.
PARAMETERS = Parameters.from_mapping({"resolution.processing": 160, "seed.small_targets": False})
# Of frames that are painted here, not drawn.
SHAPE = (120, 160)


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


class Painted:
    """Takes the pixels of a mask for an object; remembers the boxes that it was asked about."""

    def __init__(self, mask: Mask) -> None:
        self._mask = mask
        self.asked: list[Box] = []

    def refine(self, crops: Sequence[ObjectCrop]) -> list[np.ndarray]:
        self.asked += [crop.box for crop in crops]
        return [self._mask[crop.box.slices].astype(np.float32) for crop in crops]


def surroundings_of(*areas: Mask) -> Surroundings:
    """Return what is known of a frame in some parts of which something moves."""
    shape = areas[0].shape
    scene = np.zeros((*shape, 1), np.uint8)
    still = drawn_motion(np.zeros((*shape, 2)), noise=1.0, tilt=0.5)
    outlines = [CroppedMask.of(area) for area in areas]
    moving = [MovingArea(each, each, EMPTY_MASK, (0.0, 0.0)) for each in outlines]
    return Surroundings(scene, moving, [AlignedFrame(unmasked(scene), np.eye(3))], still, 0.5)


def test_a_crop_that_cuts_an_object_is_looked_at_with_room_around_it() -> None:
    whole = 60, 30, 100, 90
    # Flow shows the lower half.
    lower = rectangle(60, 60, 100, 90, shape=SHAPE)
    painted = Painted(rectangle(*whole, shape=SHAPE))
    crops, probabilities = whole_crops(surroundings_of(lower), painted)
    (outline,) = refined_masks(crops, probabilities)
    assert outline.box == Box(*whole)
    first, second = painted.asked
    # On the side that cuts it alone.
    assert second == replace(first, y0=second.y0)
    assert second.y0 < whole[1]


def test_a_crop_that_cuts_nothing_is_looked_at_once() -> None:
    whole = 60, 60, 100, 90
    painted = Painted(rectangle(*whole, shape=SHAPE))
    crops, _ = whole_crops(surroundings_of(rectangle(*whole, shape=SHAPE)), painted)
    assert painted.asked == [crop.box for crop in crops]


def test_what_the_picture_ends_with_has_no_room() -> None:
    whole = 130, 60, 160, 90
    painted = Painted(rectangle(*whole, shape=SHAPE))
    whole_crops(surroundings_of(rectangle(*whole, shape=SHAPE)), painted)
    assert len(painted.asked) == 1


def test_a_wider_crop_leaves_another_areas_object_to_that_ones_crop() -> None:
    mine, other = (20, 40, 60, 90), (90, 40, 130, 90)
    areas = rectangle(20, 60, 60, 90, shape=SHAPE), rectangle(90, 60, 130, 90, shape=SHAPE)
    painted = Painted(rectangle(*mine, shape=SHAPE) | rectangle(*other, shape=SHAPE))
    outlines = refined_masks(*whole_crops(surroundings_of(*areas), painted))
    found = sorted((outline.box for outline in outlines), key=lambda box: box.x0)
    assert found == [Box(*mine), Box(*other)]
