"""From any depth of grey value to the 8 bits that flow and outlines work on."""

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
        finite = samples[np.isfinite(samples)].astype(np.float64)
        low, high = self._follow(finite.clip(-_MAX_VALUE, _MAX_VALUE))
        values = image.astype(np.float32)
        if image.dtype.kind == "f":
            values = np.nan_to_num(values, nan=low, posinf=low, neginf=low)
        # Before the difference, which may overflow.
        values = np.clip(values, np.float32(low), np.float32(high))
        least = max(_MIN_RANGE, _RESOLUTION * max(abs(low), abs(high)))
        return cv2.convertScaleAbs((values - np.float32(low)) * (255.0 / max(high - low, least)))

    def _follow(self, samples: npt.NDArray[np.float64]) -> tuple[float, float]:
        if not samples.size:
            return self._range or (0.0, 1.0)
        low, high = (float(v) for v in np.percentile(samples, [_LOW_PERCENTILE, _HIGH_PERCENTILE]))
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


def _crushes(used: tuple[float, float], width: float) -> bool:
    return 0.0 < _TOO_WIDE * width < used[1] - used[0]
