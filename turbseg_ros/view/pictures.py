"""Camera images as JPEG, kept until their results come."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2

from turbseg_ros.arrays import Image
from turbseg_ros.overlay import to_bgr8
from turbseg_ros.segmentation.tone import ToneMap

_QUALITY = 80
# Pictures that wait for results, which may come so much later than the first one waits for.
_KEPT = 120


@dataclass(frozen=True)
class Jpeg:
    """A picture, and the width and height of the image that it was made of."""

    data: bytes
    size: tuple[int, int]


class JpegEncoder:
    """Makes JPEG of images, at most `width` pixels wide; of more than 8 bits, stretched steadily.

    An instance belongs to one stream.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._tones: dict[str, ToneMap] = {}

    def encode(self, image: Image) -> Jpeg:
        """Return an image, HxW or HxWx3 of any depth, as JPEG."""
        height, width = image.shape[:2]
        scale = min(1.0, self._width / width)
        small = image
        if scale < 1.0:
            size = (round(width * scale), max(round(height * scale), 1))
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        tone = self._tones.setdefault(image.dtype.name, ToneMap())
        picture = tone(small) if small.ndim == 2 else to_bgr8(small, tone)
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        return Jpeg(data.tobytes(), (width, height))


class WaitingPictures:
    """Pictures by the stamps of their images, in nanoseconds, until a result asks for them."""

    def __init__(self) -> None:
        self._pictures: dict[int, Jpeg] = {}
        self._unanswered = 0

    def add(self, stamp: int, picture: Jpeg) -> None:
        """Keep a picture; the oldest goes when there are too many."""
        self._pictures[stamp] = picture
        while len(self._pictures) > _KEPT:
            del self._pictures[next(iter(self._pictures))]
            self._unanswered += 1

    def take(self, stamp: int) -> Jpeg | None:
        """Return the picture of a stamp, None where there is none; earlier ones go."""
        picture = self._pictures.get(stamp)
        if picture is None:
            return None
        self._unanswered = 0
        for earlier in list(self._pictures):
            del self._pictures[earlier]
            if earlier == stamp:
                break
        return picture

    @property
    def are_in_vain(self) -> bool:
        """Whether no result has asked for any for so long that none will."""
        return self._unanswered > 0

    def clear(self) -> None:
        """Forget them all."""
        self._pictures.clear()
        self._unanswered = 0


class Pace:
    """Lets through at most `rate` a second."""

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._due = -math.inf

    def lets_through(self, now: float) -> bool:
        """Whether the next one may pass at a time, in seconds."""
        if now < self._due:
            return False
        # In step with what comes, but no burst after a pause.
        self._due = max(self._due + self._period, now)
        return True
