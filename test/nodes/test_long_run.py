"""The pipeline over more frames than a day's watch has key frames: nothing grows."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.drawn_scene import ByteImage, texture
from support.segmenters import segmenter_by_rules
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame

SHAPE = (64, 96)
SMALL = SHAPE[::-1]
LONG = [pytest.mark.soak, pytest.mark.timeout(7200)]
# A round of pictures, played again and again: a square crosses, then the scene is empty.
ROUND, CROSSING = 48, 24


def pictures(size: tuple[int, int]) -> list[ByteImage]:
    ground, square = texture(SHAPE, seed=1), texture((16, 16), seed=2, low=10, high=90)
    images = []
    for number in range(ROUND):
        image = ground.copy()
        if number < CROSSING:
            image[20:36, 3 * number : 3 * number + 16] = square
        image = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
        noise = np.random.default_rng(number).normal(0, 2, image.shape)
        images.append(np.clip(image + noise, 0, 255).astype(np.uint8))
    return images


def frames(count: int, size: tuple[int, int]) -> Iterator[Frame]:
    images = pictures(size)
    for number in range(count):
        yield Frame(number * 33_000_000, images[number % ROUND])


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize(
    ("count", "blocks", "size", "processing"),
    [
        (480, 5, SMALL, 128),
        pytest.param(100_000, 20, SMALL, 128, marks=LONG),
        pytest.param(20_000, 20, (1920, 1080), 432, marks=LONG),
    ],
    ids=["short", "100,000", "20,000-1080p"],
)
def test_memory_and_time_a_frame_stay_flat(
    count: int, blocks: int, size: tuple[int, int], processing: int
) -> None:
    segmenter = segmenter_by_rules(Parameters.from_mapping({"resolution.processing": processing}))
    memory, pace, answered, highest = [], [], 0, 0
    begun = time.process_time()
    for number, frame in enumerate(frames(count, size), start=1):
        for result in segmenter.push(frame):
            assert result.frame.stamp == answered * 33_000_000
            answered += 1
            highest = max([highest, *(moving.id for moving in result.objects)])
        if number % (count // blocks) == 0:
            now = time.process_time()
            memory.append(resident_bytes())
            pace.append((now - begun) / (count // blocks))
            begun = now
            reached = f"{number} frames, {highest} objects"
            print(f"{reached}: {memory[-1] / 1e6:.1f} MB, {1e3 * pace[-1]:.2f} ms", flush=True)
    answered += len(segmenter.flush())
    assert answered == count
    assert highest >= 0.9 * count / ROUND - 1
    # The first block fills caches and the allocator's pools.
    assert max(memory[1:]) - memory[1] < 10e6
    assert np.median(pace[-3:]) < 1.5 * np.median(pace[1:4])
