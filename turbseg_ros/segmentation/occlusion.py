"""Which object each pixel belongs to where objects touch or hide one another.

Each object is remembered as it was when last seen whole. Where several are expected in one
mask, they compete for its pixels: by how far a pixel lies from where the object is expected, by
how well the object's remembered colours explain it, and by who is known to be in front.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Generic, TypeVar

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map, Mask, Point
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask

Key = TypeVar("Key", bound=Hashable)

# An object's usual difference from its appearance model in grey values is taken from so many
# pixels at least, and is not below what a camera's noise makes.
_MIN_SAMPLES = 20
_MIN_DIFFERENCE = 3.0
# The most usual differences that one pixel counts: a highlight may differ by any amount.
_MAX_DIFFERENCES = 6.0
# Distance from where an object is expected that counts as one usual difference, and the largest
# that is told apart, in pixels.
_DISTANCE = 2.0
_MAX_DISTANCE = 24.0
# Side in pixels of the square over which costs are averaged: neighbours belong together.
_SMOOTHING = 5
# Pixels that two objects must share to tell which one is in front, and to tell it fully.
_MIN_SHARED = 12
_FULL_SHARED = 50
# Share of what is known of the depth order that is kept from one frame to the next, and the most
# usual differences that it counts.
_ORDER_KEPT = 0.9
_MAX_LEAD = 1.0


@dataclass(frozen=True)
class AppearanceModel:
    """An object as it was last seen whole.

    `picture` is hxwxC, what its box of the frame showed; `centre` is where its centroid (x, y)
    lies.
    """

    outline: CroppedMask
    picture: ByteImage
    centre: Point

    @classmethod
    def of(cls, outline: CroppedMask, image: ByteImage, centre: Point) -> AppearanceModel:
        """Return the appearance model of what an outline holds in a frame, HxWxC."""
        return cls(outline, image[outline.box.slices].copy(), centre)

    def at(self, position: Point) -> AppearanceModel:
        """Return it where its centroid lies at `position`, to the pixel."""
        dx, dy = np.rint(position - self.centre).astype(int)
        moved = CroppedMask(self.outline.box.moved(int(dx), int(dy)), self.outline.mask)
        return AppearanceModel(moved, self.picture, position)


class DepthOrder(Generic[Key]):
    """Who is in front of whom, remembered over frames."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self._leads: dict[tuple[Key, Key], float] = {}

    def observe(self, one: Key, other: Key, lead: float) -> None:
        """Take one frame's evidence that `one` is in front: negative if the other is."""
        known = _ORDER_KEPT * self._leads.get((one, other), 0.0) + lead
        self._leads[one, other], self._leads[other, one] = known, -known

    def lead(self, one: Key, other: Key) -> float:
        """Return from -1 to 1 how sure it is that `one` is in front of the other; 0: unknown."""
        return float(np.clip(self._leads.get((one, other), 0.0), -_MAX_LEAD, _MAX_LEAD))

    def front_to_back(self, keys: Collection[Key]) -> list[Key]:
        """Return those in front before those behind, else in the order given."""
        return sorted(keys, key=lambda key: -sum(self.lead(key, other) for other in keys))

    def keep(self, keys: Collection[Key]) -> None:
        """Forget all others."""
        self._leads = {
            pair: lead for pair, lead in self._leads.items() if pair[0] in keys and pair[1] in keys
        }


def divided_among(
    found: CroppedMask,
    appearances: Mapping[Key, AppearanceModel],
    image: ByteImage,
    tilt: float,
    order: DepthOrder[Key],
) -> dict[Key, CroppedMask]:
    """Divide the pixels of a mask among the objects that are expected in it.

    :param appearances: the objects where they are expected.
    :param image: HxWxC, the frame.
    :param tilt: rms turbulent motion an axis in pixels.
    :param order: what is known of who is in front; learns from where the objects overlap.
    :return: the pixels of each object that has any.
    """
    box, keys = found.box, list(appearances)
    expected = [appearances[key].outline.within(box) & found.mask for key in keys]
    differences, costs = [], []
    for key, alone in zip(keys, _unshared(expected), strict=True):
        distance, picture = _extended(appearances[key], box)
        difference = difference_beyond(image[box.slices], picture, reach=1 + round(tilt))
        usual = float(difference[alone].mean()) if alone.sum() >= _MIN_SAMPLES else 0.0
        difference /= max(usual, _MIN_DIFFERENCE)
        differences.append(np.minimum(difference, _MAX_DIFFERENCES))
        costs.append(np.minimum(distance, _MAX_DISTANCE) / _DISTANCE + differences[-1])
    for one, other in combinations(range(len(keys)), 2):
        shared = expected[one] & expected[other]
        count = np.count_nonzero(shared)
        if count >= _MIN_SHARED:
            better = float((differences[other] - differences[one])[shared].mean())
            order.observe(keys[one], keys[other], better * min(count / _FULL_SHARED, 1.0))
        lead = order.lead(keys[one], keys[other])
        costs[other if lead > 0.0 else one][shared] += abs(lead)
    smooth = [cv2.blur(cost, (_SMOOTHING, _SMOOTHING)) for cost in costs]
    owner = np.argmin(smooth, axis=0)
    parts = {
        key: CroppedMask.of(found.mask & (owner == number), box.x0, box.y0)
        for number, key in enumerate(keys)
    }
    return {key: part for key, part in parts.items() if part.area}


def _unshared(masks: Sequence[Mask]) -> list[Mask]:
    """Return what each mask has for itself."""
    count = np.sum(masks, axis=0)
    return [mask & (count == 1) for mask in masks]


def _extended(appearance: AppearanceModel, box: Box) -> tuple[Map, ByteImage]:
    """Return how far a box's pixels lie from a known object, and its picture, continued all round.

    Distances, hxw, are in pixels, 0 within the outline; beyond it the picture, hxwxC, goes on
    with the nearest colour.
    """
    outline, channels = appearance.outline, appearance.picture.shape[2]
    expected = outline.within(box)
    common = outline.box.intersection(box)
    if common is None or not expected.any():
        blank = np.zeros((*box.shape, channels), np.uint8)
        return np.full(box.shape, _MAX_DISTANCE, np.float32), blank
    distance, nearest = cv2.distanceTransformWithLabels(
        (~expected).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    seen = common.moved(-outline.box.x0, -outline.box.y0).slices
    colours = np.zeros((int(nearest.max()) + 1, channels), np.uint8)
    colours[nearest[expected]] = appearance.picture[seen][outline.mask[seen]]
    return distance, colours[nearest]


def difference_beyond(image: ByteImage, picture: ByteImage, reach: int) -> Map:
    """Return by how many grey values pixels lie outside what a picture shows nearby, hxw.

    Tilt moves its parts by about a pixel, so all that it shows within `reach` pixels is allowed.
    """
    nearby = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    least, most = cv2.erode(picture, nearby), cv2.dilate(picture, nearby)
    above = cv2.subtract(image, most.reshape(image.shape))
    below = cv2.subtract(least.reshape(image.shape), image)
    outside = np.maximum(above.reshape(image.shape), below.reshape(image.shape))
    difference: Map = outside.mean(axis=2, dtype=np.float32)
    return difference
