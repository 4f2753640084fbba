"""From any depth of grey value to the 8 bits that flow and outlines work on.

The range is that of nearly all pixels, unless it goes far beyond where the scene has its detail:
hot or dead pixels, a flare, a chimney or a plain cold sky would leave the rest few grey values.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Image

_LOW_PERCENTILE, _HIGH_PERCENTILE = 0.5, 99.5
# Room left beyond the percentiles, as a fraction of their distance, so that little saturates.
_HEADROOM = 0.25
# Beyond a quarter of what float32 holds, the difference of two values overflows.
_MAX_VALUE = float(np.finfo(np.float32).max) / 4
# The smallest range, and that as a fraction of the values: float32 resolves no less.
_MIN_RANGE, _RESOLUTION = 1e-30, 1e-6
# A range so many times as wide as what the picture fills leaves it too few grey values.
_TOO_WIDE = 16.0
# Share of the range that follows the newest frame: a step in exposure is taken up in a second or
# so, noise in the percentiles doesn't flicker.
_ADAPTATION = 0.05
_SAMPLES = 20000
# Where the scene has its detail: quantiles of the values of textured pixels, weighted by how far
# their contrast exceeds that of the plainest parts, in per cent of all. No edge weighs more
# than half of the others do, and one so many times as steep as those is no detail, but the border
# of what lies far beyond.
_STEEP = 8.0
_LOW_DETAIL, _HIGH_DETAIL = 0.05, 0.95
_PLAINEST, _TEXTURE, _AROUND = 20.0, 1.5, (5, 5)
# The range goes no further beyond the detail than so many times its width.
_BEYOND = 1.0
# One sample of so many each way tells it.
_DETAIL_STEP = 2
# Shares of the pixels that lie far out of range, and how many at least, between which those that
# stand alone are a sensor's defects.
_FEW_SPECKS, _MOST_SPECKS, _MIN_SPECKS = 0.001, 0.05, 8

Values = npt.NDArray[np.float32]


class ToneMap:
    """Stretches 16-bit and float frames to 8 bits, steadily; 8-bit frames pass as they are."""

    def __init__(self) -> None:
        self._range: tuple[float, float] | None = None

    def reset(self) -> None:
        """Forget the range: the next frame sets it anew."""
        self._range = None

    def __call__(self, image: Image) -> ByteImage:
        """Return the 8-bit picture of an image, same shape.

        NaN and infinities count as the darkest grey.
        """
        if image.dtype == np.uint8:
            return image
        step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / _SAMPLES)))
        samples = image[::step, ::step]
        low, high = self._follow(samples)
        values = image.astype(np.float32)
        if image.dtype.kind == "f":
            values = np.nan_to_num(values, nan=low, posinf=low, neginf=low)
        values = _without_specks(values, low, high)
        # Before the difference, which may overflow.
        values = np.clip(values, np.float32(low), np.float32(high))
        least = max(_MIN_RANGE, _RESOLUTION * max(abs(low), abs(high)))
        return cv2.convertScaleAbs((values - np.float32(low)) * (255.0 / max(high - low, least)))

    def _follow(self, samples: Image) -> tuple[float, float]:
        finite = np.isfinite(samples)
        values = samples[finite].astype(np.float64).clip(-_MAX_VALUE, _MAX_VALUE)
        if not values.size:
            return self._range or (0.0, 1.0)
        low, high = _range_of(values)
        near = _near_detail(np.where(finite, samples, low).astype(np.float32), (low, high))
        if near != (low, high):
            low, high = _range_of(values[(values >= near[0]) & (values <= near[1])])
        room = _HEADROOM * (high - low)
        wanted = (max(low - room, -_MAX_VALUE), min(high + room, _MAX_VALUE))
        old = self._range
        if old is None or low > old[1] or high < old[0] or _crushes(old, high - low):
            # Nothing seen so far tells anything of this picture.
            old = wanted
        self._range = (
            old[0] + _ADAPTATION * (wanted[0] - old[0]),
            old[1] + _ADAPTATION * (wanted[1] - old[1]),
        )
        return self._range


def _range_of(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.percentile(values, [_LOW_PERCENTILE, _HIGH_PERCENTILE])
    return float(low), float(high)


def _near_detail(samples: Values, widest: tuple[float, float]) -> tuple[float, float]:
    """Return as much of a range as lies near the values that the scene has its detail at.

    :param samples: hxw or hxwxC, some of a picture's pixels.
    """
    samples = samples.clip(-_MAX_VALUE, _MAX_VALUE)
    # Single hot or dead pixels are no detail.
    smooth = cv2.medianBlur(samples, 3)
    if min(smooth.shape[:2]) < 2:
        return widest
    here = smooth[:-1, :-1]
    contrast = np.abs(smooth[:-1, 1:] - here)
    contrast += np.abs(smooth[1:, :-1] - here)
    around = cv2.blur(contrast, _AROUND)
    values, contrast, around = (
        each[::_DETAIL_STEP, ::_DETAIL_STEP] for each in (here, contrast, around)
    )
    plain = _TEXTURE * np.percentile(around, _PLAINEST)
    textured = (around > plain) & (contrast > plain)
    if not textured.any():
        return widest
    values, weight = values[textured], contrast[textured] - plain
    usual = np.median(weight)
    weight = np.where(weight < _STEEP * usual, np.minimum(weight, usual), 0.0)
    order = np.argsort(values)
    share = np.cumsum(weight[order], dtype=np.float64)
    places = np.searchsorted(share, np.array([_LOW_DETAIL, _HIGH_DETAIL]) * share[-1])
    low, high = (float(v) for v in values[order][np.minimum(places, len(order) - 1)])
    room = _BEYOND * (high - low)
    if not room:
        return widest
    return max(widest[0], low - room), min(widest[1], high + room)


def _without_specks(values: Values, low: float, high: float) -> Values:
    """Return a picture with its hot and dead pixels as those around, if it has many.

    They are far out of range where the pixels around are not. Single ones may be anything.
    """
    width = high - low
    far_out = (values < np.float32(low - width)) | (values > np.float32(high + width))
    count = np.count_nonzero(far_out)
    if not max(_FEW_SPECKS * far_out.size, _MIN_SPECKS) <= count <= _MOST_SPECKS * far_out.size:
        return values
    around = cv2.medianBlur(values, 3).reshape(values.shape)
    inside = (around >= np.float32(low)) & (around <= np.float32(high))
    return np.where(far_out & inside, around, values)


def _crushes(used: tuple[float, float], width: float) -> bool:
    return 0.0 < _TOO_WIDE * width < used[1] - used[0]
