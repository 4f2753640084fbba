"""Eight-bit pictures of frames of any depth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.drawn_scene import texture
from turbseg_ros.segmentation.tone import ToneMap

SCENE = texture((96, 160), seed=7, low=0, high=255)
DEEP = SCENE.astype(np.uint16) * 16 + 3000


def test_eight_bits_are_left_as_they_are() -> None:
    assert ToneMap()(SCENE) is SCENE


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)], ids=str)
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_picture_keeps_its_shape(shape: tuple[int, ...], dtype: type) -> None:
    picture = ToneMap()(np.zeros(shape, dtype))
    assert picture.shape == shape
    assert picture.dtype == np.uint8


@pytest.mark.parametrize("deep", [DEEP, DEEP.astype(np.float32) / 1e4], ids=["uint16", "float32"])
def test_a_narrow_range_is_stretched_over_most_of_the_grey_values(deep: np.ndarray) -> None:
    picture = ToneMap()(deep)
    low, high = np.percentile(picture, [1, 99])
    assert low < 64
    assert high > 191
    # Little saturates, and what is brighter stays brighter.
    assert np.mean((picture == 0) | (picture == 255)) < 0.005
    assert np.corrcoef(picture.ravel(), deep.ravel())[0, 1] > 0.999


def test_a_flickering_hot_pixel_changes_no_other() -> None:
    tone = ToneMap()
    pictures = []
    for number in range(20):
        frame = DEEP.copy()
        frame[40, 80] = 65535 if number % 2 else 0
        pictures.append(tone(frame).astype(int))
    others = np.ones(DEEP.shape, bool)
    others[40, 80] = False
    assert max(np.abs(p - pictures[0])[others].max() for p in pictures) <= 1


def with_hot_spot(frame: np.ndarray, side: int) -> np.ndarray:
    spot = np.zeros(frame.shape)
    spot[10 : 10 + side, 20 : 20 + side] = 1.0
    spot = cv2.GaussianBlur(spot, (0, 0), 1.0)
    return frame * (1.0 - spot) + 40000.0 * spot


def with_hot_pixels(frame: np.ndarray, value: int) -> np.ndarray:
    hot = frame.astype(float)
    hot[np.random.default_rng(0).random(frame.shape) < 0.01] = value
    return hot


def under_a_sky(frame: np.ndarray, rows: int) -> np.ndarray:
    cold = frame.astype(float)
    cold[:rows] = 200 + np.random.default_rng(0).normal(0, 3, (rows, frame.shape[1]))
    return cold


# What takes the range though it is not the scene's detail.
EXTREMES = {
    "hot spot of 1 %": with_hot_spot(DEEP, 12),
    "hot spot of 4 %": with_hot_spot(DEEP, 25),
    "hot pixels": with_hot_pixels(DEEP, 65535),
    "dead pixels": with_hot_pixels(DEEP, 0),
    "cold sky": under_a_sky(DEEP, 16),
    "much cold sky": under_a_sky(DEEP, 40),
    "hot spot under a cold sky": under_a_sky(with_hot_spot(DEEP, 12), 16),
}


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("frame", EXTREMES.values(), ids=EXTREMES)
def test_the_scene_keeps_its_grey_values_whatever_lies_far_beyond(
    frame: np.ndarray, dtype: type
) -> None:
    tone = ToneMap()
    pictures = [tone(frame.astype(dtype)) for _ in range(5)]
    scene = np.s_[44:, :]
    assert pictures[-1][scene].std() > 0.6 * ToneMap()(DEEP)[scene].std()
    assert np.abs(pictures[-1].astype(int) - pictures[0]).max() <= 1


@pytest.mark.parametrize("value", [0, 65535])
def test_pixels_that_are_defect_look_like_those_around(value: int) -> None:
    clean = texture((96, 160), seed=7, low=0, high=255, grain=3.0).astype(np.uint16) * 16 + 20000
    picture = ToneMap()(with_hot_pixels(clean, value).astype(np.uint16)).astype(int)
    assert np.percentile(np.abs(picture - ToneMap()(clean)), 99.9) <= 24


def test_a_hot_spot_that_comes_and_goes_changes_nothing_else() -> None:
    tone = ToneMap()
    tone(DEEP)
    hot = with_hot_spot(DEEP, 16).astype(np.uint16)
    pictures = [tone(hot if number % 4 < 2 else DEEP)[40:].astype(int) for number in range(20)]
    assert max(np.abs(picture - pictures[0]).max() for picture in pictures) <= 6


def test_noise_does_not_make_the_picture_flicker() -> None:
    tone = ToneMap()
    random = np.random.default_rng(0)
    means = [
        tone((DEEP + random.normal(0, 40, DEEP.shape)).astype(np.uint16)).mean() for _ in range(20)
    ]
    assert np.ptp(means) < 1.0


def test_a_step_in_exposure_is_taken_up_in_some_seconds() -> None:
    tone = ToneMap()
    tone(DEEP)
    brighter = DEEP + np.uint16(2000)
    for _ in range(90):
        picture = tone(brighter)
    assert np.abs(picture.astype(int) - ToneMap()(brighter)).max() <= 3


def test_reset_starts_with_the_next_frames_range() -> None:
    tone = ToneMap()
    tone(DEEP)
    tone.reset()
    brighter = DEEP * np.uint16(2)
    np.testing.assert_array_equal(tone(brighter), ToneMap()(brighter))


@pytest.mark.parametrize("value", [0, 1, 65535])
def test_a_constant_picture_stays_constant(value: int) -> None:
    picture = ToneMap()(np.full((20, 30), value, np.uint16))
    assert np.ptp(picture) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_a_number_is_dark_and_spoils_nothing_else(bad: float) -> None:
    clean = DEEP.astype(np.float32)
    spoilt = clean.copy()
    spoilt[10:14, 20:24] = bad
    picture = ToneMap()(spoilt)
    assert not picture[10:14, 20:24].any()
    others = np.isfinite(spoilt)
    assert np.abs(picture.astype(int) - ToneMap()(clean))[others].max() <= 1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_picture_without_any_number_changes_nothing_for_the_next(bad: float) -> None:
    frame = DEEP.astype(np.float32)
    tone = ToneMap()
    before = tone(frame)
    assert not tone(np.full_like(frame, bad)).any()
    assert np.abs(tone(frame).astype(int) - before).max() <= 1


@settings(max_examples=60, deadline=None)
@given(
    image=hnp.arrays(
        np.float32,
        st.sampled_from([(1, 1), (3, 4), (6, 5, 3)]),
        elements=st.floats(width=32, allow_nan=False, allow_infinity=False)
        | st.sampled_from([float("nan"), float("inf"), float("-inf")]),
    )
)
def test_brighter_is_never_darker(image: np.ndarray) -> None:
    picture = ToneMap()(image).ravel()
    values = np.where(np.isfinite(image), image, -np.inf).ravel()
    assert (np.diff(picture[np.argsort(values)].astype(int)) >= 0).all()


def test_after_a_frame_of_rubbish_the_picture_keeps_most_of_its_contrast() -> None:
    tone = ToneMap()
    before = tone(DEEP)
    tone(np.random.default_rng(0).integers(0, 65536, DEEP.shape).astype(np.uint16))
    assert tone(DEEP).std() > 0.4 * before.std()


@pytest.mark.filterwarnings("error")
def test_the_largest_numbers_overflow_nothing_and_are_forgotten_with_the_next_frame() -> None:
    frame = DEEP.astype(np.float32)
    tone = ToneMap()
    before = tone(frame)
    rubbish = np.where(np.arange(frame.size) % 2, 3e38, -3e38).reshape(frame.shape)
    assert set(np.unique(ToneMap()(rubbish.astype(np.float32)))) == {0, 255}
    tone(rubbish.astype(np.float32))
    assert np.abs(tone(frame).astype(int) - before).mean() <= 4
