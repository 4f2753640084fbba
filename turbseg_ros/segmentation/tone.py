"""From any depth of grey value to the 8 bits that flow and outlines work on."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.frame import Image

_LOW_PERCENTILE, _HIGH_PERCENTILE = 0.5, 99.5
# Room left beyond the percentiles, as a fraction of their distance, so that little saturates.
_HEADROOM = 0.25
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

    def __call__(self, image: Image) -> npt.NDArray[np.uint8]:
        """Give the 8-bit picture of an image, same shape.

        NaN and infinities count as the darkest grey.
        """
        if image.dtype == np.uint8:
            return image
        step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / _SAMPLES)))
        samples = image[::step, ::step].astype(np.float32).ravel()
        samples = samples[np.isfinite(samples)]
        low, high = self._follow(samples)
        values = image.astype(np.float32)
        if image.dtype.kind == "f":
            values = np.nan_to_num(values, nan=low, posinf=low, neginf=low)
        scale = 255.0 / max(high - low, 1e-6)
        return cv2.convertScaleAbs(np.clip((values - low) * scale, 0.0, 255.0))

    def _follow(self, samples: npt.NDArray[np.float32]) -> tuple[float, float]:
        if not samples.size:
            return self._range or (0.0, 1.0)
        low, high = (float(v) for v in np.percentile(samples, [_LOW_PERCENTILE, _HIGH_PERCENTILE]))
        room = _HEADROOM * (high - low)
        wanted = (low - room, high + room)
        if self._range is None or low > self._range[1] or high < self._range[0]:
            # Nothing seen so far tells anything of this picture.
            self._range = wanted
        old = self._range
        self._range = (
            old[0] + _ADAPTATION * (wanted[0] - old[0]),
            old[1] + _ADAPTATION * (wanted[1] - old[1]),
        )
        return self._range
