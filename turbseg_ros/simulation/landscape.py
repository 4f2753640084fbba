"""Landscapes as a long lens sees them: painted once, larger than the image, in scene pixels.

A painter gets a `Brush` and leaves behind a `Backdrop`. Everything is laid out in shares of the
view's height, so that a landscape looks the same at any resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from .objects import Colour, Layer, Path, Pose, SceneObject, Sprite
from .textures import fractal_noise

Field = npt.NDArray[np.float32]
Point = tuple[float, float]

_SUPERSAMPLING = 2
_TILE = 1024


@dataclass(frozen=True)
class Extent:
    """The part of the scene that is painted: the view and a margin around it, in pixels.

    Scene coordinates have their origin in the view's first pixel at the first frame.
    """

    width: int
    height: int
    margin_x: int
    margin_y: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the painting."""
        return self.height + 2 * self.margin_y, self.width + 2 * self.margin_x


@dataclass(frozen=True)
class Palette:
    """The colour of every material, in daylight or as its temperature to a thermal camera."""

    sky_top: Colour = (0.86, 0.72, 0.56)
    sky_low: Colour = (0.86, 0.83, 0.79)
    hill: Colour = (0.62, 0.57, 0.52)
    leaves: Colour = (0.2, 0.36, 0.3)
    dry_leaves: Colour = (0.27, 0.37, 0.36)
    soil: Colour = (0.5, 0.58, 0.66)
    grass: Colour = (0.3, 0.5, 0.46)
    crop: Colour = (0.38, 0.58, 0.62)
    asphalt: Colour = (0.4, 0.39, 0.39)
    pavement: Colour = (0.64, 0.68, 0.71)
    marking: Colour = (0.85, 0.87, 0.88)
    yellow_marking: Colour = (0.3, 0.62, 0.75)
    facades: tuple[Colour, ...] = (
        (0.6, 0.68, 0.75), (0.7, 0.74, 0.76), (0.48, 0.58, 0.68), (0.62, 0.62, 0.6),
    )  # fmt: skip
    roofs: tuple[Colour, ...] = ((0.33, 0.4, 0.62), (0.5, 0.52, 0.53), (0.36, 0.42, 0.5))
    window: Colour = (0.3, 0.26, 0.22)
    wood: Colour = (0.2, 0.25, 0.31)
    metal: Colour = (0.6, 0.6, 0.58)
    water: Colour = (0.5, 0.46, 0.38)
    shadow: float = 0.62
    relief: float = 1.0


DAYLIGHT = Palette()

THERMAL = Palette(
    sky_top=(0.03,) * 3,
    sky_low=(0.16,) * 3,
    hill=(0.27,) * 3,
    leaves=(0.31,) * 3,
    dry_leaves=(0.33,) * 3,
    soil=(0.47,) * 3,
    grass=(0.36,) * 3,
    crop=(0.4,) * 3,
    asphalt=(0.54,) * 3,
    pavement=(0.5,) * 3,
    marking=(0.5,) * 3,
    yellow_marking=(0.51,) * 3,
    facades=((0.42,) * 3, (0.46,) * 3, (0.39,) * 3),
    roofs=((0.33,) * 3, (0.56,) * 3, (0.29,) * 3),
    window=(0.28,) * 3,
    wood=(0.4,) * 3,
    metal=(0.25,) * 3,
    water=(0.22,) * 3,
    shadow=0.88,
    relief=0.5,
)


class Animation(Protocol):
    """A part of the landscape that stirs without going anywhere."""

    def draw(self, painting: Field, frame: int) -> None:
        """Redraw its region of the painting (float32 HxWx3) in place, as of this frame."""


@dataclass(frozen=True)
class Backdrop:
    """A painted landscape: what lies behind the objects, what before them, and what stirs."""

    painting: Field
    foreground: Layer | None = None
    animations: Sequence[Animation] = ()

    def at(self, frame: int) -> Field:
        """Return the painting at a frame, float32 HxWx3."""
        if not self.animations:
            return self.painting
        painting = self.painting.copy()
        for animation in self.animations:
            animation.draw(painting, frame)
        return painting


@dataclass
class Brush:
    """Paints polygons, textures and plants on one supersampled canvas, in scene coordinates."""

    extent: Extent
    palette: Palette
    rng: np.random.Generator
    canvas: Field = field(init=False)
    """Blue, green, red and coverage."""

    def __post_init__(self) -> None:
        height, width = (length * _SUPERSAMPLING for length in self.extent.shape)
        self.canvas = np.zeros((height, width, 4), np.float32)
        self._noise = fractal_noise((_TILE, _TILE), self.rng)

    @property
    def unit(self) -> float:
        """One share of the view's height, in pixels."""
        return float(self.extent.height)

    @property
    def left(self) -> float:
        """The painting's left border, in shares of the view's height."""
        return -self.extent.margin_x / self.unit

    @property
    def right(self) -> float:
        """The painting's right border, in shares of the view's height."""
        return (self.extent.width + self.extent.margin_x) / self.unit

    @property
    def top(self) -> float:
        """The painting's upper border, in shares of the view's height."""
        return -self.extent.margin_y / self.unit

    @property
    def bottom(self) -> float:
        """The painting's lower border, in shares of the view's height."""
        return 1 + self.extent.margin_y / self.unit

    def fill(
        self,
        points: Sequence[Point],
        colour: Colour,
        grain: float = 0.0,
        stretch: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """Paint a polygon; `grain` is the rms of its texture's relative brightness."""
        fixed = self._fixed(points)
        if grain == 0:
            cv2.fillPoly(self.canvas, [fixed], (*colour, 1.0), shift=4)
            return
        x, y, width, height = cv2.boundingRect(fixed >> 4)
        x0, y0 = max(x, 0), max(y, 0)
        x1, y1 = min(x + width, self.canvas.shape[1]), min(y + height, self.canvas.shape[0])
        if x1 <= x0 or y1 <= y0:
            return
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        cv2.fillPoly(mask, [fixed - np.array([x0, y0], np.int32) * 16], (1,), shift=4)
        texture = 1 + grain * self.palette.relief * self._texture(mask.shape, stretch)
        inside = mask > 0
        region = self.canvas[y0:y1, x0:x1]
        region[inside, :3] = texture[inside, None] * np.array(colour, np.float32)
        region[inside, 3] = 1.0

    def rectangle(
        self, x0: float, y0: float, x1: float, y1: float, colour: Colour, grain: float = 0.0,
        stretch: tuple[float, float] = (1.0, 1.0),
    ) -> None:  # fmt: skip
        """Paint an upright rectangle."""
        self.fill(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), colour, grain, stretch)

    def line(self, points: Sequence[Point], width: float, colour: Colour) -> None:
        """Paint a line of the given width (a share of the view's height) through points."""
        for (x0, y0), (x1, y1) in pairwise(points):
            length = math.hypot(x1 - x0, y1 - y0)
            nx, ny = -(y1 - y0) / length * width / 2, (x1 - x0) / length * width / 2
            self.fill(
                ((x0 + nx, y0 + ny), (x1 + nx, y1 + ny), (x1 - nx, y1 - ny), (x0 - nx, y0 - ny)),
                colour,
            )

    def foliage(self, x: float, y: float, rx: float, ry: float, colour: Colour) -> None:
        """Paint a bush or crown around (x, y): clumps of leaves, lit from the upper left."""
        pixel = self.unit * _SUPERSAMPLING
        clump = max(min(0.09 * min(rx, ry), 0.008), 1.2 / pixel)
        count = int(min(2.5 * rx * ry / clump**2, 1500)) + 12
        angle = self.rng.uniform(0, 2 * math.pi, count)
        radius = np.sqrt(self.rng.uniform(0, 1, count))
        lumpy = 1 + 0.14 * np.sin(3 * angle + self.rng.uniform(0, 6)) + 0.1 * np.sin(7 * angle)
        dx, dy = radius * lumpy * np.cos(angle), radius * lumpy * np.sin(angle)
        boughs = np.sin(5 * dx + self.rng.uniform(0, 6)) * np.sin(6 * dy + self.rng.uniform(0, 6))
        light = 0.93 - 0.16 * dx - 0.32 * dy + 0.14 * boughs
        light += 0.15 * self.rng.standard_normal(count)
        light = 1 + (light - 1) * (0.3 + 0.7 * self.palette.relief)
        hue = 1 + 0.06 * self.palette.relief * self.rng.standard_normal((count, 3))
        tints = np.clip(np.array(colour) * light[:, None] * hue, 0, 1)
        sizes = clump * pixel * 16 * self.rng.uniform(0.55, 1.35, count)
        leaves = list(
            zip(
                self._fixed(np.column_stack((x + rx * dx, y + ry * dy))).tolist(),
                np.column_stack((sizes, 0.7 * sizes)).astype(int).tolist(),
                self.rng.uniform(0, 180, count).tolist(),
                tints.tolist(),
                strict=True,
            )
        )
        for index in np.argsort(light + 0.35 * self.rng.standard_normal(count)):
            at, axes, turn, tint = leaves[index]
            cv2.ellipse(self.canvas, at, axes, turn, 0, 360, (*tint, 1.0), -1, shift=4)

    def tree(self, x: float, ground: float, height: float, colour: Colour) -> None:
        """Paint a tree whose trunk stands at (x, ground)."""
        top = ground - height
        self.line([(x, ground), (x, top + 0.4 * height)], 0.05 * height, self.palette.wood)
        for _ in range(4):
            offset = float(self.rng.uniform(-0.24, 0.24)) * height
            level = top + float(self.rng.uniform(0.28, 0.52)) * height
            spread = float(self.rng.uniform(0.24, 0.34)) * height
            self.foliage(x + offset, level, spread, 0.8 * spread, colour)

    def park(self, kind: str, x: float, ground: float, size: float, paint: Colour) -> None:
        """Paint a vehicle that stands still, part of the landscape."""
        thermal = self.palette is not DAYLIGHT
        parked = SceneObject(0, kind, size * self.unit * _SUPERSAMPLING, Path(((0, 0, 0),)), paint)
        pixel = self._fixed([(x, ground)])[0] / 16
        sprite = Sprite(parked, thermal, self.rng)
        pose = Pose(float(pixel[0]), float(pixel[1]), mirrored=bool(self.rng.random() < 0.5))
        placed = sprite.place(0.0, pose, np.eye(2, 3))
        placed.lay_over(self.canvas[..., :3])

    def weather(self, horizon: float) -> None:
        """Mottle everything below the horizon: dust, stains and uneven light."""
        y = max((self._row(horizon)) * _SUPERSAMPLING, 0)
        ground = self.canvas[y:, :, :3]
        mottle = self._texture(ground.shape[:2], (1.5, 1.0))
        ground *= 1 + 0.045 * self.palette.relief * mottle[..., None]

    def pebbles(self, upper: float, lower: float, number: int, colour: Colour) -> None:
        """Strew stones, tufts and litter: small hard specks, larger when nearer."""
        for nearness in np.sort(self.rng.random(number)):
            x = float(self.rng.uniform(self.left, self.right))
            y = upper + float(nearness) * (lower - upper)
            size = float(self.rng.uniform(0.001, 0.0015 + 0.003 * nearness))
            contrast = float(self.rng.choice((0.6, 0.78, 1.25)))
            b, g, r = (min(c * (1 + (contrast - 1) * self.palette.relief), 1) for c in colour)
            self.rectangle(x, y, x + 1.8 * size, y + size, (b, g, r))

    def haze(self, levels: Sequence[tuple[float, float]], airlight: Colour) -> None:
        """Lay air light over the picture; `levels` are (share of height, opacity) downwards."""
        pixels = np.arange(self.canvas.shape[0]) / _SUPERSAMPLING - self.extent.margin_y
        rows = pixels / self.unit
        opacity = np.interp(rows, [y for y, _ in levels], [o for _, o in levels])
        veil = opacity.astype(np.float32)[:, None, None]
        colours = self.canvas[..., :3]
        colours += veil * (np.array(airlight, np.float32) - colours)

    def region(self, x0: float, y0: float, x1: float, y1: float) -> tuple[slice, slice]:
        """Return the rows and columns of the finished painting that a rectangle covers."""
        columns = [self._column(x) for x in (x0, x1)]
        rows = [self._row(y) for y in (y0, y1)]
        return slice(*rows), slice(*columns)

    def finish(self) -> Field:
        """Return the painting at scene resolution, float32 HxWx3, values 0 to 1."""
        return np.ascontiguousarray(self._reduced()[..., :3])

    def finish_layer(self) -> Layer:
        """Return what was painted, with its coverage, premultiplied."""
        reduced = self._reduced()
        return Layer(np.ascontiguousarray(reduced[..., :3]), reduced[..., 3].copy())

    def _reduced(self) -> Field:
        height, width = self.extent.shape
        reduced = cv2.resize(self.canvas, (width, height), interpolation=cv2.INTER_AREA)
        return np.clip(reduced, 0, 1)

    def _texture(self, shape: tuple[int, ...], stretch: tuple[float, float]) -> Field:
        height, width = shape
        rows = (np.arange(height) / stretch[1] + self.rng.integers(_TILE)) % (_TILE - 1)
        columns = (np.arange(width) / stretch[0] + self.rng.integers(_TILE)) % (_TILE - 1)
        map_x, map_y = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
        return cv2.remap(self._noise, map_x, map_y, cv2.INTER_LINEAR)

    def _column(self, x: float) -> int:
        limit = self.extent.shape[1]
        return min(max(round(x * self.unit) + self.extent.margin_x, 0), limit)

    def _row(self, y: float) -> int:
        limit = self.extent.shape[0]
        return min(max(round(y * self.unit) + self.extent.margin_y, 0), limit)

    def _fixed(self, points: Sequence[Point] | npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
        """Return canvas coordinates of scene points, in sixteenths of a pixel."""
        scene = np.array(points, dtype=np.float64) * self.unit
        margin = np.array([self.extent.margin_x, self.extent.margin_y])
        canvas = (scene + margin + 0.5) * _SUPERSAMPLING - 0.5
        return np.rint(canvas * 16).astype(np.int32)


@dataclass(frozen=True)
class Sway:
    """Plants that the wind bends: a layer sheared more the higher it stands.

    `rows` and `columns` are its region of the painting; `amplitude` is the rms motion of its
    top, in pixels.
    """

    layer: Layer
    rows: slice
    columns: slice
    amplitude: float
    seed: int

    def draw(self, painting: Field, frame: int) -> None:
        """Lay the bent plants over the painting."""
        region = painting[self.rows, self.columns]
        height, width = region.shape[:2]
        rng = np.random.default_rng(self.seed)
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        lever = (1 - y / height) ** 1.3
        shift_x, shift_y = np.zeros_like(x), np.zeros_like(x)
        for scale, rate, share in ((4.0, 0.05, 0.7), (1.5, 0.11, 0.5), (0.4, 0.23, 0.35)):
            phase = 2 * math.pi * (rate * frame + rng.random())
            wave = x / (scale * height) * 2 * math.pi + y / (2 * scale * height) * 2 * math.pi
            swing = np.float32(self.amplitude * share * math.sqrt(2))
            shift_x += swing * np.sin(phase + wave)
            shift_y += np.float32(0.3) * swing * np.cos(1.3 * phase + 1.7 * wave)
        map_x, map_y = x + lever * shift_x, y + lever * shift_y
        bent = Layer(
            cv2.remap(self.layer.colour, map_x, map_y, cv2.INTER_LINEAR),
            cv2.remap(self.layer.coverage, map_x, map_y, cv2.INTER_LINEAR),
        )
        region[:] = bent.over(region)


@dataclass(frozen=True)
class Water:
    """A stretch of rippling water; ripples are flatter and slower towards the far shore."""

    rows: slice
    columns: slice
    colour: Colour
    ripples: tuple[Field, Field]
    contrast: float

    def draw(self, painting: Field, frame: int) -> None:
        """Paint the ripples of this frame."""
        region = painting[self.rows, self.columns]
        height, width = region.shape[:2]
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        depth = 0.35 + 0.65 * y / height
        glitter = np.ones_like(x)
        for noise, direction in zip(self.ripples, (1.0, -0.6), strict=True):
            map_x = np.mod(x / (1.8 * depth) + direction * 0.55 * frame, noise.shape[1] - 1)
            map_y = np.mod(y / (0.45 * depth) + 0.4 * frame, noise.shape[0] - 1)
            glitter += self.contrast * cv2.remap(noise, map_x, map_y, cv2.INTER_LINEAR)
        region[:] = np.clip(glitter[..., None] * np.array(self.colour, np.float32), 0, 1)


@dataclass(frozen=True)
class Flag:
    """A flag in the wind; `x` and `y` of its upper hoist corner in the painting, pixels."""

    x: float
    y: float
    width: float
    height: float
    stripes: tuple[Colour, ...]

    def draw(self, painting: Field, frame: int) -> None:
        """Paint the cloth with this frame's travelling wave."""
        columns = np.arange(math.floor(self.x), math.ceil(self.x + self.width))
        along = np.clip((columns - self.x) / self.width, 0, 1)
        phase = 2 * math.pi * (1.6 * along - 0.13 * frame)
        sag = 0.11 * self.height * along * np.sin(phase)
        light = 1 + 0.22 * along * np.cos(phase)
        rows = np.arange(math.floor(self.y - self.height), math.ceil(self.y + 2 * self.height))
        down = (rows[:, None] - self.y - sag[None, :]) / self.height
        coverage = np.clip(np.minimum(down, 1 - down) * self.height + 0.5, 0, 1)
        cloth = np.array(self.stripes[0]) * np.ones((*down.shape, 1))
        for index, colour in enumerate(self.stripes[1:], start=1):
            edge = (down - index / len(self.stripes)) * self.height
            cloth += np.clip(edge + 0.5, 0, 1)[..., None] * (np.array(colour) - cloth)
        cloth *= light[None, :, None]
        region = painting[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        region += (coverage[..., None] * (cloth - region)).astype(np.float32)


Painter = Callable[[Extent, Palette, np.random.Generator], Backdrop]
