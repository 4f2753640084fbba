"""Where something is in the next frame, told by its picture.

What has just come into view, or is too fast for flow, stands out but has no velocity, and the
middle of its outline jumps when a shadow or a neighbour is outlined with it. Its picture is
looked for by normalised cross-correlation instead (Lewis, Fast Normalized Cross-Correlation,
1995), which changes of light leave as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Matrix, Point
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import transformed_point

# Detail pixels of the surroundings that count: the rim of what is plain tells where it is.
_RIM = 2
# Pixels at which a picture is looked for, at most: a larger one is reduced.
_PIXELS = 1000
# How far it is looked for, in diagonals of its box: as far as a detection may lie off.
_REACH = 0.6
# Least contrast in grey values, and least number of pixels, that tell one place from another.
_MIN_CONTRAST, _MIN_PIXELS = 3.0, 12
SAME, SURELY_SAME = 0.6, 0.8
"""Correlations from which on it may be, and surely is, the same thing."""


@dataclass(frozen=True)
class Template:
    """Which pixels of a frame count, and what their box of it showed in grey, hxw."""

    outline: CroppedMask
    picture: ByteImage

    @classmethod
    def of(cls, outline: CroppedMask, image: ByteImage) -> Template:
        """Return the template of what an outline holds in a frame, HxWxC."""
        whole = outline.dilated(_RIM, image.shape[:2])
        return cls(whole, _grey(image[whole.box.slices]))

    def displacement(
        self, image: ByteImage, ego_motion: Matrix, correlation: float = SAME
    ) -> Point | None:
        """Return how far it has moved against the scene, (x, y) in pixels.

        :param image: HxWxC, the frame after the template's.
        :param ego_motion: takes that one's pixels to this one's.
        :param correlation: how like the template it must look there.
        :return: None where it isn't found again: it has changed, is plain, or leaves the view.
        """
        box = self.outline.box
        height, width = box.shape
        middle = np.array([box.x0 + width / 2.0, box.y0 + height / 2.0])
        scene = transformed_point(ego_motion, middle) - middle
        dx, dy = np.rint(scene).astype(int).tolist()
        reach = int(_REACH * np.hypot(height, width)) + _RIM
        there = box.moved(dx, dy).padded(reach, image.shape[:2])
        ratio = max(float(np.sqrt(height * width / _PIXELS)), 1.0)
        size = max(round(width / ratio), 1), max(round(height / ratio), 1)
        scale = np.array([size[0] / width, size[1] / height])
        picture = cv2.resize(self.picture, size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(self.outline.mask.view(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        rows, columns = there.shape
        searched = round(columns * scale[0]), round(rows * scale[1])
        if (
            not _tells_places_apart(picture, mask)
            or searched[0] < size[0]
            or searched[1] < size[1]
        ):
            return None
        reduced = cv2.resize(_grey(image[there.slices]), searched, interpolation=cv2.INTER_AREA)
        alike = cv2.matchTemplate(reduced, picture, cv2.TM_CCOEFF_NORMED, mask=mask)
        # Where a place is plain, OpenCV divides by nothing.
        alike[~(np.abs(alike) <= 1.001)] = -1.0
        place = _peak(alike, correlation)
        if place is None:
            return None
        corner = np.array([there.x0, there.y0]) + place / scale
        return np.asarray(corner - (box.x0, box.y0) - scene)


def _grey(image: ByteImage) -> ByteImage:
    """Return a part of a frame, hxwxC, in grey, hxw: colour tells little more, and costs time."""
    if image.shape[2] == 1:
        return image[..., 0].copy()
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def _tells_places_apart(picture: ByteImage, mask: ByteImage) -> bool:
    """Whether a picture's pixels that count, hxw each, are enough and not all alike."""
    pixels = picture[mask > 0]
    return len(pixels) >= _MIN_PIXELS and float(pixels.std()) >= _MIN_CONTRAST


def _peak(correlation: Map, least: float) -> Point | None:
    """Return where a map of correlations, hxw, is highest, (x, y); None if that is too little."""
    _, highest, _, (x, y) = cv2.minMaxLoc(correlation)
    if highest < least:
        return None
    return np.array([x + _offset(correlation[y], x), y + _offset(correlation[:, x], y)])


def _offset(values: npt.NDArray[np.float32], highest: int) -> float:
    """Return how far the top of a parabola through the highest value and its neighbours lies."""
    if not 0 < highest < len(values) - 1:
        return 0.0
    before, here, after = values[highest - 1 : highest + 2].tolist()
    curvature = before - 2.0 * here + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
