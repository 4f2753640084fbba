"""What the scene looks like without its objects, and what stands out from it.

The background is never kept as a picture: for each object's surroundings it is the median over
earlier (and a few later) frames, aligned by ego-motion and without the pixels that were objects.
So it follows any camera that the alignment follows, and costs in proportion to the objects' size.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.exposure import AS_IT_IS, ColourExposure, Exposure
from turbseg_ros.segmentation.geometry import scaling, translation, upper_median

Counts = npt.NDArray[np.int32]

# A pixel's background is known once so many frames have shown it.
_MIN_SAMPLES = 3
# Value of the channel that tells where objects hide the scene: no grey value is higher. And the
# bits of all others in a pixel of three colours as one number.
_HIDDEN = 255
_COLOURS = np.int32(0x00FFFFFF)
# Area in pixels from which on those of half the size are sampled.
_COARSE = 4.0
_TO_HALF = scaling(0.5, 0.5)
# Columns that OpenCV resamples at once; one by one, those left over take as long as all others.
_AT_ONCE = 16
# Interquartile range of a normal variable, in standard deviations.
_IQR_TO_SIGMA = 1.0 / 1.349
# Grey values closer than this are the same, whatever the camera.
_MIN_NOISE = 1.5
# One pixel of so many tells what spread is usual.
_SPREAD_STEP = 3
# Rest of the tilt, in pixels, that even a calm picture has: registration isn't perfect.
_MIN_TILT = 0.25


@dataclass(frozen=True)
class MaskedImage:
    """A frame and where objects hide the scene in it.

    `image` is HxWx(C+1), C 1 or 3: its last channel is 255 where objects are, else 0.
    """

    image: ByteImage

    @functools.cached_property
    def half(self) -> MaskedImage:
        """The same at half the size, rounded up: each pixel is the mean of four."""
        image = self.image
        odd_row, odd_column = image.shape[0] % 2, image.shape[1] % 2
        if odd_row or odd_column:
            border = cv2.BORDER_REPLICATE
            image = cv2.copyMakeBorder(image, 0, odd_row, 0, odd_column, borderType=border)
        size = (image.shape[1] // 2, image.shape[0] // 2)
        return MaskedImage(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


@dataclass(frozen=True)
class AlignedFrame:
    """Another frame of the same scene.

    `to_image` takes the reference frame's pixels to its own, `exposure` its grey values to the
    reference's.
    """

    scene: MaskedImage
    to_image: Matrix
    exposure: Exposure | ColourExposure = AS_IT_IS

    def shows_of(self, box: Box) -> bool:
        """Whether it shows any of a box of the reference frame."""
        corners = [[box.x0, box.x1, box.x0, box.x1], [box.y0, box.y0, box.y1, box.y1], [1] * 4]
        x, y = (self.to_image @ corners)[:2]
        rows, columns = self.scene.image.shape[:2]
        return bool(x.max() > 0 and x.min() < columns and y.max() > 0 and y.min() < rows)


def unmasked(picture: ByteImage) -> MaskedImage:
    """Return the scene that a picture, HxW or HxWxC, shows, no objects hiding it."""
    if picture.ndim == 2 or picture.shape[2] == 1:
        grey = picture.reshape(picture.shape[:2])
        # From channel to channel; NumPy would go from pixel to pixel.
        return MaskedImage(cv2.merge([grey, np.zeros_like(grey)]))
    image = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)
    pixels = _as_numbers(image)
    pixels &= _COLOURS
    return MaskedImage(image)


def with_objects_masked(scene: MaskedImage, objects: Iterable[CroppedMask]) -> MaskedImage:
    """Return a scene with objects that hide it."""
    objects = list(objects)
    if not objects:
        return scene
    image = scene.image.copy()
    for outline in objects:
        image[outline.box.slices][outline.mask, -1] = _HIDDEN
    return MaskedImage(image)


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
    box: Box, views: Sequence[AlignedFrame], shape: tuple[int, int] | None = None
) -> Background:
    """Estimate the background within a box of the reference frame from other views of it.

    :param shape: rows and columns to sample the box at, its own if None.
    """
    lower, median, upper, known = _quartiles_in(box, views, shape or box.shape)
    spread = without_last(upper - lower) * np.float32(_IQR_TO_SIGMA)
    return Background(without_last(median).astype(np.float32), spread, known)


def cut_out(views: Sequence[AlignedFrame], box: Box, shape: tuple[int, int]) -> list[MaskedImage]:
    """Return what views show of a box of the reference frame, exposed as that, a scene each.

    :param shape: rows and columns to sample the box at.
    """
    if not views:
        return []
    samples = _sampled(views, box, shape)[:, :, : shape[1]]
    return [MaskedImage(np.ascontiguousarray(sample)) for sample in samples]


def calm_background_in(
    box: Box, views: Sequence[AlignedFrame], shape: tuple[int, int] | None = None
) -> Background:
    """Estimate the background as `background_in`, its spread by the calmer side of the median.

    Where objects that nobody knows of pass all the time, they are darker or brighter than what is
    behind them, so that the other side tells by how much that varies.
    """
    lower, median, upper, known = _quartiles_in(box, views, shape or box.shape)
    calmer = np.minimum(upper - median, median - lower)
    spread = without_last(calmer) * np.float32(2 * _IQR_TO_SIGMA)
    return Background(without_last(median).astype(np.float32), spread, known)


def _quartiles_in(
    box: Box, views: Sequence[AlignedFrame], shape: tuple[int, int]
) -> tuple[ByteImage, ByteImage, ByteImage, Mask]:
    """Return the quartiles of what views show of a box, hxwx(C+1), and where that is known."""
    samples = _sampled(views, box, shape)
    count = _without_hidden(samples)[:, : shape[1]]
    ordered = np.stack(_ordered(samples))
    lower, median, upper = (_quantile(ordered, count, quarters) for quarters in (1, 2, 3))
    return lower, median, upper, count >= _MIN_SAMPLES


def _without_hidden(samples: ByteImage) -> Counts:
    """Have the samples that objects hide sort last; return how many each pixel has besides, hxw.

    :param samples: Nxhxwx(C+1), written to.
    """
    pixels = _as_numbers(samples)
    # -1, all of whose bits are set, where hidden, else 0: the last channel bears the sign.
    hidden = pixels >> (8 * pixels.itemsize - 1)
    pixels |= hidden
    count: Counts = hidden.sum(axis=0, dtype=np.int32)
    count += len(samples)
    return count


def _quantile(ordered: ByteImage, count: Counts, quarters: int) -> ByteImage:
    """Return so many quarters' quantile of the first `count` values of each pixel, hxwx(C+1).

    :param ordered: Nxhxwx(C+1), the least first; it may have more columns than `count`.
    """
    number, rows, columns, channels = ordered.shape
    rank = (np.maximum(np.arange(number + 1) - 1, 0) * quarters + 2) // 4
    place = np.arange(rows * columns).reshape(rows, columns)[:, : count.shape[1]]
    chosen = _as_numbers(ordered).ravel()[(rank * rows * columns)[count] + place]
    return chosen.view(np.uint8).reshape(*count.shape, channels)


def _as_numbers(picture: ByteImage) -> npt.NDArray[np.signedinteger[Any]]:
    """Return a picture's pixels as one number each: all its channels, two or four, at once."""
    numbers: npt.NDArray[np.signedinteger[Any]] = picture.view(f"<i{picture.shape[-1]}")[..., 0]
    return numbers


def without_last(picture: ByteImage) -> ByteImage:
    """Return a picture, hxwx(C+1), without its last channel."""
    # NumPy would copy pixel by pixel, which takes five times as long.
    return cv2.merge(cv2.split(picture)[:-1]).reshape(*picture.shape[:2], -1)


def _ordered(pictures: Iterable[ByteImage]) -> list[ByteImage]:
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
    """Return which of `count` values to compare and exchange: Batcher's odd-even merge sort.

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


def difference_from(background: Background, image: ByteImage) -> Map:
    """Return the difference in grey values of each pixel, of the channel that differs most, hxw.

    :param image: hxwxC, the same part of the reference frame.
    """
    return largest(np.abs(image - background.median))


def deviation_from(background: Background, image: ByteImage, tilt: float) -> Map:
    """Return by how many standard deviations each pixel differs from the background, hxw.

    A pixel's variance is what was seen there, not less than what is usual in the picture, and
    what tilt makes of the grey values' slope at it: edges shimmer, plain parts don't.

    :param image: hxwxC, the same part of the reference frame.
    :param tilt: rms turbulent motion an axis in pixels.
    """
    noise = np.maximum(background.spread, max(_usual_spread(background), _MIN_NOISE))
    noise *= noise
    shimmer = _squared_slope(background.median)
    shimmer *= np.float32(max(tilt, _MIN_TILT) ** 2)
    noise += shimmer
    squared = np.square(image - background.median)
    squared /= noise
    return np.sqrt(largest(squared))


def _usual_spread(background: Background) -> float:
    """Return the median of the spread where it is known, 0 if nowhere."""
    channels = background.spread.shape[2]
    spread = background.spread.reshape(-1, channels)[::_SPREAD_STEP]
    known = spread[background.known.ravel()[::_SPREAD_STEP]].ravel()
    return upper_median(known) if known.size else 0.0


def largest(values: Map) -> Map:
    """Return the largest of each pixel's channels, hxw."""
    # NumPy's maximum along the last axis, which is short, takes forty times as long.
    return functools.reduce(np.maximum, _channels(values))


def smallest(values: Map) -> Map:
    """Return the smallest of each pixel's channels, hxw."""
    return functools.reduce(np.minimum, _channels(values))


def _channels(values: Map) -> list[Map]:
    return [values[..., channel] for channel in range(values.shape[2])]


def _squared_slope(picture: Map) -> Map:
    """Return the square of the grey values' gradient, a pixel, hxwxC."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    squared: Map = across * across + down * down
    return squared.reshape(picture.shape)


def _sampled(views: Sequence[AlignedFrame], box: Box, shape: tuple[int, int]) -> ByteImage:
    """Resample views in a box, Nxhxwx(C+1); what is out of view counts as hidden.

    On the right there may be columns more than asked for.
    """
    height, width = shape
    to_box = translation(box.x0, box.y0) @ scaling(box.shape[1] / width, box.shape[0] / height)
    columns = -(-width // _AT_ONCE) * _AT_ONCE
    channels = views[0].scene.image.shape[2]
    samples = np.empty((len(views), height, columns, channels), np.uint8)
    for view, picture in zip(views, samples, strict=True):
        scene, to_scene = _coarse_enough(view.scene, view.to_image @ to_box)
        cv2.warpAffine(
            scene.image,
            to_scene[:2],
            (columns, height),
            dst=picture,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(_HIDDEN,) * channels,
        )
        picture[:] = view.exposure.applied_to(picture, channels=channels - 1)
    return samples


def _coarse_enough(scene: MaskedImage, to_scene: Matrix) -> tuple[MaskedImage, Matrix]:
    """Return a scene at the size at which pixels to be sampled lie less than two apart.

    :param to_scene: takes the pixels that are wanted to the scene's.
    """
    (a, b, _), (c, d, _), _ = to_scene.tolist()
    area = abs(a * d - b * c)
    while area >= _COARSE and min(scene.image.shape[:2]) > 1:
        scene, to_scene, area = scene.half, _TO_HALF @ to_scene, area / 4.0
    return scene, to_scene
