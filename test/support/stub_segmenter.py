"""A segmenter that costs what is asked, for tests of all that is around the method."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult


class StubSegmenter:
    """Answers each frame at once with one object, after `cost` seconds of work elsewhere.

    Every `fail_every`-th frame fails, if that is not 0.
    """

    look_ahead = 0
    device = "cpu"
    cost = 0.0
    fail_every = 0

    def __init__(self, _parameters: Parameters) -> None:
        self._count = 0
        self._labels = np.zeros((0, 0), np.uint16)

    def push(self, frame: Frame, waiting: int = 0) -> list[SegmentationResult]:
        self._count += 1
        time.sleep(self.cost)
        if self.fail_every and self._count % self.fail_every == 0:
            raise RuntimeError(f"frame {self._count} is one of those that fail")
        return [self._result(frame)]

    def flush(self, waiting: Callable[[], int] | None = None) -> list[SegmentationResult]:
        return []

    def reset(self) -> None:
        pass

    def reconfigure(self, _parameters: Parameters) -> None:
        pass

    def empty_result(self, frame: Frame) -> SegmentationResult:
        return SegmentationResult.empty(frame, (243, 432))

    def close(self) -> None:
        pass

    def _result(self, frame: Frame) -> SegmentationResult:
        height, width = frame.image.shape[:2]
        if self._labels.shape != (height, width):
            self._labels = np.zeros((height, width), np.uint16)
            self._labels[height // 4 : height // 2, width // 4 : width // 2] = 1
        box = (width // 4, height // 4, width // 2 - width // 4, height // 2 - height // 4)
        centre = (box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2)
        moving_object = MovingObject(1, 0, centre, (1.0, 0.0), box[2] * box[3], box)
        motion_map = np.zeros((243, 432), np.float32)
        return SegmentationResult(frame, self._labels, (moving_object,), motion_map, 0.1, "stub")
