"""What is learnt from: folders of pictures, videos and sequences, and bags with their truth."""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turbseg_ros.arrays import ByteImage, Mask
from turbseg_ros.bag.errors import BagError, ClipError
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.cli.errors import UsageError
from turbseg_ros.datasets.footage import as_mask, as_picture, clip_footage, sources_in
from turbseg_ros.evaluation.labels import LabelsByStamp, read_labels
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.simulation.footage import Footage


@dataclass(frozen=True)
class BagFootage:
    """The frames of a bag's image topic, and what its truth says moves in them."""

    path: Path

    @functools.cached_property
    def length(self) -> int:
        """The number of frames that can be read."""
        return sum(1 for _ in self._frames())

    @property
    def has_masks(self) -> bool:
        """Whether the bag holds the truth."""
        return TRUTH_TOPIC in BagReader(self.path).topics

    def pictures(self, first: int, count: int) -> list[ByteImage]:
        """Return so many frames from the `first` on, HxWx3 (BGR) each, of 8 bits."""
        return [as_picture(frame.image) for frame in self._part(first, count)]

    def masks(self, first: int, count: int) -> list[Mask] | None:
        """Return what moves in them, HxW each; None where that isn't known.

        Where a frame has no truth, nothing moves.
        """
        if not self.has_masks:
            return None
        truth = LabelsByStamp(read_labels(BagReader(self.path), TRUTH_TOPIC))
        found = []
        for frame in self._part(first, count):
            labels = truth.at(frame.stamp, frame.received, frame.period)
            found.append(as_mask(np.zeros(frame.image.shape[:2]) if labels is None else labels))
        return found

    def _part(self, first: int, count: int) -> itertools.islice[Frame]:
        return itertools.islice(self._frames(), first, first + count)

    def _frames(self) -> BagFrames:
        reader = BagReader(self.path)
        return BagFrames(reader, reader.find_image_topic(None))


def backgrounds_in(folder: Path | None) -> list[Footage]:
    """Return each picture, video, sequence and bag in a folder by itself, sorted by name.

    :param folder: none gives none.
    :raises UsageError: when there is nothing in it, or something can't be read.
    """
    return [] if folder is None else [footage for _, footage in _read(folder)]


def objects_in(folder: Path | None) -> list[Footage]:
    """Return the sequences and bags in a folder, all of which have masks, sorted by name.

    :param folder: none gives none.
    :raises UsageError: when there is none, or one can't be read or has no masks.
    """
    if folder is None:
        return []
    found = _read(folder)
    for source, footage in found:
        if not footage.has_masks:
            raise UsageError(f"{source} has no masks, so nothing can be cut out of it")
    return [footage for _, footage in found]


def _read(folder: Path) -> list[tuple[Path, Footage]]:
    try:
        return [(source, _footage(source)) for source in sources_in(folder)]
    except (BagError, ClipError) as error:
        raise UsageError(str(error)) from error


def _footage(source: Path) -> Footage:
    if not _is_bag(source):
        return clip_footage(source)
    bag = BagFootage(source)
    if not bag.length:
        raise BagError(f"{source} holds no image that can be read")
    return bag


def _is_bag(source: Path) -> bool:
    is_folder = source.is_dir()
    return is_folder and ((source / "metadata.yaml").exists() or any(source.glob("*.mcap")))
