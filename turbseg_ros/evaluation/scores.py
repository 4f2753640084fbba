"""Scores of a bag: from frames to a bag, from bags to a table and a JSON file."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from turbseg_ros.evaluation.boxes import box_overlaps
from turbseg_ros.evaluation.metrics import (
    MATCH_IOU,
    FalseIdCounter,
    FoundCounter,
    IdSwitchCounter,
    Labels,
    ObjectJaccard,
    ObjectOverlaps,
    PixelCounter,
    boundary_f,
    dice,
    false_ids,
    foreground_fraction,
    jaccard,
    object_overlaps,
    true_components,
)
from turbseg_ros.evaluation.reliability import ScoreBin
from turbseg_ros.evaluation.tracking import TrackingScorer
from turbseg_ros.messages.detections import Detection

# A true box may be drawn loosely: what overlaps it at all is taken for it.
_TOUCHING = 1e-9
# IoU from which on a box counts as found well.
_WELL = 0.5
# Between the columns of a table.
_GAP = "  "


@dataclass(frozen=True)
class ObjectScores:
    """What a true object's segmentation is worth; None where truth is boxes, or a union.

    `found` is the share of its `frames` in which it was found: touched where truth is a box, at an
    IoU of `MATCH_IOU` or more where it is a mask. `j` and `dice` are means over its frames.
    """

    id: int | str
    frames: int
    found: float
    j: float | None
    dice: float | None


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
    when the truth doesn't tell objects apart.

    `hits` and `hits_50` are the shares of true boxes, frame by frame, that the box of some object
    overlaps, at all and by an IoU of 0.5; `box_iou` is the mean of the best IoU: None without
    boxes. `false_object_frames` counts frames with false objects, `false_ids` ids that were false
    whenever they were there, `ids_per_object` how many ids a true object had, where it was found.
    `missed` is the share of true objects found in less than a tenth of their frames; a union
    counts as one. `mota`, `idf1` and `hota` are those of the MOTChallenge, over masks or boxes.
    `pixel_f` is the F measure of all frames' pixels together, as in CDnet. `objects` has each true
    object. `fps`, `ms_p50` and `ms_p95` are of the segmentation
    alone, `tilt_px` is the median of the measured turbulence. `score_bins` tell how often objects
    were true by their score; empty where none was given.
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
    pixel_f: float | None
    hits: float | None
    hits_50: float | None
    box_iou: float | None
    false_object_frames: int
    false_ids: int | None
    ids_per_object: float | None
    missed: float | None
    mota: float | None
    idf1: float | None
    hota: float | None
    objects: tuple[ObjectScores, ...]
    fps: float | None
    ms_p50: float | None
    ms_p95: float | None
    tilt_px: float | None
    score_bins: tuple[ScoreBin, ...] = ()

    def without_times(self) -> BagScores:
        """Return the scores of something that did its work before."""
        return dataclasses.replace(self, fps=None, ms_p50=None, ms_p95=None)

    def without_ids(self) -> BagScores:
        """Return the scores of something that doesn't claim to follow objects."""
        return dataclasses.replace(
            self,
            j_object=None,
            id_switches=None,
            false_ids=None,
            ids_per_object=None,
            mota=None,
            idf1=None,
            hota=None,
            objects=tuple(dataclasses.replace(each, j=None, dice=None) for each in self.objects),
            score_bins=(),
        )


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
    """Scores the frames of one sequence, in order, against labels or against boxes."""

    def __init__(self) -> None:
        self._j: list[float] = []
        self._dice: list[float] = []
        self._boundary_f: list[float] = []
        self._best_box_iou: list[float] = []
        self._false_alarm_areas: list[float] = []
        self._false_objects: list[int] = []
        self._frames = 0
        self._pixels = PixelCounter()
        self._found = FoundCounter()
        self._false_ids = FalseIdCounter()
        self._object_jaccard = ObjectJaccard()
        self._id_switches = IdSwitchCounter()
        self._tracking: TrackingScorer | None = TrackingScorer()

    def add(self, prediction: Labels, truth: Labels, ignored: Labels | None = None) -> None:
        """Score the next frame against labels.

        :param ignored: non-zero where pixels count neither as right nor as wrong; a frame in
            which none counts is left out.
        :raises ValueError: when the images differ in size.
        """
        for image in (truth, ignored):
            if image is not None and prediction.shape != image.shape:
                raise ValueError(
                    f"truth of {_size(image)} doesn't fit labels of {_size(prediction)} pixels"
                )
        if ignored is not None:
            if ignored.all():
                return
            prediction, truth = (np.where(ignored, 0, each) for each in (prediction, truth))
        overlaps = object_overlaps(prediction, truth)
        j = jaccard(prediction, truth)
        self._object_jaccard.add(overlaps)
        if overlaps.tells_objects_apart:
            best = overlaps.iou.max(axis=1, initial=0.0)
            self._found.add(overlaps.true_ids, (best >= MATCH_IOU).tolist())
        else:
            self._found.add(overlaps.true_ids, [j >= MATCH_IOU])
            self._tracking = None
        self._id_switches.add(overlaps)
        if self._tracking is not None:
            self._tracking.add(overlaps.true_ids, overlaps.predicted_ids, overlaps.iou)
        if not overlaps.tells_objects_apart:
            overlaps = object_overlaps(prediction, true_components(truth))
        self._add_false(overlaps, false_ids(overlaps))
        self._pixels.add(prediction, truth)
        if truth.any():
            self._j.append(j)
            self._dice.append(dice(prediction, truth))
            self._boundary_f.append(boundary_f(prediction, truth))
        else:
            self._false_alarm_areas.append(foreground_fraction(prediction))

    def add_boxes(
        self, prediction: Labels, truth: Sequence[Detection], ignored: Labels | None = None
    ) -> None:
        """Score the next frame against boxes.

        :param ignored: non-zero where objects that are found beside the boxes are not false.
        :raises ValueError: when the images differ in size.
        """
        if not self._frames:
            self._id_switches = IdSwitchCounter(_TOUCHING)
        overlaps = box_overlaps(prediction, truth, ignored)
        best = overlaps.iou.max(axis=1, initial=0.0)
        self._best_box_iou += best.tolist()
        self._found.add(overlaps.true_ids, (best > 0.0).tolist())
        self._id_switches.add(overlaps)
        if self._tracking is not None:
            self._tracking.add(overlaps.true_ids, overlaps.predicted_ids, overlaps.iou)
        touched = overlaps.shared.sum(axis=0).tolist()
        false = [i for i, area in zip(overlaps.predicted_ids, touched, strict=True) if not area]
        self._add_false(overlaps, false)
        if not overlaps.true_ids:
            alarms = np.isin(prediction, overlaps.predicted_ids)
            self._false_alarm_areas.append(foreground_fraction(alarms))

    def _add_false(self, overlaps: ObjectOverlaps, false: Sequence[int]) -> None:
        self._frames += 1
        self._false_objects.append(len(false))
        self._false_ids.add(overlaps.predicted_ids, false)

    def scores(self, bag: str, frames: int, measurements: Measurements) -> BagScores:
        """Sum up what was scored of a bag with so many `frames`."""
        j, dice_ = _mean(self._j), _mean(self._dice)
        boxes = np.array(self._best_box_iou)
        tracking = None if self._tracking is None else self._tracking.scores()
        return BagScores(
            bag=bag,
            frames=frames,
            scored_frames=self._frames,
            j=j,
            dice=dice_,
            g=None if j is None or dice_ is None else (j + dice_) / 2,
            boundary_f=_mean(self._boundary_f),
            j_object=self._object_jaccard.mean,
            false_alarm_frames=int(np.count_nonzero(self._false_alarm_areas)),
            false_alarm_area=_mean(self._false_alarm_areas),
            false_objects=_mean(self._false_objects),
            id_switches=self._id_switches.switches,
            pixel_f=self._pixels.f_measure,
            hits=_mean(boxes > 0.0),
            hits_50=_mean(boxes >= _WELL),
            box_iou=_mean(boxes),
            false_object_frames=int(np.count_nonzero(self._false_objects)),
            false_ids=self._false_ids.count,
            ids_per_object=self._id_switches.ids_per_object,
            missed=self._found.missed,
            mota=None if tracking is None else tracking.mota,
            idf1=None if tracking is None else tracking.idf1,
            hota=None if tracking is None else tracking.hota,
            objects=self._objects(),
            fps=measurements.fps,
            ms_p50=measurements.push_milliseconds(50),
            ms_p95=measurements.push_milliseconds(95),
            tilt_px=measurements.median_tilt,
        )

    def _objects(self) -> tuple[ObjectScores, ...]:
        j = self._object_jaccard.by_object or {}
        dice_ = self._object_jaccard.dice_by_object or {}
        return tuple(
            ObjectScores(each, frames, self._found.share(each), j.get(each), dice_.get(each))
            for each, frames in self._found.frames.items()
        )


def mean_scores(bags: Sequence[BagScores]) -> dict[str, float | None]:
    """Return each figure's mean over the bags that have it.

    `miou` and `mdice` are means over all true objects of all bags, each with the same weight.
    """
    names = [
        figure.name
        for figure in dataclasses.fields(BagScores)
        if figure.name not in ("bag", "objects", "score_bins")
    ]
    means = {
        name: _mean([value for bag in bags if (value := getattr(bag, name)) is not None])
        for name in names
    }
    objects = [each for bag in bags for each in bag.objects]
    means["miou"] = _mean([each.j for each in objects if each.j is not None])
    means["mdice"] = _mean([each.dice for each in objects if each.dice is not None])
    return means


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
    Column("area", "false_alarm_area", ".3%", "share of the image found where nothing moves"),
    Column("false obj", "false_objects", ".2f", "false positives a frame"),
    Column("id sw", "id_switches", ".4g", "times that a true object changed its id"),
    Column("fps", "fps", ".1f", "frames a second of segmentation; runs share the cores"),
    Column("ms p50", "ms_p50", ".1f", "median time that a frame took, milliseconds"),
    Column("ms p95", "ms_p95", ".1f", "time that one frame in twenty exceeded, milliseconds"),
    Column("tilt", "tilt_px", ".2f", "turbulence as it was measured: rms tilt an axis, pixels"),
)

OBJECT_COLUMNS = (
    Column("hits", "hits", ".3f", "share of true boxes that something found overlaps"),
    Column("IoU 0.5", "hits_50", ".3f", "share of true boxes found with an IoU of 0.5 or more"),
    Column("box IoU", "box_iou", ".3f", "IoU of true boxes with the best that was found"),
    Column("false obj", "false_objects", ".2f", "false positives a frame"),
    Column("false fr", "false_object_frames", ".4g", "frames with false positives"),
    Column("false id", "false_ids", ".4g", "ids of false positives"),
    Column("ids/obj", "ids_per_object", ".2f", "ids that a true object had, where it was found"),
    Column("id sw", "id_switches", ".4g", "times that a true object changed its id"),
    Column("missed", "missed", ".2f", "share of true objects found in under a tenth of theirs"),
    Column("MOTA", "mota", ".3f", "of the MOTChallenge, at an IoU of 0.5"),
    Column("IDF1", "idf1", ".3f", "of the MOTChallenge, at an IoU of 0.5"),
    Column("HOTA", "hota", ".3f", "of the MOTChallenge, mean over IoU 0.05 to 0.95"),
    Column("pixel F", "pixel_f", ".3f", "F measure of all pixels together, as in CDnet"),
)
"""What a second table tells of objects: boxes, false ones, ids."""


def short_names(bags: Sequence[str]) -> dict[str, str]:
    """Return each bag's name without the folders that all of them are in."""
    parts = [Path(bag).parts for bag in bags]
    shared = 0
    while all(len(each) > shared + 1 for each in parts) and len({p[shared] for p in parts}) == 1:
        shared += 1
    return {bag: str(Path(*each[shared:])) for bag, each in zip(bags, parts, strict=True)}


@dataclass(frozen=True)
class Table:
    """A plain-text table of scores that can be printed line by line.

    `title` heads its first column, which is `name_width` characters wide; longer names lose their
    middle. `short` has names that stand for others.
    """

    title: str
    name_width: int
    columns: Sequence[Column] = COLUMNS
    short: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, names: Sequence[str], title: str = "bag", columns: Sequence[Column] = COLUMNS
    ) -> Table:
        """Lay out a table for whatever `title` says, of these names."""
        return cls(title, max(map(len, (*names, title, "mean"))), columns)

    @classmethod
    def of_bags(cls, names: Sequence[str], columns: Sequence[Column] = COLUMNS) -> Table:
        """Lay out a table for bags of these names, without the folders that they share."""
        short = short_names(names)
        return replace(cls.of(list(short.values()), columns=columns), short=short)

    def fitted(self, width: int | None = None) -> list[Table]:
        """Return tables of the same rows that share its columns out, as `width` has room for them.

        There are as few as can be, as wide as one another. Without a width, it is the terminal's.
        """
        width = width or shutil.get_terminal_size().columns
        named = replace(self, name_width=min(self.name_width, max(width // 2, 8)))
        fewest = len(named._parts(width))
        least = next(w for w in range(width + 1) if len(named._parts(w)) <= fewest)
        return [replace(named, columns=part) for part in named._parts(least)]

    @property
    def head(self) -> str:
        """The line of titles."""
        return self._line(self.title, [column.title for column in self.columns])

    def row(self, scores: BagScores) -> str:
        """Return the line of one bag."""
        name = self.short.get(scores.bag, scores.bag)
        return self._row(name, dataclasses.asdict(scores))

    def mean(self, bags: Sequence[BagScores], name: str = "mean") -> str:
        """Return the line of the means over bags."""
        return self._row(name, mean_scores(bags))

    def _parts(self, width: int) -> list[list[Column]]:
        parts: list[list[Column]] = []
        left = 0
        for column in self.columns:
            needed = column.width + len(_GAP)
            if not parts or left < needed:
                parts.append([])
                left = width - self.name_width
            parts[-1].append(column)
            left -= needed
        return parts

    def _row(self, name: str, figures: Mapping[str, Any]) -> str:
        return self._line(name, [column.text(figures) for column in self.columns])

    def _line(self, name: str, cells: Sequence[str]) -> str:
        if len(name) > self.name_width:
            half = (self.name_width - 1) // 2
            name = f"{name[: self.name_width - 1 - half]}…{name[len(name) - half :]}"
        padded = (
            cell.rjust(column.width) for cell, column in zip(cells, self.columns, strict=True)
        )
        return _GAP.join((name.ljust(self.name_width), *padded))


def _mean(values: Sequence[float] | npt.NDArray[Any]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _size(labels: Labels) -> str:
    return f"{labels.shape[1]}x{labels.shape[0]}"
