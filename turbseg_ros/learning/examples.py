"""What Refine-Net learns from: the method's own windows on rendered clips, with their truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path
from zipfile import BadZipFile

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

STEP = 3
"""Windows of every so many frames are kept, for neighbours are nearly alike."""


@dataclass(frozen=True)
class Examples:
    """Windows as the network sees them, and what is right.

    `inputs` is NxCHANNELSxSIDExSIDE; `truth`, the share of each pixel that objects cover, and
    `ruled`, what the rules made of it (0 where that wasn't asked for), are NxSIDExSIDE.
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

    @classmethod
    def on_disk(cls, parts: Iterable[Examples], folder: Path) -> Examples:
        """Put examples together in files, of which memory holds what is in use.

        A window takes a quarter of a megabyte, so that tens of thousands fill a memory.

        :param folder: where the files are made; they must not be there yet.
        """
        names = [each.name for each in fields(cls)]
        count = 0
        with ExitStack() as opened:
            files = [opened.enter_context((folder / name).open("xb")) for name in names]
            for part in parts:
                count += len(part)
                for name, file in zip(names, files, strict=True):
                    np.ascontiguousarray(getattr(part, name)).tofile(file)
        shapes = (count, len(CHANNELS), SIDE, SIDE), (count, SIDE, SIDE), (count, SIDE, SIDE)
        if not count:
            return cls(*(np.empty(shape, np.float16) for shape in shapes))
        return cls(
            *(
                np.memmap(folder / name, np.float16, "r+", shape=shape)
                for name, shape in zip(names, shapes, strict=True)
            )
        )

    def save(self, path: Path) -> None:
        """Write the examples to a file."""
        part = path.with_name(f".{path.name}.part")
        with part.open("wb") as file:
            np.savez(file, inputs=self.inputs, truth=self.truth, ruled=self.ruled)
        part.replace(path)

    @classmethod
    def load(cls, path: Path) -> Examples:
        """Read examples that `save` wrote.

        :raises ValueError: when the file is no such one, or of another kind of network input.
        """
        try:
            with np.load(path) as held:
                found = cls(held["inputs"], held["truth"], held["ruled"])
        except (KeyError, OSError, ValueError, BadZipFile) as error:
            raise ValueError(f"{path} holds no windows ({error})") from error
        if found.inputs.shape[1:] != (len(CHANNELS), SIDE, SIDE):
            raise ValueError(f"{path} holds windows of another kind: {found.inputs.shape[1:]}")
        return found


def examples_from(
    clip: Iterable[tuple[Frame, Labels]],
    parameters: Parameters,
    step: int = STEP,
    ruled: bool = True,
) -> Examples:
    """Run the method over a clip and keep its windows.

    :param clip: frames with their labels, no wider than `resolution.detail`.
    :param parameters: those of the method; by `refine.mode` it draws its outlines by rules or by
        a network, which decides what it takes for background later.
    :param step: windows of every so many frames are kept.
    :param ruled: whether it is kept what the rules make of them, which takes its time.
    """
    truth: dict[int, Labels] = {}
    observer = _WindowKeeper(truth, parameters.outline.threshold if ruled else None)
    with motion_segmenter(parameters, observer) as segmenter:
        for number, (frame, labels) in enumerate(clip):
            if number % step == 0:
                truth[frame.stamp] = labels
            segmenter.push(frame)
        segmenter.flush()
    return observer.examples()


class _WindowKeeper(StageObserver):
    """Keeps the windows of frames whose truth is known, with what the rules make of them."""

    def __init__(self, truth: dict[int, Labels], threshold: float | None) -> None:
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
        if self._threshold is None:
            return ruled
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
