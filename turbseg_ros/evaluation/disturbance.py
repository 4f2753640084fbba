"""Turbulence and shake put on a recorded clip, frames and truth alike, before it is segmented."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Image
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.simulation.camera import CameraMotion
from turbseg_ros.simulation.turbulence import Turbulence
from turbseg_ros.simulation.warp import ClipWarper


class DisturbanceError(ValueError):
    """A disturbance that can't be put on a clip; the text says why."""


class Distorter(Protocol):
    """Distorts the frames of one clip, one by one in their order."""

    def distort(self, image: Image, labels: Labels | None) -> tuple[Image, Labels | None]:
        """Return the next frame and its truth as they are seen then."""


class Disturbance(Protocol):
    """Something that makes a clip harder; it can be sent to another process."""

    def distorter(self, shape: tuple[int, int], frames: int) -> Distorter:
        """Start on a clip of images of `shape` (height, width).

        :raises DisturbanceError: when such images can't be disturbed that much.
        """


@dataclass(frozen=True)
class AddedTurbulence:
    """Turbulence beside that which the clip has: `tilt_px` rms an axis, in pixels of its image.

    Blur follows the tilt. Made by the same `seed`, it differs in nothing but its strength.
    """

    tilt_px: float
    seed: int = 0

    def distorter(self, shape: tuple[int, int], frames: int) -> Distorter:
        """Start on a clip of images of `shape` (height, width)."""
        return ClipWarper(shape, Turbulence.typical(self.tilt_px, shape[1]), self.seed)


@dataclass(frozen=True)
class AddedShake:
    """A hand-held camera: the picture steps by `step_px` rms an axis from frame to frame.

    So that no border comes into view, the picture is cut to what a shake of `widest_step_px`
    leaves: two shakes with the same widest show the same part of the scene.
    """

    step_px: float
    widest_step_px: float
    seed: int = 0

    def distorter(self, shape: tuple[int, int], frames: int) -> Distorter:
        """Start on a clip of images of `shape` (height, width).

        :raises DisturbanceError: when the widest shake leaves less than half of the height or
            width.
        """
        offsets = self._offsets(self.step_px, frames)
        margin = math.ceil(np.abs(self._offsets(self.widest_step_px, frames)).max(initial=0)) + 2
        if 4 * margin > min(shape):
            raise DisturbanceError(
                f"a shake of {self.widest_step_px:g} px moves the picture by up to {margin} px, "
                f"too much for {shape[1]}x{shape[0]}"
            )
        return _ClipShaker(offsets, margin)

    def _offsets(self, step_px: float, frames: int) -> npt.NDArray[np.float64]:
        """Return the (x, y) of each frame's scene in its picture, Nx2; the steps scale them."""
        rng = np.random.default_rng([self.seed, 1])
        return CameraMotion(shake=step_px).trajectory(frames, (0.0, 0.0), rng)[:, :, 2]


class DisturbedClip:
    """The frames of a clip under a disturbance, and the truth that goes with them.

    The truth of a frame is known once the frame was given.
    """

    def __init__(
        self,
        frames: Iterable[Frame],
        count: int,
        truth: LabelsByStamp,
        disturbance: Disturbance,
    ) -> None:
        self._frames = frames
        self._count = count
        self._source_truth = truth
        self._disturbance = disturbance
        self.truth = LabelsByStamp()

    def __iter__(self) -> Iterator[Frame]:
        """Disturb the frames one by one.

        :raises DisturbanceError: when a frame can't be disturbed, or is not of the first one's
            size.
        """
        distorter: Distorter | None = None
        for frame in self._frames:
            height, width = frame.image.shape[:2]
            if distorter is None:
                distorter = self._disturbance.distorter((height, width), self._count)
            labels = self._source_truth.at(frame.stamp, frame.received, frame.period)
            try:
                image, seen_labels = distorter.distort(frame.image, labels)
            except ValueError as error:
                raise DisturbanceError(str(error)) from error
            if seen_labels is not None:
                self.truth.add(StampedLabels(frame.stamp, seen_labels, frame.received))
            yield replace(frame, image=image)


class _ClipShaker:
    """Moves each picture by an offset, and cuts off `margin` pixels on every side."""

    def __init__(self, offsets: npt.NDArray[np.float64], margin: int) -> None:
        self._offsets = iter(offsets)
        self._margin = margin

    def distort(self, image: Image, labels: Labels | None) -> tuple[Image, Labels | None]:
        """Return the next frame and its truth as the shaken camera sees them, dtypes kept."""
        offset = next(self._offsets)
        moved = self._moved(image, offset, cv2.INTER_CUBIC)
        if labels is None:
            return moved, None
        return moved, self._moved(labels, offset, cv2.INTER_NEAREST)

    def _moved(self, image: Image, offset: npt.NDArray[np.float64], interpolation: int) -> Image:
        height, width = image.shape[:2]
        cut = self._margin
        to_moved = np.column_stack([np.eye(2), offset - cut])
        size = (width - 2 * cut, height - 2 * cut)
        return np.asarray(cv2.warpAffine(image, to_moved, size, flags=interpolation))
