"""What a report shows of one clip: frames from all of it, its worst frames, J over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.evaluation.metrics import Labels, jaccard
from turbseg_ros.overlay import (
    Annotator,
    Canvas,
    OutlineAnnotator,
    TruthAnnotator,
    draw_overlay,
    evenly_spaced,
)
from turbseg_ros.segmentation.frame import SegmentationResult

_TILES = 6
_TILE_WIDTH = 480
_WORST = 3
_JPEG_QUALITY = 88
# Least part of the picture's width that a close-up shows, and room around what went wrong, as a
# fraction of its size.
_CLOSEST = 0.3
_ROOM = 0.4


@dataclass(frozen=True)
class Picture:
    """A drawn frame, as JPEG; `caption` tells its number in the clip and how well it was done."""

    caption: str
    jpeg: bytes
    width: int
    height: int


@dataclass(frozen=True)
class Illustrations:
    """The pictures of one clip: `tiles` evenly spaced, `worst` close-ups, in order of time.

    `j` holds (frame, J) of every frame whose truth has an object.
    """

    tiles: tuple[Picture, ...]
    worst: tuple[Picture, ...]
    j: tuple[tuple[int, float], ...]


class Illustrator:
    """Draws the results of a clip of so many `frames` while they come."""

    def __init__(self, frames: int, annotators: Sequence[Annotator]) -> None:
        self._wanted = set(evenly_spaced(frames, _TILES))
        self._annotators = annotators
        self._worst = _WorstResults(_WORST, separation=max(frames // (3 * _WORST), 2))
        self._tiles: list[Picture] = []
        self._j: list[tuple[int, float]] = []
        self._seen = 0

    def add(self, result: SegmentationResult, truth: Labels | None) -> None:
        """Take the clip's next result and the truth of its frame, where there is one."""
        if truth is not None:
            judged = _Judged(self._seen, jaccard(result.labels, truth), result, truth)
            self._worst.add(judged)
            if truth.any():
                self._j.append((self._seen, judged.j))
        if self._seen in self._wanted:
            verdict = "" if truth is None else f", {judged.verdict}"
            canvas = draw_overlay(result, self._annotators, _TILE_WIDTH)
            self._tiles.append(_picture(f"frame {self._seen}{verdict}", canvas))
        self._seen += 1

    def illustrations(self) -> Illustrations:
        """Return what was drawn."""
        return Illustrations(
            tiles=tuple(self._tiles),
            worst=tuple(_close_up(judged) for judged in self._worst.in_order()),
            j=tuple(self._j),
        )


@dataclass(frozen=True)
class _Judged:
    """A result beside its truth."""

    frame: int
    j: float
    result: SegmentationResult
    truth: Labels

    @property
    def verdict(self) -> str:
        """What to say of it."""
        if self.truth.any():
            return f"J {self.j:.2f}"
        return "nothing there, false alarm" if self.result.labels.any() else "nothing there"


class _WorstResults:
    """Keeps the few results with the least J, no two of them closer than `separation` frames."""

    def __init__(self, count: int, separation: int) -> None:
        self._count = count
        self._separation = separation
        self._kept: list[_Judged] = []

    def add(self, judged: _Judged) -> None:
        if judged.j >= 1.0:
            return
        near = [kept for kept in self._kept if judged.frame - kept.frame < self._separation]
        if any(kept.j <= judged.j for kept in near):
            return
        apart = [kept for kept in self._kept if kept not in near]
        self._kept = sorted([*apart, judged], key=lambda kept: kept.j)[: self._count]

    def in_order(self) -> list[_Judged]:
        return sorted(self._kept, key=lambda kept: kept.frame)


def _close_up(judged: _Judged) -> Picture:
    """Draw what went wrong: the true outlines white, those that were found in colour."""
    rows, columns = _window((judged.result.labels != 0) != (judged.truth != 0))
    scale = _TILE_WIDTH / (columns.stop - columns.start)
    canvas = draw_overlay(
        judged.result,
        (TruthAnnotator(judged.truth), OutlineAnnotator()),
        width=round(judged.truth.shape[1] * scale),
    )
    window = tuple(slice(round(s.start * scale), round(s.stop * scale)) for s in (rows, columns))
    caption = f"frame {judged.frame}, {judged.verdict}"
    return _picture(caption, Canvas(canvas.image[window], scale))


def _window(wrong: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return rows and columns around what is wrong, in the picture and of its proportions."""
    height, width = wrong.shape
    x, y, wrong_width, wrong_height = cv2.boundingRect(wrong.astype(np.uint8))
    needed = (1 + _ROOM) * max(wrong_width / width, wrong_height / height)
    share = min(max(needed, _CLOSEST), 1.0)
    rows = _centred(y + wrong_height // 2, round(height * share), height)
    columns = _centred(x + wrong_width // 2, round(width * share), width)
    return rows, columns


def _centred(centre: int, length: int, limit: int) -> slice:
    start = min(max(centre - length // 2, 0), limit - length)
    return slice(start, start + length)


def _picture(caption: str, canvas: Canvas) -> Picture:
    _, jpeg = cv2.imencode(".jpg", canvas.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    height, width = canvas.image.shape[:2]
    return Picture(caption, jpeg.tobytes(), width, height)
