"""What others found, as folders of masks: scored as if a segmenter had just found it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.datasets.images import ImageFolder, image_folder, image_paths
from turbseg_ros.datasets.masks import MaskMeaning, mask_meaning
from turbseg_ros.evaluation.labels import result_from_labels
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

_NUMBER = re.compile(r"(\d+)\D*")
# What a mask that doesn't tell objects apart has for a label.
_FOREGROUND = 255


@dataclass(frozen=True)
class RecordedMasks:
    """A method of which only the masks are there: a folder for each clip, as DAVIS lays them out.

    `keeps_ids` tells whether they are labels of objects, or of foreground and background only.
    """

    name: str
    folder: Path
    keeps_ids: bool
    recorded: ClassVar[bool] = True

    @classmethod
    def of(cls, name: str, folder: Path) -> RecordedMasks:
        """Look at the masks in a folder, or in folders in it; `name` is what tables call them.

        :raises ClipError: when there are none, or they can't be read.
        """
        if not folder.is_dir():
            raise ClipError(f"no such folder: {folder}")
        folders = [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]
        with_masks = [each for each in folders if image_paths(each)]
        if not with_masks:
            raise ClipError(f"{folder} holds no masks, nor do folders in it")
        return cls(name, folder.absolute(), any(map(_tells_objects_apart, with_masks)))

    def segmenter(self, clip: str = "", frames: int = 0) -> MaskSegmenter:
        """Return what answers the frames of a clip with its masks.

        :raises ClipError: when there are none of that clip, or they don't fit its frames.
        """
        folder = self.folder / clip
        if not (clip and folder.is_dir()):
            folder = self.folder
        if not image_paths(folder):
            raise ClipError(f"{self.folder} holds no masks of {clip}; name their folder {clip}")
        masks = image_folder(folder)
        return MaskSegmenter(masks, _frame_numbers(masks, frames), self.keeps_ids)


class MaskSegmenter:
    """Answers each frame at once, with the mask of its number; without one it holds nothing."""

    def __init__(self, masks: ImageFolder, numbers: Sequence[int], keeps_ids: bool) -> None:
        self._meaning: MaskMeaning = mask_meaning(masks)
        self._masks = iter(masks)
        self._numbers = frozenset(numbers)
        self._keeps_ids = keeps_ids
        self._folder = masks.folder
        self._seen = 0

    def push(self, frame: Frame) -> list[SegmentationResult]:
        """Take the next frame; return its result.

        :raises ClipError: when its mask is of another size.
        """
        number = self._seen
        self._seen += 1
        if number not in self._numbers:
            return [SegmentationResult.empty(frame)]
        labels = self._meaning.labels(next(self._masks))
        if labels.shape != frame.image.shape[:2]:
            (height, width), (rows, columns) = labels.shape, frame.image.shape[:2]
            raise ClipError(
                f"{self._folder}: masks of {width}x{height} don't fit frames of {columns}x{rows}"
            )
        if not self._keeps_ids:
            _, components = cv2.connectedComponents((labels != 0).astype(np.uint8))
            return [result_from_labels(frame, components.astype(np.uint16))]
        return [result_from_labels(frame, labels)]

    def flush(self) -> list[SegmentationResult]:
        """Return nothing: every frame was answered."""
        return []


def _frame_numbers(masks: ImageFolder, frames: int) -> Sequence[int]:
    """Return the frame that each mask is of: in order, or where some are missing by their names.

    :raises ClipError: when neither tells.
    """
    if masks.count() == frames:
        return range(frames)
    found = [_NUMBER.findall(path.stem) for path in masks.paths]
    numbers = [int(each[-1]) for each in found if each]
    in_order = all(after > before for before, after in itertools.pairwise(numbers))
    if len(numbers) != masks.count() or not in_order or numbers[-1] >= frames:
        raise ClipError(
            f"{masks.folder} has {masks.count()} masks for {frames} frames; name each after its "
            "frame's number, from 0"
        )
    return numbers


def _tells_objects_apart(folder: Path) -> bool:
    """Whether the first mask that shows anything holds labels, not only foreground."""
    for mask in image_folder(folder):
        if np.any(mask):
            return bool(mask_meaning([mask]).objects.max() != _FOREGROUND)
    return False
