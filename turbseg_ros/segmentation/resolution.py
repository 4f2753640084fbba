"""The sizes that a frame is worked on at."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from turbseg_ros.arrays import Matrix
from turbseg_ros.segmentation.geometry import scaling

# Flow needs so many pixels each way.
_MIN_SIDE = 16


def pixels_of(width: int) -> float:
    """Return how many pixels a 16:9 picture of a width has."""
    return width**2 * 9 / 16


@dataclass(frozen=True)
class Resolution:
    """The sizes (width, height) a frame is worked on: as it came, for flow, for outlines."""

    input: tuple[int, int]
    processing: tuple[int, int]
    detail: tuple[int, int]

    @classmethod
    def of(cls, shape: tuple[int, ...], processing_width: int, detail_width: int) -> Resolution:
        """Choose the sizes for an image of `shape`.

        Both widths are those of a 16:9 picture; others get the same number of pixels. Flow is
        always computed at that size, a small image is enlarged for it; outlines are drawn at the
        detail size or, when that is smaller, at the input's.
        """
        height, width = shape[:2]

        def scaled(pixels: float) -> tuple[int, int]:
            scale = np.sqrt(pixels / (width * height))
            # A strip is widened for flow to fit in, at the cost of its length.
            longest = round(pixels) // _MIN_SIDE
            x, y = (
                min(max(round(side * scale), _MIN_SIDE), max(longest, _MIN_SIDE))
                for side in (width, height)
            )
            return x, y

        return cls(
            input=(width, height),
            processing=scaled(pixels_of(processing_width)),
            detail=scaled(min(pixels_of(detail_width), width * height)),
        )

    @property
    def detail_from_processing(self) -> tuple[float, float]:
        """Factors in x and y from processing to detail pixels."""
        return (
            self.detail[0] / self.processing[0],
            self.detail[1] / self.processing[1],
        )

    def to_detail(self, transform: Matrix) -> Matrix:
        """Return a transform between processing images as one between detail images."""
        scale, inverse = self._scales
        result: Matrix = scale @ transform @ inverse
        return result

    @functools.cached_property
    def _scales(self) -> tuple[Matrix, Matrix]:
        """What takes processing pixels to detail pixels, and its inverse."""
        scale = scaling(*self.detail_from_processing)
        return scale, np.asarray(np.linalg.inv(scale))

    def tilt_in_detail(self, tilt: float) -> float:
        """Return a tilt in processing pixels as one in detail pixels, 0 for one not measured."""
        return 0.0 if np.isnan(tilt) else tilt * self.detail_from_processing[0]

    @property
    def detail_shape(self) -> tuple[int, int]:
        """Rows and columns at detail resolution."""
        return self.detail[1], self.detail[0]

    @property
    def processing_shape(self) -> tuple[int, int]:
        """Rows and columns at processing resolution."""
        return self.processing[1], self.processing[0]
