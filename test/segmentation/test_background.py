"""The scene without its objects, from views whose content is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.drawn_scene import ByteImage, Mask, scene_behind, texture
from turbseg_ros.segmentation.background import (
    AlignedFrame,
    Background,
    background_in,
    calm_background_in,
    cut_out,
    deviation_from,
    difference_from,
)
from turbseg_ros.segmentation.cropped_mask import Box
from turbseg_ros.segmentation.exposure import Exposure

SHAPE = (60, 90)
GROUND = texture(SHAPE, seed=8, grain=2.0)[..., None]
WHOLE = Box(0, 0, SHAPE[1], SHAPE[0])
EMPTY_MASK = np.zeros(SHAPE, bool)


def view(
    image: ByteImage, objects: Mask = EMPTY_MASK, shift: tuple[int, int] = (0, 0)
) -> AlignedFrame:
    to_image = np.eye(3)
    to_image[:2, 2] = shift
    return AlignedFrame(scene_behind(image, objects), to_image)


def noisy_views(count: int, sigma: float, ground: ByteImage = GROUND) -> list[AlignedFrame]:
    random = np.random.default_rng(0)
    return [
        view(np.clip(np.rint(ground + random.normal(0, sigma, ground.shape)), 0, 255).astype("u1"))
        for _ in range(count)
    ]


def test_a_box_is_the_smallest_around_a_mask() -> None:
    mask = np.zeros((20, 30), bool)
    mask[4, 7] = mask[11, 18] = True
    box = Box.around(mask)
    assert box == Box(7, 4, 19, 12)
    assert box.shape == (8, 12)
    assert mask[box.slices].sum() == 2


def test_a_box_grows_up_to_the_picture() -> None:
    assert Box(7, 4, 19, 12).padded(5, (15, 100)) == Box(2, 0, 24, 15)


@pytest.mark.parametrize(("side", "most"), [(96, 0.1), (24, 2.0), (9, 4.0)])
def test_a_background_seen_from_further_is_an_average_of_what_was_there(
    side: int, most: float
) -> None:
    ground = cv2.GaussianBlur(np.random.default_rng(0).normal(120, 60, (96, 96)), (0, 0), 3.0)
    views = [view(ground[..., None].astype(np.uint8), np.zeros((96, 96), bool))] * 5
    far = background_in(Box(0, 0, 96, 96), views, (side, side))
    expected = cv2.resize(ground, (side, side), interpolation=cv2.INTER_AREA)
    assert far.median.shape == (side, side, 1)
    assert far.known.all()
    assert np.abs(far.median[..., 0] - np.floor(expected)).mean() < most


def test_views_of_another_exposure_are_brought_to_that_of_the_frame() -> None:
    dark = AlignedFrame(scene_behind(GROUND // 2, EMPTY_MASK), np.eye(3), Exposure(2.0, 1.0))
    median = background_in(WHOLE, [dark] * 5).median
    assert np.abs(median - GROUND).max() <= 1


@pytest.mark.parametrize("channels", [1, 3])
def test_objects_that_are_masked_leave_no_trace(channels: int) -> None:
    ground = np.repeat(GROUND, channels, axis=2)
    views = []
    for x in range(0, 60, 6):
        image, objects = ground.copy(), EMPTY_MASK.copy()
        # A big object that hides the middle in most of the views.
        place = (slice(20, 40), slice(x, x + 30))
        image[place], objects[place] = 255, True
        views.append(view(image, objects))
    background = background_in(WHOLE, views)
    assert background.known.all()
    np.testing.assert_array_equal(background.median, ground)
    assert not background.spread.any()


def test_objects_that_nobody_masked_are_outvoted() -> None:
    views = []
    for x in range(0, 60, 6):
        image = GROUND.copy()
        image[20:40, x : x + 12] = 255
        views.append(view(image))
    np.testing.assert_array_equal(background_in(WHOLE, views).median, GROUND)


@settings(max_examples=40, deadline=None)
@given(
    pictures=hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.just(3), st.just(4))),
    data=st.data(),
)
def test_the_median_is_that_of_the_samples_without_objects(
    pictures: np.ndarray, data: st.DataObject
) -> None:
    objects = data.draw(hnp.arrays(np.bool_, pictures.shape))
    views = [
        AlignedFrame(scene_behind(picture[..., None], hidden), np.eye(3))
        for picture, hidden in zip(pictures, objects, strict=True)
    ]
    background = background_in(Box(0, 0, 4, 3), views)
    for y, x in np.ndindex(3, 4):
        samples = np.sort(pictures[~objects[:, y, x], y, x])
        count = len(samples)
        assert background.known[y, x] == (count >= 3)
        if count:
            middle = samples[(count - 1) // 2], samples[count // 2]
            assert background.median[y, x, 0] in middle


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("width", [5, 16, 33])
def test_quartiles_are_those_of_what_is_seen_of_each_pixel(width: int, channels: int) -> None:
    random = np.random.default_rng(width)
    pictures = random.integers(0, 256, (13, 7, width, channels), np.uint8)
    objects = random.random(pictures.shape[:3]) < 0.4
    views = [
        AlignedFrame(scene_behind(picture, hidden), np.eye(3))
        for picture, hidden in zip(pictures, objects, strict=True)
    ]
    background = background_in(Box(0, 0, width, 7), views)
    for y, x in np.ndindex(7, width):
        samples = np.sort(pictures[~objects[:, y, x], y, x], axis=0).astype(np.float32)
        assert background.known[y, x] == (len(samples) >= 3)
        if background.known[y, x]:
            last = len(samples) - 1
            lower, median, upper = (samples[(last * q + 2) // 4] for q in (1, 2, 3))
            np.testing.assert_array_equal(background.median[y, x], median)
            np.testing.assert_allclose(background.spread[y, x], (upper - lower) / 1.349, rtol=1e-6)


def test_spread_is_the_standard_deviation_of_noise() -> None:
    plain = np.full((*SHAPE, 1), 128, np.uint8)
    background = background_in(WHOLE, noisy_views(40, 6.0, plain))
    assert background.spread.mean() == pytest.approx(6.0, rel=0.1)


def test_the_calmer_side_tells_the_spread_where_cars_pass() -> None:
    views = noisy_views(40, 2.0)
    for bright in views[::3]:
        bright.scene.image[..., 0] = 255
    calm, spread = (
        float(np.median(made(WHOLE, views).spread)) for made in (calm_background_in, background_in)
    )
    assert 1.0 < calm < 4.0
    assert spread > 10.0


def test_views_are_aligned_by_where_they_look() -> None:
    shifts = [(0, 0), (5, -2), (-7, 3), (4, 4), (-3, -5)]
    views = [
        view(
            cv2.warpAffine(GROUND, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), (90, 60))[..., None],
            shift=(x, y),
        )
        for x, y in shifts
    ]
    box = Box(20, 15, 70, 45)
    background = background_in(box, views)
    assert background.known.all()
    np.testing.assert_array_equal(background.median, GROUND[box.slices])


def test_what_lies_out_of_a_view_is_no_sample() -> None:
    beyond = [view(GROUND, shift=(40, 0))] * 5
    known = background_in(WHOLE, beyond).known
    assert known[:, :50].all()
    assert not known[:, 50:].any()


def flat_background(shape: tuple[int, int], grey: float, spread: float) -> Background:
    return Background(
        median=np.full((*shape, 1), grey, np.float32),
        spread=np.full((*shape, 1), spread, np.float32),
        known=np.ones(shape, bool),
    )


def test_difference_is_that_of_the_channel_that_differs_most() -> None:
    background = background_in(
        Box(0, 0, 2, 1),
        [
            AlignedFrame(
                scene_behind(np.full((1, 2, 3), 100, np.uint8), np.zeros((1, 2), bool)),
                np.eye(3),
            )
        ]
        * 3,
    )
    image = np.array([[[100, 100, 100], [110, 70, 105]]], np.uint8)
    assert difference_from(background, image).tolist() == [[0, 30]]


def test_deviation_is_the_difference_in_units_of_the_noise() -> None:
    image = np.full((20, 30, 1), 130, np.uint8)
    deviation = deviation_from(flat_background((20, 30), 100.0, 5.0), image, tilt=1.0)
    np.testing.assert_allclose(deviation, 6.0, rtol=1e-4)


def test_grey_values_without_noise_may_differ_a_little() -> None:
    image = np.full((20, 30, 1), 101, np.uint8)
    assert deviation_from(flat_background((20, 30), 100.0, 0.0), image, tilt=0.0).max() < 1.0


def test_shimmer_excuses_edges_and_nothing_else() -> None:
    step = np.full((40, 60, 1), 50.0, np.float32)
    step[:, 30:] = 150.0
    background = Background(step, np.full_like(step, 2.0), np.ones((40, 60), bool))
    # The edge seen a pixel off, and a plain part that differs as much.
    image = step.astype(np.uint8)
    image[:, 30] = 50
    image[10:20, 10:20] = 150
    calm, turbulent = (deviation_from(background, image, tilt) for tilt in (0.0, 1.5))
    assert turbulent[:, 30].max() < 0.25 * calm[:, 30].max()
    assert turbulent[:, 30].max() < 4.0
    np.testing.assert_allclose(turbulent[12:18, 12:18], 50.0, rtol=1e-3)


def test_a_still_scene_deviates_as_noise_does() -> None:
    views = noisy_views(30, 4.0)
    background = background_in(WHOLE, views)
    deviation = deviation_from(background, views[3].scene.image[..., :-1], tilt=0.1)
    assert np.mean(deviation > 3.0) < 0.01


@pytest.mark.parametrize("shape", [(61, 91), (243, 433), (1, 5)], ids=str)
def test_pictures_of_odd_sizes_are_halved_in_place(shape: tuple[int, int]) -> None:
    across = np.broadcast_to(np.arange(shape[1]) / 2, shape)
    down = np.broadcast_to(np.arange(shape[0])[:, None] / 2, shape)
    ramps = np.stack([across, down, across], axis=-1).astype(np.uint8)
    halved = scene_behind(ramps, np.zeros(shape, bool)).half.image
    rows, columns = -(-shape[0] // 2), -(-shape[1] // 2)
    assert halved.shape[:2] == (rows, columns)
    # A pixel lies between two, at twice its number and a half; greys are cut off to whole ones.
    np.testing.assert_allclose(halved[..., 0], np.arange(columns)[None].repeat(rows, 0), atol=1)
    np.testing.assert_allclose(halved[..., 1], np.arange(rows)[:, None].repeat(columns, 1), atol=1)


def test_a_picture_is_sampled_where_it_is_at_every_size() -> None:
    # The last but one row of a picture that halves to an odd number of rows.
    shape = (246, 300)
    ground = np.zeros((*shape, 1), np.uint8)
    ground[240:] = 200
    whole = Box(0, 0, shape[1], shape[0])
    for ratio in (2, 3, 4, 6):
        small = (shape[0] // ratio, shape[1] // ratio)
        (seen,) = cut_out([view(ground, np.zeros(shape, bool))], whole, small)
        column = seen.image[:, 5, 0].astype(float)
        below = column[: small[0] - 1].sum() + 200.0
        assert below == pytest.approx(200.0 * 6 / ratio, abs=60.0)
