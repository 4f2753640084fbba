"""A place where an object stands: what was there before it came, and what shows there now.

What was there before is kept as views of that place alone, aligned to one frame, its reference,
and carried on by the camera's motion. So it outlasts the window's frames, all of which show the
object after a while.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.background import (
    AlignedFrame,
    Background,
    MaskedImage,
    background_in,
    cut_out,
)
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.exposure import ColourExposure, exposure_of_pixels
from turbseg_ros.segmentation.geometry import pixel_grid, scaling, translation, upper_median
from turbseg_ros.segmentation.occlusion import difference_beyond

# Rows and columns that a place is looked at with at most, and the share of the object's size, and
# the detail pixels, that it reaches beyond the object.
_SIDE, _MARGIN, _MIN_MARGIN = 160, 0.4, 16
# Views of it that are kept, and the share of the object's pixels that may be hidden in one.
_VIEWS, _HIDDEN_SHARE = 8, 0.7
# Grey values, and standard deviations of the place, by which two pictures of it differ.
_DIFFERENT, _DIFFERENT_SIGMA = 4.0, 3.0
# Share of an object's pixels, and their number, that must tell it from what was there before.
_TELLING, _MIN_TELLING = 0.25, 20
# A pixel shows the object when that explains it so much better than what was there before.
_BETTER = 0.5
# Share of the telling pixels that decides what a place shows, and from which it is all of it.
_MOST, _WHOLE = 0.5, 0.9
# Pixels around an object that show nothing of what is beside it.
_GUARD = 5


class Sight(enum.Enum):
    """What a place shows of the object that stood there."""

    WHOLE = "whole"
    """The object, all of it."""
    OBJECT = "object"
    """The object, most of it."""
    BEFORE = "before"
    """What was there before it came."""
    OTHER = "other"
    """Neither: something hides it."""


@dataclass(frozen=True)
class Place:
    """A place in the scene, as a frame sees it.

    `box` is a part of the reference frame, `to_reference` takes the pixels of the frame at hand to
    the reference's. `views` are what other frames showed in the box, each hxwx(C+1), `before` is
    the background by them, hxwxC; `picture`, hxwxC, is what the box showed when the object was
    seen there last, whose outline is in the reference frame. `exposure` and `exposure_then` take
    the values from before to those of the frame at hand and of the picture; `hidden` is which
    pixels, hxw, show something else there.
    """

    box: Box
    to_reference: Matrix
    views: Sequence[MaskedImage]
    before: Background
    picture: ByteImage
    outline: CroppedMask
    exposure: ColourExposure
    exposure_then: ColourExposure
    hidden: Mask

    @classmethod
    def of(
        cls, outline: CroppedMask, image: ByteImage, views: Sequence[AlignedFrame]
    ) -> Place | None:
        """Return the place of an object; None where what was there before doesn't tell it.

        :param outline: the object.
        :param image: HxWxC, the frame that shows it, which becomes the reference.
        :param views: other frames that may show the place without it, as seen from there.
        """
        margin = max(round(_MARGIN * max(outline.box.shape)), _MIN_MARGIN)
        box = outline.box.padded(margin, (image.shape[0], image.shape[1]))
        shape = min(box.shape[0], _SIDE), min(box.shape[1], _SIDE)
        kept = _showing(cut_out(views, box, shape), _at(outline, box, shape))
        if not kept:
            return None
        there = Box(0, 0, shape[1], shape[0])
        before = background_in(there, [AlignedFrame(each, np.eye(3)) for each in kept])
        channels = image.shape[2]
        place = cls(
            box,
            np.eye(3),
            kept,
            before,
            np.zeros((*shape, channels), np.uint8),
            outline,
            ColourExposure.as_it_is(channels),
            ColourExposure.as_it_is(channels),
            np.zeros(shape, bool),
        )
        place = replace(place, picture=place._shown(image))
        telling = np.count_nonzero(place._telling(reach=1))
        if telling < max(_TELLING * np.count_nonzero(place._mask), _MIN_TELLING):
            return None
        return place

    def seen_from(self, motion: Matrix) -> Place:
        """Return it as another frame sees it.

        :param motion: takes the pixels of the frame at hand to that one's.
        """
        return replace(self, to_reference=self.to_reference @ np.linalg.inv(motion))

    def outline_in(self, shape: tuple[int, int]) -> CroppedMask:
        """Return where the object is in the frame at hand, which is of some shape."""
        to_frame = np.asarray(np.linalg.inv(self.to_reference))
        return self.outline.resampled(to_frame, shape, cv2.INTER_NEAREST)

    def hidden_in(self, shape: tuple[int, int]) -> CroppedMask:
        """Return where something hides it in the frame at hand, which is of some shape."""
        to_frame = np.asarray(np.linalg.inv(self._to_place @ self.to_reference))
        return CroppedMask.of(self.hidden).resampled(to_frame, shape, cv2.INTER_LINEAR)

    def with_outline(self, outline: CroppedMask, shape: tuple[int, int]) -> Place | None:
        """Return it with another outline, in the frame at hand; None where that leaves it.

        :param shape: of the reference frame.
        """
        there = outline.resampled(self.to_reference, shape, cv2.INTER_NEAREST)
        if not there.area or self.box.intersection(there.box) != there.box:
            return None
        return replace(self, outline=there)

    def aligned_views(self) -> list[AlignedFrame]:
        """Return what was there before as the frame at hand sees it."""
        to_view = self._to_place @ self.to_reference
        return [AlignedFrame(view, to_view, self.exposure) for view in self.views]

    def with_picture(self, image: ByteImage) -> Place:
        """Return it with what the frame at hand, HxWxC, shows there as the object's picture."""
        if not self._visible(image).all():
            return self
        return replace(self, picture=self._shown(image), exposure_then=self.exposure)

    def look(self, image: ByteImage, tilt: float) -> tuple[Sight, Place]:
        """Return what it shows in the frame at hand, and what is known of it then.

        :param image: HxWxC, the frame.
        :param tilt: rms turbulent motion an axis in pixels.
        """
        shown, seen = self._shown(image), self._visible(image)
        exposure = self._exposure_to(shown, seen)
        place = replace(self, exposure=exposure)
        reach = 1 + round(tilt * self._scale)
        telling = place._telling(reach) & seen
        count = np.count_nonzero(telling)
        if count < _MIN_TELLING:
            return Sight.OTHER, place
        before = self.before.median.astype(np.uint8)
        exposed = exposure.applied_to(before, before.shape[2])
        from_before = difference_beyond(shown, exposed, reach)
        since = exposure.since(self.exposure_then)
        pictured = since.applied_to(self.picture, self.picture.shape[2])
        from_object = difference_beyond(shown, pictured, reach)
        like_object = telling & (from_object < _BETTER * from_before)
        like_before = telling & (from_before < _BETTER * place._level)
        place = replace(place, hidden=_opened(from_object > place._level))
        share = np.count_nonzero(like_object) / count
        if share > _MOST:
            return (Sight.WHOLE if share > _WHOLE else Sight.OBJECT), place
        gone = np.count_nonzero(like_before) > _MOST * count
        return (Sight.BEFORE if gone else Sight.OTHER), place

    @property
    def _shape(self) -> tuple[int, int]:
        return self.picture.shape[0], self.picture.shape[1]

    @property
    def _scale(self) -> float:
        """How many pixels of the place a pixel of the frame makes."""
        return self._shape[1] / self.box.shape[1]

    @property
    def _to_place(self) -> Matrix:
        """What takes the reference's pixels to the place's."""
        return _to_cut(self.box, self._shape)

    @property
    def _mask(self) -> Mask:
        """Where the object is, hxw."""
        return _at(self.outline, self.box, self._shape)

    @property
    def _level(self) -> float:
        """Grey values by which pictures of the place differ."""
        known = self.before.spread[self.before.known]
        usual = upper_median(known.ravel()) if known.size else 0.0
        return max(_DIFFERENT, _DIFFERENT_SIGMA * usual)

    def _telling(self, reach: int) -> Mask:
        """Return where the object differs from what was there before, hxw."""
        before = self.before.median.astype(np.uint8)
        then = self.exposure_then.applied_to(before, before.shape[2])
        difference = difference_beyond(self.picture, then, reach)
        return self._mask & self.before.known & (difference > self._level)

    def _shown(self, image: ByteImage) -> ByteImage:
        """Return what a frame shows there, hxwxC."""
        to_place = self._to_place @ self.to_reference
        height, width = self._shape
        to_frame = np.asarray(np.linalg.inv(to_place))
        there = Box(0, 0, width, height).transformed(to_frame, image.shape)
        shown = np.zeros_like(self.picture)
        if 0 not in there.shape:
            # OpenCV copies all of a picture whose channels are a part of another's.
            cut, from_cut = image[there.slices], to_place @ translation(there.x0, there.y0)
            shown = cv2.warpAffine(cut, from_cut[:2], (width, height), flags=cv2.INTER_LINEAR)
        return np.asarray(shown.reshape(self.picture.shape), np.uint8)

    def _visible(self, image: ByteImage) -> Mask:
        """Return which of its pixels lie in a frame, hxw."""
        to_frame = np.asarray(np.linalg.inv(self._to_place @ self.to_reference))
        there = cv2.transform(pixel_grid(self._shape), to_frame[:2])
        size = np.array([image.shape[1] - 1, image.shape[0] - 1], np.float32)
        return np.asarray(((there >= 0.0) & (there <= size)).all(axis=2))

    def _exposure_to(self, shown: ByteImage, seen: Mask) -> ColourExposure:
        """Return what takes the values from before to those of the frame, by what lies beside.

        Where that is hidden, too, it is as it was.
        """
        guard = np.ones((2 * _GUARD + 1, 2 * _GUARD + 1), np.uint8)
        beside = cv2.dilate(self._mask.view(np.uint8), guard) == 0
        beside &= seen & self.before.known
        before = self.before.median[beside].astype(np.uint8)[:, None]
        now = shown[beside][:, None]
        if not now.size:
            return self.exposure
        found = exposure_of_pixels(before, now)
        off = cv2.absdiff(found.applied_to(before, before.shape[2]), now).reshape(before.shape)
        fits = np.mean(off.max(axis=2) < self._level) > _MOST
        return found if fits else self.exposure


def _to_cut(box: Box, shape: tuple[int, int]) -> Matrix:
    """Return what takes a frame's pixels to those of a box of it, cut out at some shape."""
    scale = scaling(shape[1] / box.shape[1], shape[0] / box.shape[0])
    return np.asarray(scale @ translation(-box.x0, -box.y0))


def _at(outline: CroppedMask, box: Box, shape: tuple[int, int]) -> Mask:
    """Return an outline within a box of its frame, cut out at some shape, hxw."""
    return outline.resampled(_to_cut(box, shape), shape, cv2.INTER_NEAREST).in_frame(shape)


def _showing(views: Sequence[MaskedImage], mask: Mask) -> list[MaskedImage]:
    """Return the views that show most of what a mask, hxw, covers."""
    shares = [_hidden_share(view, mask) for view in views]
    order = sorted(range(len(views)), key=lambda number: shares[number])
    return [views[number] for number in order[:_VIEWS] if shares[number] < _HIDDEN_SHARE]


def _opened(mask: Mask) -> Mask:
    kernel = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def _hidden_share(view: MaskedImage, mask: Mask) -> float:
    hidden = view.image[..., -1][mask] > 127
    return float(np.mean(hidden)) if hidden.size else 1.0
