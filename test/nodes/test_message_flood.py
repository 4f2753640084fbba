"""Random messages through what stands behind the node's subscription, with the real method."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image

from support.result_topics import fresh_outputs
from support.segmenters import segmenter_by_rules
from turbseg_ros.bag.writer import serialised
from turbseg_ros.messages.images import (
    ImageConversionError,
    frame_from_message,
    frame_from_serialised,
    message_from_image,
    stamp_to_ns,
)
from turbseg_ros.nodes.diagnostics import Event, Statistics
from turbseg_ros.nodes.worker import SegmentationWorker
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

PARAMETERS = Parameters.from_mapping({"resolution.processing": 128, "resolution.detail": 128})
ENCODINGS = (
    *("mono8", "8UC1", "mono16", "16UC1", "32FC1", "bgr8", "rgb8", "bgra8", "rgba8"),
    *("bgr16", "rgb16", "bgra16", "rgba16", "yuv422", "uyvy", "yuv422_yuy2", "yuyv"),
    *(
        f"bayer_{pattern}{bits}"
        for pattern in ("rggb", "bggr", "gbrg", "grbg")
        for bits in (8, 16)
    ),
)
BYTES = {"16": 2, "32FC1": 4, "yuv": 2, "uyvy": 2, "yuyv": 2}
MAX_BYTES = 400_000


class RandomCamera:
    """Gives messages as no camera should: any size, encoding, layout, stamp and content."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._now = 1_700_000_000_000_000_000
        self._encoding = "mono8"
        self._size = (32, 48)

    def message(self) -> Image | CompressedImage:
        """Return the next message: every other one is as the one before, but for its content."""
        random = self._random
        if random.random() < 0.05:
            self._encoding = str(random.choice([*ENCODINGS, "", "mono12", "32FC3", "é" * 3000]))
            self._size = self._any_size()
        message = self._compressed() if random.random() < 0.15 else self._image()
        message.header.stamp = self._stamp()
        message.header.frame_id = str(random.choice(["", "camera", "x" * 500]))
        return message

    def _any_size(self) -> tuple[int, int]:
        largest = int(self._random.choice([1, 4, 40, 300]))
        height, width = (int(side) for side in self._random.integers(1, largest + 1, 2))
        if self._random.random() < 0.1:
            return int(self._random.choice([0, 1, height])), int(self._random.choice([0, 3000]))
        return height, width

    def _image(self) -> Image:
        random = self._random
        height, width = self._size
        channels = 4 if "a" in self._encoding[:4] else 3 if "gb" in self._encoding[:3] else 1
        row = width * channels * next((n for k, n in BYTES.items() if k in self._encoding), 1)
        step = row + int(random.choice([0, 0, 1, 7]))
        length = min(height * step, MAX_BYTES)
        if random.random() < 0.1:
            step = int(random.choice([0, row - 1 if row else 0, 2**32 - 1, step]))
            length = int(random.choice([0, max(length - 1, 0), length + 100, length // 2]))
        message = Image(
            height=height if random.random() < 0.98 else 2**32 - 1,
            width=width,
            encoding=self._encoding,
            step=step,
            is_bigendian=int(random.choice([0, 0, 1, 255])),
        )
        message.data.frombytes(random.bytes(length))
        return message

    def _compressed(self) -> CompressedImage:
        random = self._random
        height, width = (max(side, 1) for side in self._size)
        dtype = (np.uint8, np.uint16)[random.integers(2)]
        picture = random.integers(0, np.iinfo(dtype).max, (height, width, 3)).astype(dtype)
        if random.random() < 0.5:
            picture = picture[:, :, 0]
        suffix = str(random.choice([".png", ".jpg", ".tiff", ".bmp"]))
        if suffix != ".png":
            picture = picture.astype(np.uint8)
        data = bytearray(cv2.imencode(suffix, picture)[1].tobytes())
        if random.random() < 0.3:
            data = data[: int(random.integers(0, len(data) + 1))]
        if data and random.random() < 0.3:
            data[int(random.integers(0, len(data)))] ^= int(random.integers(1, 256))
        message = CompressedImage(format=suffix[1:])
        message.data.frombytes(bytes(data))
        return message

    def _stamp(self) -> Time:
        random = self._random
        kind = random.random()
        if kind < 0.93:
            self._now += 33_000_000
        elif kind < 0.95:
            self._now += int(random.integers(-(10**12), 10**12))
        elif kind < 0.97:
            return Time()
        elif kind < 0.98:
            return Time(sec=2**31 - 1, nanosec=2**32 - 1)
        elif kind < 0.99:
            return Time(sec=-(2**31), nanosec=999_999_999)
        return Time(sec=self._now // 10**9, nanosec=self._now % 10**9)


class CountingLogger:
    """Counts lines by their level and how they begin."""

    def __init__(self) -> None:
        self.lines: Counter[str] = Counter()
        self.longest = 0
        self.errors: list[str] = []

    def _log(self, text: str, **_: Any) -> None:
        self.lines[text[:24]] += 1
        self.longest = max(self.longest, len(text))

    info = warning = _log

    def error(self, text: str, **_: Any) -> None:
        self.errors.append(text)


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize(
    "count", [200, pytest.param(10_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_every_valid_message_is_answered_once_and_every_other_is_counted(count: int) -> None:
    camera, statistics, logger = RandomCamera(seed=count), Statistics(), CountingLogger()
    builders = fresh_outputs(2)
    accepted: list[int] = []
    answered: list[int] = []
    lock = threading.Lock()

    def convert(message: tuple[memoryview, type[Any]]) -> Frame:
        frame = frame_from_serialised(*message)
        with lock:
            accepted.append(frame.stamp)
        return frame

    def publish(result: SegmentationResult) -> None:
        assert result.labels.shape == result.frame.image.shape[:2]
        assert np.isfinite(result.motion_map).all()
        for output in builders:
            for built in output.build(result):
                if hasattr(built, "header"):
                    assert stamp_to_ns(built.header.stamp) == result.frame.stamp
                serialised(built)
        answered.append(result.frame.stamp)

    worker = SegmentationWorker(
        segmenter_by_rules(PARAMETERS),
        convert=convert,
        publish=publish,
        now=lambda: 0,
        statistics=statistics,
        logger=logger,
        queue_size=count,
    )
    worker.start()
    begun = time.monotonic()
    memory = []
    for number in range(count):
        while worker.waiting > 20:
            time.sleep(0.001)
        message = camera.message()
        # As the middleware gives it.
        worker.submit((memoryview(serialize_message(message)), type(message)))
        if number % (count // 4) == count // 8:
            memory.append(resident_bytes())
    while worker.waiting:
        time.sleep(0.01)
    worker.stop()
    assert logger.errors == []
    totals = statistics.take().totals
    assert totals[Event.RECEIVED] == count
    assert totals[Event.FAILED] == totals[Event.DROPPED] == 0
    assert totals[Event.ANSWERED] == len(answered) == count - totals[Event.SKIPPED]
    assert len(answered) > count // 4
    # In the order of arrival, without those that repeat or come late. Where too many did, times of
    # arrival stand in for stamps: this clock stands at 0, so that they count up from there.
    coming = iter(accepted)
    assert all(stamp in coming for stamp in answered if stamp > count)
    kinds = 8
    assert sum(n for line, n in logger.lines.items() if "skipped" in line) <= kinds * (
        1 + (time.monotonic() - begun) / 5
    )
    assert logger.longest < 1000
    assert memory[-1] - memory[0] < 150e6


@pytest.mark.parametrize("size", [(1, 1), (1, 7680), (4320, 1), (4320, 7680)], ids=str)
@pytest.mark.parametrize("encoding", ["mono16", "bgr8"])
def test_a_frame_from_one_pixel_to_8k_is_answered(size: tuple[int, int], encoding: str) -> None:
    image = np.zeros(size, np.uint16) if encoding == "mono16" else np.zeros((*size, 3), np.uint8)
    image[::2] = 3
    segmenter = segmenter_by_rules(PARAMETERS)
    results = []
    for stamp in range(2):
        results += segmenter.push(frame_from_message(message_from_image(image, encoding, stamp)))
    results += segmenter.flush()
    assert [result.frame.stamp for result in results] == [0, 1]
    assert all(result.labels.shape == size for result in results)


@pytest.mark.parametrize("nanosec", [10**9, 2**32 - 1])
def test_a_stamp_that_no_answer_can_carry_is_refused(nanosec: int) -> None:
    message = message_from_image(np.zeros((4, 4), np.uint8), "mono8", 0)
    message.header.stamp = Time(sec=2**31 - 1, nanosec=nanosec)
    with pytest.raises(ImageConversionError, match="which is a second or more"):
        frame_from_message(message)


def test_a_long_name_does_not_fill_the_log() -> None:
    for message in (Image(encoding="x" * 10**6), CompressedImage(format="\x1b[2J" * 10**5)):
        with pytest.raises(ImageConversionError) as error:
            frame_from_message(message)
        assert len(str(error.value)) < 1000
        assert str(error.value).isprintable()


DECODE = r"""
import re, sys
from pathlib import Path
from sensor_msgs.msg import CompressedImage
from turbseg_ros.messages.images import ImageConversionError, image_from_message
message = CompressedImage(format="png")
message.data.frombytes(Path(sys.argv[1]).read_bytes())
try:
    image_from_message(message)
except ImageConversionError as error:
    print(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])
"""


def test_a_small_message_that_claims_a_giant_picture_takes_no_memory(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return len(data).to_bytes(4, "big") + kind + data + checksum.to_bytes(4, "big")

    side = 32_000
    header = side.to_bytes(4, "big") * 2 + bytes([1, 0, 0, 0, 0])  # a bit a pixel
    packer = zlib.compressobj(1)
    block = bytes((side // 8 + 1) * 100)
    rows = b"".join([packer.compress(block) for _ in range(side // 100)] + [packer.flush()])
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    giant = b"\x89PNG\r\n\x1a\n" + chunks
    (tmp_path / "giant.png").write_bytes(giant)
    assert len(giant) < 1_000_000
    # Decoded, it is 1 GB. In a process of its own, for OpenCV asks once for its limit.
    done = subprocess.run(
        [sys.executable, "-c", DECODE, str(tmp_path / "giant.png")],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert int(done.stdout) < 300_000
