"""What Refine-Net learns from: the method's own windows on rendered clips, with their truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Labels, Map
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.learning.random_scenes import random_scene
from turbseg_ros.learning.window_input import CHANNELS, SIDE, resized, window_input
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.foreground import ObjectCrop, foreground_masks
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.simulation.render import render

HalfMaps = npt.NDArray[np.float16]

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
    observer = _WindowKeeper(truth, parameters.outline.threshold)
    by_rules = parameters.replace({"refine.mode": "none"})
    with motion_segmenter(by_rules, observer) as segmenter:
        for number, (frame, labels) in enumerate(clip):
            if number % _STEP == 0:
                truth[frame.stamp] = labels
            segmenter.push(frame)
        segmenter.flush()
    return observer.examples()


class _WindowKeeper(StageObserver):
    """Keeps the windows of frames whose truth is known, with what the rules make of them."""

    def __init__(self, truth: dict[int, Labels], threshold: float) -> None:
        self._truth = truth
        self._threshold = threshold
        self._kept: list[tuple[Map, Map, Map]] = []

    def crops(self, stamp: int, crops: Sequence[ObjectCrop]) -> None:
        """Keep the windows of a frame, if its truth is known."""
        if stamp not in self._truth:
            return
        square = SIDE, SIDE
        for crop in crops:
            objects = self._truth[stamp][crop.box.slices] > 0
            truth = resized(objects.astype(np.float32), square)
            self._kept.append((window_input(crop), truth, resized(self._ruled(crop), square)))

    def _ruled(self, crop: ObjectCrop) -> Map:
        """Return 1 within the outlines by rules, 0 without."""
        ruled = np.zeros(crop.box.shape, np.float32)
        for outline in foreground_masks([crop], self._threshold):
            inside = outline.box.moved(-crop.box.x0, -crop.box.y0)
            ruled[inside.slices][outline.mask] = 1.0
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
