"""Scores of a bag: from frames to a bag, from bags to a table and a JSON file."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from turbseg_ros.evaluation.metrics import (
    IdSwitchCounter,
    Labels,
    ObjectJaccard,
    boundary_f,
    count_false_objects,
    dice,
    foreground_fraction,
    jaccard,
    object_overlaps,
    true_components,
)


@dataclass(frozen=True)
class BagScores:
    """What the segmentation of one bag is worth; None where there is nothing to tell it from.

    `j`, `dice`, `g` (the mean of the two) and `boundary_f` are of the union of all objects, means
    over the frames whose truth has an object. `j_object` is the mean J of the true objects, each
    held against the one predicted id that stands for it in the whole bag, over the frames in which
    it exists; see `ObjectJaccard`. `false_alarm_frames` counts those frames without any true
    object in which something was found, `false_alarm_area` is the mean share of the image found in
    all such frames. `false_objects` is the mean number, over all frames with a truth, of objects
    found where there is none; see `count_false_objects`. `j_object` and `id_switches` are None
    when the truth doesn't tell objects apart. `fps`, `ms_p50` and `ms_p95` are of the segmentation
    alone, `tilt_px` is the median of the measured turbulence.
    """

    bag: str
    frames: int
    scored_frames: int
    j: float | None
    dice: float | None
    g: float | None
    boundary_f: float | None
    j_object: float | None
    false_alarm_frames: int
    false_alarm_area: float | None
    false_objects: float | None
    id_switches: int | None
    fps: float | None
    ms_p50: float | None
    ms_p95: float | None
    tilt_px: float | None

    def without_ids(self) -> BagScores:
        """Return the scores of something that doesn't claim to follow objects."""
        return dataclasses.replace(self, j_object=None, id_switches=None)


@dataclass
class Measurements:
    """What a segmenter showed of itself at work: seconds a push and a flush took, tilts in pixels.

    A tilt is NaN where it was unknown. Empty for labels whose making wasn't seen.
    """

    push_seconds: list[float] = field(default_factory=list)
    flush_seconds: float = 0.0
    tilts: list[float] = field(default_factory=list)

    @property
    def fps(self) -> float | None:
        """Frames a second of pure segmentation."""
        seconds = sum(self.push_seconds) + self.flush_seconds
        return len(self.push_seconds) / seconds if self.push_seconds else None

    @property
    def median_tilt(self) -> float | None:
        """Median of the known tilts, in pixels."""
        known = [tilt for tilt in self.tilts if math.isfinite(tilt)]
        return float(np.median(known)) if known else None

    def push_milliseconds(self, percentile: float) -> float | None:
        """Return a percentile of the time that a push took."""
        if not self.push_seconds:
            return None
        return 1e3 * float(np.percentile(self.push_seconds, percentile))


class Scorer:
    """Scores the frames of one sequence, in order."""

    def __init__(self) -> None:
        self._j: list[float] = []
        self._dice: list[float] = []
        self._boundary_f: list[float] = []
        self._false_alarm_areas: list[float] = []
        self._false_objects: list[int] = []
        self._object_jaccard = ObjectJaccard()
        self._id_switches = IdSwitchCounter()

    def add(self, prediction: Labels, truth: Labels) -> None:
        """Score the next frame.

        :raises ValueError: when prediction and truth differ in size.
        """
        if prediction.shape != truth.shape:
            raise ValueError(
                f"truth of {_size(truth)} doesn't fit labels of {_size(prediction)} pixels"
            )
        overlaps = object_overlaps(prediction, truth)
        self._id_switches.add(overlaps)
        self._object_jaccard.add(overlaps)
        if not overlaps.tells_objects_apart:
            overlaps = object_overlaps(prediction, true_components(truth))
        self._false_objects.append(count_false_objects(overlaps))
        if truth.any():
            self._j.append(jaccard(prediction, truth))
            self._dice.append(dice(prediction, truth))
            self._boundary_f.append(boundary_f(prediction, truth))
        else:
            self._false_alarm_areas.append(foreground_fraction(prediction))

    def scores(self, bag: str, frames: int, measurements: Measurements) -> BagScores:
        """Sum up what was scored of a bag with so many `frames`."""
        j, dice_ = _mean(self._j), _mean(self._dice)
        return BagScores(
            bag=bag,
            frames=frames,
            scored_frames=len(self._j) + len(self._false_alarm_areas),
            j=j,
            dice=dice_,
            g=None if j is None or dice_ is None else (j + dice_) / 2,
            boundary_f=_mean(self._boundary_f),
            j_object=self._object_jaccard.mean,
            false_alarm_frames=int(np.count_nonzero(self._false_alarm_areas)),
            false_alarm_area=_mean(self._false_alarm_areas),
            false_objects=_mean(self._false_objects),
            id_switches=self._id_switches.switches,
            fps=measurements.fps,
            ms_p50=measurements.push_milliseconds(50),
            ms_p95=measurements.push_milliseconds(95),
            tilt_px=measurements.median_tilt,
        )


def mean_scores(bags: Sequence[BagScores]) -> dict[str, float | None]:
    """Return each figure's mean over the bags that have it."""
    names = [figure.name for figure in dataclasses.fields(BagScores) if figure.name != "bag"]
    return {
        name: _mean([value for bag in bags if (value := getattr(bag, name)) is not None])
        for name in names
    }


def write_json(
    path: Path,
    bags: Sequence[BagScores],
    parameters: Mapping[str, bool | int | float | str],
    experiments: Mapping[str, object] | None = None,
) -> None:
    """Write the scores of bags, their means and the parameters they were reached with.

    `experiments` are what else there is to tell, each under its own key.

    :raises OSError: when the file can't be written; an older one then stays as it was.
    """
    content = {
        "bags": [dataclasses.asdict(bag) for bag in bags],
        "mean": mean_scores(bags),
        "parameters": dict(parameters),
        **(experiments or {}),
    }
    write_whole(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_whole(path: Path, text: str) -> None:
    """Write a text under its name when it is complete.

    :raises OSError: when the file can't be written; an older one then stays as it was.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@dataclass(frozen=True)
class Column:
    """A figure in tables for people: its title, its name in `BagScores` and what it means."""

    title: str
    name: str
    format: str
    meaning: str

    @property
    def width(self) -> int:
        """Characters that the title and usual values take."""
        return max(len(self.title), 6)

    def text(self, figures: Mapping[str, Any]) -> str:
        """Return the figure as it is printed, a dash when there is none."""
        value = figures[self.name]
        return "-" if value is None else format(value, self.format)


COLUMNS = (
    Column("frames", "frames", ".0f", "frames that were segmented"),
    Column("scored", "scored_frames", ".0f", "frames that have a truth"),
    Column("J", "j", ".3f", "intersection over union of what was found and the truth"),
    Column("Dice", "dice", ".3f", "twice the intersection over the sum of both areas"),
    Column("G", "g", ".3f", "mean of J and Dice"),
    Column("bound F", "boundary_f", ".3f", "F measure of the outlines, as in the DAVIS benchmark"),
    Column("J obj", "j_object", ".3f", "mean J of the true objects, each beside its best label"),
    Column(
        "alarms",
        "false_alarm_frames",
        ".4g",
        "frames without any true object in which something was found",
    ),
    Column(
        "alarm area", "false_alarm_area", ".3%", "share of the image found where nothing moves"
    ),
    Column("false obj", "false_objects", ".2f", "objects a frame that were found in vain"),
    Column("id sw", "id_switches", ".4g", "times that a true object changed its id"),
    Column("fps", "fps", ".1f", "frames a second of segmentation; runs share the cores"),
    Column("ms p50", "ms_p50", ".1f", "median time that a frame took, milliseconds"),
    Column("ms p95", "ms_p95", ".1f", "time that one frame in twenty exceeded, milliseconds"),
    Column("tilt px", "tilt_px", ".2f", "turbulence as it was measured: rms tilt an axis, pixels"),
)


@dataclass(frozen=True)
class Table:
    """A plain-text table of scores that can be printed line by line.

    `title` heads its first column, which is `name_width` characters wide.
    """

    title: str
    name_width: int

    @classmethod
    def of(cls, names: Sequence[str], title: str = "bag") -> Table:
        """Lay out a table for bags, or whatever `title` says, of these names."""
        return cls(title, max(map(len, (*names, title, "mean"))))

    @property
    def head(self) -> str:
        """The line of titles."""
        return self._line(self.title, [column.title for column in COLUMNS])

    def row(self, scores: BagScores) -> str:
        """Return the line of one bag."""
        return self._row(scores.bag, dataclasses.asdict(scores))

    def mean(self, bags: Sequence[BagScores], name: str = "mean") -> str:
        """Return the line of the means over bags."""
        return self._row(name, mean_scores(bags))

    def _row(self, name: str, figures: Mapping[str, Any]) -> str:
        return self._line(name, [column.text(figures) for column in COLUMNS])

    def _line(self, name: str, cells: Sequence[str]) -> str:
        padded = (cell.rjust(column.width) for cell, column in zip(cells, COLUMNS, strict=True))
        return "  ".join((name.ljust(self.name_width), *padded))


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _size(labels: Labels) -> str:
    return f"{labels.shape[1]}x{labels.shape[0]}"
