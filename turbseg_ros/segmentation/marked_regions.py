"""Regions that a user has marked in the picture: where objects are looked for, and where not.

They stay where they are in the picture, whatever the camera does. An object that is known goes on
being tracked where it passes through an ignored one, and keeps its id; it is not reported there.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Map, Mask
from turbseg_ros.parameters import ParameterError
from turbseg_ros.segmentation.clutter import enlarged
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask, union_mask
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Detection

# Share of an object by which it lies in a region.
_MOSTLY = 0.5
# Share by which the sides' proportions may differ between pictures of one view.
_MAX_STRETCH = 0.02
# OpenCV takes sub-pixel positions as integers with this many fractional bits.
_SHIFT = 4

Corners = npt.NDArray[np.float64]
"""Nx2: (x, y) of a closed line's corners."""
Size = tuple[int, int]
"""Width and height in pixels."""


@dataclass(frozen=True)
class Limits:
    """What an object must keep to be reported: its box's longer side in pixels, and its speed.

    The speed is in pixels a second against the scene; where the frames' rate is not known, it is
    not judged.
    """

    min_size: float = 0.0
    max_size: float = float("inf")
    min_speed: float = 0.0

    def scaled(self, factor: float) -> Limits:
        """Return them in pixels of a picture so many times as wide."""
        return Limits(self.min_size * factor, self.max_size * factor, self.min_speed * factor)

    def hold(self, size: float, speed: float | None) -> bool:
        """Whether they hold for an object; `speed` is None where it is not known."""
        fast = speed is None or speed >= self.min_speed
        return fast and self.min_size <= size <= self.max_size


class Shape(Protocol):
    """What of the picture is marked, at whatever size the picture comes."""

    @property
    def size(self) -> Size | None:
        """The size of the picture that it was marked in; None: of any."""

    def mask(self, size: Size) -> Mask:
        """Return what is marked in a picture of a size, HxW."""

    def contours(self, size: Size) -> list[Corners]:
        """Return its border in pixels of a picture of a size."""


@dataclass(frozen=True, eq=False)
class Polygon:
    """A closed line; `corners` are in fractions of the picture's width and height, Nx2."""

    corners: Corners
    size: Size | None = None

    def mask(self, size: Size) -> Mask:
        """Return what is marked; see `Shape`."""
        (pixels,) = self.contours(size)
        drawn = _filled(pixels, size)
        # A sliver at the border may lie beyond the last pixels' centres.
        return drawn if drawn.any() else _filled(np.clip(pixels, 0, np.array(size) - 1), size)

    def contours(self, size: Size) -> list[Corners]:
        """Return its border; see `Shape`."""
        # Pixel centres lie at whole numbers, so that the picture begins half a pixel before 0.
        return [self.corners * size - 0.5]


def _filled(pixels: Corners, size: Size) -> Mask:
    drawn = np.zeros((size[1], size[0]), np.uint8)
    cv2.fillPoly(drawn, [np.rint(pixels * (1 << _SHIFT)).astype(np.int32)], 1, 8, _SHIFT)
    return drawn > 0


@dataclass(frozen=True, eq=False)
class MaskPicture:
    """Pixels of a picture, `pixels`: HxW."""

    pixels: Mask

    @property
    def size(self) -> Size:
        """The picture's size; see `Shape`."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def mask(self, size: Size) -> Mask:
        """Return what is marked; see `Shape`."""
        white = self.pixels.view(np.uint8) * np.uint8(255)
        return cv2.resize(white, size, interpolation=cv2.INTER_AREA) > 127

    def contours(self, size: Size) -> list[Corners]:
        """Return its borders; see `Shape`."""
        found, _ = cv2.findContours(
            self.mask(size).view(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE
        )
        return [contour.reshape(-1, 2).astype(np.float64) for contour in found]


@dataclass(frozen=True)
class MarkedRegion:
    """A region of the picture: `ignored`, or one of those in which objects are looked for.

    `name` is for people, `source` what messages call where it was read.
    """

    name: str
    ignored: bool
    shape: Shape
    limits: Limits = Limits()
    source: str = ""


@dataclass(frozen=True)
class MarkedRegions:
    """All that a user has marked; nothing: objects are looked for everywhere."""

    marked: tuple[MarkedRegion, ...] = ()

    def fitted(self, resolution: Resolution) -> FittedRegions:
        """Return them for pictures of the input's size.

        :raises ParameterError: when one was marked in pictures of other proportions, or nothing
            is left to look at.
        """
        self.ignored(resolution.input)
        return FittedRegions(self.marked, resolution)

    def ignored(self, size: Size) -> Mask:
        """Return where nothing is looked for in pictures that come at a size, HxW.

        :raises ParameterError: as `fitted` does.
        """
        for region in self.marked:
            marked_in = region.shape.size
            if marked_in is not None and not _same_view(marked_in, size):
                raise ParameterError(
                    f"{region.source}: {marked_in[0]}x{marked_in[1]} pixels, which images "
                    f"of {size[0]}x{size[1]} can't be, scaled or not"
                )
        ignored = _ignored(self.marked, size)
        if ignored.all():
            sources = ", ".join(dict.fromkeys(region.source for region in self.marked))
            raise ParameterError(f"{sources}: nothing of the picture is left to look at")
        return ignored


def _ignored(marked: Sequence[MarkedRegion], size: Size) -> Mask:
    """Return every ignored region and, where any are to be included, all that lies in none."""
    shape = size[1], size[0]
    included = [region.shape.mask(size) for region in marked if not region.ignored]
    ignored = ~np.logical_or.reduce(included) if included else np.zeros(shape, bool)
    for region in marked:
        if region.ignored:
            ignored |= region.shape.mask(size)
    return ignored


@dataclass(frozen=True, eq=False)
class FittedRegions:
    """What is marked, in pictures as they are worked on."""

    marked: tuple[MarkedRegion, ...]
    resolution: Resolution

    def ignored(self, size: Size) -> Mask:
        """Return where nothing is looked for, in a picture as it is worked on at a size, HxW."""
        return _ignored(self.marked, size)

    def without_seeds(self, noise: Map, objects: Mask) -> Map:
        """Return a motion map's noise, HxW, infinite where nothing may be a seed.

        :param objects: hxw cells that known objects cover, which are followed everywhere.
        """
        if not self.marked:
            return noise
        unseen = self._at_processing & ~enlarged(objects, noise.shape)
        return np.where(unseen, np.float32(np.inf), noise)

    def looked_at(
        self, detections: Sequence[Detection], expected: Sequence[Detection]
    ) -> list[Detection]:
        """Return detections, at detail resolution, without those that mostly are ignored.

        :param expected: known objects as they should be, which are followed everywhere.
        """
        if not self.marked:
            return list(detections)
        known = union_mask([each.outline for each in expected], self.resolution.detail_shape)
        return [
            detection
            for detection in detections
            if detection.outline.intersection_area(self._at_detail) <= _MOSTLY * detection.area
            or detection.outline.intersection_area(known)
        ]

    def reported(self, outline: CroppedMask, speed: float | None) -> CroppedMask | None:
        """Return what of an object, at the input's resolution, is reported; None for nothing.

        :param speed: in pixels a second against the scene, None where it is not known.
        """
        if not self.marked:
            return outline
        area = outline.area
        hidden = outline.mask & self._at_input[outline.box.slices]
        if np.count_nonzero(hidden) > _MOSTLY * area:
            return None
        size = max(Box.around(outline.mask).shape)
        for mask, limits in self._limited:
            inside = outline.intersection_area(mask) > _MOSTLY * area
            if inside and not limits.hold(size, speed):
                return None
        return CroppedMask(outline.box, outline.mask & ~hidden)

    @functools.cached_property
    def contours(self) -> list[tuple[MarkedRegion, list[Corners]]]:
        """Each region with its border in pixels of the input."""
        return [(each, each.shape.contours(self.resolution.input)) for each in self.marked]

    @functools.cached_property
    def _at_processing(self) -> Mask:
        return self.ignored(self.resolution.processing)

    @functools.cached_property
    def _at_detail(self) -> Mask:
        return self.ignored(self.resolution.detail)

    @functools.cached_property
    def _at_input(self) -> Mask:
        return self.ignored(self.resolution.input)

    @functools.cached_property
    def _limited(self) -> list[tuple[Mask, Limits]]:
        """Where which limits hold, in pixels of the input."""
        width = self.resolution.input[0]
        return [
            (
                region.shape.mask(self.resolution.input),
                region.limits.scaled(width / region.shape.size[0] if region.shape.size else 1.0),
            )
            for region in self.marked
            if region.limits != Limits()
        ]


def _same_view(one: Size, other: Size) -> bool:
    """Whether pictures of two sizes can be one view, scaled."""
    across, down = one[0] / other[0], one[1] / other[1]
    return abs(across / down - 1.0) <= _MAX_STRETCH
