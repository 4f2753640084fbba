"""What flows into the method and what comes out of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]

_MAX_LABELS = 65535


@dataclass(frozen=True)
class Frame:
    """One image of the camera.

    `image` is HxW (grey) or HxWx3 (blue, green, red), uint8, uint16 or float32; `stamp` is the
    time it was taken, in nanoseconds; `frame_id` names the camera's coordinate frame. Where it is
    not `image_wanted`, its result comes with a black image, for full-size ones of all frames that
    wait take much memory.
    """

    stamp: int
    image: Image
    frame_id: str = ""
    image_wanted: bool = True

    def kept(self) -> Frame:
        """Return what is to be kept of it for its result."""
        if self.image_wanted:
            return self
        # One pixel for all of them.
        black = np.broadcast_to(np.zeros((), self.image.dtype), self.image.shape)
        return replace(self, image=black)


@dataclass(frozen=True)
class MovingObject:
    """One object that really moves, as it stands in one frame.

    Lengths are pixels of the input image. `slot` is the output slot that the object keeps while
    it lives, -1 when all were taken; `velocity` is pixels a frame against the scene; `trail` are
    earlier centroids, oldest first, in this frame's coordinates.
    """

    id: int
    slot: int
    centroid: tuple[float, float]
    velocity: tuple[float, float]
    area: int
    box: tuple[int, int, int, int]
    trail: tuple[tuple[float, float], ...] = ()

    @property
    def label(self) -> int:
        """What marks its pixels in the labels."""
        return label_of(self.id)


@dataclass(frozen=True)
class SegmentationResult:
    """What was found in one frame.

    `labels` is uint16, HxW as the frame: 0 is background, k the object with id k
    (counted from 1 again after 65,535). `motion_map` is
    float32 at processing resolution: pixels a frame (of the input image) by which a point breaks
    the camera's own motion. `tilt` is the measured turbulence: rms image motion a axis in input
    pixels, NaN while unknown. `ego_motion_model` names the model chosen for the camera's motion.
    `coasted` tells that its objects were carried along in haste, not looked for.
    """

    frame: Frame
    labels: npt.NDArray[np.uint16]
    objects: tuple[MovingObject, ...]
    motion_map: npt.NDArray[np.float32]
    tilt: float
    ego_motion_model: str
    coasted: bool = False


def label_of(object_id: int) -> int:
    """Return the label of an object: its id, counted from 1 again after 65,535."""
    return (object_id - 1) % _MAX_LABELS + 1


class Segmenter(Protocol):
    """What is driven: `MotionSegmenter`, or anything else that answers each frame in order."""

    def push(self, frame: Frame) -> Sequence[SegmentationResult]:
        """Take the next frame; return the results that it completes."""

    def flush(self) -> Sequence[SegmentationResult]:
        """Return the results of the frames that still wait for later ones."""


def segment(frames: Iterable[Frame], segmenter: Segmenter) -> Iterator[SegmentationResult]:
    """Yield one result for every frame, in order."""
    for frame in frames:
        yield from segmenter.push(frame)
    yield from segmenter.flush()
