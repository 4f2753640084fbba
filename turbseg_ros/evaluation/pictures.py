"""What a report shows of one clip: frames from all of it, its worst frames, J over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.evaluation.mistakes import Mistakes, mistakes_in_boxes, mistakes_in_masks
from turbseg_ros.evaluation.truth import Boxes
from turbseg_ros.overlay import (
    WHITE,
    Annotator,
    Canvas,
    Colour,
    OutlineAnnotator,
    draw_overlay,
    evenly_spaced,
)
from turbseg_ros.segmentation.frame import SegmentationResult

_TILES = 6
# As wide as the frame, but within these: enough to enlarge, and a page that can be mailed.
_LEAST_WIDTH, _MOST_WIDTH = 480, 800
_WORST = 3
_JPEG_QUALITY = 85
# Least part of the picture's width that a close-up shows, and room around what went wrong, as a
# fraction of its size.
_CLOSEST = 0.3
_ROOM = 0.4
# Blue, green, red: apart for those too who don't see red and green apart.
MISSED: Colour = (255, 100, 20)
FALSE: Colour = (40, 40, 235)
_OPACITY = 0.5
# OpenCV takes positions as integers with this many fractional bits.
_SHIFT = 4


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

    `j` holds (frame, J) of every frame whose true masks show an object.
    """

    tiles: tuple[Picture, ...]
    worst: tuple[Picture, ...]
    j: tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class MistakeAnnotator:
    """What is missed in blue, what is false in red, and the truth in white."""

    mistakes: Mistakes

    def annotate(self, canvas: Canvas, result: SegmentationResult) -> None:
        """Draw on `canvas`, in place."""
        for mask, colour in ((self.mistakes.missed, MISSED), (self.mistakes.false, FALSE)):
            _tint(canvas, mask, colour)
        contours = [canvas.fixed_point(each.reshape(-1, 2)) for each in self.mistakes.outlines]
        cv2.polylines(canvas.image, contours, True, WHITE, 1, cv2.LINE_AA, _SHIFT)
        for left, top, width, height in self.mistakes.boxes:
            # A box's edges lie between pixels, whose centres are at whole numbers.
            corners = np.array([(left, top), (left + width, top + height)]) - 0.5
            first, last = canvas.fixed_point(corners).tolist()
            cv2.rectangle(canvas.image, first, last, WHITE, 1, cv2.LINE_AA, _SHIFT)


class Illustrator:
    """Draws the results of a clip of so many `frames` while they come."""

    def __init__(self, frames: int, annotators: Sequence[Annotator]) -> None:
        self._wanted = set(evenly_spaced(frames, _TILES))
        self._annotators = annotators
        self._worst = _WorstResults(_WORST, separation=max(frames // (3 * _WORST), 2))
        self._tiles: list[Picture] = []
        self._j: list[tuple[int, float]] = []
        self._seen = 0

    def add(
        self,
        result: SegmentationResult,
        truth: Labels | Boxes | None,
        ignored: Labels | None = None,
    ) -> None:
        """Take the clip's next result and the truth of its frame, where there is one.

        :param ignored: non-zero where truth says nothing, HxW.
        """
        mistakes = None
        if isinstance(truth, tuple):
            mistakes = mistakes_in_boxes(result.labels, truth, ignored)
        elif truth is not None:
            mistakes = mistakes_in_masks(result.labels, truth, ignored)
            if mistakes.outlines:
                self._j.append((self._seen, mistakes.quality))
        if mistakes is not None:
            self._worst.add(_Judged(self._seen, result, mistakes))
        if self._seen in self._wanted:
            verdict = "" if mistakes is None else f", {mistakes.verdict}"
            marks = () if mistakes is None else (MistakeAnnotator(mistakes),)
            canvas = draw_overlay(result, (*marks, *self._annotators), _width(result))
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
    """A result and what is wrong in it."""

    frame: int
    result: SegmentationResult
    mistakes: Mistakes


class _WorstResults:
    """Keeps the few results of least quality, no two of them closer than `separation` frames."""

    def __init__(self, count: int, separation: int) -> None:
        self._count = count
        self._separation = separation
        self._kept: list[_Judged] = []

    def add(self, judged: _Judged) -> None:
        quality = judged.mistakes.quality
        if quality >= 1.0:
            return
        near = [kept for kept in self._kept if judged.frame - kept.frame < self._separation]
        if any(kept.mistakes.quality <= quality for kept in near):
            return
        apart = [kept for kept in self._kept if kept not in near]
        worst = sorted([*apart, judged], key=lambda kept: kept.mistakes.quality)
        self._kept = worst[: self._count]

    def in_order(self) -> list[_Judged]:
        return sorted(self._kept, key=lambda kept: kept.frame)


def _close_up(judged: _Judged) -> Picture:
    """Draw what went wrong, and the outlines of what was found in colour."""
    wrong = judged.mistakes.anywhere
    rows, columns = _window(wrong)
    scale = _width(judged.result) / (columns.stop - columns.start)
    canvas = draw_overlay(
        judged.result,
        (MistakeAnnotator(judged.mistakes), OutlineAnnotator()),
        width=round(wrong.shape[1] * scale),
    )
    window = tuple(slice(round(s.start * scale), round(s.stop * scale)) for s in (rows, columns))
    caption = f"frame {judged.frame}, {judged.mistakes.verdict}"
    return _picture(caption, Canvas(canvas.image[window], scale))


def _tint(canvas: Canvas, mask: Mask, colour: Colour) -> None:
    """Lay a colour over what a mask of the frame, HxW, shows, on the canvas in place."""
    if not mask.any():
        return
    height, width = canvas.image.shape[:2]
    resized = cv2.resize(
        mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST_EXACT
    )
    shown = resized != 0
    blended = (1 - _OPACITY) * canvas.image[shown] + _OPACITY * np.array(colour)
    canvas.image[shown] = np.rint(blended).astype(np.uint8)


def _width(result: SegmentationResult) -> int:
    return min(max(result.frame.image.shape[1], _LEAST_WIDTH), _MOST_WIDTH)


def _window(wrong: Mask) -> tuple[slice, slice]:
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
