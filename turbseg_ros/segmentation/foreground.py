"""Cutting objects out of the picture: what moves and stands out from the background."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Mask
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import (
    AlignedFrame,
    Background,
    background_in,
    deviation_from,
    difference_from,
    largest,
    smallest,
)
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask, union_mask
from turbseg_ros.segmentation.motion import MotionEstimate

# Pixels around what moves that are looked at with it.
_MARGIN = 8
# Difference that belongs to an object, as a fraction of the object's usual one: less is blur.
_FRINGE = 0.2
# Width in pixels of the square in which a faint patch is measured by a stronger one.
_NEARBY = 31
# A shadow keeps the colour of what it falls on and most of its light, and is fainter than this
# fraction of the object's usual difference; it covers no more than that share of the whole.
_SHADOW_CONTRAST = 0.65
_SHADOW_LIGHT = (0.3, 0.98)
_SHADOW_COLOUR = 0.15
_SHADOW_SHARE = 0.4
# Share of a moving area whose background must be unknown for colour to be asked, and the most
# pixels that it is asked about, for GrabCut is slow.
_OPEN = 0.03
_MAX_CUT = 20000
_CUT_ITERATIONS = 2
# Gap that may part an object, say by a pole, as a fraction of the root of its largest part's area;
# and the fraction of the largest object's area below which a part of the same area is debris.
_GAP = 0.2
_DEBRIS = 0.1


@dataclass(frozen=True)
class AreaMasks:
    """Where objects are to be looked for in a part of a frame, hxw masks; see `MovingArea`.

    `nearest` marks the pixels that lie nearer to it than to any other area.
    """

    search_mask: Mask
    probable: Mask
    certain: Mask
    nearest: Mask


@dataclass(frozen=True)
class ObjectCrop:
    """A part of a frame in which something moves, and all that is known of it there.

    `image` is hxwxC; `area` tells where to look; `views` show the scene at other times; `motion`
    is hxw, the motion map M in units of its noise; `tilt` is the rms turbulent motion an axis in
    pixels.
    """

    box: Box
    image: ByteImage
    views: Sequence[AlignedFrame]
    area: AreaMasks
    motion: Map
    tilt: float


@dataclass(frozen=True)
class Surroundings:
    """All that is known of a frame in which something moves; crops are cut out of it.

    `image` is HxWxC; `views` show the scene at other times, for its background, and `parts` parts
    of it, of which crops have those that lie in them; `tilt` is the rms turbulent motion an axis
    in pixels.
    """

    image: ByteImage
    areas: Sequence[MovingArea]
    views: Sequence[AlignedFrame]
    motion: MotionEstimate
    tilt: float
    parts: Sequence[AlignedFrame] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.image.shape[0], self.image.shape[1]

    @functools.cached_property
    def crops(self) -> list[ObjectCrop]:
        """A crop for each area; those that touch are looked at together.

        Where no view shows the scene, at once after the camera was turned to another, there is
        none.
        """
        if not self.areas:
            return []
        mode = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        pieces, _ = cv2.findContours(self._search_mask.view(np.uint8), *mode)
        crops = []
        for piece in reversed(pieces):
            box = Box.of_rectangle(cv2.boundingRect(piece)).padded(_MARGIN, self.shape)
            _, labels = cv2.connectedComponents(self._search_mask[box.slices].view(np.uint8))
            column, row = piece[0, 0] - (box.x0, box.y0)
            mask: Mask = labels == labels[row, column]
            crop = self._cut_out(box, mask)
            if crop.views:
                crops.append(crop)
        return crops

    def wider(self, crop: ObjectCrop, box: Box) -> ObjectCrop:
        """Return a crop with more around it: a box that holds its own."""
        search_mask = CroppedMask(crop.box, crop.area.search_mask).within(box)
        return self._cut_out(box, search_mask)

    def _cut_out(self, box: Box, search_mask: Mask) -> ObjectCrop:
        """Return what is known of a part of the frame.

        :param search_mask: hxw, where in it objects of this area are to be looked for.
        """
        cut = box.slices
        others = self._search_mask[cut] & ~search_mask
        nearest = _nearer_to(search_mask, others) if others.any() else np.ones_like(search_mask)
        return ObjectCrop(
            box=box,
            image=np.ascontiguousarray(self.image[cut]),
            views=[*self.views, *(part for part in self.parts if part.shows_of(box))],
            area=AreaMasks(search_mask, self._probable[cut], self._certain[cut], nearest),
            motion=_cropped(self._strength, box, self.shape),
            tilt=self.tilt,
        )

    @functools.cached_property
    def _search_mask(self) -> Mask:
        return union_mask([area.search_mask for area in self.areas], self.shape)

    @functools.cached_property
    def _probable(self) -> Mask:
        return union_mask([area.probable for area in self.areas], self.shape)

    @functools.cached_property
    def _certain(self) -> Mask:
        return union_mask([area.certain for area in self.areas], self.shape)

    @functools.cached_property
    def _strength(self) -> Map:
        """The motion map M in units of its noise, at processing resolution."""
        return self.motion.motion_map / self.motion.noise


def _nearer_to(part: Mask, others: Mask) -> Mask:
    """Return which pixels are nearer to a part than to others, hxw."""
    here, there = (
        cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3) for mask in (part, others)
    )
    nearer: Mask = here < there
    return nearer


def foreground_masks(crops: Sequence[ObjectCrop], threshold: float) -> list[CroppedMask]:
    """Cut the objects out of crops; what is found in one is split by the gaps in it.

    :param threshold: standard deviations by which an object differs from the background.
    """
    found = []
    for crop in crops:
        background, image = background_in(crop.box, crop.views), crop.image
        mask = foreground_mask(background, image, crop.area, crop.tilt, threshold)
        parts = [without_shadow(part, image, background) for part in separated(mask)]
        found += [CroppedMask.of(part, crop.box.x0, crop.box.y0) for part in parts if part.any()]
    return found


def foreground_mask(
    background: Background, image: ByteImage, area: AreaMasks, tilt: float, threshold: float
) -> Mask:
    """Return what stands out from the background where something moves, hxw.

    A pixel does when it differs from the background by more than noise and shimmer explain, and
    by a fair part of what the object differs by. Where no view shows the background yet, GrabCut
    decides by colour. Edges follow those of the image.

    :param image: hxwxC; `background` and `area` are of the same part of the frame.
    """
    moving = area.search_mask
    deviation = deviation_from(background, image, tilt) / threshold
    difference = difference_from(background, image)
    certain = moving & background.known & (deviation > 1.0)
    usual = _usual_difference(difference, certain)
    deviation = np.minimum(deviation, difference / np.maximum(_FRINGE * usual, 1e-3))
    score = np.clip(cv2.blur(np.minimum(deviation, 4.0), (3, 3)) - 1.0, -1.0, 1.0)
    if np.count_nonzero(moving & ~background.known) > _OPEN * np.count_nonzero(moving):
        cut = _cut_by_colour(background, image, score, area)
        score = np.where(background.known, score, np.where(cut, 1.0, -1.0)).astype(np.float32)
    channels = image.shape[2]
    grey = cv2.transform(image.astype(np.float32), np.full((1, channels), 1 / (255 * channels)))
    score = guided_filter(grey, score, radius=2, epsilon=1e-3)
    return _filled((score > 0.0) & moving)


def separated(mask: Mask) -> list[Mask]:
    """Split a mask into objects: parts with a gap small for the largest of them belong together.

    What is left over close beside an object that is ten times as large is a part of nothing.
    """
    _, _, statistics, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8))
    size = np.sqrt(statistics[1:, cv2.CC_STAT_AREA].max(initial=0))
    reach = int(np.clip(_GAP * size, 1, 20))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    padded = cv2.copyMakeBorder(
        mask.astype(np.uint8), reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=0
    )
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach]
    count, groups = cv2.connectedComponents(closed)
    parts = [(groups == group) & mask for group in range(1, count)]
    return [part for part in parts if not any(_is_debris(part, other) for other in parts)]


def _is_debris(part: Mask, other: Mask) -> bool:
    large = np.count_nonzero(other)
    close = Box.around(part).gap(Box.around(other)) < np.sqrt(large)
    return bool(close and np.count_nonzero(part) < _DEBRIS * large)


def without_shadow(mask: Mask, image: ByteImage, background: Background) -> Mask:
    """Take an object's shadow off its mask, hxw.

    A shadow lies below its object, darkens what it falls on without changing its colour
    (Prati et al. 2003), and is fainter than the object. An object that looks like a shadow all
    over stays whole.

    :param image: hxwxC; `background` is of the same part of the frame.
    """
    area = np.count_nonzero(mask)
    if not area:
        return mask
    difference = cv2.blur(difference_from(background, image), (3, 3))
    usual = float(np.percentile(difference[mask], 80))
    light = (image.astype(np.float32) + 1.0) / (background.median + 1.0)
    least, most = smallest(light), largest(light)
    darkened = (least > _SHADOW_LIGHT[0]) & (most < _SHADOW_LIGHT[1])
    same_colour = most - least < _SHADOW_COLOUR
    faint = difference < _SHADOW_CONTRAST * usual
    shadowy = (mask & background.known & darkened & same_colour & faint).astype(np.uint8)
    shadowy = cv2.morphologyEx(shadowy, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    rim = mask & ~(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    middle = float(np.nonzero(mask)[0].mean())
    count, patches, statistics, centroids = cv2.connectedComponentsWithStats(shadowy)
    lit = mask.copy()
    for patch in range(1, count):
        inside = patches == patch
        small = statistics[patch, cv2.CC_STAT_AREA] <= _SHADOW_SHARE * area
        if small and centroids[patch][1] > middle and (inside & rim).any():
            lit &= ~inside
    return opened(lit)


def guided_filter(guide: Map, source: Map, radius: int, epsilon: float) -> Map:
    """Smooth `source` along the edges of `guide` (He, Sun and Tang 2013), both HxW float32.

    :param guide: grey values from 0 to 1.
    :param epsilon: variance of the guide above which an edge is kept.
    """
    size = (2 * radius + 1, 2 * radius + 1)
    mean_guide, mean_source = cv2.blur(guide, size), cv2.blur(source, size)
    covariance = cv2.blur(guide * source, size) - mean_guide * mean_source
    variance = cv2.blur(guide * guide, size) - mean_guide * mean_guide
    slope = covariance / (variance + epsilon)
    offset = mean_source - slope * mean_guide
    smoothed: Map = cv2.blur(slope, size) * guide + cv2.blur(offset, size)
    return smoothed


def _usual_difference(difference: Map, certain: Mask) -> Map:
    """Return what the strongest patch of certain pixels nearby differs by, 0 far from any, hxw."""
    count, patches = cv2.connectedComponents(certain.astype(np.uint8))
    owner, values = patches[certain], difference[certain]
    ordered = values[np.lexsort((values, owner))]
    sizes = np.bincount(owner, minlength=count)
    usual = np.zeros(count, np.float32)
    # The 80th percentile of each patch: its values follow one another, the least first.
    first = np.cumsum(sizes) - sizes
    usual[1:] = ordered[first[1:] + np.rint(0.8 * (sizes[1:] - 1)).astype(int)]
    nearby: Map = cv2.dilate(usual[patches], np.ones((_NEARBY, _NEARBY), np.uint8))
    return nearby


def _cut_by_colour(background: Background, image: ByteImage, score: Map, area: AreaMasks) -> Mask:
    """Return objects from background by GrabCut (Rother et al. 2004), hxw.

    It starts from what the background tells where it is known, and from the motion elsewhere.
    """
    moving = area.search_mask
    labels = np.full(moving.shape, cv2.GC_PR_BGD, np.uint8)
    labels[area.probable] = cv2.GC_PR_FGD
    labels[area.certain & ~background.known] = cv2.GC_FGD
    labels[background.known & (score > 0.0)] = cv2.GC_PR_FGD
    labels[background.known & (score > 0.9)] = cv2.GC_FGD
    labels[background.known & (score <= 0.0)] = cv2.GC_PR_BGD
    labels[(background.known & (score < -0.4)) | ~moving] = cv2.GC_BGD
    scale = min(1.0, float(np.sqrt(_MAX_CUT / moving.size)))
    size = (max(round(moving.shape[1] * scale), 1), max(round(moving.shape[0] * scale), 1))
    colour = image if image.shape[2] == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    small = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    labels = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
    if (
        min(np.count_nonzero(_is_foreground(labels)), np.count_nonzero(~_is_foreground(labels)))
        < 8
    ):
        return area.probable
    # OpenCV draws GrabCut's first clusters from its global generator.
    cv2.setRNGSeed(1)
    labels, _, _ = cv2.grabCut(
        small, labels, None, None, None, _CUT_ITERATIONS, cv2.GC_INIT_WITH_MASK
    )
    shape = (moving.shape[1], moving.shape[0])
    cut: Mask = cv2.resize(_is_foreground(labels).astype(np.float32), shape) > 0.5
    return cut


def _is_foreground(labels: npt.NDArray[np.uint8]) -> Mask:
    foreground: Mask = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return foreground


def _cropped(values: Map, box: Box, shape: tuple[int, int]) -> Map:
    """Return the part of a map that a box of the frame of `shape` covers, at the frame's scale."""
    scale_x, scale_y = values.shape[1] / shape[1], values.shape[0] / shape[0]
    height, width = box.shape
    # Pixel centres lie at half of a pixel.
    to_values = np.array(
        [
            [scale_x, 0.0, (box.x0 + 0.5) * scale_x - 0.5],
            [0.0, scale_y, (box.y0 + 0.5) * scale_y - 0.5],
        ]
    )
    cropped: Map = cv2.warpAffine(
        values,
        to_values,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return cropped


def _filled(mask: Mask) -> Mask:
    """Close gaps that are small for the mask's size, and fill what is enclosed."""
    radius = int(np.clip(0.1 * np.sqrt(np.count_nonzero(mask)), 1, 3))
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return opened(cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED) > 0)


def opened(mask: Mask) -> Mask:
    """Take away what is thinner than three pixels."""
    opened: Mask = (
        cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    )
    return opened
