"""Pictures that no camera should give: what comes out is defined, and the method recovers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.drawn_clip import PAPER, PARAMETERS, SHAPE, assert_sound, segmented, stamps
from support.drawn_scene import ByteImage, DrawnScene, jaccard, texture
from support.segmenters import segmenter_by_rules
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.resolution import Resolution

CAUSAL = PARAMETERS.replace({"latency.mode": "causal"})
SLOW = DrawnScene(velocity=(1, 0), start=(10, 36))
STILL = DrawnScene(velocity=None)
FRAMES, FAULT, LENGTH = 36, 20, 6


def noise(number: int) -> ByteImage:
    return np.random.default_rng(number).integers(0, 256, SHAPE).astype(np.uint8)


def another_scene(number: int) -> ByteImage:
    grain = np.random.default_rng(number).normal(0, 2, SHAPE)
    return np.clip(texture(SHAPE, seed=9) + grain, 0, 255).astype(np.uint8)


# What a frame becomes during a fault, from its number.
COVERS = {
    "lens cap": lambda number: np.random.default_rng(number).poisson(3, SHAPE).astype(np.uint8),
    "black": lambda number: np.zeros(SHAPE, np.uint8),
    "saturated": lambda number: np.full(SHAPE, 255, np.uint8),
    "noise": noise,
}


def during(
    images: Iterable[ByteImage], cover: Callable[[int], ByteImage], length: int
) -> list[ByteImage]:
    """Put other pictures in the place of some, from frame FAULT on."""
    end = FAULT + length
    return [cover(n) if FAULT <= n < end else image for n, image in enumerate(images)]


def scores(results: Sequence[SegmentationResult], scene: DrawnScene) -> list[float]:
    return [jaccard(r.labels > 0, scene.truth(n)) for n, r in enumerate(results)]


@pytest.mark.parametrize("length", [1, LENGTH])
@pytest.mark.parametrize("cover", COVERS.values(), ids=COVERS)
def test_a_covered_lens_shows_nothing_and_the_object_is_found_again_at_once(
    cover: Callable[[int], ByteImage], length: int
) -> None:
    results = segmented(during(SLOW.images(FRAMES), cover, length))
    assert_sound(results)
    blind, after = results[FAULT : FAULT + length], results[FAULT + length :]
    assert not any(result.labels.any() for result in blind)
    assert min(scores(results, SLOW)[FAULT + length :]) > 0.6
    known = {moving.id for result in results[:FAULT] for moving in result.objects}
    assert {moving.id for result in after for moving in result.objects} <= known


@pytest.mark.parametrize("cover", [*COVERS.values(), another_scene], ids=[*COVERS, "cut"])
def test_a_still_scene_has_no_objects_whatever_comes_between(
    cover: Callable[[int], ByteImage],
) -> None:
    results = segmented(during(STILL.images(FRAMES), cover, LENGTH))
    assert not any(result.labels.any() for result in results)


@pytest.mark.parametrize("old", [STILL, SLOW], ids=["still", "moving"])
def test_after_a_cut_what_moves_in_the_new_scene_is_found_at_once(old: DrawnScene) -> None:
    new = DrawnScene(velocity=(-2, 0), start=(120, 20))
    images = [*old.images(FAULT), *(255 - image for image in new.images(40))]
    results = segmented(images)
    assert stamps(results) == list(range(FAULT + 40))
    assert_sound(results)
    # The first frame of the new scene might still have been a fault.
    assert min(scores(results[FAULT:], new)[2:]) > 0.9
    before = {moving.id for result in results[:FAULT] for moving in result.objects}
    assert before.isdisjoint(m.id for result in results[FAULT:] for m in result.objects)


@pytest.mark.parametrize(
    "parameters", [PARAMETERS, CAUSAL, PAPER], ids=["live", "causal", "paper"]
)
def test_an_object_over_most_of_the_view_leaves_the_method_sound(parameters: Parameters) -> None:
    ground, body = texture(SHAPE, seed=1), texture((80, 128), seed=5, low=10, high=240)
    images = []
    for number in range(80):
        image = ground.copy()
        left, right = max(160 - 14 * number, 0), min(288 - 14 * number, 160)
        if left < right:
            offset = 160 - 14 * number
            image[8:88, left:right] = body[:, left - offset : right - offset]
        images.append(image)
    results = segmented(images, parameters)
    assert stamps(results) == list(range(80))
    assert_sound(results)
    if parameters.tracking.mode != "kmeans":
        # It has left the view at frame 21; what it hid is known again when the memory has passed.
        assert not any(result.labels.any() for result in results[-2:])


def spoilt(image: ByteImage, seed: int) -> np.ndarray:
    frame = image.astype(np.float32)
    rng = np.random.default_rng(seed)
    for bad in (3e38, -3e38, np.nan, np.inf, -np.inf, 1e-44):
        frame[rng.integers(0, SHAPE[0], 5), rng.integers(0, SHAPE[1], 5)] = bad
    return frame


def test_pixels_that_are_no_grey_values_do_not_hide_the_object() -> None:
    clip = [spoilt(image, n) for n, image in enumerate(DrawnScene().images(24))]
    results = segmented(clip)
    assert_sound(results)
    assert np.median(scores(results, DrawnScene())[8:]) > 0.6


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "parameters", [PARAMETERS, CAUSAL, PAPER], ids=["live", "causal", "paper"]
)
def test_any_bits_as_float_frames_give_sound_results(parameters: Parameters) -> None:
    rng = np.random.default_rng(0)
    clip = [rng.integers(0, 2**32, SHAPE, np.uint32).view(np.float32) for _ in range(12)]
    results = segmented(clip, parameters)
    assert stamps(results) == list(range(12))
    assert_sound(results)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (9, 17), (17, 9), (1, 300), (300, 1)], ids=str)
@pytest.mark.parametrize(
    "parameters", [PARAMETERS, CAUSAL, PAPER], ids=["live", "causal", "paper"]
)
def test_the_smallest_pictures_give_sound_results(
    shape: tuple[int, int], parameters: Parameters
) -> None:
    clip = [np.roll(texture((40, 400), seed=3), n, 1)[: shape[0], : shape[1]] for n in range(8)]
    if shape[0] > 40:
        clip = [
            np.roll(texture((400, 40), seed=3), n, 0)[: shape[0], : shape[1]] for n in range(8)
        ]
    results = segmented(clip, parameters)
    assert stamps(results) == list(range(8))
    assert_sound(results)


@settings(max_examples=300, deadline=None)
@given(
    width=st.integers(1, 100_000),
    height=st.integers(1, 100_000),
    processing=st.integers(64, 2000),
    detail=st.integers(64, 4000),
)
def test_no_shape_of_picture_costs_more_than_any_other(
    width: int, height: int, processing: int, detail: int
) -> None:
    resolution = Resolution.of((height, width), processing, detail)
    for wanted, size in ((processing, resolution.processing), (detail, resolution.detail)):
        assert min(size) >= 16
        assert size[0] * size[1] <= 1.05 * max(wanted * wanted * 9 / 16, 16 * 16) + 16 * max(size)


def test_the_65536th_object_gets_label_1_again_and_its_own_id() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    tracker: Any = segmenter._strategies.tracker
    tracker._next_id = 65_535
    results: list[SegmentationResult] = []
    for part in range(2):
        for number, image in enumerate(DrawnScene().images(20)):
            results += segmenter.push(Frame(100 * part + number, image))
        results += segmenter.flush()
        segmenter.reset()
    labels = {
        moving.id: set(np.unique(result.labels)) - {0}
        for result in results
        for moving in result.objects
    }
    assert labels == {65_535: {65_535}, 65_536: {1}}
    late = next(moving for result in results for moving in result.objects if moving.id == 65_536)
    assert late.label == 1


# What the brightness of a frame is multiplied with, from its number.
LIGHTS = {
    "a step": lambda number: 1.3 if number >= FAULT else 1.0,
    "flicker": lambda number: 0.8 if number % 2 else 1.0,
    "dusk": lambda number: 1.0 - 0.015 * number,
}


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS)
def test_a_change_of_exposure_hides_nothing_and_shows_nothing(
    light: Callable[[int], float],
) -> None:
    def lit(scene: DrawnScene) -> list[ByteImage]:
        images = scene.images(FRAMES)
        return [np.clip(i * light(n), 0, 255).astype(np.uint8) for n, i in enumerate(images)]

    found = scores(segmented(lit(SLOW)), SLOW)
    usual = scores(segmented(list(SLOW.images(FRAMES))), SLOW)
    assert np.mean(found) > np.mean(usual) - 0.05
    assert not any(result.labels.any() for result in segmented(lit(STILL)))


# What blue, green and red are multiplied with, from a frame's number.
WHITE_BALANCES = {
    "a step": lambda number: (0.75, 1.0, 1.25) if number >= FAULT else (1.0, 1.0, 1.0),
    "a drift": lambda number: (1.0 - 0.008 * number, 1.0, 1.0 + 0.008 * number),
    "one channel": lambda number: (0.6, 1.0, 1.0) if number >= FAULT else (1.0, 1.0, 1.0),
}


@pytest.mark.parametrize("balance", WHITE_BALANCES.values(), ids=WHITE_BALANCES)
def test_a_change_of_the_white_balance_hides_nothing_and_shows_nothing(
    balance: Callable[[int], tuple[float, ...]],
) -> None:
    tint = np.stack([texture(SHAPE, seed=20 + channel) for channel in range(3)], axis=-1) / 200.0

    def balanced(scene: DrawnScene, used: Callable[[int], tuple[float, ...]]) -> list[np.ndarray]:
        return [
            np.clip(image[..., None] * tint * np.array(used(number)), 0, 255).astype(np.uint8)
            for number, image in enumerate(scene.images(FRAMES))
        ]

    found = scores(segmented(balanced(SLOW, balance)), SLOW)
    usual = scores(segmented(balanced(SLOW, lambda _: (1.0, 1.0, 1.0))), SLOW)
    assert np.mean(found) > np.mean(usual) - 0.03
    assert not any(result.labels.any() for result in segmented(balanced(STILL, balance)))
