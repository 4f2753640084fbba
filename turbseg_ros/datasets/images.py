"""Folders of images and files of many pages, as the frames of a clip."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from turbseg_ros.arrays import Image
from turbseg_ros.bag.errors import ClipError, reading
from turbseg_ros.encoded_picture import PictureError, decoded

IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"),
    *(".pgm", ".ppm", ".pnm", ".webp", ".jp2"),
)
_PAGED_SUFFIXES = (".tif", ".tiff")
_FLAGS = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
# Pages that are read at a time: OpenCV looks for each from the file's beginning.
_PAGES = 16

# The last number of a name, which counts frames; longer ones are times.
_FRAME_NUMBER = re.compile(r"(?P<before>.*?)(?P<number>\d{1,9})(?P<after>\D*)")
# Times since 1970 as names: seconds with decimals, or whole milli-, micro- or nanoseconds.
_TIME = re.compile(r"(?P<seconds>\d{10})[._](?P<decimals>\d{3,9})|(?P<whole>\d{13}|\d{16}|\d{19})")
_UNITS = {13: 10**3, 16: 10**6, 19: 10**9}


@dataclass(frozen=True)
class ImageFolder:
    """Images in natural order, read when iterated over; `pages` are how many each file has."""

    folder: Path
    paths: tuple[Path, ...]
    pages: tuple[int, ...]

    @property
    def stated_count(self) -> int:
        """The number of images."""
        return sum(self.pages)

    def count(self) -> int:
        """Return the number of images."""
        return self.stated_count

    def __iter__(self) -> Iterator[Image]:
        """Read the images, HxW or HxWx3 (BGR).

        :raises ClipError: for a file that is no image.
        """
        for path, pages in zip(self.paths, self.pages, strict=True):
            yield from [_read_image(path)] if pages == 1 else _read_pages(path, pages)

    def timed(self, rate: float, as_asked: bool) -> Iterator[tuple[float, Image]]:
        """Return each image with its time in seconds from the first.

        Names that are times say it, unless a rate is asked for; numbers that are left out take
        their time all the same.
        """
        times = None if as_asked else self._times()
        numbers = self._positions()
        for place, image in enumerate(self):
            yield (times[place] if times else numbers[place] / rate), image

    def notes(self, as_asked: bool) -> list[str]:
        """Return what is particular about the images, a line each."""
        if not as_asked and self._times():
            return [f"{self.folder}: the names are taken for times"]
        positions = self._positions()
        gaps = [after - before - 1 for before, after in itertools.pairwise(positions)]
        if not any(gaps):
            return []
        place = next(place for place, gap in enumerate(gaps) if gap)
        return [
            f"{self.folder}: {sum(gaps)} frames are missing by their numbers, the first behind "
            f"{self.paths[place].name}; their time is left empty"
        ]

    def _positions(self) -> Sequence[int]:
        """Return the place of each image in time, in frames; where numbers are left out, a gap."""
        evenly = range(self.stated_count)
        matches = [_FRAME_NUMBER.fullmatch(path.stem) for path in self.paths]
        if len(self.paths) < self.stated_count or not all(matches):
            return evenly
        names = {(match["before"], match["after"]) for match in matches if match}
        numbers = [int(match["number"]) for match in matches if match]
        steps = Counter(after - before for before, after in itertools.pairwise(numbers))
        if len(names) != 1 or not steps:
            return evenly
        # Every fifth frame has no gaps; numbers without a usual step count something else.
        step, times = steps.most_common(1)[0]
        if min(steps) < 1 or 2 * times < len(numbers) or any(other % step for other in steps):
            return evenly
        return [(number - numbers[0]) // step for number in numbers]

    def _times(self) -> list[float] | None:
        """Return what the names say in seconds from the first, None when they are no times."""
        matches = [_TIME.fullmatch(path.stem) for path in self.paths]
        if len(self.paths) < self.stated_count or not all(matches):
            return None
        times = [_seconds(match) for match in matches if match]
        if any(after <= before for before, after in itertools.pairwise(times)):
            return None
        return [float(time - times[0]) for time in times]


def image_folder(source: Path) -> ImageFolder:
    """Find the images in a folder, or the pages of a file.

    :raises ClipError: when there are none.
    """
    if source.is_file():
        return ImageFolder(source, (source,), (_page_count(source),))
    if not source.is_dir():
        raise ClipError(f"no such folder: {source}")
    paths = image_paths(source)
    if not paths:
        raise ClipError(f"{source} holds no images ({', '.join(IMAGE_SUFFIXES)})")
    return ImageFolder(source, tuple(paths), tuple(map(_page_count, paths)))


def image_paths(folder: Path) -> list[Path]:
    """Return the images of a folder in natural order."""
    paths = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    ]
    return sorted(paths, key=lambda path: _natural_order(path.name))


def _natural_order(name: str) -> tuple[tuple[str | int, ...], str]:
    """Sort numbers in names by value, so that frame10 comes after frame9."""
    parts = re.split(r"(\d+)", name)
    return tuple(int(part) if part.isdecimal() else part for part in parts), name


def _seconds(match: re.Match[str]) -> Fraction:
    if match["whole"]:
        return Fraction(int(match["whole"]), _UNITS[len(match["whole"])])
    return Fraction(f"{match['seconds']}.{match['decimals']}")


def _page_count(path: Path) -> int:
    if path.suffix.lower() not in _PAGED_SUFFIXES:
        return 1
    return max(cv2.imcount(str(path), _FLAGS), 1)


def _read_pages(path: Path, count: int) -> Iterator[Image]:
    for start in range(0, count, _PAGES):
        wanted = min(_PAGES, count - start)
        _, pages = cv2.imreadmulti(str(path), start, wanted, flags=_FLAGS)
        if len(pages) != wanted:
            raise ClipError(f"{path}: page {start + len(pages)} of {count} can't be read")
        yield from map(_without_alpha, pages)


def _read_image(path: Path) -> Image:
    with reading(path):
        content = path.read_bytes()
    try:
        return _without_alpha(decoded(np.frombuffer(content, np.uint8), _FLAGS))
    except PictureError as error:
        reason = f": {error}" if str(error) else ""
        raise ClipError(f"{path} is not an image that can be read{reason}") from error


def _without_alpha(image: Image) -> Image:
    return image[:, :, :3] if image.ndim == 3 else image
