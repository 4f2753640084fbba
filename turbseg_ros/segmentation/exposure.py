"""Exposure of frames against one another: automatic gain, white balance, flicker, a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Matrix
from turbseg_ros.segmentation.geometry import scaling, upper_median

Samples = npt.NDArray[np.float32]

# Every so many pixels each way one is compared, and about how many of a picture in colours.
_STEP = 8
_COLOUR_SAMPLES = 1600
# Grey values out of this range may have been cut off.
_DARKEST, _BRIGHTEST = 5, 250
_MIN_SAMPLES = 50
_REFITS = 2
# Pixels further off than so many median deviations show something else.
_OUTLIERS = 4.0
# Grey values, in the mean of squares, that exposures may differ by and still count as one.
_MIN_CHANGE = 2.4
# No change from one frame to another goes further; it is another scene.
_MAX_GAIN = 3.0


@dataclass(frozen=True)
class Exposure:
    """What takes the grey values of one frame to those of another: gain · value + offset."""

    gain: float = 1.0
    offset: float = 0.0

    def then(self, other: Exposure) -> Exposure:
        """Return what takes the grey values on to those of a third frame."""
        return Exposure(self.gain * other.gain, self.offset * other.gain + other.offset)

    def applied_to(self, image: ByteImage, channels: int) -> ByteImage:
        """Return an image, HxW or HxWxC, with the first so many channels as the other frame's."""
        return ColourExposure((self,) * channels).applied_to(image, channels)


AS_IT_IS = Exposure()
"""What takes grey values to themselves."""


@dataclass(frozen=True)
class ColourExposure:
    """An exposure for each channel, for white balance changes each by itself."""

    channels: tuple[Exposure, ...]

    @classmethod
    def as_it_is(cls, channels: int) -> ColourExposure:
        """Return what takes the values of so many channels to themselves."""
        return cls((AS_IT_IS,) * channels)

    def then(self, other: ColourExposure) -> ColourExposure:
        """Return what takes the values on to those of a third frame."""
        pairs = zip(self.channels, other.channels, strict=True)
        return ColourExposure(tuple(one.then(next_one) for one, next_one in pairs))

    def since(self, other: ColourExposure) -> ColourExposure:
        """Return what takes the values that another exposure leads to to those it leads to."""
        pairs = zip(self.channels, other.channels, strict=True)
        gains = [(now, now.gain / then.gain, then) for now, then in pairs]
        return ColourExposure(
            tuple(Exposure(gain, now.offset - gain * then.offset) for now, gain, then in gains)
        )

    def applied_to(self, image: ByteImage, channels: int) -> ByteImage:
        """Return an image, HxW or HxWxC, with the first so many channels as the other frame's."""
        exposures = self.channels[:channels]
        if all(each == AS_IT_IS for each in exposures):
            return image
        table = np.repeat(np.arange(256, dtype=np.float32)[:, None], _channels(image), axis=1)
        for channel, each in enumerate(exposures):
            table[:, channel] = table[:, channel] * each.gain + each.offset
        rounded = np.clip(np.rint(table), 0, 255).astype(np.uint8)
        exposed: ByteImage = cv2.LUT(image, rounded[:, None, :])
        return exposed.reshape(image.shape)


def exposure_between(source: ByteImage, target: ByteImage, to_source: Matrix) -> Exposure:
    """Estimate what takes the grey values of `source` to those of `target`.

    Pixels are compared that show the same point of the scene; objects, which are few pixels,
    don't count.

    :param source: HxW grey image.
    :param target: HxW grey image of the same size.
    :param to_source: takes the target's pixels to the source's.
    """
    (found,) = _exposures(*_sampled(source, target, to_source, _STEP))
    return found


def colour_exposure_between(
    source: ByteImage, target: ByteImage, to_source: Matrix
) -> ColourExposure:
    """Estimate what takes the values of each channel of `source` to those of `target`.

    :param source: HxWx4, three colours and a channel that isn't looked at.
    :param target: the same of another frame.
    :param to_source: takes the target's pixels to the source's.
    """
    step = max(int(np.sqrt(target.shape[0] * target.shape[1] / _COLOUR_SAMPLES)), 1)
    x, y = (each[..., :3] for each in _sampled(source, target, to_source, step))
    return ColourExposure(_exposures(np.ascontiguousarray(x), np.ascontiguousarray(y)))


def exposure_of_pixels(source: ByteImage, target: ByteImage) -> ColourExposure:
    """Estimate what takes the values of pixels to those of others that show the same points.

    :param source: Nx1xC; `target` likewise.
    """
    if not source.size:
        return ColourExposure.as_it_is(source.shape[2])
    return ColourExposure(_exposures(source, target))


def _sampled(
    source: ByteImage, target: ByteImage, to_source: Matrix, step: int
) -> tuple[ByteImage, ByteImage]:
    """Return the pixels of both that show the same points, of every so many of the target's."""
    rows, columns = target.shape[0] // step, target.shape[1] // step
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    to_grid = (to_source @ scaling(step, step))[:2]
    x = cv2.warpAffine(source, to_grid, (columns, rows), flags=flags)
    y = cv2.resize(target[: step * rows, : step * columns], (columns, rows))
    return x, y


def _exposures(x: ByteImage, y: ByteImage) -> tuple[Exposure, ...]:
    """Return what takes each channel of one picture, hxw or hxwxC, to that of another."""
    usable = cv2.bitwise_and(*(_in_range(each) for each in (x, y)))
    channels = _channels(x)
    # Most frames are exposed alike, which mean and deviation show quickly.
    if cv2.countNonZero(usable) < _MIN_SAMPLES or _seem_alike(x, y, usable):
        return (AS_IT_IS,) * channels
    here, there = (each[usable > 0].reshape(-1, channels).astype(np.float32) for each in (x, y))
    return tuple(_exposure(here[:, channel], there[:, channel]) for channel in range(channels))


def _in_range(picture: ByteImage) -> ByteImage:
    """Return where no channel may have been cut off, 255 or 0."""
    channels = _channels(picture)
    if channels == 1:
        return cv2.inRange(picture, _DARKEST, _BRIGHTEST)
    return cv2.inRange(picture, (_DARKEST,) * channels, (_BRIGHTEST,) * channels)


def _exposure(x: Samples, y: Samples) -> Exposure:
    """Return what takes values to others, most of which show the same."""
    found = _median_line(x, y)
    for _ in range(_REFITS):
        found = _refitted(found, x, y)
        if _change(found, x) < _MIN_CHANGE:
            return AS_IT_IS
    return found if 1 / _MAX_GAIN < found.gain < _MAX_GAIN else AS_IT_IS


def _change(exposure: Exposure, x: Samples) -> float:
    """Return the root mean square of what an exposure adds to values.

    The darkest and brightest count too: a gain that leaves the middle as it is changes them most.
    """
    added = x * (exposure.gain - 1.0) + exposure.offset
    return float(np.sqrt(np.mean(np.square(added))))


def _seem_alike(x: ByteImage, y: ByteImage, usable: ByteImage) -> bool:
    """Whether mean and deviation differ by less than half of what exposures may."""
    moments = [np.ravel(cv2.meanStdDev(each, mask=usable)) for each in (x, y)]
    return bool(np.abs(moments[0] - moments[1]).max() < _MIN_CHANGE / 2)


def _median_line(x: Samples, y: Samples) -> Exposure:
    """Return the line through the medians of the darker and of the brighter half.

    Brown and Mood (1951). Both frames being equally noisy, halves are told by the sum.
    """
    both = x + y
    bright = both > upper_median(both)
    if not bright.any():
        return Exposure(1.0, upper_median(y - x))
    x_dark, x_bright, y_dark, y_bright = (
        upper_median(half) for half in (x[~bright], x[bright], y[~bright], y[bright])
    )
    gain = (y_bright - y_dark) / max(x_bright - x_dark, 1.0)
    return Exposure(gain, upper_median(y - gain * x))


def _refitted(found: Exposure, x: Samples, y: Samples) -> Exposure:
    """Fit mean and deviation of what fits already.

    A regression would underestimate the gain, for the source is noisy, too.
    """
    error = np.abs(x * found.gain + found.offset - y)
    kept = error <= _OUTLIERS * max(upper_median(error), 1.0)
    x, y = x[kept], y[kept]
    gain = float(y.std() / max(x.std(), 1.0))
    return Exposure(gain, float(y.mean() - gain * x.mean()))


def _channels(image: ByteImage) -> int:
    return image.shape[2] if image.ndim == 3 else 1
