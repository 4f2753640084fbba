"""Exposure of one frame against another, on frames whose exposures are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from support.drawn_scene import ByteImage, texture
from turbseg_ros.segmentation.exposure import (
    AS_IT_IS,
    ColourExposure,
    Exposure,
    colour_exposure_between,
    exposure_between,
)
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
@example(gain=1.16015625, offset=-14.5).via("the middle stays as it is, dark and bright don't")
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


def coloured(gains: tuple[float, ...], offset: float = 0.0, seed: int = 0) -> ByteImage:
    """A scene of three colours and a channel that says nothing, HxWx4."""
    tints = [texture(SHAPE, seed=10 + channel, low=20, high=160) for channel in range(3)]
    grain = np.random.default_rng(seed).normal(0, 3, (*SHAPE, 3))
    colours = np.stack(tints, axis=-1) * np.array(gains) + offset + grain
    hidden = np.full((*SHAPE, 1), 255 * (seed % 2))
    return np.concatenate([np.clip(colours, 0, 255), hidden], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("gains", [(0.7, 1.0, 1.3), (0.6, 1.0, 1.0), (1.2, 0.9, 0.8)], ids=str)
def test_a_step_of_the_white_balance_is_found_channel_by_channel(
    gains: tuple[float, ...],
) -> None:
    source, target = coloured((1.0, 1.0, 1.0)), coloured(gains, seed=1)
    found = colour_exposure_between(source, target, IDENTITY)
    for gain, exposure in zip(gains, found.channels, strict=True):
        assert exposure.gain == pytest.approx(gain, abs=0.04)
    exposed_alike = found.applied_to(source, channels=3)
    assert abs(exposed_alike[..., :3].astype(float) - target[..., :3]).mean() < 5.0
    np.testing.assert_array_equal(exposed_alike[..., 3], source[..., 3])


def test_colours_that_only_differ_by_noise_are_left_as_they_are() -> None:
    source, target = coloured((1.0, 1.0, 1.0)), coloured((1.0, 1.0, 1.0), seed=1)
    found = colour_exposure_between(source, target, IDENTITY)
    assert found == ColourExposure((AS_IT_IS,) * 3)
    assert found.applied_to(source, channels=3) is source


def test_exposures_of_colours_follow_one_another() -> None:
    one = ColourExposure((Exposure(2.0, 1.0), AS_IT_IS))
    other = ColourExposure((Exposure(0.5, 3.0), Exposure(1.5, 0.0)))
    assert one.then(other) == ColourExposure((Exposure(1.0, 3.5), Exposure(1.5, 0.0)))
