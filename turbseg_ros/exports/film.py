"""A film of the overlay: H.264 by PyAV where that is installed, MPEG-4 by OpenCV elsewhere."""

from __future__ import annotations

import importlib
import importlib.util
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import cv2

from turbseg_ros.arrays import ByteImage
from turbseg_ros.overlay import draw_overlay
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.tone import ToneMap

SUFFIXES = (".mp4", ".mkv", ".mov")
# Ticks a second: what MPEG counts in, and all usual rates are whole numbers of.
_TICKS = 90_000
# Constant quality, as x264 counts it: hard to tell from the original.
_QUALITY = "20"
# Where nothing tells how long a picture is shown, in seconds.
_DEFAULT_PERIOD = 1 / 30
# Nothing is shown longer, in seconds: a recording's pause is not a film's.
_LONGEST = 2.0


class FilmError(RuntimeError):
    """A film that can't be written; the text is one line: which, and why."""


class _Encoder(Protocol):
    def add(self, picture: ByteImage, time: float) -> None:
        """Append a picture, HxWx3 (blue, green, red), shown from `time`, seconds, on."""

    def close(self) -> None:
        """Write what is left, and the index."""


class Film:
    """A film of results on their frames, in the frames' own time; used in a `with`.

    It lies under its name once it is complete; nothing is left of one that an exception ends. All
    pictures have the first one's size, less a row or column where that is odd, which players ask
    for.

    :param path: ends in one of `SUFFIXES`.
    :raises FilmError: when it can't be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._partial = path.with_name(f".{path.stem}.partial{path.suffix}")
        self._encoder: _Encoder | None = None
        self._tone = ToneMap()
        self._size = (0, 0)
        self._time = 0.0
        self._last_stamp: int | None = None

    def __enter__(self) -> Film:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if self._encoder is not None:
                self._encoder.close()
                if kind is None:
                    self._partial.replace(self._path)
        finally:
            self._partial.unlink(missing_ok=True)

    def add(self, result: SegmentationResult) -> None:
        """Append the next result.

        :raises FilmError: when it can't be written.
        """
        picture = draw_overlay(result, tone=self._tone).image
        period = result.frame.period or _DEFAULT_PERIOD
        if self._encoder is None:
            self._size = (picture.shape[1] // 2 * 2, picture.shape[0] // 2 * 2)
            self._encoder = _encoder(self._partial, self._size, 1 / period)
        else:
            self._time += self._step(result.frame.stamp, period)
        self._last_stamp = result.frame.stamp
        width, height = self._size
        if picture.shape[1] < width or picture.shape[0] < height:
            picture = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)
        self._encoder.add(picture[:height, :width], self._time)

    def _step(self, stamp: int, period: float) -> float:
        """Return for how many seconds the picture before is shown."""
        assert self._last_stamp is not None  # there is one before
        passed = (stamp - self._last_stamp) * 1e-9
        return min(passed, _LONGEST) if passed > 0 else period


def _encoder(path: Path, size: tuple[int, int], rate: float) -> _Encoder:
    if importlib.util.find_spec("av") is not None:
        return _PyAvEncoder(path, size, rate)
    return _OpenCvEncoder(path, size, rate)


class _PyAvEncoder:
    """H.264, each picture at its own time."""

    def __init__(self, path: Path, size: tuple[int, int], rate: float) -> None:
        self._av: Any = importlib.import_module("av")
        name = "libx264" if "libx264" in self._av.codecs_available else "mpeg4"
        try:
            self._container = self._av.open(str(path), "w")
            self._stream = self._container.add_stream(name, Fraction(rate).limit_denominator(1001))
        except (self._av.FFmpegError, OSError) as error:
            raise FilmError(f"{path} can't be written: {error}") from error
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = Fraction(1, _TICKS)
        if name == "libx264":
            self._stream.options = {"crf": _QUALITY, "preset": "veryfast"}
        self._last = -1

    def add(self, picture: ByteImage, time: float) -> None:
        frame = self._av.VideoFrame.from_ndarray(picture.copy(), format="bgr24")
        self._last = frame.pts = max(round(time * _TICKS), self._last + 1)
        frame.time_base = Fraction(1, _TICKS)
        self._write(frame)

    def close(self) -> None:
        self._write(None)
        self._container.close()

    def _write(self, frame: Any) -> None:
        try:
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except (self._av.FFmpegError, OSError) as error:
            raise FilmError(f"{self._container.name} can't be written: {error}") from error


class _OpenCvEncoder:
    """MPEG-4, which more players than browsers show; pictures evenly spaced in time."""

    def __init__(self, path: Path, size: tuple[int, int], rate: float) -> None:
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, size)
        if not self._writer.isOpened():
            raise FilmError(f"{path} can't be written: this OpenCV has no encoder for it")

    def add(self, picture: ByteImage, time: float) -> None:
        self._writer.write(picture)

    def close(self) -> None:
        self._writer.release()
