"""Drawings on frames: outlines, ids and trails, and strips of several frames.

An annotator draws one kind of mark on a canvas; what a picture shows is a sequence of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Image
from turbseg_ros.segmentation.frame import MovingObject, SegmentationResult
from turbseg_ros.segmentation.tone import ToneMap

Colour = tuple[int, int, int]

# Blue, green, red. Bright on sky and ground alike, and neighbours in the list far apart.
_PALETTE: tuple[Colour, ...] = (
    (60, 225, 255),
    (255, 165, 80),
    (100, 100, 255),
    (255, 255, 90),
    (225, 110, 255),
    (110, 255, 120),
    (40, 150, 255),
    (255, 190, 190),
    (160, 255, 220),
    (255, 135, 195),
)
# Formats that hold 8-bit colour. Some OpenCV does without WebP or TIFF.
_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_SHADOW: Colour = (20, 20, 20)
WHITE: Colour = (245, 245, 245)
_IGNORED: Colour = (70, 70, 235)
_INCLUDED: Colour = (90, 220, 90)
# Width of a canvas for each pixel of an outline's.
_WIDTH_PER_PIXEL = 480.0
# From one dot of a trail to the next, and a dot's radius, in widths of an outline.
_DOT_STEP, _DOT_RADIUS = 4.0, 0.5
# Outlines for viewers are let off corners that stand out less than this, in pixels.
_OUTLINE_TOLERANCE = 0.5
# Length of a broken line's pieces, in pixels of the canvas.
_DASH = 6.0
_FONT = cv2.FONT_HERSHEY_SIMPLEX
# Height of a capital letter at scale 1, in pixels.
_FONT_HEIGHT = 21.0
# OpenCV takes sub-pixel positions as integers with this many fractional bits.
_SHIFT = 4


def colour_of(object_id: int) -> Colour:
    """Return the colour (blue, green, red) that belongs to an object id."""
    return _PALETTE[object_id % len(_PALETTE)]


def outlines(
    labels: npt.NDArray[np.uint16], moving_object: MovingObject
) -> list[npt.NDArray[np.int32]]:
    """Return an object's outer contours in the image, each Nx2 (x, y) and closed."""
    x, y, width, height = moving_object.box
    window = np.ascontiguousarray(labels[y : y + height, x : x + width])
    mask = (window == moving_object.label).view(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(x, y))
    return [contour.reshape(-1, 2) for contour in contours]


def simplified_outlines(
    labels: npt.NDArray[np.uint16], moving_object: MovingObject
) -> list[npt.NDArray[np.int32]]:
    """Return `outlines` without the corners that hardly stand out."""
    return [
        cv2.approxPolyDP(contour, _OUTLINE_TOLERANCE, True).reshape(-1, 2)
        for contour in outlines(labels, moving_object)
    ]


def text_height(height: int) -> float:
    """Return the height of a digit in pixels that stays readable on a picture of a height."""
    return float(np.clip(height / 28.0, 9.0, 30.0))


def line_width(width: int) -> int:
    """Return the width of an outline in pixels: two, and more on wide pictures."""
    return max(2, round(width / _WIDTH_PER_PIXEL))


@dataclass(frozen=True)
class Canvas:
    """A picture to draw on: uint8 HxWx3, `scale` of its pixels to one of the frame's."""

    image: npt.NDArray[np.uint8]
    scale: float = 1.0

    @classmethod
    def of(cls, image: Image, width: int | None = None, tone: ToneMap | None = None) -> Canvas:
        """Make a canvas of a frame's image as `to_bgr8` does, resized to `width` where given."""
        scale = 1.0 if width is None else width / image.shape[1]
        if scale != 1.0:
            interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
            size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
            image = cv2.resize(image, size, interpolation=interpolation)
        return cls(image=to_bgr8(image, tone), scale=scale)

    @property
    def text_scale(self) -> float:
        """Font scale at which a digit stays readable, whatever the size of the canvas."""
        return text_height(self.image.shape[0]) / _FONT_HEIGHT

    @property
    def line_width(self) -> int:
        """Width of an outline in pixels."""
        return line_width(self.image.shape[1])

    def fixed_point(self, points: npt.ArrayLike) -> npt.NDArray[np.int32]:
        """Return frame positions (x, y) on the canvas, in OpenCV's fixed-point numbers."""
        # A pixel's centre lies at a whole number in the frame and on the canvas alike.
        on_canvas = (np.asarray(points, dtype=np.float64) + 0.5) * self.scale - 0.5
        return np.rint(on_canvas * (1 << _SHIFT)).astype(np.int32)


class Annotator(Protocol):
    """Something that draws one kind of mark for all objects of a result."""

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""


@dataclass(frozen=True)
class OutlineAnnotator:
    """The outline of each object, in the object's colour."""

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""
        for moving_object in result.objects:
            contours = [
                canvas.fixed_point(contour) for contour in outlines(result.labels, moving_object)
            ]
            colour = colour_of(moving_object.id)
            width = canvas.line_width
            cv2.polylines(canvas.image, contours, True, colour, width, cv2.LINE_AA, _SHIFT)


@dataclass(frozen=True)
class RegionAnnotator:
    """What was marked in the picture, as broken lines with names: ignored, or to be included."""

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""
        if result.regions is None:
            return
        for region, contours in result.regions.contours:
            colour = _IGNORED if region.ignored else _INCLUDED
            for contour in contours:
                dashes = [canvas.fixed_point(dash) for dash in _dashes(contour, canvas.scale)]
                cv2.polylines(canvas.image, dashes, False, colour, 1, cv2.LINE_AA, _SHIFT)
            if contours:
                x, y = (canvas.fixed_point(contours[0].min(axis=0)) >> _SHIFT).tolist()
                text = f"{region.name} (ignored)" if region.ignored else region.name
                write_text(canvas, text, (x + 3, y), colour)


def _dashes(contour: npt.NDArray[np.float64], scale: float) -> list[npt.NDArray[np.float64]]:
    """Return every other piece of a closed line, Nx2, that is drawn `scale` times as large."""
    closed = np.vstack([contour, contour[:1]])
    lengths = np.hypot(*np.diff(closed, axis=0).T)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    pieces = max(round(float(at[-1]) * scale / _DASH), 2) // 2 * 2
    ends = np.linspace(0.0, at[-1], pieces + 1)
    points = np.stack([np.interp(ends, at, closed[:, axis]) for axis in (0, 1)], axis=-1)
    return [points[k : k + 2] for k in range(0, pieces, 2)]


@dataclass(frozen=True)
class TrailAnnotator:
    """The way each object came, dotted, in the object's colour."""

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""
        radius = round(_DOT_RADIUS * canvas.line_width * (1 << _SHIFT))
        for moving_object in result.objects:
            if not moving_object.trail:
                continue
            way = np.array((*moving_object.trail, moving_object.centroid), np.float64)
            colour = colour_of(moving_object.id)
            for dot in canvas.fixed_point(
                _dots(way, _DOT_STEP * canvas.line_width / canvas.scale)
            ):
                cv2.circle(
                    canvas.image, dot.tolist(), radius, colour, cv2.FILLED, cv2.LINE_AA, _SHIFT
                )


def _dots(way: npt.NDArray[np.float64], step: float) -> npt.NDArray[np.float64]:
    """Return points, Nx2, along a way, Nx2, so far from each other; the first is its beginning."""
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    ends = np.arange(0.0, at[-1] + step / 2.0, step)
    return np.stack([np.interp(ends, at, way[:, axis]) for axis in (0, 1)], axis=-1)


@dataclass(frozen=True)
class IdAnnotator:
    """Each object's id beside it, in the object's colour."""

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""
        for moving_object in result.objects:
            x, y, width, _ = moving_object.box
            corner = (round((x + width) * canvas.scale) + 2, round(y * canvas.scale) - 2)
            write_text(canvas, str(moving_object.id), corner, colour_of(moving_object.id))


DEFAULT_ANNOTATORS: tuple[Annotator, ...] = (
    RegionAnnotator(),
    TrailAnnotator(),
    OutlineAnnotator(),
    IdAnnotator(),
)


def draw_overlay(
    result: SegmentationResult,
    annotators: Sequence[Annotator] = DEFAULT_ANNOTATORS,
    width: int | None = None,
    tone: ToneMap | None = None,
) -> Canvas:
    """Draw a result on its frame, at the frame's size or resized to `width` pixels.

    `tone` is that of earlier frames, for a picture that does not flicker.
    """
    canvas = Canvas.of(result.frame.image, width, tone)
    for annotator in annotators:
        annotator.annotate(canvas, result)
    return canvas


class OverlayStrip:
    """A picture of results evenly spaced over a sequence of `frames`, with their numbers."""

    def __init__(
        self,
        frames: int,
        tiles: int = 9,
        tile_width: int = 480,
        annotators: Sequence[Annotator] = DEFAULT_ANNOTATORS,
    ) -> None:
        self._wanted = set(evenly_spaced(frames, tiles))
        self._tile_width = tile_width
        self._annotators = annotators
        self._seen = 0
        self._tiles: list[npt.NDArray[np.uint8]] = []

    def add(self, result: SegmentationResult) -> None:
        """Take the sequence's next result; it is drawn if its turn has come."""
        if self._seen in self._wanted:
            canvas = draw_overlay(result, self._annotators, self._tile_width)
            write_text(canvas, f"frame {self._seen}", (4, 0), WHITE)
            self._tiles.append(canvas.image)
        self._seen += 1

    def picture(self, columns: int = 3) -> npt.NDArray[np.uint8]:
        """Return what was drawn, line by line: uint8 HxWx3 (blue, green, red).

        :raises ValueError: when there was no result.
        """
        return grid(self._tiles, columns)


def evenly_spaced(total: int, wanted: int) -> list[int]:
    """Return at most `wanted` indices from the whole of `range(total)`, both ends among them."""
    count = min(total, wanted)
    return [int(index) for index in np.rint(np.linspace(0, total - 1, count))]


def to_bgr8(image: Image, tone: ToneMap | None = None) -> npt.NDArray[np.uint8]:
    """Return a copy of an image for people: uint8 HxWx3, 16-bit and float values stretched.

    `tone` stretches them, by default as this image alone asks for.
    """
    picture = (tone or ToneMap())(image)
    if picture.ndim == 2:
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    return picture.copy() if picture is image else picture


class PictureError(ValueError):
    """A name that tells no format of pictures; the text names those there are."""


def check_picture_name(path: Path) -> None:
    """See that a file's name tells a format in which pictures can be written.

    :raises PictureError: when it doesn't.
    """
    possible = [suffix for suffix in _PICTURE_SUFFIXES if cv2.haveImageWriter(f"x{suffix}")]
    if path.suffix.lower() not in possible:
        raise PictureError(f"{path} is no name of a picture; end it in {', '.join(possible)}")


def write_picture(path: Path, picture: npt.NDArray[np.uint8]) -> None:
    """Write a picture under its name, which tells the format, when it is complete.

    :raises PictureError: when the name tells none that can be written.
    :raises OSError: when the file can't be written; an older one then stays as it was.
    """
    check_picture_name(path)
    _, encoded = cv2.imencode(path.suffix.lower(), picture)
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(encoded.tobytes())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def grid(
    tiles: Sequence[npt.NDArray[np.uint8]], columns: int, gap: int = 4
) -> npt.NDArray[np.uint8]:
    """Lay out tiles on white, in cells of the largest one's size."""
    if not tiles:
        raise ValueError("a strip needs at least one frame")
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    height = max(tile.shape[0] for tile in tiles)
    width = max(tile.shape[1] for tile in tiles)
    grid_size = (rows * (height + gap) - gap, columns * (width + gap) - gap, 3)
    grid = np.full(grid_size, 255, np.uint8)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, columns)
        top, left = row * (height + gap), column * (width + gap)
        grid[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    return grid


def write_text(canvas: Canvas, text: str, corner: tuple[int, int], colour: Colour) -> None:
    """Write text with its lower left at `corner`, moved inside the canvas where it must be."""
    canvas_height, canvas_width = canvas.image.shape[:2]
    ink = _ink(text, canvas.text_scale)[:canvas_height, :canvas_width]
    # OpenCV 5 takes a text's thickness for the weight of its letters, so it can't make a rim.
    rim = cv2.dilate(ink, np.ones((3, 3), np.uint8))
    height, width = ink.shape
    x = max(0, min(corner[0], canvas_width - width))
    y = max(0, min(corner[1] - height, canvas_height - height))
    window = canvas.image[y : y + height, x : x + width]
    for paint, opacity in ((_SHADOW, rim), (colour, ink)):
        share = opacity[..., None] / np.float32(255)
        window[:] = np.rint(window * (1 - share) + np.asarray(paint, np.float32) * share)


def _ink(text: str, scale: float) -> npt.NDArray[np.uint8]:
    """Return the opacity of a text's pixels, 0 to 255, with room for a rim."""
    (width, height), baseline = cv2.getTextSize(text, _FONT, scale, 1)
    margin = 2
    ink = np.zeros((height + baseline + 2 * margin, width + 2 * margin), np.uint8)
    return np.asarray(
        cv2.putText(ink, text, (margin, margin + height), _FONT, scale, 255, 1, cv2.LINE_AA)
    )
