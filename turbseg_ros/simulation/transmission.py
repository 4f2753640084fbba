"""What happens to a camera's picture on its way: rows that interlace, text, blocks of a codec."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage


@dataclass(frozen=True)
class Transmission:
    """How a video reached us.

    `reduction` is by what factor its resolution was lower, 1 none; `quality` that of its JPEG
    pictures, 0 none; `interlaced`, whether every other row is half a frame late; `texts` are
    burnt in, with a running clock if `clock`.
    """

    reduction: float = 1.0
    quality: int = 0
    interlaced: bool = False
    texts: tuple[tuple[str, float, float], ...] = ()
    clock: bool = False
    cross: bool = False

    def receiver(self) -> Receiver:
        """Start on a clip."""
        return Receiver(self)


@dataclass
class Receiver:
    """Takes a clip's pictures in their order, and gives what arrives of them."""

    transmission: Transmission
    _before: ByteImage | None = field(default=None, init=False)

    def received(self, image: ByteImage, frame: int) -> ByteImage:
        """Return a picture, HxW or HxWx3, as it arrives."""
        how = self.transmission
        height, width = image.shape[:2]
        if how.reduction > 1:
            size = (round(width / how.reduction), round(height / how.reduction))
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            image = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
        if how.interlaced:
            image, self._before = self._woven(image), image
        image = self._written(image, frame)
        if how.quality:
            _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, how.quality])
            flag = cv2.IMREAD_GRAYSCALE if image.ndim == 2 else cv2.IMREAD_COLOR
            image = np.asarray(cv2.imdecode(packed, flag), np.uint8)
        return image

    def _woven(self, image: ByteImage) -> ByteImage:
        if self._before is None:
            return image
        # Halfway between two frames, as far as one can tell from them.
        woven = image.copy()
        woven[1::2] = cv2.addWeighted(image, 0.5, self._before, 0.5, 0.0)[1::2]
        return woven

    def _written(self, image: ByteImage, frame: int) -> ByteImage:
        how = self.transmission
        height, width = image.shape[:2]
        texts = list(how.texts)
        if how.clock:
            texts.append((f"{frame // 30:02}:{frame % 30:02}", 0.04, 0.08))
        if not (texts or how.cross):
            return image
        image = image.copy()
        size = height / 500
        for text, x, y in texts:
            at = (round(x * width), round(y * height))
            for colour, thickness in ((0, 3), (255, 1)):
                cv2.putText(
                    image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (colour,) * 3, thickness
                )
        if how.cross:
            centre = (width // 2, height // 2)
            cv2.drawMarker(image, centre, (255,) * 3, cv2.MARKER_CROSS, max(height // 8, 8), 1)
        return image


def random_transmission(rng: np.random.Generator) -> Transmission:
    """Draw how a video reached us; half of them well."""
    texts = tuple(
        (
            "".join(rng.choice(list("ABCDEFGHKLMNPRSTUXZ0123456789:.- "), rng.integers(3, 18))),
            float(rng.uniform(0.0, 0.7)),
            float(rng.choice((rng.uniform(0.04, 0.12), rng.uniform(0.88, 0.98)))),
        )
        for _ in range(rng.integers(1, 4) if rng.random() < 0.12 else 0)
    )
    return Transmission(
        reduction=float(rng.uniform(1.2, 2.5)) if rng.random() < 0.3 else 1.0,
        quality=round(100 - math.exp(rng.uniform(1.5, 4.2))) if rng.random() < 0.5 else 0,
        interlaced=bool(rng.random() < 0.06),
        texts=texts,
        clock=bool(texts and rng.random() < 0.5),
        cross=bool(rng.random() < 0.04),
    )
