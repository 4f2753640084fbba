"""Footage whose truth is known, to train on: as it is, and as other cameras might have shown it.

Unlike in a composite nothing is put together, so that what moves keeps its own shadow, its own
ground, and a camera that follows it as a person's does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Labels
from turbseg_ros.learning.random_scenes import log_uniform
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.simulation.footage import Crop, Footage
from turbseg_ros.simulation.render import FIRST_STAMP_NS
from turbseg_ros.simulation.transmission import Receiver, random_transmission
from turbseg_ros.simulation.turbulence import BlurField, Field, TiltField, Turbulence, blur, warp

WIDEST = 854
"""Columns of a clip to train on at most."""

_RATE_HZ = 30.0
# Frames that are read at once.
_AT_ONCE = 32
# Frames of a varied clip at most.
_MOST_FRAMES = 96
# Shares of the clips that show all of a frame, that run backwards, are grey and, of these, have
# bright for dark; that are seen through calm air, without noise, in full contrast, and as sent.
_WHOLE, _BACKWARDS, _GREY, _INVERTED = 0.4, 0.4, 0.45, 0.3
_CALM, _CLEAN, _FULL_CONTRAST, _AS_SENT = 0.4, 0.5, 0.5, 0.5
# Scale; share of a frame's width and height that is shown at least; rms tilt in pixels of 432
# columns; noise in grey values; range of grey values as a share of all.
_SCALES, _LEAST_PART = (0.35, 1.0), 0.55
_TILTS, _NOISES, _RANGES = (0.3, 2.5), (0.5, 5.0), (0.35, 1.0)
# Pixels around the picture, which the tilt draws in.
_MARGIN = 16
# Tells these random numbers from those of composites and drawn scenes.
_PURPOSE = 78


@dataclass(frozen=True)
class _Camera:
    """How a footage is seen: by whom, through what, and what is left of it when it arrives.

    `turbulence` is None in calm air; `noise` is the rms in grey values; of the range of grey
    values, from 0 to 1, the share `range_` is used, from `darkest` on.
    """

    crop: Crop
    grey: bool = False
    inverted: bool = False
    turbulence: Turbulence | None = None
    noise: float = 0.0
    darkest: float = 0.0
    range_: float = 1.0
    receiver: Receiver | None = None


def shown_clip(footage: Footage, widest: int = 640) -> Iterator[tuple[Frame, Labels]]:
    """Return a footage as it is, with what its masks tell, no wider than so many pixels."""
    for first in range(0, footage.length, _AT_ONCE):
        count = min(_AT_ONCE, footage.length - first)
        pictures, masks = footage.pictures(first, count), footage.masks(first, count) or []
        for number, (picture, mask) in enumerate(zip(pictures, masks, strict=True), start=first):
            scale = min(widest / picture.shape[1], 1.0)
            size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
            image = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            covered = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            yield _frame(number, image), _labels(covered)


def varied_clip(seed: int, footage: Footage) -> Iterator[tuple[Frame, Labels]]:
    """Return a footage as a camera drawn at random might have shown it, with what moves.

    Frames are HxW or HxWx3, uint8, no wider than `WIDEST`, 96 at most; the same for the same
    seed and footage.
    """
    rng = np.random.default_rng([_PURPOSE, seed])
    count = min(footage.length, _MOST_FRAMES)
    first = int(rng.integers(0, footage.length - count + 1))
    pictures, masks = footage.pictures(first, count), footage.masks(first, count) or []
    if rng.random() < _BACKWARDS:
        pictures, masks = pictures[::-1], masks[::-1]
    camera = _random_camera((pictures[0].shape[0], pictures[0].shape[1]), rng)
    air = None if camera.turbulence is None else _Air(camera.crop.shape, camera.turbulence, rng)
    for number, (picture, mask) in enumerate(zip(pictures, masks, strict=True)):
        seen, covered = camera.crop.of(picture), camera.crop.of(mask)
        if air is not None:
            seen, covered = air.through(seen, covered)
        yield _frame(number, _exposed(seen, camera, number, rng)), _labels(covered)


class _Air:
    """What a clip is seen through."""

    def __init__(
        self, shape: tuple[int, int], turbulence: Turbulence, rng: np.random.Generator
    ) -> None:
        self._tilts = TiltField(shape, turbulence, rng)
        self._blurs = BlurField(shape, turbulence, rng)

    def through(self, picture: Field, covered: Field) -> tuple[Field, Field]:
        """Return the next frame's picture, HxWx3, and what moves in it, HxW, as seen through."""
        tilt = self._tilts.next()
        bent = warp(_with_margin(picture), tilt, _MARGIN)
        seen = blur(np.asarray(bent, np.float32), self._blurs.next())
        where = warp(_with_margin(covered), tilt, _MARGIN, cv2.INTER_LINEAR)
        return seen, np.asarray(where, np.float32)


def _random_camera(source: tuple[int, int], rng: np.random.Generator) -> _Camera:
    """Draw a camera that shows frames of a shape, rows and columns."""
    crop = _random_crop(source, rng)
    width = crop.shape[1]
    grey = rng.random() < _GREY
    tilt = 0.0 if rng.random() < _CALM else log_uniform(rng, *_TILTS)
    range_ = 1.0 if rng.random() < _FULL_CONTRAST else float(rng.uniform(*_RANGES))
    return _Camera(
        crop,
        grey=grey,
        inverted=grey and rng.random() < _INVERTED,
        turbulence=Turbulence.typical(tilt * width / 432, width) if tilt else None,
        noise=0.0 if rng.random() < _CLEAN else log_uniform(rng, *_NOISES),
        darkest=float(rng.uniform(0.0, 1.0 - range_)),
        range_=range_,
        receiver=None if rng.random() < _AS_SENT else random_transmission(rng).receiver(),
    )


def _random_crop(source: tuple[int, int], rng: np.random.Generator) -> Crop:
    rows, columns = source
    scale = min(log_uniform(rng, *_SCALES), WIDEST / columns)
    shape = round(rows * scale), round(columns * scale)
    if rng.random() < _WHOLE:
        return Crop(0, 0, columns, rows, shape, mirrored=False)
    drawn = Crop.drawn(source, shape, _LEAST_PART, rng)
    # No larger than it was.
    smaller = min(shape[0], drawn.height), min(shape[1], drawn.width)
    return Crop(drawn.x, drawn.y, drawn.width, drawn.height, smaller, drawn.mirrored)


def _exposed(seen: Field, camera: _Camera, number: int, rng: np.random.Generator) -> ByteImage:
    """Return what arrives of a picture, HxWx3 with grey values from 0 to 255."""
    values = 255.0 - seen if camera.inverted else seen
    values = camera.darkest * 255.0 + camera.range_ * np.clip(values, 0.0, 255.0)
    values += rng.normal(0.0, camera.noise, values.shape) if camera.noise else 0.0
    image = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    if camera.grey:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return image if camera.receiver is None else camera.receiver.received(image, number)


def _with_margin(picture: Field) -> Field:
    margins = (_MARGIN,) * 4
    return np.asarray(cv2.copyMakeBorder(picture, *margins, cv2.BORDER_REFLECT), np.float32)


def _frame(number: int, image: ByteImage) -> Frame:
    return Frame(FIRST_STAMP_NS + round(number * 1e9 / _RATE_HZ), image)


def _labels(covered: Field) -> Labels:
    return (covered > 0.5).astype(np.uint16)
