"""Procedural textures: what surfaces, foliage and skies look like from kilometres away."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

Field = npt.NDArray[np.float32]


def fractal_noise(
    shape: tuple[int, int],
    rng: np.random.Generator,
    exponent: float = 1.0,
    stretch: tuple[float, float] = (1.0, 1.0),
) -> Field:
    """Return noise whose amplitude falls as 1/f^exponent, as natural pictures' does.

    float32 of `shape`, zero mean, unit variance, periodic; `stretch` draws it out along x and y.
    Reference: Field, "Relations between the statistics of natural images and the response
    properties of cortical cells", JOSA A 4(12), 1987.
    """
    height, width = shape
    ky = fft.fftfreq(height)[:, None] * stretch[1]
    kx = fft.rfftfreq(width)[None, :] * stretch[0]
    frequency = np.hypot(kx, ky)
    frequency[0, 0] = np.inf
    spectrum = fft.rfft2(rng.standard_normal(shape)) / frequency**exponent
    noise = fft.irfft2(spectrum, s=shape)
    return np.asarray(noise / noise.std(), dtype=np.float32)
