"""What Refine-Net learns from: the method's own windows on rendered clips, with their truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from turbseg_ros.learning.random_scenes import random_scene
from turbseg_ros.learning.window_input import CHANNELS, SIDE, resized, window_input
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.foreground import ObjectCrop, foreground_masks
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.segmentation.pipeline import MotionSegmenter
from turbseg_ros.simulation.render import render

Map = npt.NDArray[np.float32]
HalfMaps = npt.NDArray[np.float16]
Labels = npt.NDArray[np.uint16]

# Windows of every so many frames are kept, for neighbours are nearly alike.
_STEP = 3


@dataclass(frozen=True)
class Examples:
    """Windows as the network sees them, and what is right.

    `inputs` is NxCHANNELSxSIDExSIDE; `truth`, the share of each pixel that objects cover, and
    `ruled`, what the rules made of it, are NxSIDExSIDE.
    """

    inputs: HalfMaps
    truth: HalfMaps
    ruled: HalfMaps

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.inputs)

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        """Put examples together."""
        return cls(
            np.concatenate([part.inputs for part in parts]),
            np.concatenate([part.truth for part in parts]),
            np.concatenate([part.ruled for part in parts]),
        )


def examples_from(clip: Iterable[tuple[Frame, Labels]], parameters: Parameters) -> Examples:
    """Run the method by its rules over a clip and keep its windows.

    :param clip: frames with their labels, no wider than `resolution.detail`.
    """
    truth: dict[int, Labels] = {}
    observer = _Observer(truth, parameters.outline.threshold)
    segmenter = MotionSegmenter(parameters, observer)
    for number, (frame, labels) in enumerate(clip):
        if number % _STEP == 0:
            truth[frame.stamp] = labels
        segmenter.push(frame)
    segmenter.flush()
    return observer.examples()


class _Observer:
    """Draws the rules' outlines, and keeps the windows of frames whose truth is known."""

    def __init__(self, truth: dict[int, Labels], threshold: float) -> None:
        self._truth = truth
        self._threshold = threshold
        self._kept: list[tuple[Map, Map, Map]] = []

    def refine(self, windows: Sequence[ObjectCrop]) -> list[Map]:
        """Return 1 within the outlines by rules, 0 without."""
        return [self._refined(window) for window in windows]

    def _refined(self, window: ObjectCrop) -> Map:
        ruled = np.zeros(window.box.shape, np.float32)
        for outline in foreground_masks([window], self._threshold):
            inside = outline.box.moved(-window.box.x0, -window.box.y0)
            ruled[inside.slices][outline.mask] = 1.0
        if window.stamp in self._truth:
            objects = self._truth[window.stamp][window.box.slices] > 0
            square = SIDE, SIDE
            truth = resized(objects.astype(np.float32), square)
            self._kept.append((window_input(window), truth, resized(ruled, square)))
        return ruled

    def examples(self) -> Examples:
        """Return what was kept."""
        count = len(self._kept)
        inputs = np.empty((count, len(CHANNELS), SIDE, SIDE), np.float16)
        truth, ruled = np.empty((2, count, SIDE, SIDE), np.float16)
        for number, maps in enumerate(self._kept):
            inputs[number], truth[number], ruled[number] = maps
        return Examples(inputs, truth, ruled)


def rendered_clip(seed: int, frames: int) -> Iterator[tuple[Frame, Labels]]:
    """Render a scene drawn at random, with its labels; the same for the same seed."""
    drawn = random_scene(np.random.default_rng(seed), frames)
    for rendered in render(drawn, seed):
        yield Frame(rendered.stamp_ns, rendered.image), rendered.labels
