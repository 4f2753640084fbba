"""What the scene looks like without its objects, and what stands out from it.

The background is never kept as a picture: for each object's surroundings it is the median over
earlier (and a few later) frames, aligned by ego-motion and without the pixels that were objects.
So it follows any camera that the alignment follows, and costs in proportion to the objects' size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
Matrix = npt.NDArray[np.float64]

# A pixel's background is known once so many frames have shown it.
_FEWEST_SAMPLES = 3
_MASKED = 256
# Interquartile range of a normal variable, in standard deviations.
_IQR_TO_SIGMA = 1.0 / 1.349


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels: columns x0 to x1 - 1, rows y0 to y1 - 1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y1 - self.y0, self.x1 - self.x0

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index that cuts the box out of an image."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def grown(self, margin: int, shape: tuple[int, int]) -> Box:
        """Give the box with `margin` more on each side, within an image of `shape`."""
        return Box(
            max(self.x0 - margin, 0),
            max(self.y0 - margin, 0),
            min(self.x1 + margin, shape[1]),
            min(self.y1 + margin, shape[0]),
        )

    @classmethod
    def around(cls, mask: Mask) -> Box:
        """Give the smallest box around a mask that holds something."""
        x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
        return cls(x, y, x + width, y + height)


@dataclass(frozen=True)
class View:
    """Another frame of the same scene: image, which pixels are objects, and where it looks.

    `to_image` takes the reference frame's pixel coordinates to the image's.
    """

    image: Image
    objects: Mask | None
    to_image: Matrix


@dataclass(frozen=True)
class Background:
    """A part of the scene without its objects: hxwxC median and spread, hxw known or not.

    `spread` is the standard deviation of what was seen there, by the interquartile range: on
    edges it is what tilt makes of them.
    """

    median: Map
    spread: Map
    known: Mask


def background_in(box: Box, views: Sequence[View]) -> Background:
    """Estimate the background within a box of the reference frame from other views of it."""
    samples = np.stack([_sampled(view, box) for view in views])
    samples.sort(axis=0)
    count = np.count_nonzero(samples[..., :1] < _MASKED, axis=0)
    last = np.maximum(count - 1, 0)

    def quantile(numerator: int) -> npt.NDArray[np.float32]:
        index = np.broadcast_to((last * numerator + 2) // 4, samples.shape[1:])
        return np.take_along_axis(samples, index[None], axis=0)[0].astype(np.float32)

    return Background(
        median=quantile(2),
        spread=(quantile(3) - quantile(1)) * np.float32(_IQR_TO_SIGMA),
        known=count[..., 0] >= _FEWEST_SAMPLES,
    )


def deviation_from(background: Background, image: Image, noise: float) -> Map:
    """Give by how many standard deviations each pixel differs from the background, hxw.

    The channel that differs most counts; 0 where the background is not known.

    :param image: hxwxC, the same part of the reference frame.
    :param noise: standard deviation of the camera's grey values, the least to be assumed.
    """
    difference = np.abs(image.astype(np.float32) - background.median)
    deviation = (difference / np.maximum(background.spread, noise)).max(axis=2)
    result: Map = np.where(background.known, deviation, 0.0).astype(np.float32)
    return result


def silhouette(
    background: Background, image: Image, moving: Mask, noise: float, threshold: float
) -> Mask:
    """Cut out what stands out from the background where something moves, hxw.

    Where the background isn't known, motion alone decides. Edges follow those of the image by a
    guided filter (He et al. 2013), small holes are closed, and what is enclosed belongs to it.

    :param image: hxwxC, the same part of the reference frame.
    :param moving: hxw, where motion was found: nothing outside it is taken.
    :param noise: standard deviation of the camera's grey values.
    :param threshold: standard deviations by which an object differs from the background.
    """
    deviation = np.minimum(deviation_from(background, image, noise), 4.0 * threshold)
    score = np.clip(cv2.blur(deviation, (3, 3)) / threshold - 1.0, -1.0, 1.0)
    score = np.where(background.known, score, np.where(moving, 0.3, -0.3)).astype(np.float32)
    guide = image.astype(np.float32).mean(axis=2) / 255.0
    score = guided_filter(guide, score, radius=2, epsilon=1e-3)
    return _tidied((score > 0.0) & moving)


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


def _sampled(view: View, box: Box) -> npt.NDArray[np.uint16]:
    """Resample a view in a box, hxwxC; pixels of objects or out of view get _MASKED."""
    height, width = box.shape
    to_box = np.array([[1.0, 0.0, box.x0], [0.0, 1.0, box.y0], [0.0, 0.0, 1.0]])
    transform = (view.to_image @ to_box)[:2]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpAffine(
        view.image, transform, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
    ).reshape(height, width, -1)
    hidden = (
        np.zeros(view.image.shape[:2], np.uint8)
        if view.objects is None
        else view.objects.astype(np.uint8)
    )
    hidden = cv2.warpAffine(
        hidden,
        transform,
        (width, height),
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=1,
    )
    return np.where(hidden[..., None] > 0, np.uint16(_MASKED), image).astype(np.uint16)


def _tidied(mask: Mask) -> Mask:
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED)
    opened = cv2.morphologyEx(filled, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    tidy: Mask = opened > 0
    return tidy
