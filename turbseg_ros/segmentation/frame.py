"""What flows into the method and what comes out of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np

from turbseg_ros.arrays import Image, Labels, Map, Mask
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.load import Step
from turbseg_ros.segmentation.marked_regions import FittedRegions

_MAX_LABELS = 65535


@dataclass(frozen=True)
class Frame:
    """One image of the camera.

    `image` is HxW (grey) or HxWx3 (blue, green, red), uint8, uint16 or float32; `stamp` is the
    time it was taken, in nanoseconds; `frame_id` names the camera's coordinate frame. Where it is
    not `image_wanted`, its result comes with a black image, for full-size ones of all frames that
    wait take much memory. Where it was decoded at a part of its size, and not wanted either,
    `whole` is the size (rows, columns) that it has and its result gets. `received` is when it came
    or was recorded, in nanoseconds, and `period` the usual time, in seconds, from one frame to the
    next, None where that is not known. One that `begins_stream` has nothing to do with those
    before.
    """

    stamp: int
    image: Image
    frame_id: str = ""
    image_wanted: bool = True
    whole: tuple[int, int] | None = None
    received: int | None = None
    period: float | None = None
    begins_stream: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the camera's image."""
        return self.whole or (self.image.shape[0], self.image.shape[1])

    def kept(self) -> Frame:
        """Return what is to be kept of it for its result."""
        if self.image_wanted:
            return self
        # One pixel for all of them.
        shape = (*self.shape, *self.image.shape[2:])
        black = np.broadcast_to(np.zeros((), self.image.dtype), shape)
        return replace(self, image=black, whole=None)


@dataclass(frozen=True)
class MovingObject:
    """One object that really moves, as it stands in one frame.

    Lengths are pixels of the input image. `slot` is the output slot that the object keeps while
    it lives, -1 when all were taken; `velocity` is pixels a frame against the scene; `trail` are
    earlier centroids, oldest first, in this frame's coordinates; `period` is the time from one
    frame to the next in seconds, None where it is not known; `score` is how sure it is, from 0 to
    1, that something moves there in earnest. One that is `absorbed` stood for so long that it is
    background from the next frame on.
    """

    id: int
    slot: int
    centroid: tuple[float, float]
    velocity: tuple[float, float]
    area: int
    box: tuple[int, int, int, int]
    trail: tuple[tuple[float, float], ...] = ()
    period: float | None = None
    score: float = 1.0
    absorbed: bool = False

    @property
    def velocity_per_second(self) -> tuple[float, float] | None:
        """The velocity in pixels a second, None where the frames' rate is not known."""
        if self.period is None:
            return None
        return self.velocity[0] / self.period, self.velocity[1] / self.period

    @property
    def label(self) -> int:
        """What marks its pixels in the labels."""
        return label_of(self.id)

    @classmethod
    def from_mask(
        cls,
        mask: Mask,
        id: int,  # as the field is called
        slot: int = -1,
        velocity: tuple[float, float] = (0.0, 0.0),
        trail: tuple[tuple[float, float], ...] = (),
        origin: tuple[int, int] = (0, 0),
        period: float | None = None,
        score: float = 1.0,
        absorbed: bool = False,
    ) -> MovingObject:
        """Return the object that a mask, hxw, shows: its centroid, area and box by the mask.

        :param origin: (x, y) of the mask's first pixel in the image.
        :raises ValueError: when the mask holds nothing.
        """
        pixels = mask.view(np.uint8)
        moments = cv2.moments(pixels, binaryImage=True)
        area = moments["m00"]
        if not area:
            raise ValueError("an object needs a pixel")
        x, y, width, height = cv2.boundingRect(pixels)
        return cls(
            id=id,
            slot=slot,
            centroid=(moments["m10"] / area + origin[0], moments["m01"] / area + origin[1]),
            velocity=velocity,
            area=int(area),
            box=(x + origin[0], y + origin[1], width, height),
            trail=trail,
            period=period,
            score=score,
            absorbed=absorbed,
        )


@dataclass(frozen=True)
class SegmentationResult:
    """What was found in one frame.

    `labels` is uint16, HxW as the frame: 0 is background, k the object with id k
    (counted from 1 again after 65,535). `motion_map` is
    float32 at processing resolution: pixels a frame (of the input image) by which a point breaks
    the camera's own motion. `tilt` is the measured turbulence: rms image motion an axis in input
    pixels, NaN while unknown. `ego_motion_model` names what tells the camera's motion: the model
    of the motion measure, or that of the frame's registration where it is a poorer one, see
    `registration.EgoMotionModel`; `camera` is what the camera does.
    `clutter` is float32, a cell for each four by four pixels at processing resolution: by how many
    pixels a frame (of the input image) a place is known to move without anything being there; None
    while nothing is known. `coasted` tells that its objects coasted under load: propagated, not
    looked for, and `step` what was given up under load by then. `regions` is what its user marked
    in the picture, None where that is not known.
    `condition` tells what the frame was like: one that is damaged, blind or repeated
    is answered with what was known before it, and has no say in other frames' results.
    """

    frame: Frame
    labels: Labels
    objects: tuple[MovingObject, ...]
    motion_map: Map
    tilt: float
    ego_motion_model: str
    coasted: bool = False
    clutter: Map | None = None
    regions: FittedRegions | None = None
    condition: Condition = Condition.SOUND
    camera: CameraState = CameraState.STILL
    step: Step = Step.FULL

    @classmethod
    def empty(cls, frame: Frame, motion_shape: tuple[int, int] = (0, 0)) -> SegmentationResult:
        """Return the result of a frame in which nothing is found.

        :param motion_shape: rows and columns of the motion map, which is 0 all over.
        """
        return cls(
            frame=frame,
            labels=np.zeros(frame.shape, np.uint16),
            objects=(),
            motion_map=np.zeros(motion_shape, np.float32),
            tilt=float("nan"),
            ego_motion_model="none",
        )


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
