"""What stands out from a drawn scene's past, and what is explained away."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from support.drawn_scene import ByteImage, Mask, scene_behind, texture
from turbseg_ros.arrays import Matrix
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import AlignedFrame
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.standing_out import Past, past_in, standing_areas

SHAPE = (240, 320)
SIZE = (320, 240)
CAR = (slice(100, 130), slice(140, 190))
NOTHING = np.zeros(SHAPE, bool)


def road(start: int = 0) -> ByteImage:
    """A plain ground with a strip of texture across its upper part, HxWx3.

    :param start: the first column that is seen.
    """
    grey = np.full(SHAPE, 120, np.uint8)
    grey[:60] = texture((60, SHAPE[1] + 20), seed=3, grain=3.0)[:, start : start + SHAPE[1]]
    return cv2.merge([grey] * 3)


def noisy(image: ByteImage, seed: int) -> ByteImage:
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def with_car(image: ByteImage, where: tuple[slice, slice] = CAR, value: int = 60) -> ByteImage:
    seen = image.copy()
    seen[where] = value
    return seen


def seen_as(image: ByteImage, to_image: Matrix | None = None) -> AlignedFrame:
    return AlignedFrame(scene_behind(image, NOTHING), np.eye(3) if to_image is None else to_image)


def past(images: list[ByteImage]) -> Past:
    found = past_in([seen_as(image) for image in images], SIZE, tilt=0.2)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def empty_past() -> Past:
    return past([noisy(road(), seed) for seed in range(9)])


def standing(image: ByteImage, before: Past, looked_at: Mask = NOTHING) -> list[MovingArea]:
    return standing_areas(scene_behind(noisy(image, 99), NOTHING), before, looked_at)


def test_an_empty_scene_stands_out_nowhere(empty_past: Past) -> None:
    assert standing(road(), empty_past) == []


@pytest.mark.parametrize("value", [40, 150])
def test_what_was_not_there_stands_out(empty_past: Past, value: int) -> None:
    (area,) = standing(with_car(road(), value=value), empty_past)
    found = area.search_mask.in_frame(SHAPE)
    assert found[CAR].all()
    assert found.sum() < 2.5 * found[CAR].sum()
    assert area.velocity == (0.0, 0.0)
    assert not area.probable.area


def test_what_is_looked_at_anyway_is_not_proposed(empty_past: Past) -> None:
    looked_at = NOTHING.copy()
    looked_at[CAR] = True
    assert standing(with_car(road()), empty_past, looked_at) == []


def test_what_always_changes_does_not_stand_out() -> None:
    before = past([with_car(road(), value=60 + 70 * k % 120) for k in range(12)])
    assert standing(with_car(road(), value=70), before) == []


def test_a_road_with_traffic_is_still_calm() -> None:
    # A third of the frames show cars at the place.
    before = past([with_car(road(), value=40 if k % 3 == 0 else 120) for k in range(12)])
    assert len(standing(with_car(road(), value=200), before)) == 1


@pytest.mark.parametrize("shift", [1, 4])
def test_a_scene_that_lies_aside_does_not_stand_out(empty_past: Past, shift: int) -> None:
    assert standing(road(shift), empty_past) == []


LIT = (slice(5, 50), slice(100, 180))


@pytest.mark.parametrize(("gain", "offset"), [(0.5, 0), (0.6, 90), (1.0, 40)])
def test_a_scene_in_another_light_does_not_stand_out(
    empty_past: Past, gain: float, offset: int
) -> None:
    image = road()
    image[LIT] = np.clip(gain * image[LIT] + offset, 0, 255).astype(np.uint8)
    assert standing(image, empty_past) == []


def test_what_hides_a_scene_stands_out_whatever_it_looks_like(empty_past: Past) -> None:
    image = road()
    other = texture((45, 80), seed=8, grain=3.0)
    image[LIT] = cv2.merge([other] * 3)
    assert standing(image, empty_past)
    image[LIT] = 20
    assert standing(image, empty_past)


@pytest.mark.parametrize("row", [230, 330, 455])
def test_a_thin_line_that_shimmers_does_not_stand_out(row: int) -> None:
    # A kerb across a picture whose size, halved, is odd.
    ground = np.full((486, 864, 3), 90, np.uint8)
    ground[row : row + 4] = 200
    random = np.random.default_rng(row)

    def shimmering() -> ByteImage:
        aside = translation(0.0, random.normal(0.0, 0.5))[:2]
        return cv2.warpAffine(ground, aside, (864, 486), borderMode=cv2.BORDER_REPLICATE)

    nothing = np.zeros(ground.shape[:2], bool)
    views = [AlignedFrame(scene_behind(shimmering(), nothing), np.eye(3)) for _ in range(9)]
    before = past_in(views, (864, 486), tilt=0.5)
    assert before is not None
    for _ in range(20):
        assert standing_areas(scene_behind(shimmering(), nothing), before, nothing) == []


def test_another_scene_has_no_objects(empty_past: Past) -> None:
    assert standing(255 - road(), empty_past) == []


def test_no_past_is_known_of_few_views() -> None:
    assert past_in([seen_as(road())] * 4, SIZE, tilt=0.2) is None


@pytest.mark.parametrize(("aside", "known"), [(12.0, True), (40.0, False)])
def test_views_from_elsewhere_tell_nothing_of_the_past(aside: float, known: bool) -> None:
    views = [seen_as(road(), translation(aside, 0.0)) for _ in range(6)]
    assert (past_in(views, SIZE, tilt=0.2) is not None) == known


def test_the_past_follows_the_camera(empty_past: Past) -> None:
    way = translation(30.0, 0.0)
    panned = cv2.warpAffine(with_car(road()), way[:2], SIZE, borderValue=(255, 0, 0))
    (area,) = standing(panned, empty_past.seen_from(translation(-30.0, 0.0)))
    moved = area.search_mask.in_frame(SHAPE)
    assert moved[CAR[0], CAR[1].start + 30 : CAR[1].stop + 30].all()
    # What comes into view was never seen: nothing is told of it.
    assert not moved[:, :30].any()


def test_a_past_of_grey_frames_is_asked_alike() -> None:
    before = past([road()[..., :1].copy() for _ in range(6)])
    assert len(standing(with_car(road())[..., :1].copy(), before)) == 1
    assert before.seen_from(translation(3.0, 0.0)).median.shape == before.median.shape


def test_the_same_place_gives_the_past_itself(empty_past: Past) -> None:
    assert empty_past.seen_from(np.eye(3)) is empty_past
    assert replace(empty_past).shape == empty_past.shape
