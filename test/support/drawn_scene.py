"""Textured ground, and a textured square that goes over it, with its exact truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.background import MaskedImage, unmasked, with_objects_masked
from turbseg_ros.segmentation.cropped_mask import CroppedMask

ByteImage = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


def texture(
    shape: tuple[int, int], seed: int, *, low: int = 60, high: int = 200, grain: float = 1.5
) -> ByteImage:
    """Draw smooth noise, HxW, that fills the grey values from `low` to `high`."""
    noise = np.random.default_rng(seed).uniform(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), grain)
    return cv2.normalize(smooth, None, low, high, cv2.NORM_MINMAX).astype(np.uint8)


def scene_behind(picture: ByteImage, objects: Mask) -> MaskedImage:
    """Return the scene that a picture shows where a mask of its size doesn't tell of objects."""
    return with_objects_masked(unmasked(picture), [CroppedMask.of(objects)])


def rectangle(x0: int, y0: int, x1: int, y1: int, shape: tuple[int, int] = (96, 160)) -> Mask:
    mask = np.zeros(shape, bool)
    mask[y0:y1, x0:x1] = True
    return mask


@dataclass(frozen=True)
class DrawnScene:
    """A ground, 160x96 pixels, and how a square of 24 pixels goes over it: from where, how fast.

    Without a `velocity` there is no square.
    """

    velocity: tuple[int, int] | None = (3, 0)
    start: tuple[int, int] = (20, 36)
    side: int = 24
    noise: float = 2.0
    shape: tuple[int, int] = (96, 160)

    def truth(self, number: int) -> Mask:
        """Where the square is in a frame, HxW."""
        mask = np.zeros(self.shape, bool)
        if self.velocity is not None:
            x, y = (p + number * v for p, v in zip(self.start, self.velocity, strict=True))
            mask[y : y + self.side, x : x + self.side] = True
        return mask

    def images(self, count: int) -> Iterator[ByteImage]:
        """Draw the first frames, HxW, with a camera's noise."""
        ground = texture(self.shape, seed=1)
        square = texture((self.side, self.side), seed=2, low=10, high=90)
        for number in range(count):
            image = ground.copy()
            image[self.truth(number)] = square.ravel() if self.velocity else 0
            noise = np.random.default_rng(number).normal(0.0, self.noise, self.shape)
            yield np.clip(image + noise, 0, 255).astype(np.uint8)


def jaccard(mask: Mask, truth: Mask) -> float:
    """Return the share of two masks' union that both hold."""
    union = int(np.count_nonzero(mask | truth))
    return float(np.count_nonzero(mask & truth)) / max(union, 1)
