"""What stirs in a picture and goes nowhere: leaves, water, smoke and light, on any picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from .textures import fractal_noise
from .turbulence import Field


@dataclass(frozen=True)
class Leaves:
    """Parts of a picture that the wind sways.

    `where` is HxW, 0 to 1; `amplitude` the rms motion in pixels; `period` of the slowest wave in
    frames and `scale` its length in pixels.
    """

    where: Field
    amplitude: float
    period: float
    scale: float
    phase: float

    def at(self, picture: Field, frame: int) -> Field:
        """Return a picture, HxWx3, as the wind has it at a frame."""
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
        shift_x, shift_y = np.zeros_like(x), np.zeros_like(x)
        for finer, share in ((1.0, 0.8), (2.3, 0.5), (5.0, 0.3)):
            turn = 2 * math.pi * finer**0.7 * frame / self.period + self.phase * finer
            wave = np.float32(2 * math.pi * finer / self.scale) * (x + np.float32(0.6) * y)
            shift_x += np.float32(share) * np.sin(wave + np.float32(turn))
            shift_y += np.float32(0.4 * share) * np.cos(np.float32(1.4) * wave + np.float32(turn))
        reach = self.where * np.float32(self.amplitude * math.sqrt(2))
        return _remapped(picture, x + reach * shift_x, y + reach * shift_y)


@dataclass(frozen=True)
class Ripples:
    """Water: a part of a picture is seen as a mirror that ripples, with glitter on it.

    `where` is HxW, 0 to 1; `noise` periodic; `speed` in pixels a frame.
    """

    where: Field
    noise: Field
    amplitude: float
    glitter: float
    speed: float

    def at(self, picture: Field, frame: int) -> Field:
        """Return a picture, HxWx3, as the water has it at a frame."""
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
        height, width = self.noise.shape
        waves = np.zeros_like(x)
        for across, down, stretch in ((1.0, 0.5, 0.45), (-0.6, 0.7, 0.8)):
            waves += cv2.remap(
                self.noise,
                np.mod(stretch * x + across * self.speed * frame, width - 1),
                np.mod(2.2 * stretch * y + down * self.speed * frame, height - 1),
                cv2.INTER_LINEAR,
            )
        moved = _remapped(
            picture,
            x + self.where * np.float32(self.amplitude) * waves,
            y + self.where * np.float32(0.5 * self.amplitude) * waves,
        )
        return np.clip(moved * (1 + (self.where * self.glitter * waves)[..., None]), 0, 1)


@dataclass(frozen=True)
class Smoke:
    """Smoke, dust, spray or mist: a veil of `light` (0 to 1) that drifts and changes its form.

    `where` is HxW, 0 to 1, the most that it hides; `noise` are two periodic maps; `drift` (x, y)
    in pixels a frame.
    """

    where: Field
    noise: tuple[Field, Field]
    light: float
    drift: tuple[float, float]

    def at(self, picture: Field, frame: int) -> Field:
        """Return a picture, HxWx3, behind the veil of a frame."""
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
        density = np.zeros_like(x)
        for noise, share in zip(self.noise, (1.0, 1.4), strict=True):
            height, width = noise.shape
            density += cv2.remap(
                noise,
                np.mod(x - share * self.drift[0] * frame, width - 1),
                np.mod(y - share * self.drift[1] * frame, height - 1),
                cv2.INTER_LINEAR,
            )
        opacity = (self.where * np.clip(0.5 + 0.4 * density, 0, 1))[..., None]
        return np.asarray(picture + opacity * (np.float32(self.light) - picture), np.float32)


@dataclass(frozen=True)
class PassingLight:
    """Clouds before the sun: brightness that goes over the picture, by `strength` at most."""

    noise: Field
    strength: float
    drift: tuple[float, float]

    def at(self, picture: Field, frame: int) -> Field:
        """Return a picture, HxWx3, in the light of a frame."""
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
        height, width = self.noise.shape
        shade = cv2.remap(
            self.noise,
            np.mod(0.2 * x - self.drift[0] * frame, width - 1),
            np.mod(0.2 * y - self.drift[1] * frame, height - 1),
            cv2.INTER_LINEAR,
        )
        gain = 1 + np.float32(self.strength) * np.clip(shade, -1, 1)
        return np.clip(picture * gain[..., None], 0, 1)


Stir = Leaves | Ripples | Smoke | PassingLight

_TILE = 256


def random_stir(shape: tuple[int, int], rng: np.random.Generator) -> Stir:
    """Draw something that stirs in a picture of a shape (height, width)."""
    kind = rng.choice(["leaves", "ripples", "smoke", "light"], p=[0.4, 0.25, 0.25, 0.1])
    if kind == "leaves":
        return Leaves(
            _patches(shape, rng, share=rng.uniform(0.2, 0.6)),
            amplitude=float(math.exp(rng.uniform(math.log(0.3), math.log(3.0)))),
            period=float(rng.uniform(10, 60)),
            scale=float(rng.uniform(12, 90)),
            phase=float(rng.uniform(0, 2 * math.pi)),
        )
    drift = float(rng.normal(0, 1.5)), float(rng.normal(0, 0.7))
    noise, other = (
        fractal_noise((_TILE, _TILE), rng, exponent=rng.uniform(1.1, 1.8)) for _ in range(2)
    )
    if kind == "ripples":
        below = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None]
        shore = rng.uniform(0.2, 0.8)
        where = np.clip((below - shore) * 30, 0, 1) * np.ones(shape, np.float32)
        return Ripples(
            where,
            fractal_noise((_TILE, _TILE), rng, exponent=rng.uniform(0.6, 1.2)),
            amplitude=float(rng.uniform(0.2, 2.0)),
            glitter=float(rng.uniform(0.0, 0.15)),
            speed=float(rng.uniform(0.2, 1.5)),
        )
    if kind == "smoke":
        opacity = np.float32(rng.uniform(0.2, 0.9))
        where = opacity * _patches(shape, rng, share=rng.uniform(0.05, 0.3))
        return Smoke(where, (noise, other), float(rng.uniform(0.2, 0.95)), drift)
    return PassingLight(noise, float(rng.uniform(0.05, 0.25)), drift)


def _patches(shape: tuple[int, int], rng: np.random.Generator, share: float) -> Field:
    """Return soft-edged patches, HxW from 0 to 1, that cover about a share of the whole."""
    coarse = rng.standard_normal((5, 7)).astype(np.float32)
    smooth = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    level = np.quantile(smooth[::4, ::4], 1 - share)
    return np.asarray(np.clip((smooth - level) * 3, 0, 1), np.float32)


def _remapped(picture: Field, map_x: Field, map_y: Field) -> Field:
    return np.asarray(
        cv2.remap(picture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    )
