"""Video files, as the frames of a clip: their bits and their stamps as they are."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from turbseg_ros.arrays import Image
from turbseg_ros.bag.errors import ClipError
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.messages.video import array_of

# Bits of each channel are the last character of FFmpeg's name for a format of pixels, or the
# first where bytes are the other way round; but for these.
_DEPTHS = {b"RGB0": 16, b"BGR0": 16, b"RBA@": 16, b"BRA@": 16, b"P010": 10, b"P016": 16}
_GREY_16 = b"Y1\0\x10"
# Stamps of the file that are so near to even ones stand for these: containers count milliseconds.
_ROUNDING = 1.1e-3


@dataclass(frozen=True)
class VideoFile:
    """A video, decoded when iterated over.

    `rate`, in Hz, and `stated_count`, of frames, are what the file says, None where it doesn't.
    `depth` is the bits of each channel, `is_grey_16` whether OpenCV gives all 16 of grey, and
    `rotation` how far it is to be turned clockwise, degrees.
    """

    path: Path
    rate: float | None
    stated_count: int | None
    depth: int = 8
    is_grey_16: bool = False
    rotation: int = 0

    def count(self) -> int:
        """Count the frames by going through them, for what the file states may be wrong."""
        return sum(1 for _ in self)

    def __iter__(self) -> Iterator[Image]:
        """Decode the frames: HxWx3 (BGR), or HxW where they are grey in more than 8 bits."""
        return (image for _, image in self._decoded())

    def timed(self, rate: float, as_asked: bool) -> Iterator[tuple[float, Image]]:
        """Return each frame with its time in seconds from the first.

        That is the file's own stamp, unless a rate is asked for, or stamps don't rise.
        """
        first: float | None = None
        last = -math.inf
        for number, (stamp, image) in enumerate(self._decoded()):
            first = stamp if first is None else first
            time = number / rate
            if not as_asked and abs(stamp - first - time) > _ROUNDING:
                time = stamp - first
            if time <= last or not math.isfinite(time):
                time = last + 1 / rate
            yield time, image
            last = time

    def notes(self, as_asked: bool) -> list[str]:
        """Return what is lost of it, a line each."""
        if self.depth <= 8 or self._keeps_depth:
            return []
        return [
            f"{self.path}: {self.depth} bits a channel become 8; '{how_to_install('av')}' to keep "
            "them all"
        ]

    @property
    def _keeps_depth(self) -> bool:
        return self.is_grey_16 or importlib.util.find_spec("av") is not None

    def _decoded(self) -> Iterator[tuple[float, Image]]:
        if self.depth > 8 and self._keeps_depth and not self.is_grey_16:
            return self._decoded_by_pyav()
        return self._decoded_by_opencv()

    def _decoded_by_opencv(self) -> Iterator[tuple[float, Image]]:
        capture = cv2.VideoCapture(str(self.path))
        if self.is_grey_16:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        try:
            while True:
                read, frame = capture.read()
                if not read:
                    return
                yield capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3, frame
        finally:
            capture.release()

    def _decoded_by_pyav(self) -> Iterator[tuple[float, Image]]:
        av: Any = importlib.import_module("av")
        try:
            with av.open(str(self.path)) as container:
                for picture in container.decode(video=0):
                    time = math.nan if picture.time is None else float(picture.time)
                    yield time, np.rot90(array_of(picture), -self.rotation // 90)
        except av.FFmpegError as error:
            raise ClipError(f"{self.path} can't be decoded: {error}") from error


def open_video(path: Path) -> VideoFile:
    """Find out what a video file holds.

    :raises ClipError: when it is none that can be read.
    """
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened() or not capture.grab():
            raise ClipError(f"{path} is not a video that can be read")
        rate = capture.get(cv2.CAP_PROP_FPS)
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        pixels = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF
        rotation = int(capture.get(cv2.CAP_PROP_ORIENTATION_META))
        code = pixels.to_bytes(4, "little")
        is_grey_16 = code == _GREY_16 and _gives_16_bits(capture)
    finally:
        capture.release()
    return VideoFile(
        path=path,
        rate=rate if rate > 0 else None,
        stated_count=int(count) if count > 0 else None,
        depth=_depth(code),
        is_grey_16=is_grey_16,
        rotation=rotation % 360 if rotation > 0 else 0,
    )


def _gives_16_bits(capture: cv2.VideoCapture) -> bool:
    """Whether this OpenCV can give a grabbed frame as it is."""
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    read, frame = capture.retrieve()
    return read and frame.dtype == np.uint16 and frame.ndim == 2


def _depth(code: bytes) -> int:
    known = _DEPTHS.get(code)
    if known is not None:
        return known
    return next((bits for bits in (code[3], code[0]) if 8 < bits <= 16), 8)
