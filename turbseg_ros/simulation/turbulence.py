"""Tilt and blur that Kolmogorov turbulence gives to an image.

The turbulence is one thin screen of the phase spectrum Φ(k) ∝ k^(-11/3), seen through apertures
of diameter D that stand side by side, one for every pixel. What each aperture measures is its
Zernike tilt, so that the field of tilts over the image has the spectrum

    P(k) = k^(-11/3) · (J₂(kD/2) / (kD/2))²    along the unit vector k/|k|,

from which follow a longitudinal correlation ∫kP(J₀ - J₂)dk and a transverse ∫kP(J₀ + J₂)dk
(J of ks at separation s).

References: Fried, "Differential angle of arrival: theory, evaluation, and measurement
feasibility", Radio Science 10(1), 1975; Noll, "Zernike polynomials and atmospheric turbulence",
JOSA 66(3), 1976 (the tilt's variance); Chimitt & Chan, "Simulating anisoplanatic turbulence by
sampling intermodal and spatially correlated Zernike coefficients", Optical Engineering 59(8),
2020 (the tilt's correlation over the image).
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from scipy import fft, integrate, special

from turbseg_ros.arrays import Image

Field = npt.NDArray[np.float32]

_GRID_POINTS_PER_APERTURE = 6.0
"""The aperture averages away what is finer than itself, so a coarser grid loses nothing."""


def fried_parameter(
    cn2: float,
    path_length: float,
    wavelength: float,
    wave: Literal["spherical", "plane"] = "spherical",
) -> float:
    """Return Fried's r0 in metres for a structure constant that is the same along the path.

    `cn2` in m^(-2/3), `path_length` and `wavelength` in metres. Plane wave:
    (0.423 k² Cn² L)^(-3/5); spherical wave (an object at a finite range): the path weight
    (z/L)^(5/3) multiplies the integral by 3/8 (Roggemann & Welsh, "Imaging through turbulence",
    1996, section 3.4).
    """
    wavenumber = 2 * math.pi / wavelength
    weight = {"plane": 1.0, "spherical": 3 / 8}[wave]
    return float((0.423 * wavenumber**2 * cn2 * path_length * weight) ** (-3 / 5))


@dataclass(frozen=True)
class Optics:
    """The camera and the air before it: all that sets the strength of what it sees.

    `aperture` (diameter D), `r0` (Fried's parameter) and `wavelength` in metres; `ifov` is the
    angle of one pixel in radians; `turbulence_distance`, in metres, is how far from the camera
    the air boils: an aperture there covers D / (distance · IFOV) pixels.
    """

    aperture: float
    r0: float
    ifov: float
    turbulence_distance: float
    wavelength: float = 550e-9

    def __post_init__(self) -> None:
        if min(astuple(self)) <= 0:
            raise ValueError(f"all lengths and angles must be positive: {self}")

    @property
    def tilt_px(self) -> float:
        """Rms tilt an axis in pixels: variance 0.182 (λ/D)² (D/r0)^(5/3) rad² (Noll 1976)."""
        variance = (
            0.182 * (self.wavelength / self.aperture) ** 2 * (self.aperture / self.r0) ** (5 / 3)
        )
        return math.sqrt(variance) / self.ifov

    @property
    def blur_px(self) -> float:
        """Width (sigma) of the short-exposure blur in pixels.

        What is left of the long-exposure seeing disc (FWHM 0.98 λ/r0) when its tilt is taken out.
        """
        seeing = 0.98 * self.wavelength / self.r0 / (2 * math.sqrt(2 * math.log(2))) / self.ifov
        return math.sqrt(max(seeing**2 - self.tilt_px**2, 0.0))

    @property
    def aperture_px(self) -> float:
        """What the aperture covers at the turbulence, in pixels: the scale of correlation."""
        return self.aperture / (self.turbulence_distance * self.ifov)


@dataclass(frozen=True)
class Turbulence:
    """Turbulence as the image shows it; lengths in pixels, times in frames.

    `tilt_px` is the rms tilt an axis, the part that is common to the whole image included;
    `aperture_px` the aperture's diameter projected to where the turbulence is; `blur_px` the
    median sigma of the blur, which varies from place to place by the factor
    exp(`blur_variation` · normal). The air drifts by `wind_px` a frame, and an eddy of the size
    of the aperture decorrelates to 1/e in `eddy_lifetime` frames; larger ones live longer as
    size^(2/3) (Kolmogorov's turnover time). The defaults give, beside the common part,
    autocorrelations of about 0.6, 0.35, 0.25 and 0.2 at lags of 1 to 4 frames, as measured on
    real clips at 30 Hz.
    """

    tilt_px: float
    aperture_px: float = 24.0
    blur_px: float = 0.0
    blur_variation: float = 0.35
    wind_px: tuple[float, float] = (11.5, 3.0)
    eddy_lifetime: float = 1.0

    def __post_init__(self) -> None:
        if self.tilt_px < 0 or self.blur_px < 0:
            raise ValueError("tilt and blur cannot be negative")
        if self.aperture_px <= 0 or self.eddy_lifetime <= 0:
            raise ValueError("aperture_px and eddy_lifetime must be positive")

    @classmethod
    def typical(cls, tilt_px: float, image_width: int) -> Turbulence:
        """Return turbulence of some strength, scaled as a long lens sees it.

        Correlation over 1/36 of the image's width, as measured on a real clip of a compact
        camera at full zoom, drift and blur in proportion.
        """
        aperture_px = image_width / 36
        wind_px = (0.48 * aperture_px, 0.125 * aperture_px)
        return cls(tilt_px, aperture_px, blur_px=0.7 * tilt_px, wind_px=wind_px)

    @classmethod
    def from_optics(cls, optics: Optics) -> Turbulence:
        """Return the turbulence that a camera sees through given air."""
        return cls(optics.tilt_px, optics.aperture_px, optics.blur_px)

    def with_tilt(self, tilt_px: float) -> Turbulence:
        """Return the same air, stronger or weaker: the blur follows the tilt."""
        ratio = tilt_px / self.tilt_px if self.tilt_px > 0 else 0.0
        return replace(self, tilt_px=tilt_px, blur_px=self.blur_px * ratio)


def tilt_spectrum(wavenumber: npt.ArrayLike, aperture_px: float) -> npt.NDArray[np.float64]:
    """Return P(k) of the Zernike tilt, up to a constant; k in radians a pixel, above 0."""
    k = np.asarray(wavenumber, dtype=np.float64)
    argument = k * aperture_px / 2
    filtered = k ** (-11 / 3) * (special.jv(2, argument) / argument) ** 2
    return np.asarray(filtered, dtype=np.float64)


def tilt_correlation(separation: float) -> tuple[float, float]:
    """Return the theoretical (longitudinal, transverse) correlation of the tilt of two points.

    `separation` is the distance between them in apertures; longitudinal means of the components
    along the line that joins them. Unbounded outer scale.
    """
    log_k = np.linspace(math.log(1e-7), math.log(400.0), 100_000)
    k = np.exp(log_k)
    energy = k**2 * tilt_spectrum(k, aperture_px=1.0)
    even, odd = special.jv(0, k * separation), special.jv(2, k * separation)
    total = integrate.simpson(energy, x=log_k)
    longitudinal = integrate.simpson(energy * (even - odd), x=log_k) / total
    transverse = integrate.simpson(energy * (even + odd), x=log_k) / total
    return float(longitudinal), float(transverse)


class EddyField:
    """A periodic Gaussian random field that drifts with the wind and boils.

    Every Fourier mode is a first-order autoregressive process whose memory falls with its
    wavenumber and whose phase the wind turns: Taylor's frozen flow and the decay of eddies in
    one step. The field covers an image of `shape` (height, width) twice over, so that opposite
    borders of the image are not neighbours.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        turbulence: Turbulence,
        rng: np.random.Generator,
    ) -> None:
        self._shape = shape
        self._rng = rng
        self.spacing = max(1.0, turbulence.aperture_px / _GRID_POINTS_PER_APERTURE)
        points = fft.next_fast_len(math.ceil(2 * max(shape) / self.spacing) + 8)
        frequencies = 2 * math.pi * np.fft.fftfreq(points, d=self.spacing)
        self.kx, self.ky = np.meshgrid(frequencies, frequencies)
        self.k = np.hypot(self.kx, self.ky)
        self.k_step = 2 * math.pi / (points * self.spacing)

        eddy_size = turbulence.aperture_px * np.maximum(self.k, self.k_step / 2) / (2 * math.pi)
        memory = np.exp(-(eddy_size ** (2 / 3)) / turbulence.eddy_lifetime)
        wind_x, wind_y = turbulence.wind_px
        self._advance = memory * np.exp(-1j * (self.kx * wind_x + self.ky * wind_y))
        self._renewal = np.sqrt(1 - memory**2)
        self._modes = self._white_modes()

    def step(self) -> None:
        """Go on by one frame."""
        self._modes = self._advance * self._modes + self._renewal * self._white_modes()

    def sample(self, transfer: npt.NDArray[np.complexfloating[Any, Any]]) -> Field:
        """Return the field that `transfer` shapes from the modes: float32 of the image's shape.

        The real part of a field with modes of independent complex noise has half their power;
        `transfer` of unit total power therefore gives unit variance, the noise having power 2.
        """
        field = fft.ifft2(transfer * self._modes, norm="forward").real.astype(np.float32)
        height, width = self._shape
        rows, columns = (math.ceil(length / self.spacing) + 4 for length in self._shape)
        scale = np.float32(1 / self.spacing)
        map_x, map_y = np.meshgrid(
            np.arange(width, dtype=np.float32) * scale + 2,
            np.arange(height, dtype=np.float32) * scale + 2,
        )
        return cv2.remap(field[:rows, :columns], map_x, map_y, cv2.INTER_CUBIC)

    def _white_modes(self) -> npt.NDArray[np.complex128]:
        noise = self._rng.standard_normal((2, *self.k.shape))
        return np.asarray(noise[0] + 1j * noise[1], dtype=np.complex128)


class TiltField:
    """Successive tilt fields of an image.

    `next()` gives float32 HxWx2 in pixels, x first: pixel p of the distorted image shows the
    undistorted image at p + tilt(p).
    """

    def __init__(
        self, shape: tuple[int, int], turbulence: Turbulence, rng: np.random.Generator
    ) -> None:
        self._eddies = EddyField(shape, turbulence, rng)
        eddies = self._eddies
        still = eddies.k == 0
        k = np.where(still, 1.0, eddies.k)
        distinct, where = np.unique(k, return_inverse=True)  # Bessel functions are slow
        spectrum = tilt_spectrum(distinct, turbulence.aperture_px)[where].reshape(k.shape)
        power = np.where(still, 0.0, spectrum)

        # The cell around k = 0 holds the tilt that the whole image shares. P ∝ k^(-5/3) there
        # (J₂(x)/x → x/8), which integrates over a disc of the cell's area to 6π·c·k^(1/3).
        low = (turbulence.aperture_px / 16) ** 2
        disc = eddies.k_step / math.sqrt(math.pi)
        shared = 6 * math.pi * low * disc ** (1 / 3) / eddies.k_step**2

        norm = turbulence.tilt_px * math.sqrt(2 / (power.sum() + shared))
        common = np.where(still, math.sqrt(shared / 2) * norm, 0.0)
        amplitude = np.sqrt(power) * norm
        # Two directions of the shared tilt are independent; real and imaginary part of the one
        # mode at k = 0 serve as the two.
        self._along_x = 1j * eddies.kx / k * amplitude + common
        self._along_y = 1j * eddies.ky / k * amplitude - 1j * common

    def next(self) -> Field:
        """Return the field of the next frame."""
        self._eddies.step()
        x, y = self._eddies.sample(self._along_x), self._eddies.sample(self._along_y)
        return np.dstack((x, y))


class BlurField:
    """Successive maps of the blur's width over the image.

    `next()` gives float32 HxW, the sigma in pixels: log-normal around `blur_px`, smooth over
    several apertures.
    """

    def __init__(
        self, shape: tuple[int, int], turbulence: Turbulence, rng: np.random.Generator
    ) -> None:
        self._turbulence = turbulence
        self._eddies = EddyField(shape, turbulence, rng)
        extent = 2 * turbulence.aperture_px
        shape_factor = np.exp(-((self._eddies.k * extent) ** 2) / 4)
        self._transfer = (shape_factor / np.sqrt((shape_factor**2).sum())).astype(np.complex128)

    def next(self) -> Field:
        """Return the map of the next frame."""
        self._eddies.step()
        variation = self._turbulence.blur_variation * self._eddies.sample(self._transfer)
        return np.asarray(self._turbulence.blur_px * np.exp(variation), dtype=np.float32)


def warp(
    image: Image, tilt: Field, margin: int = 0, interpolation: int = cv2.INTER_CUBIC
) -> Image:
    """Return the image as seen through the tilt: pixel p shows the image at p + tilt(p).

    Keeps the dtype and has the tilt's height and width; the image may be larger by `margin` on
    every side, which fills what the tilt draws in from outside; beyond it is reflected.
    """
    height, width = tilt.shape[:2]
    map_x, map_y = np.meshgrid(
        np.arange(margin, width + margin, dtype=np.float32),
        np.arange(margin, height + margin, dtype=np.float32),
    )
    return cv2.remap(
        image,
        map_x + tilt[..., 0],
        map_y + tilt[..., 1],
        interpolation,
        borderMode=cv2.BORDER_REFLECT,
    )


def blur(image: Field, sigma: Field) -> Field:
    """Blur the image by a Gaussian whose sigma (pixels, HxW) varies from pixel to pixel.

    Interpolates, in variance, between images of a few constant widths.
    """
    widest = float(sigma.max())
    if widest <= 0:
        return image
    levels = 5
    position = (sigma / widest) ** 2 * (levels - 1)
    blurred = np.zeros_like(image)
    for level in range(levels):
        weight = np.maximum(1 - np.abs(position - level), 0)
        level_sigma = widest * math.sqrt(level / (levels - 1))
        layer = image if level == 0 else cv2.GaussianBlur(image, (0, 0), level_sigma)
        blurred += layer * (weight if image.ndim == 2 else weight[..., None])
    return blurred
