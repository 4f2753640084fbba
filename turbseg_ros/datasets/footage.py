"""Pictures, videos and sequences with masks, as footage that composites are made of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Image, Mask
from turbseg_ros.bag.errors import ClipError
from turbseg_ros.datasets.clip import Clip, find_clip
from turbseg_ros.datasets.images import IMAGE_SUFFIXES, ImageFolder
from turbseg_ros.datasets.video import VideoFile

_VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".mpg", ".mpeg", ".webm")
# Larger pictures are shrunk, for composites are smaller by far.
_LARGEST = 1600


@dataclass(frozen=True)
class ClipFootage:
    """A clip's frames, read when they are asked for, and its masks if it has any."""

    clip: Clip
    length: int

    @property
    def has_masks(self) -> bool:
        """Whether it is known what moves."""
        return self.clip.masks is not None

    def pictures(self, first: int, count: int) -> list[ByteImage]:
        """Return so many frames from the `first` on, HxWx3 (BGR) each, of 8 bits.

        :raises ClipError: when one can't be read.
        """
        return [as_picture(image) for image in _read(self.clip.frames, first, count)]

    def masks(self, first: int, count: int) -> list[Mask] | None:
        """Return what moves in them, HxW each; None where that isn't known.

        :raises ClipError: when one can't be read.
        """
        if self.clip.masks is None:
            return None
        return [as_mask(image) for image in _read(self.clip.masks, first, count)]


def sources_in(folder: Path) -> list[Path]:
    """Return the pictures, videos and folders in a folder, sorted by name.

    :raises ClipError: when there are none.
    """
    if not folder.is_dir():
        raise ClipError(f"no such folder: {folder}")
    sources = [
        path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and (path.is_dir() or path.suffix.lower() in (*IMAGE_SUFFIXES, *_VIDEO_SUFFIXES))
    ]
    if not sources:
        raise ClipError(f"{folder} holds no pictures, videos or sequences")
    return sources


def clip_footage(source: Path) -> ClipFootage:
    """Return a picture, a video or a sequence as footage; see `find_clip`.

    :raises ClipError: when it can't be read.
    """
    clip = find_clip(source)
    return ClipFootage(clip, clip.frames.count())


def _read(frames: VideoFile | ImageFolder, first: int, count: int) -> Iterator[Image]:
    """Read so many frames; of a folder, only these."""
    if isinstance(frames, ImageFolder) and frames.stated_count == len(frames.paths):
        part = slice(first, first + count)
        return iter(ImageFolder(frames.folder, frames.paths[part], frames.pages[part]))
    return itertools.islice(iter(frames), first, first + count)


def as_picture(image: Image) -> ByteImage:
    """Return a frame, HxW or HxWx3 of any depth, as HxWx3 of 8 bits and no larger than of use."""
    if image.dtype != np.uint8:
        top = max(float(image.max(initial=0)), 1.0)
        image = (image * (255.0 / top)).astype(np.uint8)
    scale = _LARGEST / max(image.shape[:2])
    if scale < 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))


def as_mask(image: Image) -> Mask:
    """Return where a mask isn't 0, HxW, at the size that pictures are brought to."""
    mask = np.asarray(np.atleast_3d(image).max(axis=2) > 0, np.bool_)
    scale = _LARGEST / max(mask.shape)
    if scale < 1:
        shrunk = cv2.resize(
            mask.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
        )
        return np.asarray(shrunk > 0.5)
    return mask
