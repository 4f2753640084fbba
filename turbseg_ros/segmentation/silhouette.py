"""Cutting objects out of the picture: what moves and stands out from the background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.background import (
    Background,
    Box,
    View,
    background_in,
    deviation_from,
    difference_from,
    largest,
    smallest,
)
from turbseg_ros.segmentation.geometry import scaling, translation
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.region_growing import Region, Seed

Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
Matrix = npt.NDArray[np.float64]

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
_LARGEST_CUT = 20000
_CUT_ITERATIONS = 2
# Gap that may part an object, say by a pole, as a fraction of the root of its area; and the
# fraction of the largest object's area below which a part of the same area is debris.
_GAP = 0.2
_DEBRIS = 0.1
# Share of a seed's velocity from which a pixel is hardly another's smear.
_CORE = 0.75
SMEAR = 7
"""Pixels at processing resolution by which flow smears past an edge."""
# Two regions are one object's when their velocities differ by less than this fraction, and their
# gap is less than that fraction of the root of the smaller one's area.
_ALIKE = 0.3
_NEAR = 0.5


@dataclass(frozen=True)
class MovingArea:
    """Where objects of one motion are to be looked for: HxW masks, pixels a frame.

    `mask` holds all of them and more, for flow smears past edges; `core` is where motion is so
    strong that it is hardly smear; `heart` lies so deep in the core that it surely is object.
    """

    mask: Mask
    core: Mask
    heart: Mask
    velocity: tuple[float, float]


@dataclass(frozen=True)
class ObjectWindow:
    """A part of a frame in which something moves, and all that is known of it there.

    `image` is hxwxC; `views` show the scene at other times; `motion` is hxw, the motion map M in
    units of its noise; `tilt` is the rms turbulent motion an axis in pixels; `stamp` is the
    frame's, in nanoseconds.
    """

    box: Box
    image: Image
    views: Sequence[View]
    area: MovingArea
    motion: Map
    tilt: float
    stamp: int


@dataclass(frozen=True)
class Outline:
    """What was cut out: a box of the frame and the mask within it."""

    box: Box
    mask: Mask

    @classmethod
    def of(cls, mask: Mask, x0: int = 0, y0: int = 0) -> Outline:
        """Take a mask that holds something, whose first pixel is (x0, y0) of the frame."""
        box = Box.around(mask)
        return cls(box.moved(x0, y0), mask[box.slices])

    def in_frame(self, shape: tuple[int, int]) -> Mask:
        """Give the mask in a frame of some shape, HxW."""
        frame = np.zeros(shape, bool)
        frame[self.box.slices] = self.mask
        return frame


def moving_areas(
    regions: Sequence[Region], motion: MotionEstimate, size: tuple[int, int]
) -> list[MovingArea]:
    """Enlarge grown regions to detail resolution, regions of one object made one area.

    Flow fails within plain objects, so that only their ends may have grown: an area is the convex
    hull of neighbours with one velocity.

    :param size: width and height at detail resolution.
    """
    height, width = motion.motion_map.shape
    scale = size[0] / width, size[1] / height
    areas = []
    for group in _of_one_velocity(regions):
        seed = max((region.seed for region in group), key=lambda seed: seed.strength)
        mask = union([region.mask for region in group], (height, width))
        core = convex_hull(mask & (_share_of_velocity(motion, seed) > _CORE))
        areas.append(
            MovingArea(
                mask=enlarged(convex_hull(mask), size),
                core=enlarged(core, size),
                heart=enlarged(_eroded(core, SMEAR), size),
                velocity=(seed.velocity[0] * scale[0], seed.velocity[1] * scale[1]),
            )
        )
    return areas


def object_windows(
    image: Image,
    areas: Sequence[MovingArea],
    views: Sequence[View],
    motion: MotionEstimate,
    tilt: float,
    stamp: int,
) -> list[ObjectWindow]:
    """Gather what is known of moving areas; those that touch are looked at together.

    :param image: HxWxC, the frame.
    :param views: the scene at other times, for its background.
    :param tilt: rms turbulent motion an axis in pixels.
    """
    shape = (image.shape[0], image.shape[1])
    moving = union([area.mask for area in areas], shape)
    core = union([area.core for area in areas], shape)
    heart = union([area.heart for area in areas], shape)
    strength = motion.motion_map / motion.noise
    windows = []
    count, pieces = cv2.connectedComponents(moving.astype(np.uint8))
    for piece in range(1, count):
        inside = pieces == piece
        box = Box.around(inside).grown(_MARGIN, shape)
        cut = box.slices
        windows.append(
            ObjectWindow(
                box=box,
                image=image[cut],
                views=views,
                area=MovingArea(inside[cut], core[cut], heart[cut], (0.0, 0.0)),
                motion=_cropped(strength, box, shape),
                tilt=tilt,
                stamp=stamp,
            )
        )
    return windows


def silhouettes(windows: Sequence[ObjectWindow], threshold: float) -> list[Outline]:
    """Cut the objects out of windows; what is found in one is split by the gaps in it.

    :param threshold: standard deviations by which an object differs from the background.
    """
    found = []
    for window in windows:
        background, image = background_in(window.box, window.views), window.image
        mask = standing_out(background, image, window.area, window.tilt, threshold)
        parts = [without_shadow(part, image, background) for part in separated(mask)]
        found += [Outline.of(part, window.box.x0, window.box.y0) for part in parts if part.any()]
    return found


def standing_out(
    background: Background, image: Image, area: MovingArea, tilt: float, threshold: float
) -> Mask:
    """Tell what stands out from the background where something moves, hxw.

    A pixel does when it differs from the background by more than noise and shimmer explain, and
    by a fair part of what the object differs by. Where no view shows the background yet, GrabCut
    decides by colour. Edges follow those of the image.

    :param image: hxwxC; `background` and `area` are of the same part of the frame.
    """
    moving = area.mask
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
    """Split a mask into objects: parts with a gap small for their size belong together.

    What is left over close beside an object that is ten times as large is a part of nothing.
    """
    reach = int(np.clip(_GAP * np.sqrt(np.count_nonzero(mask)), 1, 20))
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
    close = _gap(part, other) < np.sqrt(large)
    return bool(close and np.count_nonzero(part) < _DEBRIS * large)


def without_shadow(mask: Mask, image: Image, background: Background) -> Mask:
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
    """Give what the strongest patch of certain pixels nearby differs by, 0 far from any, hxw."""
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


def _cut_by_colour(background: Background, image: Image, score: Map, area: MovingArea) -> Mask:
    """Tell objects from background by GrabCut (Rother et al. 2004), hxw.

    It starts from what the background tells where it is known, and from the motion elsewhere.
    """
    moving = area.mask
    labels = np.full(moving.shape, cv2.GC_PR_BGD, np.uint8)
    labels[area.core] = cv2.GC_PR_FGD
    labels[area.heart & ~background.known] = cv2.GC_FGD
    labels[background.known & (score > 0.0)] = cv2.GC_PR_FGD
    labels[background.known & (score > 0.9)] = cv2.GC_FGD
    labels[background.known & (score <= 0.0)] = cv2.GC_PR_BGD
    labels[(background.known & (score < -0.4)) | ~moving] = cv2.GC_BGD
    scale = min(1.0, float(np.sqrt(_LARGEST_CUT / moving.size)))
    size = (max(round(moving.shape[1] * scale), 1), max(round(moving.shape[0] * scale), 1))
    colour = image if image.shape[2] == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    small = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    labels = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
    if (
        min(np.count_nonzero(_is_foreground(labels)), np.count_nonzero(~_is_foreground(labels)))
        < 8
    ):
        return area.core
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


def convex_hull(mask: Mask) -> Mask:
    """Fill the convex hull of a mask."""
    outlines, _ = cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    hull = np.zeros(mask.shape, np.uint8)
    if outlines:
        cv2.fillConvexPoly(hull, cv2.convexHull(np.vstack(outlines)), 1)
    filled: Mask = hull > 0
    return filled


def _of_one_velocity(regions: Sequence[Region]) -> list[list[Region]]:
    """Group regions that move alike and lie close for their size."""
    groups: list[list[Region]] = []
    for region in regions:
        near = [group for group in groups if any(_alike(region, other) for other in group)]
        joined = [region, *(member for group in near for member in group)]
        groups = [group for group in groups if group not in near] + [joined]
    return groups


def _alike(region: Region, other: Region) -> bool:
    change = np.subtract(region.seed.velocity, other.seed.velocity)
    speed = max(np.hypot(*region.seed.velocity), np.hypot(*other.seed.velocity))
    if np.hypot(*change) > _ALIKE * speed:
        return False
    reach = _NEAR * np.sqrt(min(np.count_nonzero(region.mask), np.count_nonzero(other.mask)))
    return _gap(region.mask, other.mask) < reach


def _gap(mask: Mask, other: Mask) -> float:
    """Give the distance between the boxes around two masks, in pixels, 0 where they overlap."""
    a, b = Box.around(mask), Box.around(other)
    across = max(a.x0 - b.x1, b.x0 - a.x1, 0)
    down = max(a.y0 - b.y1, b.y0 - a.y1, 0)
    return float(np.hypot(across, down))


def _share_of_velocity(motion: MotionEstimate, seed: Seed) -> Map:
    """Give how much of the seed's velocity each pixel shares, HxW: 1 for all of it."""
    vx, vy = seed.velocity
    squared = max(vx * vx + vy * vy, 1e-12)
    share: Map = cv2.transform(motion.velocity, np.array([[vx, vy]]) / squared)
    return share


def _eroded(mask: Mask, radius: int) -> Mask:
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    eroded: Mask = cv2.erode(mask.astype(np.uint8), kernel) > 0
    return eroded


def _cropped(values: Map, box: Box, shape: tuple[int, int]) -> Map:
    """Give the part of a map that a box of the frame of `shape` covers, at the frame's scale."""
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


def enlarged(mask: Mask, size: tuple[int, int]) -> Mask:
    """Give a mask at another size (width, height)."""
    x, y = size[0] / mask.shape[1], size[1] / mask.shape[0]
    return moved(mask, scaling(x, y), size[::-1], cv2.INTER_LINEAR)


def moved(
    mask: Mask,
    transform: Matrix,
    shape: tuple[int, int] | None = None,
    interpolation: int = cv2.INTER_NEAREST,
) -> Mask:
    """Give a mask where a transform takes it, in a frame of some shape, its own if None."""
    shape = shape or (mask.shape[0], mask.shape[1])
    if not mask.any():
        return np.zeros(shape, bool)
    return resampled(Outline.of(mask), transform, shape, interpolation).in_frame(shape)


def dilated(mask: Mask, radius: int) -> Mask:
    """Widen a mask by some pixels all round."""
    size = 2 * radius + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    widened: Mask = cv2.dilate(mask.astype(np.uint8), kernel) > 0
    return widened


def resampled(
    outline: Outline, transform: Matrix, shape: tuple[int, int], interpolation: int
) -> Outline:
    """Give an outline in the pixels of another image of some shape, whole or what is in there.

    :param transform: 3x3, affine: takes the outline's frame to that image.
    """
    here = outline.box
    corners = np.array(
        [[here.x0, here.x1, here.x0, here.x1], [here.y0, here.y0, here.y1, here.y1]]
    )
    x, y = transform[:2, :2] @ (corners - 0.5) + transform[:2, 2:]
    there = Box(
        int(np.clip(np.floor(x.min()), 0, shape[1])),
        int(np.clip(np.floor(y.min()), 0, shape[0])),
        int(np.clip(np.ceil(x.max()) + 1, 0, shape[1])),
        int(np.clip(np.ceil(y.max()) + 1, 0, shape[0])),
    )
    height, width = there.shape
    if not (height and width):
        return Outline(there, np.zeros(there.shape, bool))
    mask = cv2.warpAffine(
        outline.mask.astype(np.uint8) * np.uint8(255),
        (translation(-there.x0, -there.y0) @ transform @ translation(here.x0, here.y0))[:2],
        (width, height),
        flags=interpolation,
    )
    return Outline(there, mask > 127)


def union(masks: Sequence[Mask], shape: tuple[int, int]) -> Mask:
    """Give the union of masks of one shape, which may be none."""
    joined = np.zeros(shape, bool)
    for mask in masks:
        joined |= mask
    return joined


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
