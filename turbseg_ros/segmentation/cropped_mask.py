"""Masks that hold something in a small part of a frame: the box around them and what is within.

All that is done to one costs as much as it is large, whatever the frame's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Mask, Matrix
from turbseg_ros.segmentation.geometry import scaling, translation


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels: columns x0 to x1 - 1, rows y0 to y1 - 1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y1 - self.y0, self.x1 - self.x0

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index that cuts the box out of an image."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def padded(self, margin: int, shape: tuple[int, int]) -> Box:
        """Return the box with `margin` more on each side, within an image of `shape`."""
        return Box(
            max(self.x0 - margin, 0),
            max(self.y0 - margin, 0),
            min(self.x1 + margin, shape[1]),
            min(self.y1 + margin, shape[0]),
        )

    def moved(self, dx: int, dy: int) -> Box:
        """Return the box that lies (dx, dy) further."""
        return Box(self.x0 + dx, self.y0 + dy, self.x1 + dx, self.y1 + dy)

    def transformed(self, transform: Matrix, shape: tuple[int, ...]) -> Box:
        """Return the box around where a transform takes it, within an image of `shape`.

        :param transform: 3x3, affine.
        """
        (a, b, c), (d, e, f) = transform[:2].tolist()
        # Numbers of Python's: NumPy takes longer for four corners than OpenCV for the pixels.
        corners = [(x - 0.5, y - 0.5) for x in (self.x0, self.x1) for y in (self.y0, self.y1)]
        across = [a * x + b * y + c for x, y in corners]
        down = [d * x + e * y + f for x, y in corners]
        return Box(
            min(max(math.floor(min(across)), 0), shape[1]),
            min(max(math.floor(min(down)), 0), shape[0]),
            min(max(math.ceil(max(across)) + 1, 0), shape[1]),
            min(max(math.ceil(max(down)) + 1, 0), shape[0]),
        )

    def intersection(self, other: Box) -> Box | None:
        """Return what two boxes have in common, None if nothing."""
        box = Box(
            max(self.x0, other.x0),
            max(self.y0, other.y0),
            min(self.x1, other.x1),
            min(self.y1, other.y1),
        )
        return box if box.x0 < box.x1 and box.y0 < box.y1 else None

    def gap(self, other: Box) -> float:
        """Return the distance between two boxes in pixels, 0 where they overlap."""
        across = max(self.x0 - other.x1, other.x0 - self.x1, 0)
        down = max(self.y0 - other.y1, other.y0 - self.y1, 0)
        return float(np.hypot(across, down))

    @classmethod
    def of_rectangle(cls, rectangle: Sequence[int]) -> Box:
        """Return what OpenCV gives as (x, y, width, height)."""
        x, y, width, height = rectangle
        return cls(x, y, x + width, y + height)

    @classmethod
    def around(cls, mask: Mask) -> Box:
        """Return the smallest box around what a mask holds, one of no size around nothing."""
        if not mask.size:
            return cls(0, 0, 0, 0)
        return cls.of_rectangle(cv2.boundingRect(mask.view(np.uint8)))


@dataclass(frozen=True)
class CroppedMask:
    """What was cut out: a box of the frame and the mask within it, which may be nothing."""

    box: Box
    mask: Mask

    @classmethod
    def of(cls, mask: Mask, x0: int = 0, y0: int = 0) -> CroppedMask:
        """Take what a mask holds, whose first pixel is (x0, y0) of the frame."""
        box = Box.around(mask)
        return cls(box.moved(x0, y0), mask[box.slices])

    @property
    def area(self) -> int:
        """Number of its pixels."""
        return int(np.count_nonzero(self.mask))

    def in_frame(self, shape: tuple[int, int]) -> Mask:
        """Return the mask in a frame of some shape, HxW."""
        return union_mask([self], shape)

    def within(self, box: Box) -> Mask:
        """Return what of it lies in a box of the frame, a mask of the box's shape."""
        mask = np.zeros(box.shape, bool)
        common = self.box.intersection(box)
        if common is not None:
            here = common.moved(-self.box.x0, -self.box.y0).slices
            mask[common.moved(-box.x0, -box.y0).slices] = self.mask[here]
        return mask

    def intersection_area(self, mask: Mask) -> int:
        """Count its pixels that a mask of the whole frame, HxW, has too."""
        return int(np.count_nonzero(self.mask & mask[self.box.slices]))

    def shares_pixels(self, other: CroppedMask) -> bool:
        """Whether two masks of one frame have a pixel in common."""
        return self.common_area(other) > 0

    def common_area(self, other: CroppedMask) -> int:
        """Count the pixels that two masks of one frame have in common."""
        common = self.box.intersection(other.box)
        if common is None:
            return 0
        here = self.mask[common.moved(-self.box.x0, -self.box.y0).slices]
        there = other.mask[common.moved(-other.box.x0, -other.box.y0).slices]
        return int(np.count_nonzero(here & there))

    def iou(self, other: CroppedMask) -> float:
        """Return the intersection over union of two masks of one frame, 0 of empty ones."""
        common = self.common_area(other)
        return common / max(self.area + other.area - common, 1)

    def dilated(self, radius: int, shape: tuple[int, int]) -> CroppedMask:
        """Return it with some pixels more all round, within a frame of some shape."""
        box, mask = self._with_margin(radius, shape)
        size = (2 * radius + 1, 2 * radius + 1)
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size)
        return CroppedMask(box, cv2.dilate(mask, kernel) > 0)

    def eroded(self, radius: int, shape: tuple[int, int]) -> CroppedMask:
        """Return it with some pixels less all round, but where the frame of some shape ends."""
        box, mask = self._with_margin(radius, shape)
        left = cv2.erode(mask, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)) > 0
        return CroppedMask.of(left, box.x0, box.y0)

    def resampled(
        self, transform: Matrix, shape: tuple[int, int], interpolation: int
    ) -> CroppedMask:
        """Return it in the pixels of another image of some shape, whole or what is in there.

        :param transform: 3x3, affine: takes the outline's frame to that image.
        """
        here, there = self.box, self.box.transformed(transform, shape)
        height, width = there.shape
        if not (self.mask.size and height and width):
            return EMPTY_MASK
        mask = cv2.warpAffine(
            self.mask.view(np.uint8) * np.uint8(255),
            (translation(-there.x0, -there.y0) @ transform @ translation(here.x0, here.y0))[:2],
            (width, height),
            flags=interpolation,
        )
        return CroppedMask(there, mask > 127)

    def resized(self, size: tuple[int, int], frame: tuple[int, int]) -> CroppedMask:
        """Return it in an image of another size (width, height) than its frame's."""
        transform = scaling(size[0] / frame[0], size[1] / frame[1])
        return self.resampled(transform, size[::-1], cv2.INTER_LINEAR)

    def _with_margin(
        self, margin: int, shape: tuple[int, int]
    ) -> tuple[Box, npt.NDArray[np.uint8]]:
        """Return a box with so many pixels more on each side, in the frame, and the mask in it."""
        box = self.box.padded(margin, shape)
        mask = np.zeros(box.shape, np.uint8)
        mask[self.box.moved(-box.x0, -box.y0).slices] = self.mask
        return box, mask


EMPTY_MASK = CroppedMask(Box(0, 0, 0, 0), np.zeros((0, 0), bool))
"""The outline of nothing."""


def union_mask(outlines: Iterable[CroppedMask], shape: tuple[int, int]) -> Mask:
    """Return the union of outlines in a frame of some shape, HxW."""
    frame = np.zeros(shape, bool)
    for outline in outlines:
        frame[outline.box.slices] |= outline.mask
    return frame


def convex_hull(outlines: Sequence[CroppedMask]) -> CroppedMask:
    """Fill the convex hull of outlines of one frame."""
    points = [
        points
        for outline in outlines
        for points in cv2.findContours(
            outline.mask.astype(np.uint8),
            cv2.RETR_EXTERNAL,
            cv2.CHAIN_APPROX_SIMPLE,
            offset=(outline.box.x0, outline.box.y0),
        )[0]
    ]
    if not points:
        return EMPTY_MASK
    corners = cv2.convexHull(np.vstack(points))
    box = Box.of_rectangle(cv2.boundingRect(corners))
    hull = np.zeros(box.shape, np.uint8)
    cv2.fillConvexPoly(hull, corners - (box.x0, box.y0), 1)
    return CroppedMask(box, hull > 0)
