"""Hooks that observe the stages: for pictures of them, their times, training examples."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import AbstractContextManager

from turbseg_ros.segmentation.foreground import ObjectCrop
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Detection

STAGES = (
    "scaling",
    "registration",
    "small targets",
    "optical flow",
    "motion map",
    "region growing",
    "propagation",
    "what stands out",
    "crops",
    "outlines",
    "tracking",
    "labels",
)
"""The names of the stages whose work can be observed, in the order of a frame's way."""


class StageObserver:
    """Looks at what the stages make of each frame; this one looks at nothing.

    Override what is of interest. Nothing that is given may be changed. `stage` is entered in
    whatever thread the stage works; the others are called in the thread that segments, in the
    order of the frames, with the frame's stamp in nanoseconds.
    """

    def stage(self, name: str) -> AbstractContextManager[object]:
        """Return what is entered while a stage works; stages may lie within others."""
        return contextlib.nullcontext()

    def motion(self, stamp: int, moving: Moving) -> None:
        """Look at what moves in a frame, measured or propagated."""

    def crops(self, stamp: int, crops: Sequence[ObjectCrop]) -> None:
        """Look at the parts of a frame from which objects are cut out."""

    def detections(
        self, stamp: int, detections: Sequence[Detection], resolution: Resolution
    ) -> None:
        """Look at a frame's detections, at detail resolution, before they are tracked."""
