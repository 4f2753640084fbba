"""Bright dots before a noisy sky, for those who look for what stands out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from turbseg_ros.arrays import ByteImage

SHAPE = (120, 180)
# Lamps that stand still, and where a target begins (x, y).
LAMPS = [(20.0, 100.0), (60.0, 104.0), (100.0, 98.0), (150.0, 102.0), (130.0, 60.0)]
START = (40.0, 40.0)

Place = Callable[[int], tuple[float, float]]
"""Where a target is, by the number of the frame."""


def sky_with_dots(
    dots: Sequence[tuple[float, float]], seed: int, contrast: float = 40.0
) -> ByteImage:
    """Draw bright dots three pixels wide at (x, y) before a sky of noise 1."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sky = np.full(SHAPE, 90.0)
    for each in dots:
        sky += contrast * np.exp(-((x - each[0]) ** 2 + (y - each[1]) ** 2) / 3.0)
    noisy = sky + np.random.default_rng(seed).normal(0.0, 1.0, SHAPE)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def straight(speed: float) -> Place:
    """Return the places of what goes to the right by so many pixels a frame."""
    return lambda index: (START[0] + speed * index, START[1])
