"""What goes along with a mover and is no part of it: its cast shadow, its dust, spray or wake."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import Matrix

from .objects import Layer, PlacedSprite
from .textures import fractal_noise
from .turbulence import Field

_TILE = 256
# Fainter than this share of the picture's light nobody sees a veil.
_FAINTEST = 0.01


@dataclass(frozen=True)
class Sun:
    """Where the sun throws shadows in a picture, and how deep they are.

    What is a pixel above the foot of its object darkens the ground `across` pixels to the right of
    there and `down` below the foot; `depth` is how far the body reaches away from the camera, as a
    share of its height. A shadow takes away the share `strength` of the light, less of the blue by
    `blue`, and has a border as soft as `softness` times its object's height.
    """

    across: float
    down: float
    depth: float
    strength: float
    blue: float
    softness: float

    def shadow_of(self, sprite: PlacedSprite) -> PlacedSprite | None:
        """Return the shadow on the ground as a sprite to be laid below; None where it has none."""
        body = sprite.layer.coverage
        rows = np.flatnonzero(body.max(axis=1) > 0.5)
        if not rows.size:
            return None
        height, width = int(rows[-1] - rows[0] + 1), body.shape[1]
        # Sheared first, its foot in the first row and drawn out by its depth, then squeezed down.
        flat = abs(self.down)
        deep = math.ceil((self.depth * height + 1) / flat)
        reach = self.across * (height - 1)
        left = math.floor(min(reach, 0.0)) - 1
        foot_first = np.ascontiguousarray(body[rows[0] : rows[-1] + 1][::-1])
        shear = np.array([[1.0, self.across, -left], [0.0, 1.0, deep]])
        size = width + math.ceil(abs(reach)) + 3, height + deep
        sheared = cv2.warpAffine(foot_first, shear, size)
        drawn_out = cv2.dilate(sheared, np.ones((deep + 1, 1), np.uint8), anchor=(0, 0))
        length = max(round(flat * size[1]), 1)
        shade = cv2.resize(drawn_out, (size[0], length), interpolation=cv2.INTER_AREA)
        top = int(rows[-1]) - round(flat * deep)
        if self.down < 0:
            shade, top = np.ascontiguousarray(shade[::-1]), int(rows[-1]) - length + 1
        soft = max(self.softness * height, 0.3)
        margin = math.ceil(3 * soft) + 1
        shade = cv2.copyMakeBorder(shade, margin, margin, margin, margin, cv2.BORDER_CONSTANT)
        shade = cv2.GaussianBlur(shade, (0, 0), soft)
        coverage = np.float32(self.strength) * shade
        # What blue is left of the sky's light, on ground of a middling grey.
        sky = np.array([self.blue, 0.3 * self.blue, 0.0], np.float32)
        layer = Layer(0.4 * coverage[..., None] * sky, coverage)
        return PlacedSprite(sprite.left + left - margin, sprite.top + top - margin, layer, None)


def random_sun(rng: np.random.Generator) -> Sun:
    """Draw where the sun stands, mostly low, as it is seldom overhead."""
    length = math.exp(rng.uniform(math.log(0.3), math.log(2.5)))
    angle = rng.uniform(-0.5, 0.35) + math.pi * rng.integers(0, 2)
    down = length * math.sin(angle)
    return Sun(
        across=length * math.cos(angle),
        down=math.copysign(max(abs(down), 0.04), down),
        depth=float(rng.uniform(0.03, 0.3)),
        strength=float(rng.uniform(0.3, 0.75)),
        blue=float(rng.uniform(0.0, 0.15)),
        softness=float(rng.uniform(0.0, 0.04)),
    )


@dataclass(frozen=True)
class PlumeLook:
    """What a mover leaves behind: dust, spray, exhaust, or a wake where it is flat.

    Lengths are in sizes of the mover: `radius` of a puff when it is new, `growth` of that after
    one frame, as the square root of its age. A new puff hides the share `opacity` of what is
    behind it, one of `life` frames a third of that. `flat` is its height over its width, `light`
    its own brightness, 0 to 1, `drift` (x, y) the wind's way a frame.
    """

    radius: float
    growth: float
    opacity: float
    life: float
    flat: float
    light: float
    drift: tuple[float, float]


class Plume:
    """A veil that hangs where a mover has been, thinner and wider the longer that is ago.

    :param positions: of the mover's foot in the scene, Nx2, in pixels, frame by frame; it is taken
        to have come as straight before the first.
    :param size: of the mover, in pixels.
    """

    def __init__(
        self, positions: Matrix, size: float, look: PlumeLook, rng: np.random.Generator
    ) -> None:
        self._positions = positions
        self._first_step = np.diff(positions[:2], axis=0).sum(axis=0)
        self._size = size
        self._look = look
        self._noise = fractal_noise((_TILE, _TILE), rng, exponent=rng.uniform(1.0, 1.6))
        self._way = float(rng.uniform(-0.5, 0.5))

    def at(self, frame: int, to_picture: Matrix, shape: tuple[int, int]) -> PlacedSprite:
        """Return the veil of a frame as a sprite as large as a picture of a shape."""
        look, (height, width) = self._look, shape
        ages = np.arange(1, math.ceil(3 * look.life) + 1)
        frames = frame - ages
        feet = self._positions[np.clip(frames, 0, len(self._positions) - 1)]
        feet = feet + np.minimum(frames, 0)[:, None] * self._first_step
        feet += self._size * ages[:, None] * np.array(look.drift)
        centres = feet @ to_picture[:, :2].T + to_picture[:, 2]
        radii = self._size * (look.radius + look.growth * np.sqrt(ages))
        strengths = look.opacity * np.exp(-ages / look.life)
        seen = np.ones(shape, np.float32)
        for (x, y), radius, strength in zip(centres, radii, strengths, strict=True):
            across = np.exp(-(((np.arange(width) - x) / radius) ** 2))
            # It hangs over the ground on which the mover's foot was.
            raised = y - look.flat * radius
            down = np.exp(-(((np.arange(height) - raised) / (look.flat * radius)) ** 2))
            seen *= np.float32(1) - np.outer(strength * down, across).astype(np.float32)
        coverage = (1 - seen) * self._billows(frame, shape)
        coverage[coverage < _FAINTEST] = 0.0
        layer = Layer(np.repeat(coverage[..., None] * np.float32(look.light), 3, axis=2), coverage)
        return PlacedSprite(0, 0, layer, None)

    def _billows(self, frame: int, shape: tuple[int, int]) -> Field:
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
        way = np.float32(self._way * frame)
        noise = cv2.remap(
            self._noise, np.mod(x + way, _TILE - 1), np.mod(y, _TILE - 1), cv2.INTER_LINEAR
        )
        return np.asarray(np.clip(0.65 + 0.35 * noise, 0, 1), np.float32)


def random_plume(rng: np.random.Generator) -> PlumeLook:
    """Draw what something leaves behind."""
    is_wake = rng.random() < 0.3
    return PlumeLook(
        radius=float(rng.uniform(0.1, 0.35)),
        growth=float(rng.uniform(0.0, 0.15)),
        opacity=float(rng.uniform(0.1, 0.6)),
        life=float(rng.uniform(3.0, 20.0)),
        flat=float(rng.uniform(0.05, 0.2) if is_wake else rng.uniform(0.3, 1.0)),
        light=float(rng.uniform(0.3, 1.0)),
        drift=(float(rng.normal(0, 0.01)), 0.0 if is_wake else float(-abs(rng.normal(0, 0.005)))),
    )
