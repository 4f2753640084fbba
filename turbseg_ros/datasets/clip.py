"""Clips that are not bags yet: a video file or a folder of frames, and its folder of masks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from turbseg_ros.arrays import Image
from turbseg_ros.bag.errors import ClipError
from turbseg_ros.datasets.images import (
    IMAGE_SUFFIXES,
    ImageFolder,
    image_folder,
    image_paths,
)
from turbseg_ros.datasets.video import VideoFile, open_video

# How data sets name the folders of a sequence.
FRAME_FOLDERS = ("frames", "images", "imgs", "img", "input", "rgb")
_MASK_FOLDERS = ("masks", "mask", "annotations", "groundtruth", "ground_truth", "gt", "labels")
# How they name the folder of all sequences' frames, where it has one for all masks beside it.
_FRAME_TREES = (*FRAME_FOLDERS, "jpegimages")
# Folders between that and a sequence's own at most, as `480p` of DAVIS.
_TREE_DEPTH = 2


@dataclass(frozen=True)
class Clip:
    """Frames, and the masks that show their truth, where there are any, paired by order."""

    frames: ImageFolder | VideoFile
    masks: ImageFolder | None


@dataclass(frozen=True)
class FrameFormat:
    """What all frames of a clip have in common."""

    height: int
    width: int
    dtype: np.dtype[Any]
    colour: bool

    def conform(self, number: int, frame: Image) -> Image:
        """Return a frame, the `number`th, as HxW, or as HxWx3 (BGR) when the clip has colour.

        :raises ClipError: when its size or depth is another.
        """
        height, width = frame.shape[:2]
        if (height, width, frame.dtype) != (self.height, self.width, self.dtype):
            raise ClipError(
                f"frame {number} is {width}x{height} {frame.dtype}, "
                f"the first {self.width}x{self.height} {self.dtype}"
            )
        if self.colour and frame.ndim == 2:
            return np.asarray(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
        if not self.colour and frame.ndim == 3:
            return frame[:, :, 0]
        return frame


def find_clip(source: Path, masks: Path | None = None) -> Clip:
    """Find the frames and masks that `source` stands for.

    `source` is a video, an image of many pages, a folder of images, or a sequence's folder with
    one folder of frames and at most one of masks. Masks are those in `masks`, or else those beside
    the frames in such a folder, or those that the data set keeps in a tree like that of its
    frames, as DAVIS does: JPEGImages/480p/SEQUENCE and Annotations/480p/SEQUENCE.

    :raises ClipError: when that gives no frames, several choices, or masks that don't match.
    """
    if not source.exists():
        raise ClipError(f"no such video or folder: {source}")
    if source.is_dir():
        folder, masks_beside = _sequence_folders(source)
        frames: ImageFolder | VideoFile = image_folder(folder)
        masks = masks or masks_beside
    elif source.suffix.lower() in IMAGE_SUFFIXES:
        frames = image_folder(source)
    else:
        frames = open_video(source)
    if masks is None:
        return Clip(frames, None)
    mask_images = image_folder(masks)
    if frames.count() != mask_images.count():
        raise ClipError(
            f"{source} has {frames.count()} frames, {masks} has {mask_images.count()} masks; "
            "there must be a mask for each frame"
        )
    return Clip(frames, mask_images)


def frame_format(frames: Iterable[Image]) -> FrameFormat:
    """Return the format of a clip; it has colour when any frame's channels differ.

    :raises ClipError: when there is no frame.
    """
    first: Image | None = None
    colour = False
    for frame in frames:
        first = frame if first is None else first
        if not _is_grey(frame):
            colour = True
            break
    if first is None:
        raise ClipError("the clip has no frames")
    height, width = first.shape[:2]
    return FrameFormat(height, width, first.dtype, colour)


def _is_grey(frame: Image) -> bool:
    return frame.ndim == 2 or all(
        np.array_equal(frame[:, :, 0], frame[:, :, channel]) for channel in (1, 2)
    )


def _sequence_folders(source: Path) -> tuple[Path, Path | None]:
    """Return the folders of frames and of masks that belong to `source`."""
    if image_paths(source):
        return source, _only(_masks_in_parallel(source), source)
    frames = _folders_named(source, FRAME_FOLDERS)
    if len(frames) != 1:
        raise ClipError(
            f"{source} holds no images and {len(frames) or 'no'} folders of frames "
            f"({', '.join(FRAME_FOLDERS)}); name the one with the frames"
        )
    return frames[0], _only(_folders_named(source, _MASK_FOLDERS), source)


def _only(masks: list[Path], source: Path) -> Path | None:
    if len(masks) > 1:
        raise ClipError(
            f"{source} has several folders of masks; choose with --masks: "
            f"{', '.join(map(str, masks))}"
        )
    return masks[0] if masks else None


def _folders_named(source: Path, names: tuple[str, ...]) -> list[Path]:
    return [
        folder
        for folder in sorted(source.iterdir())
        if folder.name.lower() in names and folder.is_dir()
    ]


def _masks_in_parallel(frames: Path) -> list[Path]:
    """Find the masks of a sequence in trees beside that of the frames."""
    sequence = frames.resolve()
    return [
        masks / sequence.relative_to(tree)
        for tree in list(sequence.parents)[:_TREE_DEPTH]
        if tree.name.lower() in _FRAME_TREES
        for masks in _folders_named(tree.parent, _MASK_FOLDERS)
        if (masks / sequence.relative_to(tree)).is_dir()
    ]
