"""How the camera moves: hand shake, pan and vibration, and its sensor's noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Field = npt.NDArray[np.float32]


@dataclass(frozen=True)
class CameraMotion:
    """Motion of the picture that the camera causes, in pixels and frames.

    `shake` is the rms step from one frame to the next an axis, of a wander that a hand or tripod
    pulls back within `shake_memory` frames; with it goes a roll of `roll` radians rms. `pan` is
    the steady motion of the view over the scene a frame, `vibration` the amplitude of a
    sinusoid (engine, rotor) with a period of `vibration_period` frames.
    """

    shake: float = 0.0
    shake_memory: float = 8.0
    roll: float = 0.0
    pan: tuple[float, float] = (0.0, 0.0)
    vibration: float = 0.0
    vibration_period: float = 3.3

    @property
    def is_still(self) -> bool:
        """Whether the camera stands on rock."""
        return not (self.shake or self.roll or self.vibration or any(self.pan))

    def trajectory(
        self, frames: int, centre: tuple[float, float], rng: np.random.Generator
    ) -> npt.NDArray[np.float64]:
        """Return the maps from scene to image of every frame: affine matrices, float64 Nx2x3.

        The picture rolls about `centre` (x, y). The first frame is where the scene was laid out,
        apart from shake.
        """
        time = np.arange(frames)
        wander = _wander(frames, self.shake_memory, rng)
        step = np.sqrt(2 * (1 - math.exp(-1 / self.shake_memory)))
        offset = wander[:, :2] * (self.shake / step)
        offset -= np.outer(time, self.pan)
        angle = 2 * math.pi * time / self.vibration_period
        offset += self.vibration * np.column_stack((np.cos(angle), np.sin(1.37 * angle)))
        roll = self.roll * wander[:, 2]

        maps = np.zeros((frames, 2, 3))
        maps[:, 0, 0] = maps[:, 1, 1] = np.cos(roll)
        maps[:, 0, 1], maps[:, 1, 0] = -np.sin(roll), np.sin(roll)
        pivot = np.asarray(centre)
        maps[:, :, 2] = offset + pivot - maps[:, :, :2] @ pivot
        return maps


def _wander(frames: int, memory: float, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """First-order autoregressive noise of unit variance, float64 Nx3."""
    keep = math.exp(-1 / memory)
    noise = rng.standard_normal((frames, 3))
    values = np.empty_like(noise)
    values[0] = noise[0]
    for index in range(1, frames):
        values[index] = keep * values[index - 1] + math.sqrt(1 - keep**2) * noise[index]
    return values


@dataclass(frozen=True)
class Sensor:
    """Turns radiance (0 to 1) into the picture that the camera delivers.

    `encoding` is `bgr8`, `mono8` or `mono16`; `full_well` the electrons of a white pixel, which
    set the shot noise, `read_noise` electrons rms; `lens_blur` the sigma, in pixels, of the
    lens; `column_noise` the rms, of full scale, of a fixed pattern as thermal sensors have.
    """

    encoding: str = "bgr8"
    full_well: float = 20_000.0
    read_noise: float = 8.0
    lens_blur: float = 0.6
    column_noise: float = 0.0

    def pattern(self, width: int, rng: np.random.Generator) -> Field:
        """Return the fixed pattern of one camera: float32 of `width`, shares of full scale."""
        return np.asarray(self.column_noise * rng.standard_normal(width), dtype=np.float32)

    def expose(
        self, radiance: Field, pattern: Field, rng: np.random.Generator
    ) -> npt.NDArray[Any]:
        """Return the picture of a radiance (float32 HxWx3): uint8 or uint16, as `encoding` says.

        Shot noise is the Poisson distribution's normal limit.
        """
        if self.encoding != "bgr8":
            radiance = cv2.cvtColor(radiance, cv2.COLOR_BGR2GRAY)
        electrons = np.clip(radiance, 0, 1) * np.float32(self.full_well)
        sigma = np.sqrt(electrons + np.float32(self.read_noise**2))
        electrons += sigma * rng.standard_normal(electrons.shape, dtype=np.float32)
        fixed = pattern if electrons.ndim == 2 else pattern[:, None]
        signal = electrons / np.float32(self.full_well) + fixed
        dtype = np.uint16 if self.encoding == "mono16" else np.uint8
        white = np.iinfo(dtype).max
        return np.rint(np.clip(signal, 0, 1) * white).astype(dtype)
