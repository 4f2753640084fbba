"""What marked regions mean for seeds, detections and what is reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.drawn_clip import CLIP, PARAMETERS, SCENE, assert_sound, frames, ids
from support.drawn_scene import jaccard, rectangle
from turbseg_ros.factory import strategies
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.frame import SegmentationResult, segment
from turbseg_ros.segmentation.marked_regions import (
    FittedRegions,
    Limits,
    MarkedRegion,
    MarkedRegions,
    MaskPicture,
    Polygon,
)
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.strategies import Strategies
from turbseg_ros.segmentation.track import Detection

SHAPE = (96, 160)
NO_LIMITS = Limits()
RESOLUTION = Resolution((160, 96), (160, 96), (160, 96))


def fitted(*regions: MarkedRegion) -> FittedRegions:
    return MarkedRegions(regions).fitted(RESOLUTION)


def marked(
    mask: np.ndarray, *, ignored: bool = True, limits: Limits = NO_LIMITS, name: str = "a"
) -> MarkedRegion:
    return MarkedRegion(name, ignored, MaskPicture(mask), limits, "marks")


def detection(x: int, y: int, side: int = 20) -> Detection:
    outline = CroppedMask.of(rectangle(x, y, x + side, y + side, SHAPE))
    return Detection(outline.box, outline.mask, (1.0, 0.0), moving=True)


LEFT = rectangle(0, 0, 60, 96, SHAPE)


@given(
    box=st.tuples(*[st.floats(0.0, 0.4)] * 2, *[st.floats(0.6, 1.0)] * 2),
    size=st.tuples(st.integers(20, 300), st.integers(20, 300)),
)
def test_a_polygon_marks_the_same_part_of_a_picture_of_any_size(
    box: tuple[float, ...], size: tuple[int, int]
) -> None:
    x0, y0, x1, y1 = box
    polygon = Polygon(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
    mask = polygon.mask(size)
    sides = (x1 - x0) * size[0], (y1 - y0) * size[1]
    # A pixel on the border counts, at most one more on each side.
    for side, found in zip(sides, (mask.any(axis=0).sum(), mask.any(axis=1).sum()), strict=True):
        assert side - 1.5 <= found <= side + 2.5


def test_a_sliver_at_the_border_marks_the_pixels_there() -> None:
    sliver = Polygon(np.array([[1.0, 0.0], [1.0, 1.0], [0.9999999, 0.5]]))
    for size in ((1, 1), (16, 9), (9, 16)):
        mask = sliver.mask(size)
        assert mask[:, -1].any()
        assert not mask[:, :-1].any()


def test_where_nothing_is_included_all_is_looked_at_but_what_is_ignored() -> None:
    np.testing.assert_array_equal(fitted(marked(LEFT)).ignored((160, 96)), LEFT)
    assert not fitted().ignored((160, 96)).any()


def test_what_is_included_is_looked_at_alone_and_ignored_regions_win() -> None:
    middle = rectangle(40, 0, 100, 96, SHAPE)
    right = rectangle(90, 0, 160, 96, SHAPE)
    regions = fitted(marked(middle, ignored=False), marked(right, ignored=False), marked(LEFT))
    np.testing.assert_array_equal(regions.ignored((160, 96)), LEFT | ~(middle | right))


def test_a_picture_of_the_same_proportions_is_scaled() -> None:
    half = rectangle(0, 0, 30, 48, (48, 80))
    np.testing.assert_array_equal(fitted(marked(half)).ignored((160, 96)), LEFT)


@pytest.mark.parametrize("shape", [(96, 150), (160, 96), (1, 1)])
def test_a_picture_of_other_proportions_is_refused_in_one_line(shape: tuple[int, int]) -> None:
    with pytest.raises(ParameterError) as caught:
        fitted(marked(np.eye(*shape, dtype=bool)))
    said = f"marks: {shape[1]}x{shape[0]} pixels, which images of 160x96 can't be, scaled or not"
    assert str(caught.value) == said


def test_regions_that_leave_nothing_are_refused() -> None:
    with pytest.raises(ParameterError, match="marks: nothing of the picture is left to look at"):
        fitted(marked(LEFT), marked(LEFT, ignored=False))


def test_seeds_are_found_in_no_ignored_pixel_but_on_a_known_object() -> None:
    noise = np.ones(SHAPE, np.float32)
    objects = np.zeros((24, 40), bool)
    objects[10, 5] = True
    left = fitted(marked(LEFT)).without_seeds(noise, objects)
    expected = LEFT & ~rectangle(20, 40, 24, 44, SHAPE)
    np.testing.assert_array_equal(np.isinf(left), expected)
    assert fitted().without_seeds(noise, objects) is noise


def test_a_detection_that_mostly_is_ignored_is_none_unless_it_is_known() -> None:
    inside, mostly, hardly = detection(10, 10), detection(49, 40), detection(51, 70)
    regions, everything = fitted(marked(LEFT)), [inside, mostly, hardly]
    assert regions.looked_at(everything, []) == [hardly]
    assert regions.looked_at(everything, [detection(12, 12)]) == [inside, hardly]
    assert fitted().looked_at(everything, []) == everything


def test_what_mostly_is_ignored_is_not_reported_and_the_rest_without_ignored_pixels() -> None:
    regions = fitted(marked(LEFT))
    assert regions.reported(detection(49, 40).outline, None) is None
    seen = regions.reported(detection(51, 40).outline, None)
    assert seen is not None
    whole = rectangle(51, 40, 71, 60, SHAPE)
    np.testing.assert_array_equal(seen.in_frame(SHAPE), whole & ~LEFT)


@pytest.mark.parametrize(
    ("limits", "speed", "reported"),
    [
        (Limits(min_size=20), None, True),
        (Limits(min_size=21), None, False),
        (Limits(max_size=20), None, True),
        (Limits(max_size=19), None, False),
        (Limits(min_speed=5), 5.0, True),
        (Limits(min_speed=5), 4.9, False),
        # Nobody knows how fast it is.
        (Limits(min_speed=5), None, True),
    ],
)
def test_limits_hold_for_what_mostly_lies_in_their_region(
    limits: Limits, speed: float | None, reported: bool
) -> None:
    everywhere = marked(np.ones(SHAPE, bool), ignored=False)
    regions = fitted(everywhere, marked(LEFT, ignored=False, limits=limits))
    assert (regions.reported(detection(10, 10).outline, speed) is not None) == reported
    assert regions.reported(detection(100, 10).outline, speed) is not None


def test_limits_are_in_pixels_of_the_picture_that_was_marked() -> None:
    half = marked(np.ones((48, 80), bool), ignored=False, limits=Limits(min_size=11))
    assert fitted(half).reported(detection(10, 10, side=20).outline, None) is None
    assert fitted(half).reported(detection(10, 10, side=22).outline, None) is not None


# --- The whole method ---------------------------------------------------------------------------


def segmented(*regions: MarkedRegion, period: float | None = None) -> list[SegmentationResult]:
    def made(parameters: Parameters) -> Strategies:
        return replace(strategies(parameters), regions=MarkedRegions(regions))

    with MotionSegmenter(PARAMETERS.replace({"refine.mode": "none"}), made) as segmenter:
        clip = [replace(frame, period=period) for frame in frames(CLIP)]
        return list(segment(clip, segmenter))


def test_an_object_in_an_ignored_region_is_none() -> None:
    results = segmented(marked(rectangle(0, 20, 160, 80, SHAPE)))
    assert [result.frame.stamp for result in results] == list(range(len(CLIP)))
    assert ids(results) == set()
    assert not any(result.labels.any() for result in results)


def test_an_ignored_region_elsewhere_changes_nothing() -> None:
    for one, other in zip(
        segmented(), segmented(marked(rectangle(0, 80, 160, 96, SHAPE))), strict=True
    ):
        np.testing.assert_array_equal(one.labels, other.labels)


def test_an_object_that_passes_an_ignored_region_keeps_its_id_and_is_not_reported_there() -> None:
    pole = rectangle(60, 0, 95, 96, SHAPE)
    results = segmented(marked(pole))
    assert_sound(results)
    assert ids(results) == {1}
    shares = [(SCENE.truth(k) & pole).sum() / SCENE.truth(k).sum() for k in range(len(CLIP))]
    assert any(share > 0.9 for share in shares)
    for result, share in zip(results, shares, strict=True):
        assert not result.labels[pole].any()
        if abs(share - 0.5) > 0.2:
            assert bool(result.objects) == (share < 0.5)
    after = [
        jaccard(result.labels > 0, SCENE.truth(k) & ~pole)
        for k, (result, share) in enumerate(zip(results, shares, strict=True))
        if share < 0.3
    ]
    assert np.mean(after) > 0.7


def test_a_mask_of_other_proportions_fails_with_the_first_frame() -> None:
    with pytest.raises(ParameterError, match="10x10 pixels, which images of 160x96 can't be"):
        segmented(marked(np.eye(10, dtype=bool)))


@pytest.mark.parametrize(("min_speed", "found"), [(20.0, True), (45.0, False)])
def test_speed_limits_are_in_pixels_a_second(min_speed: float, found: bool) -> None:
    # It moves by three pixels a frame, at ten frames a second.
    limits = Limits(min_speed=min_speed)
    everywhere = marked(np.ones(SHAPE, bool), ignored=False, limits=limits)
    results = segmented(everywhere, period=0.1)
    assert (ids(results) == {1}) == found
