"""`turbseg_train`: clips made, windows taken, Refine-Net trained and exported."""

from __future__ import annotations

import argparse
import copy
import dataclasses
import functools
import json
import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from turbseg_ros.bag.errors import BagError, ClipError
from turbseg_ros.cli.bag_footage import backgrounds_in, objects_in
from turbseg_ros.cli.errors import (
    StopRequest,
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import with_progress
from turbseg_ros.cli.outputs import check_folder, check_new
from turbseg_ros.cli.parsers.train import build_parser
from turbseg_ros.learning.composites import Material, composite_clip
from turbseg_ros.learning.examples import Examples, examples_from, rendered_clip
from turbseg_ros.learning.shown_clips import WIDEST, shown_clip, varied_clip
from turbseg_ros.learning.torch_import import require_torch
from turbseg_ros.parameters import Parameters
from turbseg_ros.worker_pool import WorkerPool

if TYPE_CHECKING:
    from turbseg_ros.learning.refine_net import RefineNet
    from turbseg_ros.learning.training import HeldOut

# Every so many drawn scenes, one is held out from training.
_HELD_OUT = 10
_REPORTS = 20
# Windows that tell the mean and variance of what a network makes of them.
_TYPICAL = 128
# Windows of held-out footage, and of clips that show footage, are taken from every so many frames.
_HELD_OUT_STEP, _SHOWN_STEP = 4, 2
_BY_RULES = Parameters().replace({"refine.mode": "none"})


@dataclass(frozen=True)
class Lessons:
    """Windows to train on, and those that show how training goes.

    `shown` are of clips that show footage, to train on as well; `held_out` are of drawn scenes,
    `footage` of what --held-out names.
    """

    trained_on: Examples
    shown: Examples
    held_out: Examples
    footage: Examples


@dataclass(frozen=True)
class _Task:
    """A clip to be made: its kind ("scene", "composite", "shown", "footage"), and which."""

    kind: str
    number: int
    held_out: bool

    @property
    def file_name(self) -> str:
        return f"{self.kind}_{self.number:06}{'_held_out' if self.held_out else ''}.npz"


@dataclass(frozen=True)
class _Workshop:
    """What the making of clips needs; it can be sent to another process.

    `network` draws the outlines in clips that show footage; by rules if None.
    """

    frames: int
    every: int
    material: Material
    held_out: Material
    windows: Path | None
    network: Path | None

    def windows_of(self, task: _Task) -> Examples:
        """Return a clip's windows: those of an earlier run, or else of the clip made now.

        :raises ValueError: when an earlier run's file holds none.
        """
        if self.windows is None:
            return self._made(task)
        path = self.windows / task.file_name
        if path.exists():
            return Examples.load(path)
        made = self._made(task)
        made.save(path)
        return made

    def _made(self, task: _Task) -> Examples:
        cv2.setNumThreads(1)
        if task.kind == "footage":
            footage = self.held_out.objects[task.number]
            return examples_from(shown_clip(footage), _BY_RULES, _HELD_OUT_STEP)
        if task.kind == "shown":
            return self._shown(task.number)
        if task.kind == "composite":
            clip = composite_clip(task.number, self.frames, self.material)
            return examples_from(clip, _BY_RULES, self.every, ruled=False)
        scene = rendered_clip(task.number, self.frames)
        if task.held_out:
            return examples_from(scene, _BY_RULES)
        return examples_from(scene, _BY_RULES, self.every, ruled=False)

    def _shown(self, number: int) -> Examples:
        """Return the windows of a footage as it is, or in the rounds after the first as varied."""
        objects, parameters = self.material.objects, _BY_RULES
        if self.network is not None:
            parameters = Parameters().replace({"refine.weights": str(self.network)})
        footage = objects[number % len(objects)]
        clip = (
            shown_clip(footage, WIDEST) if number < len(objects) else varied_clip(number, footage)
        )
        return examples_from(clip, parameters, _SHOWN_STEP, ruled=False)


@executable("turbseg_train")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    require_torch("turbseg_train")
    check_new(options.out)
    if options.scenes < 2:
        raise UsageError(f"--scenes {options.scenes}: give 2 or more, for some are held out")
    if options.keep and options.start is None:
        raise UsageError("--keep is a share of the network that --start names; give one")
    if options.windows is not None:
        check_folder(options.windows)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    with (
        stopping_at_signals("turbseg_train") as stop,
        tempfile.TemporaryDirectory(dir=options.out.parent) as scratch,
    ):
        lessons = gathered(options, Path(scratch), stop)
        written = Path(scratch) / "weights"
        written.mkdir()
        record = {"command": _command(options), **_train(options, lessons, written, stop)}
        (written / "training.json").write_text(json.dumps(record, indent=1) + "\n")
        written.rename(options.out)
    if stop.cut:
        print(f"turbseg_train: {options.out} is partial: {record['partial']}", file=sys.stderr)
    return stop.status


def gathered(options: argparse.Namespace, scratch: Path, stop: StopRequest) -> Lessons:
    """Make clips and take their windows.

    :raises Interrupted: when it is stopped: what would come of a part is another training.
    :raises UsageError: when a folder doesn't hold what it should, or nothing moved.
    """
    workshop = _workshop(options, scratch)
    scenes = range(options.first_scene, options.first_scene + options.scenes)
    drawn = [_Task("scene", each, place % _HELD_OUT == 0) for place, each in enumerate(scenes)]
    first = options.first_composite
    has_footage = workshop.material.backgrounds or workshop.material.objects
    composites = range(first, first + options.composites if has_footage else first)
    tasks = [*drawn, *(_Task("composite", each, False) for each in composites)]
    rounds = options.shown * len(workshop.material.objects)
    shown = [_Task("shown", each, False) for each in range(rounds)]
    held_out = [task for task in tasks if task.held_out]
    footage = [_Task("footage", each, True) for each in range(len(workshop.held_out.objects))]
    with WorkerPool(options.workers) as pool:
        take = functools.partial(_windows, pool, workshop, stop)
        parts: dict[str, Iterable[Examples]] = {
            "trained_on": take([task for task in tasks if not task.held_out], "making clips"),
            "shown": take(shown, "showing footage"),
            "held_out": take(held_out, "clips held out"),
            "footage": take(footage, "footage held out"),
        }
        lessons = Lessons(**{name: _stored(each, scratch / name) for name, each in parts.items()})
    if not (len(lessons.trained_on) and len(lessons.held_out)):
        raise UsageError(f"nothing moved in {len(tasks)} clips; make more, or longer ones")
    return lessons


def _workshop(options: argparse.Namespace, scratch: Path) -> _Workshop:
    from turbseg_ros.learning.export import read_weights, write_onnx

    material = Material(backgrounds_in(options.backgrounds), objects_in(options.objects))
    held_out = Material([], objects_in(options.held_out))
    network = None
    if options.shown and options.start is not None:
        network = scratch / "start.onnx"
        write_onnx(read_weights(options.start), network)
    return _Workshop(options.frames, options.every, material, held_out, options.windows, network)


def _stored(parts: Iterable[Examples], folder: Path) -> Examples:
    folder.mkdir()
    return Examples.on_disk(parts, folder)


def _windows(
    pool: WorkerPool, workshop: _Workshop, stop: StopRequest, tasks: Sequence[_Task], title: str
) -> Iterator[Examples]:
    """Return the windows of each clip, in order."""
    taken = pool.run(workshop.windows_of, tasks)
    for task, future in zip(
        tasks, with_progress(taken, title, unit="clip", total=len(tasks)), strict=True
    ):
        stop.check()
        try:
            yield future.result()
        except BrokenProcessPool as error:
            reason = f"{task.kind} {task.number}: the process that made it died"
            raise UsageError(f"{reason}; fewer --workers take less memory") from error
        except (BagError, ClipError, ValueError) as error:
            raise UsageError(str(error)) from error


def _train(
    options: argparse.Namespace, lessons: Lessons, folder: Path, stop: StopRequest
) -> dict[str, Any]:
    """Train until stopped, show how it goes, and write the network; return the record of it."""
    from turbseg_ros.learning.export import write_onnx, write_weights
    from turbseg_ros.learning.training import blended, train

    start = _start(options, lessons) if options.start else None
    every = max(options.steps // _REPORTS, 1)
    curve: list[dict[str, float]] = []
    reports = train(
        lessons.trained_on,
        options.seed,
        options.steps,
        report_every=every,
        # Training changes it.
        start=copy.deepcopy(start),
        shown=lessons.shown,
    )
    for number, (loss, net) in enumerate(reports, start=1):
        scores = _scores(net, lessons)
        step = min(number * every, options.steps)
        points = {f"{name}_j": round(each.j, 4) for name, each in scores.items()}
        curve.append({"step": step, "loss": round(loss, 4), **points})
        print(f"step {step:5}  loss {loss:.3f}  {_told(scores)}", flush=True)
        if stop.received and step < options.steps:
            stop.cut = True
            break
    if start is not None and options.keep:
        net = blended(start, net, options.keep)
        scores = _scores(net, lessons)
        print(f"with a share of {options.keep:g} kept  {_told(scores)}", flush=True)
    partial = {"partial": interrupted_after(step, options.steps, "steps")} if stop.cut else {}
    write_onnx(net, folder / "refine_net.onnx")
    write_weights(net, folder / "refine_net.safetensors")
    return {
        "windows": len(lessons.trained_on),
        "windows_of_shown_footage": len(lessons.shown),
        **{name: dataclasses.asdict(each) for name, each in scores.items()},
        "curve": curve,
        **partial,
    }


def _start(options: argparse.Namespace, lessons: Lessons) -> RefineNet:
    """Return the network to go on with, with a level more where it has one less than are trained.

    What the new level begins with is drawn by the seed.
    """
    import torch

    from turbseg_ros.learning.export import read_weights
    from turbseg_ros.learning.refine_net import WIDTHS, deepened

    net = read_weights(options.start)
    if len(net.widths) == len(WIDTHS) - 1:
        windows = lessons.trained_on.inputs
        typical = windows[:: max(len(windows) // _TYPICAL, 1)]
        maps = torch.from_numpy(typical.astype(np.float32))
        torch.manual_seed(options.seed)
        net = deepened(net, WIDTHS[-1], maps)
    return net


def _scores(net: RefineNet, lessons: Lessons) -> dict[str, HeldOut]:
    """Score a network on what it doesn't learn from, by the names that the record has."""
    from turbseg_ros.learning.training import held_out_scores

    kinds = {"held_out": lessons.held_out, "footage": lessons.footage}
    return {name: held_out_scores(net, each) for name, each in kinds.items() if len(each)}


def _told(scores: Mapping[str, HeldOut]) -> str:
    return "; ".join(
        f"{name.replace('_', '-')} J {each.j:.3f}, by rules {each.j_ruled:.3f}"
        f"  alarms {each.alarms:.2f}, by rules {each.alarms_ruled:.2f}"
        for name, each in scores.items()
    )


def _command(options: argparse.Namespace) -> str:
    """Return the command line, with the names of folders and files but not where they lie."""
    names = ["first_scene", "scenes", "frames", "every", "steps", "seed"]
    if options.keep:
        names += ["keep"]
    if options.backgrounds or options.objects:
        names += ["first_composite", "composites"]
    if options.shown:
        names += ["shown"]
    said = ["turbseg_train"]
    for name in names:
        said += [_option(name), str(getattr(options, name))]
    for name in ["backgrounds", "objects", "held_out", "start"]:
        if (path := getattr(options, name)) is not None:
            said += [_option(name), path.name]
    return shlex.join([*said, "-o", "OUT"])


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
