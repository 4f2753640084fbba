"""What composites are made of: somebody's pictures and videos, and cut-outs of their movers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Image, Mask, Matrix

from .objects import Layer, PlacedSprite, Pose
from .turbulence import Field

# Of a mask's border so much is taken off, as a share of its height: it holds what was behind.
_FRINGE = 0.012
# Pictures are kept so many times larger than they are to be drawn: enough for some magnification.
_FINENESS = 1.5
_LARGEST_MAGNIFICATION = 1.5
_LEAST_PIXELS = 40


class Footage(Protocol):
    """A picture, or the frames of a video; read when asked for, so that it may be large."""

    @property
    def length(self) -> int:
        """The number of frames."""

    @property
    def has_masks(self) -> bool:
        """Whether it is known what moves."""

    def pictures(self, first: int, count: int) -> list[ByteImage]:
        """Return so many frames from the `first` on, HxWx3 (BGR) each."""

    def masks(self, first: int, count: int) -> list[Mask] | None:
        """Return what moves in them, HxW each; None where that isn't known."""


@dataclass(frozen=True)
class Crop:
    """The part of a footage's frames that is shown, and at what size; all alike.

    `x`, `y`, `width` and `height` are in the frame's pixels, `shape` is that of the result.
    """

    x: int
    y: int
    width: int
    height: int
    shape: tuple[int, int]
    mirrored: bool

    @classmethod
    def drawn(
        cls,
        source: tuple[int, ...],
        shape: tuple[int, int],
        least: float,
        rng: np.random.Generator,
    ) -> Crop:
        """Draw a part of a frame of the shape `source` with the proportions of `shape`.

        :param least: share of the largest such part that it has at least, in width and height.
        """
        largest = min(source[1] / shape[1], source[0] / shape[0])
        scale = largest * rng.uniform(least, 1.0)
        width = max(min(round(shape[1] * scale), source[1]), 1)
        height = max(min(round(shape[0] * scale), source[0]), 1)
        x, y = (int(rng.integers(0, free + 1)) for free in (source[1] - width, source[0] - height))
        return cls(x, y, width, height, shape, bool(rng.random() < 0.5))

    def of(self, image: Image) -> Field:
        """Return the part of an image, float32 of `shape`, values as they were."""
        part = image[self.y : self.y + self.height, self.x : self.x + self.width]
        shrinks = self.height > self.shape[0]
        resized = cv2.resize(
            np.ascontiguousarray(part).astype(np.float32),
            self.shape[::-1],
            interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC,
        )
        return np.asarray(resized[:, ::-1] if self.mirrored else resized, np.float32).copy()


@dataclass(frozen=True)
class CutoutLook:
    """How a cut-out differs from what it was cut from.

    Its brightness is multiplied by `gain` for each channel; `inverted` makes bright dark, as
    thermal cameras may; `haze` is the share of the air's light before it; of its height the share
    `sunk` is hidden below a line, under which it is seen once more upside down with the opacity
    `mirage`. `growth` is by what factor it becomes larger from frame to frame.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    inverted: bool = False
    haze: float = 0.0
    sunk: float = 0.0
    mirage: float = 0.0
    growth: float = 1.0


class Cutout:
    """What moves in a footage, cut out by its masks: it keeps its own limbs and turns.

    :param size: its height or width in pixels, the larger one in the largest frame; what is
        small in the footage becomes half as large again at most.
    :raises ValueError: when the masks show too little to cut out.
    """

    def __init__(
        self, pictures: Sequence[ByteImage], masks: Sequence[Mask], size: float, look: CutoutLook
    ) -> None:
        extents = [max(_box(mask)[2:]) for mask in masks if mask.any()]
        if not extents or max(extents) ** 2 < _LEAST_PIXELS:
            raise ValueError("there is nothing in the masks to cut out")
        size = min(size, _LARGEST_MAGNIFICATION * max(extents))
        fineness = min(_FINENESS * size / max(extents), 1.0)
        self.size = size
        self._look = look
        self._scale = size / max(extents) / fineness
        self._frames = [
            _cut(picture, mask, fineness, look)
            for picture, mask in zip(pictures, masks, strict=True)
        ]

    def place(self, index: int, pose: Pose, to_image: Matrix, air: Field) -> list[PlacedSprite]:
        """Draw it in image coordinates; nothing where its frame shows none of it.

        :param index: the frame, of those that it was made of; beyond the last they go back.
        :param to_image: the camera's 2x3 affine map.
        :param air: the three channels' light of the air before it, 0 to 1.
        :return: first itself, then its mirage if it has one, which is no part of it.
        """
        layer = self._frames[_to_and_fro(index, len(self._frames))]
        if layer is None:
            return []
        height, width = layer.coverage.shape
        grown = self._scale * self._look.growth**index
        flip = -1.0 if pose.mirrored else 1.0
        c, s = grown * math.cos(pose.pitch), grown * math.sin(pose.pitch)
        linear = np.array([[c * flip, -s], [s * flip, c]])
        linear = to_image[:, :2] @ linear
        foot = to_image @ (pose.x, pose.y, 1.0)
        hidden = round(self._look.sunk * height)
        bottom = height - hidden
        matrix = np.column_stack([linear, foot - linear @ ((width - 1) / 2, bottom - 0.5)])
        hazy = self._veiled(layer, air)
        visible = Layer(hazy.colour[:bottom], hazy.coverage[:bottom])
        placed = [_placed(visible, matrix)]
        if self._look.mirage > 0:
            upside_down = Layer(
                np.ascontiguousarray(visible.colour[::-1]) * self._look.mirage,
                np.ascontiguousarray(visible.coverage[::-1]) * self._look.mirage,
            )
            below = np.column_stack([linear, foot - linear @ ((width - 1) / 2, -0.5)])
            placed.append(_placed(upside_down, below))
        return placed

    def _veiled(self, layer: Layer, air: Field) -> Layer:
        share = np.float32(self._look.haze)
        veil = layer.coverage[..., None] * (share * air)
        return Layer(layer.colour * (1 - share) + veil, layer.coverage)


def _cut(picture: ByteImage, mask: Mask, fineness: float, look: CutoutLook) -> Layer | None:
    """Cut a frame's object out, premultiplied; None if there is none."""
    if not mask.any():
        return None
    x, y, width, height = _box(mask)
    covered = np.pad(mask[y : y + height, x : x + width].astype(np.uint8), 1)
    fringe = round(_FRINGE * height)
    if fringe:
        thinner = cv2.erode(covered, np.ones((2 * fringe + 1, 2 * fringe + 1), np.uint8))
        covered = thinner if thinner.any() else covered
    colour = np.pad(picture[y : y + height, x : x + width], ((1, 1), (1, 1), (0, 0)), "edge")
    light = colour.astype(np.float32) / 255
    if look.inverted:
        light = 1 - light
    light = np.clip(light * np.array(look.gain, np.float32), 0, 1)
    coverage = covered.astype(np.float32)
    premultiplied = np.dstack([light * coverage[..., None], coverage])
    size = tuple(max(round(length * fineness), 1) for length in coverage.shape[::-1])
    small = cv2.resize(premultiplied, size, interpolation=cv2.INTER_AREA)
    return Layer(np.ascontiguousarray(small[..., :3]), small[..., 3].copy())


def _placed(layer: Layer, to_picture: Matrix) -> PlacedSprite:
    """Draw a layer where a 2x3 affine map takes it."""
    height, width = layer.coverage.shape
    corners = np.array([[-1, width, width, -1], [-1, -1, height, height], [1, 1, 1, 1]])
    moved = to_picture @ corners
    left, top = np.floor(moved.min(axis=1)).astype(int) - 1
    size = tuple(int(each) for each in np.ceil(moved.max(axis=1)).astype(int) + 2 - (left, top))
    inner = to_picture - np.array([[0, 0, left], [0, 0, top]])
    both = np.dstack([layer.colour, layer.coverage])
    drawn = cv2.warpAffine(both, inner, size, flags=cv2.INTER_LINEAR)
    return PlacedSprite(int(left), int(top), Layer(drawn[..., :3], drawn[..., 3]), None)


def _box(mask: Mask) -> tuple[int, int, int, int]:
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return int(x), int(y), int(width), int(height)


def _to_and_fro(index: int, count: int) -> int:
    """Return a place among `count` that runs to the last one and back again."""
    if count == 1:
        return 0
    place = index % (2 * count - 2)
    return min(place, 2 * count - 2 - place)
