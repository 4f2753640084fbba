"""What the scene looks like without its objects, and what stands out from it.

The background is never kept as a picture: for each object's surroundings it is the median over
earlier (and a few later) frames, aligned by ego-motion and without the pixels that were objects.
So it follows any camera that the alignment follows, and costs in proportion to the objects' size.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.exposure import AS_IT_IS, Exposure
from turbseg_ros.segmentation.geometry import lengths, scaling, translation
from turbseg_ros.segmentation.outline import Box, Outline

Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
Matrix = npt.NDArray[np.float64]

# A pixel's background is known once so many frames have shown it.
_FEWEST_SAMPLES = 3
# Value of the channel that tells where objects hide the scene: no grey value is higher.
_HIDDEN = 255
# Area in pixels from which on those of half the size are sampled.
_COARSE = 4.0
_TO_HALF = scaling(0.5, 0.5)
# Interquartile range of a normal variable, in standard deviations.
_IQR_TO_SIGMA = 1.0 / 1.349
# Grey values closer than this are the same, whatever the camera.
_LEAST_NOISE = 1.5
# Rest of the tilt, in pixels, that even a calm picture has: registration isn't perfect.
_LEAST_TILT = 0.25


@dataclass(frozen=True)
class Scene:
    """A frame and where objects hide the scene in it.

    `image` is HxWx(C+1): its last channel is 255 where objects are, else 0.
    """

    image: Image

    @functools.cached_property
    def half(self) -> Scene:
        """The same at half the size."""
        size = (max(self.image.shape[1] // 2, 1), max(self.image.shape[0] // 2, 1))
        return Scene(cv2.resize(self.image, size, interpolation=cv2.INTER_AREA))


@dataclass(frozen=True)
class View:
    """Another frame of the same scene.

    `to_image` takes the reference frame's pixels to its own, `exposure` its grey values to the
    reference's.
    """

    scene: Scene
    to_image: Matrix
    exposure: Exposure = AS_IT_IS


def scene_of(picture: Image) -> Scene:
    """Give the scene that a picture, HxW or HxWxC, shows, no objects hiding it."""
    channels = picture.shape[2] if picture.ndim == 3 else 1
    image = np.zeros((*picture.shape[:2], channels + 1), np.uint8)
    # From channel to channel; NumPy would go from pixel to pixel.
    cv2.mixChannels([picture], [image], [each for c in range(channels) for each in (c, c)])
    return Scene(image)


def without_objects(scene: Scene, objects: Iterable[Outline]) -> Scene:
    """Give a scene with objects that hide it."""
    image = scene.image.copy()
    for outline in objects:
        image[outline.box.slices][outline.mask, -1] = _HIDDEN
    return Scene(image)


@dataclass(frozen=True)
class Background:
    """A part of the scene without its objects: median and spread of its grey values, hxwxC.

    `known` tells, hxw, where enough views showed it free of objects; elsewhere the values mean
    nothing. `spread` is the standard deviation of what was seen there, by the interquartile range.
    """

    median: Map
    spread: Map
    known: Mask


def background_in(
    box: Box, views: Sequence[View], shape: tuple[int, int] | None = None
) -> Background:
    """Estimate the background within a box of the reference frame from other views of it.

    :param shape: rows and columns to sample the box at, its own if None.
    """
    shape = shape or box.shape
    pictures = [_sampled(view, box, shape) for view in views]
    count = np.full(shape, len(views))
    for picture in pictures:
        hidden = picture[..., -1] > 127
        if hidden.any():
            # So that they sort last.
            picture[hidden] = _HIDDEN
            count -= hidden
    samples = np.stack(_ordered(pictures))
    rows, columns = np.indices(shape, sparse=True)
    last = np.maximum(count - 1, 0)

    def quantile(quarters: int) -> Map:
        chosen = samples[(last * quarters + 2) // 4, rows, columns]
        return np.asarray(chosen[..., :-1], np.float32)

    return Background(
        median=quantile(2),
        spread=(quantile(3) - quantile(1)) * np.float32(_IQR_TO_SIGMA),
        known=count >= _FEWEST_SAMPLES,
    )


def _ordered(pictures: Sequence[Image]) -> list[Image]:
    """Sort the values of each pixel over pictures of one size, the least first.

    A sorting network works on whole pictures; NumPy would sort pixel by pixel, which takes long.
    """
    ordered = list(pictures)
    for low, high in _sorting_network(len(ordered)):
        a, b = ordered[low], ordered[high]
        ordered[low], ordered[high] = np.minimum(a, b), np.maximum(a, b)
    return ordered


@functools.lru_cache(maxsize=64)
def _sorting_network(count: int) -> tuple[tuple[int, int], ...]:
    """Give which of `count` values to compare and exchange in turn: Batcher's odd-even merge sort.

    Knuth, The Art of Computer Programming 3, algorithm 5.2.2M.
    """
    pairs = []
    widest = 1 << max(count - 1, 0).bit_length()
    p = widest >> 1
    while p > 0:
        q, r, d = widest >> 1, 0, p
        while d > 0:
            pairs += [(i, i + d) for i in range(count - d) if i & p == r]
            d, q, r = q - p, q >> 1, p
        p >>= 1
    return tuple(pairs)


def difference_from(background: Background, image: Image) -> Map:
    """Give the difference in grey values of each pixel, of the channel that differs most, hxw.

    :param image: hxwxC, the same part of the reference frame.
    """
    return largest(_difference(background, image))


def deviation_from(background: Background, image: Image, tilt: float) -> Map:
    """Give by how many standard deviations each pixel differs from the background, hxw.

    A pixel's variance is what was seen there, not less than what is usual in the picture, and
    what tilt makes of the grey values' slope at it: edges shimmer, plain parts don't.

    :param image: hxwxC, the same part of the reference frame.
    :param tilt: rms turbulent motion an axis in pixels.
    """
    usual = (
        float(np.median(background.spread[background.known])) if background.known.any() else 0.0
    )
    noise = np.maximum(background.spread, max(usual, _LEAST_NOISE))
    shimmer = _slope(background.median) * max(tilt, _LEAST_TILT)
    return largest(_difference(background, image) / np.sqrt(noise * noise + shimmer * shimmer))


def _difference(background: Background, image: Image) -> Map:
    """Give the difference in grey values of each channel, hxwxC."""
    return np.abs(image - background.median)


def largest(values: Map) -> Map:
    """Give the largest of each pixel's channels, hxw."""
    # NumPy's maximum along the last axis, which is short, takes forty times as long.
    return functools.reduce(np.maximum, np.moveaxis(values, 2, 0))


def smallest(values: Map) -> Map:
    """Give the smallest of each pixel's channels, hxw."""
    return functools.reduce(np.minimum, np.moveaxis(values, 2, 0))


def _slope(picture: Map) -> Map:
    """Give the length of the grey values' gradient, a pixel, hxwxC."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    return lengths(across, down).reshape(picture.shape)


def _sampled(view: View, box: Box, shape: tuple[int, int]) -> Image:
    """Resample a view in a box, hxwx(C+1); what is out of view counts as hidden."""
    height, width = shape
    to_box = translation(box.x0, box.y0) @ scaling(box.shape[1] / width, box.shape[0] / height)
    scene, to_image = view.scene, view.to_image @ to_box
    # Pixels further apart than two of the image are sampled from an average of them.
    while abs(np.linalg.det(to_image[:2, :2])) >= _COARSE and min(scene.image.shape[:2]) > 1:
        scene, to_image = scene.half, _TO_HALF @ to_image
    sampled: Image = cv2.warpAffine(
        scene.image,
        to_image[:2],
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(_HIDDEN,) * scene.image.shape[2],
    )
    return view.exposure.applied_to(sampled, channels=sampled.shape[2] - 1)
