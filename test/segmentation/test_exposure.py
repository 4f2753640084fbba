"""Exposure of one frame against another, on frames whose exposures are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.drawn_scene import ByteImage, texture
from turbseg_ros.segmentation.exposure import AS_IT_IS, Exposure, exposure_between
from turbseg_ros.segmentation.geometry import translation

SHAPE = (144, 256)
SCENE = texture(SHAPE, seed=3, low=20, high=180).astype(float)
IDENTITY = np.eye(3)


def exposed(
    gain: float = 1.0, offset: float = 0.0, seed: int = 0, noise: float = 3.0
) -> ByteImage:
    grain = np.random.default_rng(seed).normal(0, noise, SHAPE)
    return np.clip(SCENE * gain + offset + grain, 0, 255).astype(np.uint8)


@settings(max_examples=40, deadline=None)
@given(gain=st.floats(0.6, 1.35), offset=st.floats(-15, 15))
def test_the_exposure_of_a_noisy_frame_is_found_within_a_few_grey_values(
    gain: float, offset: float
) -> None:
    found = exposure_between(exposed(), exposed(gain, offset, seed=1), IDENTITY)
    for grey in np.percentile(SCENE, [10, 50, 90]):
        # Changes that nobody sees are none.
        assert abs(grey * found.gain + found.offset - (grey * gain + offset)) <= 5.0


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_only_differ_by_noise_are_exposed_alike(seed: int) -> None:
    found = exposure_between(exposed(seed=seed, noise=8.0), exposed(seed=9, noise=8.0), IDENTITY)
    assert found == AS_IT_IS


@given(
    grey=st.floats(0, 255),
    gains=st.tuples(st.floats(0.5, 2), st.floats(0.5, 2)),
    offsets=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
)
def test_exposures_follow_one_another(
    grey: float, gains: tuple[float, float], offsets: tuple[float, float]
) -> None:
    one, other = (Exposure(*each) for each in zip(gains, offsets, strict=True))
    both = one.then(other)
    step = grey * one.gain + one.offset
    assert grey * both.gain + both.offset == pytest.approx(step * other.gain + other.offset)


def test_an_object_over_a_quarter_of_the_frame_changes_nothing() -> None:
    target = exposed(seed=1)
    target[:72, :128] = 250
    assert exposure_between(exposed(), target, IDENTITY) == AS_IT_IS


def test_frames_are_compared_where_they_show_the_same() -> None:
    shifted = np.roll(exposed(1.25, seed=1), (5, 30), axis=(0, 1))
    found = exposure_between(exposed(), shifted, translation(-30, -5))
    assert found.gain == pytest.approx(1.25, abs=0.03)


@pytest.mark.parametrize("value", [0, 90, 255])
def test_a_plain_frame_has_an_exposure_too(value: int) -> None:
    plain = np.full(SHAPE, value, np.uint8)
    for source, target in ((plain, exposed()), (exposed(), plain), (plain, plain)):
        found = exposure_between(source, target, IDENTITY)
        assert np.isfinite([found.gain, found.offset]).all()


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 2), (20, 30, 4)], ids=str)
def test_only_the_channels_named_are_exposed(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    colours = max(shape[2] - 1, 1) if len(shape) == 3 else 1
    result = Exposure(1.5, -20.0).applied_to(image, channels=colours)
    assert (result.shape, result.dtype) == (image.shape, np.uint8)
    expected = np.clip(np.rint(image * np.float32(1.5) - 20.0), 0, 255)
    if len(shape) == 3:
        expected[..., colours:] = image[..., colours:]
    np.testing.assert_array_equal(result, expected)


def test_what_is_exposed_alike_is_not_copied() -> None:
    image = exposed()
    assert AS_IT_IS.applied_to(image, channels=1) is image
