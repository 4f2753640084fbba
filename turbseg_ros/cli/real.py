"""Data sets on disk, imported and scored in halves: the table of docs/accuracy.md.

Run by `make real`; not an executable of the installation.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turbseg_ros.cli import evaluate, import_
from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.outputs import check_folder
from turbseg_ros.cli.parsers.import_ import WHOLE_PICTURE
from turbseg_ros.cli.parsers.real import build_parser

_Bag = Mapping[str, Any]

# Turbulence that is put on some clips: rms tilt an axis in pixels, and its seed.
_TILT, _SEED = 3, 23
_HALVES = ("even", "odd")


@dataclass(frozen=True)
class _DataSet:
    """A data set: which paths are its clips, and the options that import one with its truth.

    `frames` is how many of a clip have a truth at most, where not all have.
    """

    clips: str
    truth: Sequence[str] = ()
    frames: int | None = None
    warped: bool = False


_SETS = {
    "far_targets": _DataSet("*.mp4", ("--boxes", "{folder}/boxes.json"), frames=240),
    "sbi": _DataSet("*/"),
    "ucsd": _DataSet("*/"),
    "static_haze": _DataSet("frames/", ("--still", WHOLE_PICTURE)),
    "davis": _DataSet("*/", warped=True),
}


@dataclass(frozen=True)
class _Figure:
    """A column of the table: its title, and what it says of the bags of a half."""

    title: str
    of: Callable[[Sequence[_Bag]], float | None]
    format: str = ".3f"


def _mean(name: str) -> Callable[[Sequence[_Bag]], float | None]:
    def mean(bags: Sequence[_Bag]) -> float | None:
        values = [bag[name] for bag in bags if bag[name] is not None]
        return sum(values) / len(values) if values else None

    return mean


def _without_hit(bags: Sequence[_Bag]) -> float | None:
    hits = [bag["hits"] for bag in bags if bag["hits"] is not None]
    return sum(share == 0 for share in hits) if hits else None


def _false_share(bags: Sequence[_Bag]) -> float:
    return sum(bag["false_object_frames"] for bag in bags) / sum(
        bag["scored_frames"] for bag in bags
    )


def _missed(bags: Sequence[_Bag]) -> float | None:
    found = [each["found"] for bag in bags for each in bag["objects"]]
    return sum(share < 0.1 for share in found) / len(found) if found else None


_FIGURES = (
    _Figure("clips", len, "d"),
    _Figure("hits", _mean("hits")),
    _Figure("IoU 0.5", _mean("hits_50")),
    _Figure("no hit", _without_hit, "d"),
    _Figure("J", _mean("j")),
    _Figure("J obj", _mean("j_object")),
    _Figure("pixel F", _mean("pixel_f")),
    _Figure("missed", _missed),
    _Figure("ids/obj", _mean("ids_per_object"), ".2f"),
    _Figure("false obj", _mean("false_objects")),
    _Figure("false fr", _false_share, ".1%"),
    _Figure("false id", _mean("false_ids"), ".2f"),
)


@executable("real")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status, 1 when a bag couldn't be scored."""
    options = build_parser().parse_args(arguments)
    check_folder(options.out)
    found = {name: _clips(options.data / name, _SETS[name]) for name in options.sets}
    if not any(found.values()):
        raise UsageError(f"{options.data} has none of {', '.join(options.sets)}")
    status = 0
    rows: list[tuple[str, Sequence[_Bag]]] = []
    for name, clips in found.items():
        for number, half in enumerate(_HALVES):
            its = clips[number::2]
            if its:
                scores = options.out / f"{name}_{half}.json"
                status |= _score(options, name, its, scores)
                rows += _rows(f"{name}, {half}", json.loads(scores.read_text()))
    print("", *_table(rows), sep="\n")
    return status


def _clips(folder: Path, data_set: _DataSet) -> list[Path]:
    return sorted(folder.glob(data_set.clips.rstrip("/")))


def _score(options: argparse.Namespace, name: str, clips: Sequence[Path], scores: Path) -> int:
    data_set = _SETS[name]
    bags = [options.out / "bags" / name / clip.stem for clip in clips]
    for clip, bag in zip(clips, bags, strict=True):
        if bag.exists():
            continue
        truth = [word.format(folder=clip.parent) for word in data_set.truth]
        most = min(filter(None, (options.frames, data_set.frames)), default=None)
        limit = [] if most is None else ["--frames", str(most)]
        if import_.main([str(clip), str(bag), *truth, *limit]):
            raise UsageError(f"{clip} could not be imported")
    arguments = [*map(str, bags), "--json", str(scores)]
    if options.workers:
        arguments += ["--workers", str(options.workers)]
    if data_set.warped:
        arguments += ["--tilt-curve", f"0,{_TILT}", "--seed", str(_SEED)]
    return evaluate.main(arguments)


def _rows(name: str, scores: Mapping[str, Any]) -> Iterator[tuple[str, Sequence[_Bag]]]:
    yield name, scores["bags"]
    for row in scores.get("tilt_curve", ()):
        if row["added_tilt_px"]:
            yield f"{name}, {row['added_tilt_px']:g} px added", row["bags"]


def _table(rows: Sequence[tuple[str, Sequence[_Bag]]]) -> Iterator[str]:
    width = max(len(name) for name, _ in rows)
    yield "  ".join(["".ljust(width), *(figure.title.rjust(7) for figure in _FIGURES)])
    for name, bags in rows:
        cells = []
        for figure in _FIGURES:
            value = figure.of(bags)
            text = "-" if value is None else format(value, figure.format)
            cells.append(text.rjust(max(len(figure.title), 7)))
        yield "  ".join([name.ljust(width), *cells])
