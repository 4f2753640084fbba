from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from turbseg_ros.simulation.turbulence import (
    BlurField,
    Optics,
    TiltField,
    Turbulence,
    blur,
    fried_parameter,
    tilt_correlation,
    warp,
)

# Separation in apertures: longitudinal and transverse correlation of the tilt of two points.
PUBLISHED_CORRELATION = {
    0.5: (0.76, 0.91),
    1.0: (0.54, 0.77),
    2.0: (0.41, 0.62),
    5.0: (0.29, 0.45),
    12.0: (0.20, 0.32),
}


def fields(turbulence: Turbulence, shape: tuple[int, int], count: int) -> npt.NDArray[np.float32]:
    """Successive tilt fields, NxHxWx2."""
    tilts = TiltField(shape, turbulence, np.random.default_rng(7))
    return np.stack([tilts.next() for _ in range(count)])


@pytest.fixture(scope="module")
def independent_fields() -> npt.NDArray[np.float32]:
    """Fields of unit variance and an aperture of 12 px, hardly correlated in time."""
    turbulence = Turbulence(tilt_px=1.0, aperture_px=12, eddy_lifetime=0.05)
    return fields(turbulence, (160, 160), 250)


@pytest.mark.parametrize(("separation", "published"), PUBLISHED_CORRELATION.items())
def test_correlation_of_theory_is_the_published_one(
    separation: float, published: tuple[float, float]
) -> None:
    assert tilt_correlation(separation) == pytest.approx(published, abs=0.035)


def test_rendered_tilt_has_the_variance_asked_for(
    independent_fields: npt.NDArray[np.float32],
) -> None:
    variance = (independent_fields.astype(np.float64) ** 2).mean(axis=(0, 1, 2))
    assert variance == pytest.approx([1.0, 1.0], abs=0.08)


@pytest.mark.parametrize("separation", PUBLISHED_CORRELATION)
def test_rendered_tilt_correlates_over_the_image_as_theory_says(
    independent_fields: npt.NDArray[np.float32], separation: float
) -> None:
    offset = round(12 * separation)
    beside = independent_fields[:, :, :-offset], independent_fields[:, :, offset:]
    below = independent_fields[:, :-offset], independent_fields[:, offset:]
    # From the structure function, in which the tilt that all the image shares drops out.
    (x_beside, y_beside), (x_below, y_below) = (
        1 - ((first - second) ** 2).mean(axis=(0, 1, 2)) / 2 for first, second in (beside, below)
    )
    longitudinal, transverse = tilt_correlation(separation)
    bound = 0.03 + 0.003 * separation  # far points have few pairs
    assert [x_beside, y_below] == pytest.approx([longitudinal, longitudinal], abs=bound)
    assert [y_beside, x_below] == pytest.approx([transverse, transverse], abs=bound)


def test_rendered_tilt_correlates_in_time_as_on_a_real_clip_at_30_hz() -> None:
    tilt = fields(Turbulence.typical(1.0, 144), (80, 144), 160)
    tilt = tilt - tilt.mean(axis=(1, 2), keepdims=True)  # ego-motion, removed there too
    lags = [(tilt[:-lag] * tilt[lag:]).mean() / (tilt**2).mean() for lag in (1, 2, 3, 4)]
    assert lags == pytest.approx([0.60, 0.35, 0.25, 0.20], abs=0.05)


def test_air_that_does_not_boil_drifts_with_the_wind() -> None:
    frozen = Turbulence(1.0, aperture_px=12, wind_px=(6.0, -3.0), eddy_lifetime=1e6)
    first, second = fields(frozen, (100, 140), 2)
    assert np.abs(second[:-3, 6:] - first[3:, :-6]).max() < 0.05
    assert np.abs(second - first).max() > 0.5


def test_tilt_scales_with_its_strength_and_vanishes_with_it() -> None:
    weak = fields(Turbulence(0.5), (40, 60), 2)
    strong = fields(Turbulence(2.0), (40, 60), 2)
    np.testing.assert_allclose(4 * weak, strong, rtol=1e-4, atol=1e-5)
    assert not fields(Turbulence(0.0), (40, 60), 2).any()


@pytest.mark.parametrize(
    ("seeing_ratio", "tilt_px"), [(1, 0.13), (2, 0.24), (3, 0.33), (5, 0.50), (10, 0.90)]
)
def test_optics_give_the_tilt_of_a_superzoom_camera(seeing_ratio: float, tilt_px: float) -> None:
    optics = Optics(0.067, 0.067 / seeing_ratio, ifov=26e-6, turbulence_distance=200)
    assert optics.tilt_px == pytest.approx(tilt_px, abs=0.02)
    assert Turbulence.from_optics(optics).tilt_px == optics.tilt_px
    assert optics.aperture_px == pytest.approx(12.9, abs=0.1)


def test_fried_parameter_agrees_with_textbook_values() -> None:
    plane = fried_parameter(1e-15, 1000, 550e-9, "plane")
    wavenumber = 2 * math.pi / 550e-9
    assert plane == pytest.approx(1.68 * (1e-15 * 1000 * wavenumber**2) ** (-3 / 5), rel=0.01)
    spherical = fried_parameter(1e-15, 1000, 550e-9)
    assert spherical == pytest.approx(plane * (3 / 8) ** (-3 / 5))


def test_impossible_values_are_refused() -> None:
    with pytest.raises(ValueError, match="negative"):
        Turbulence(-0.1)
    with pytest.raises(ValueError, match="positive"):
        Turbulence(0.1, aperture_px=0)
    with pytest.raises(ValueError, match="positive"):
        Optics(0.067, 0.0, 26e-6, 200)


def test_warp_shows_what_lies_where_the_tilt_points() -> None:
    columns = np.tile(np.arange(40, dtype=np.float32), (30, 1))
    tilt = np.zeros((20, 30, 2), np.float32)
    tilt[..., 0] = 2.25
    shown = warp(columns, tilt, margin=5, interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(shown, columns[5:25, 5:35] + 2.25, atol=0.01)


def test_even_blur_is_a_gaussian() -> None:
    image = np.random.default_rng(0).random((60, 80)).astype(np.float32)
    blurred = blur(image, np.full((60, 80), 1.7, np.float32))
    np.testing.assert_allclose(blurred, cv2.GaussianBlur(image, (0, 0), 1.7), atol=1e-6)
    assert blur(image, np.zeros((60, 80), np.float32)) is image


def test_blur_varies_over_the_image_and_in_time() -> None:
    turbulence = Turbulence(1.0, aperture_px=12, blur_px=1.0, blur_variation=0.35)
    blurs = BlurField((120, 200), turbulence, np.random.default_rng(3))
    sigma = np.stack([blurs.next() for _ in range(60)])
    assert np.median(sigma) == pytest.approx(1.0, abs=0.2)
    assert np.log(sigma).std() == pytest.approx(0.35, abs=0.07)
    steps = np.abs(np.diff(sigma, axis=2)).mean(), np.abs(np.diff(sigma, axis=0)).mean()
    assert 0 < steps[0] < 0.05
    assert 0.01 < steps[1] < 0.3
