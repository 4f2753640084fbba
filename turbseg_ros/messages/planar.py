"""Images whose luma and chroma lie in planes of their own, as video hardware gives them.

All are 8-bit Y'CbCr of ITU-R BT.601 in video range, as OpenCV takes them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage

# Y', Cb, Cr in video range to B, G, R (BT.601), the constant last.
_COLOURS = np.array([[1.164, 2.018, 0.0], [1.164, -0.391, -0.813], [1.164, 0.0, 1.596]])
_BGR_FROM_YUV = np.column_stack([_COLOURS, -_COLOURS @ [16.0, 128.0, 128.0]])


@dataclass(frozen=True)
class PlanarLayout:
    """Where chroma lies behind the rows of luma, which are `step` bytes apart.

    There are `rows` rows of it for each of luma, `pitch` times as long. `conversion` is OpenCV's;
    without one, chroma is as large as luma, Cb and Cr in turn.
    """

    rows: float
    pitch: float
    conversion: int | None = None

    @property
    def is_subsampled(self) -> bool:
        """Whether two by two pixels share their chroma, so that width and height are even."""
        return self.conversion is not None

    def size(self, width: int, height: int, step: int) -> int:
        """Return the bytes that a picture takes, without the padding of its last row."""
        chroma_rows = int(self.rows * height)
        return height * step + (chroma_rows - 1) * int(self.pitch * step) + int(self.pitch * width)

    def to_bgr(self, data: ByteImage, width: int, height: int, step: int) -> ByteImage:
        """Return the picture in `data`, a vector of `size` bytes at least, as HxWx3 (BGR)."""
        luma = _rows(data, height, width, step)
        chroma = _rows(
            data[height * step :],
            *(int(self.rows * height), int(self.pitch * width), int(self.pitch * step)),
        )
        if self.conversion is None:
            pixels = np.dstack([luma, chroma.reshape(height, width, 2)])
            return np.asarray(cv2.transform(pixels, _BGR_FROM_YUV))
        planes = np.concatenate([luma, chroma.reshape(height // 2, width)])
        return np.asarray(cv2.cvtColor(planes, self.conversion))


def _rows(data: ByteImage, height: int, width: int, step: int) -> ByteImage:
    return np.ndarray((height, width), np.uint8, data, 0, (step, 1))


_I420 = PlanarLayout(1.0, 0.5, cv2.COLOR_YUV2BGR_I420)

# By name in small letters: drivers write them either way.
PLANAR_LAYOUTS = {
    "nv12": PlanarLayout(0.5, 1.0, cv2.COLOR_YUV2BGR_NV12),
    "nv21": PlanarLayout(0.5, 1.0, cv2.COLOR_YUV2BGR_NV21),
    "nv24": PlanarLayout(1.0, 2.0),
    "i420": _I420,
    "iyuv": _I420,
    "yuv420": _I420,
    "yuv420p": _I420,
    "yv12": PlanarLayout(1.0, 0.5, cv2.COLOR_YUV2BGR_YV12),
}
