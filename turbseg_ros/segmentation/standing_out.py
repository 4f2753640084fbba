"""What stands out from the scene's own past: proposals beside the motion map.

Optical flow misses what goes further from frame to frame than it follows, and what is plain or
lies before a plain scene. But a scene that was seen without it tells: each frame is compared, at
a reduced size, with the median of others. What always changes, such as leaves and water, edges
that jitter, and a scene that lies aside or in another light are explained away; at what differs
all the same outlines are looked for. Whether it travels, and so is an object, the tracker finds
out.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import (
    AlignedFrame,
    MaskedImage,
    calm_background_in,
    cut_out,
    without_last,
)
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, Box, CroppedMask
from turbseg_ros.segmentation.geometry import corner_displacement, scaling

# Pixels of the reduced size at which frames are compared, and the views that are.
_PIXELS, _VIEWS = 20000, 8
# Widths of the picture by which a view may lie aside.
_NEAR = 0.05
# Fewer views than that make no past.
_MIN_VIEWS = 5
# Grey values that a mean over a pixel of the reduced size may be off by.
_MIN_NOISE = 1.5
# Pixels at detail resolution by which registration may be off, besides the tilt; share of the
# range of grey values nearby by which an edge may look another one.
_REGISTRATION, _SHIMMER = 1.0, 0.05
# Standard deviations by which what lies beside something that surely stands out belongs to it; the
# other does by twice as much, in that many pixels of the reduced size.
_ALSO, _MIN_SURE = 3.0, 4
# Pixels at detail resolution by which a past that lies aside is taken as it is; what lies out of
# view differs by nothing.
_SAME, _UNSEEN_DARK, _UNSEEN_BRIGHT = 0.25, (0, 0, 0), (255, 255, 255)
# Share of the picture above which it isn't an object that stands out: the past doesn't fit.
_MOST = 0.4
# Areas that are proposed, the largest.
_AREAS = 12
# Share of what stands out that is looked at anyway from which on it isn't proposed.
_LOOKED_AT = 0.6
# Pixels of the reduced size by which the scene may lie aside, and the share of the squared
# difference that is left then.
_ASIDE, _EXPLAINED = 3, 0.25
# Correlation of grey values from which on the scene itself is seen in another light, in that many
# pixels of the reduced size, which must vary by so many grey values.
_SAME_SCENE, _MIN_PIXELS, _MIN_CONTRAST = 0.95, 9, 3.0
# Pixels of the reduced size by which an area is larger than what stands out.
_MARGIN = 2


@dataclass(frozen=True)
class Past:
    """What a scene looked like at other times, as one frame sees it, at a reduced size.

    All are hxwxC, uint8: the `median`, the `lowest` and `highest` grey values nearby, beyond
    which something differs, and the `level` from which that counts. Where nothing is known, no
    difference does. `frame` is the frame's width and height.
    """

    frame: tuple[int, int]
    median: ByteImage
    lowest: ByteImage
    highest: ByteImage
    level: ByteImage

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the reduced size."""
        return self.median.shape[0], self.median.shape[1]

    def seen_from(self, to_frame: Matrix) -> Past:
        """Return it as another frame sees it.

        :param to_frame: takes the other frame's pixels to the frame's.
        """
        if corner_displacement(to_frame, self.frame) < _SAME:
            return self
        height, width = self.shape
        to_reduced = scaling(width / self.frame[0], height / self.frame[1])
        transform = (to_reduced @ to_frame @ np.linalg.inv(to_reduced))[:2]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        median, lowest, highest, level = (
            cv2.warpAffine(values, transform, (width, height), flags=flags, borderValue=beyond)
            for values, beyond in (
                (self.median, _UNSEEN_DARK),
                (self.lowest, _UNSEEN_DARK),
                (self.highest, _UNSEEN_BRIGHT),
                (self.level, _UNSEEN_BRIGHT),
            )
        )
        each = (values.reshape(height, width, -1) for values in (median, lowest, highest, level))
        return Past(self.frame, *each)


def past_in(views: Sequence[AlignedFrame], frame: tuple[int, int], tilt: float) -> Past | None:
    """Return what a frame's scene looked like at other times; None where too little is known.

    :param views: the scene at other times, as the frame sees it.
    :param frame: its width and height.
    :param tilt: rms turbulent motion an axis in pixels.
    """
    views = [view for view in views if _is_near(view, frame)]
    if len(views) < _MIN_VIEWS:
        return None
    width, height = frame
    ratio = max(float(np.sqrt(height * width / _PIXELS)), 1.0)
    shape = round(height / ratio), round(width / ratio)
    background = calm_background_in(Box(0, 0, width, height), _spread_out(views), shape)
    median, spread = (
        np.rint(values).astype(np.uint8) for values in (background.median, background.spread)
    )
    side = 2 * int(np.ceil((tilt + _REGISTRATION) / ratio)) + 1
    nearby = np.ones((side, side), np.uint8)
    lowest, highest = cv2.erode(median, nearby), cv2.dilate(median, nearby)
    noise = np.maximum(cv2.dilate(spread, nearby), np.float32(_MIN_NOISE))
    noise += np.float32(_SHIMMER) * cv2.subtract(highest, lowest)
    level = np.minimum(np.float32(_ALSO) * noise, np.float32(255.0)).astype(np.uint8)
    level, lowest, highest = (each.reshape(median.shape) for each in (level, lowest, highest))
    level[~background.known] = 255
    return Past(frame, median, lowest, highest, level)


def _is_near(view: AlignedFrame, frame: tuple[int, int]) -> bool:
    """Whether a view is from nearly the same place as a frame, of some width and height.

    What lies nearer than the scene would stand out from the others.
    """
    return corner_displacement(view.to_image, frame) < _NEAR * frame[0]


def standing_areas(scene: MaskedImage, past: Past, looked_at: Mask) -> list[MovingArea]:
    """Return where a frame stands out from its past, at detail resolution.

    Nothing is known of what is there but that: its velocity is 0, no part is probably an object.

    :param scene: the frame; what hides it counts as well.
    :param past: as this frame sees it.
    :param looked_at: HxW, where objects are looked for anyway.
    """
    reduced = past.shape[::-1]
    whole = Box(0, 0, *past.frame)
    # Sampled as the past is: edges would differ otherwise.
    (sampled,) = cut_out([AlignedFrame(scene, np.eye(3))], whole, past.shape)
    small = without_last(sampled.image)
    elsewhere = cv2.resize(looked_at.view(np.uint8), reduced, interpolation=cv2.INTER_NEAREST)
    return [
        MovingArea(
            blob.dilated(_MARGIN, past.shape).resized(past.frame, reduced),
            EMPTY_MASK,
            EMPTY_MASK,
            (0.0, 0.0),
        )
        for blob in _blobs(*_standing_out(small, past), elsewhere > 0)
        if not _is_scene_aside(small, past, blob.box)
        and not _is_scene_in_other_light(small, past, blob)
    ]


def _standing_out(image: ByteImage, past: Past) -> tuple[Mask, Mask]:
    """Return what may and what surely does stand out, hxw.

    :param image: hxwxC, the frame at the past's size.
    """
    # cv2.subtract stops at 0.
    beyond = cv2.max(cv2.subtract(image, past.highest), cv2.subtract(past.lowest, image))
    also = cv2.subtract(beyond, past.level)
    return _any_channel(also), _any_channel(cv2.subtract(also, past.level))


def _any_channel(values: ByteImage) -> Mask:
    """Return where any channel isn't 0, hxw."""
    return np.asarray(functools.reduce(cv2.max, cv2.split(values)) > 0)


def _spread_out(views: Sequence[AlignedFrame]) -> Sequence[AlignedFrame]:
    """Return every n-th view, so many that their median is known well enough."""
    return views[:: -(-len(views) // _VIEWS)]


def _blobs(also: Mask, surely: Mask, looked_at: Mask) -> list[CroppedMask]:
    """Return what surely stands out and isn't looked at anyway, the largest first, hxw each."""
    also = cv2.morphologyEx(also.view(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    if np.count_nonzero(also) > _MOST * also.size:
        return []
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(also)
    sure, known = (np.bincount(labels[where], minlength=count) for where in (surely, looked_at))
    area = statistics[:, cv2.CC_STAT_AREA]
    proposed = (sure >= _MIN_SURE) & (known < _LOOKED_AT * area)
    # The first label is that of what doesn't stand out.
    kept = [k for k in np.argsort(-area) if proposed[k] and k][:_AREAS]
    return [_blob(labels, k, statistics[k]) for k in kept]


def _blob(labels: npt.NDArray[np.int32], label: int, row: npt.NDArray[np.int32]) -> CroppedMask:
    box = Box.of_rectangle(row[:4].tolist())
    return CroppedMask(box, labels[box.slices] == label)


def _is_scene_aside(image: ByteImage, past: Past, box: Box) -> bool:
    """Whether the scene, a little aside, is what stands out in a box of the reduced size.

    It is where the camera's motion is told badly, or things lie nearer than what tells it.
    """
    around = box.padded(1, past.shape)
    scene = cv2.copyMakeBorder(past.median, *4 * (_ASIDE,), borderType=cv2.BORDER_REPLICATE)
    there = scene[around.y0 : around.y1 + 2 * _ASIDE, around.x0 : around.x1 + 2 * _ASIDE]
    difference = cv2.matchTemplate(there, image[around.slices], cv2.TM_SQDIFF)
    return bool(difference.min() < _EXPLAINED * difference[_ASIDE, _ASIDE])


def _is_scene_in_other_light(image: ByteImage, past: Past, blob: CroppedMask) -> bool:
    """Whether the scene, brighter or darker than it was, is what stands out.

    So it is in the shadow of a cloud, in a beam, or when a burnt-in banner that lets it through
    comes or fades.
    """
    # The light changes within its rim.
    inside = blob.eroded(1, past.shape)
    here, before = (
        values[inside.box.slices][inside.mask].mean(axis=-1) for values in (image, past.median)
    )
    if here.size < _MIN_PIXELS or min(here.std(), before.std()) < _MIN_CONTRAST:
        return False
    return float(np.corrcoef(here, before)[0, 1]) > _SAME_SCENE
