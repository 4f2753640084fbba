"""`turbseg_benchmark`: a frame's time, stage by stage and beside baselines, at several sizes."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import os
import platform
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.errors import Interrupted, UsageError, executable, interrupted_after
from turbseg_ros.cli.options import (
    parameters_from,
    with_progress,
)
from turbseg_ros.cli.outputs import check_file
from turbseg_ros.cli.parsers.benchmark import build_parser
from turbseg_ros.cli.replay import ReplayJob
from turbseg_ros.evaluation.baselines import (
    Method,
    TurbsegMethod,
    UnknownBaselineError,
    background_subtractions,
)
from turbseg_ros.evaluation.benchmark import (
    Footprint,
    Timing,
    endless,
    footprint,
    measure,
)
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameter_file import load_parameters
from turbseg_ros.parameters import Parameters
from turbseg_ros.presets import preset_path
from turbseg_ros.segmentation.frame import Frame, segment
from turbseg_ros.simulation.objects import Path as ObjectPath
from turbseg_ros.simulation.objects import SceneObject
from turbseg_ros.simulation.render import render
from turbseg_ros.simulation.scenes import Scene
from turbseg_ros.simulation.turbulence import Turbulence

_METHOD = "turbseg"
_RATE_HZ = 30.0
_SEED = 7
# Frames that are rendered, and then shown forward and backward: so many that objects get through
# the view, for what turns back each second sways.
_CLIP = 120
# Enough for the first frames to be caught up with and for the background's memory to be full.
_WARM_UP = 75
_KINDS = ("sedan", "person", "van", "pickup")
# Pairs of runs, in turn, of replay and of the method alone.
_PAIRS = 5


@executable("turbseg_benchmark")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    parameters = parameters_from(options)
    if options.json is not None:
        check_file(options.json)
    methods = _methods(options.baselines, parameters)
    if options.replay is not None:
        frames = _frames_of(options.replay)
    cases: list[_Case] = []
    ratios: list[float] = []
    status = 0
    try:
        for objects in options.objects:
            clip = _clip(objects)
            for size in options.sizes:
                cases.append(_case(clip, objects, size, methods, parameters, options.frames))
                print("", *_table(cases[-1], options.frames), sep="\n", flush=True)
        if options.replay is not None:
            ratios = _replay_ratios(options.replay, frames, parameters)
            print("", _replay_line(options.replay, ratios), sep="\n")
    except Interrupted as interrupted:
        if not isinstance(interrupted.code, int):
            raise
        status = interrupted.code
        total = len(options.objects) * len(options.sizes)
        partial = interrupted_after(len(cases), total, "cases")
        print(f"turbseg_benchmark: {partial}", file=sys.stderr)
    if options.json is not None and cases:
        report = _report(cases, ratios, options.frames, parameters)
        if status:
            report["partial"] = partial
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    return status


@dataclass(frozen=True)
class _Case:
    """What frames of one size with so many objects took, and needed."""

    objects: int
    timing: Timing
    needs: Footprint


def _case(
    clip: Sequence[npt.NDArray[np.uint8]],
    objects: int,
    size: tuple[int, int],
    methods: Sequence[Method],
    parameters: Parameters,
    frames: int,
) -> _Case:
    """Time `frames` frames of one size, and see what they need."""
    count = _WARM_UP + frames
    title = f"{size[0]}x{size[1]}"
    shown = with_progress(
        itertools.islice(endless(clip, size, _RATE_HZ), count), title, total=count
    )
    timing = measure(methods, shown, _WARM_UP, size)
    needs = footprint(parameters, itertools.islice(endless(clip, size, _RATE_HZ), count))
    return _Case(objects, timing, needs)


def _clip(objects: int) -> list[npt.NDArray[np.uint8]]:
    """Render a street with so many objects."""
    scene = _scene(objects)
    rendering = with_progress(render(scene, _SEED), "rendering", total=scene.frames)
    return [rendered.image for rendered in rendering]


def _frames_of(bag: Path) -> list[Frame]:
    reader = BagReader(bag)
    return list(BagFrames(reader, reader.find_image_topic(None)))


def _replay_ratios(bag: Path, frames: Sequence[Frame], parameters: Parameters) -> list[float]:
    """Return the time that replaying takes over that of the method alone, for runs in turn."""
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for number in with_progress(range(_PAIRS), "replay", total=_PAIRS, unit="pair"):
            job = ReplayJob(str(bag), bag, Path(folder) / str(number), parameters)
            replayed = _seconds(job.run)
            segmenter = motion_segmenter(parameters)
            alone = _seconds(functools.partial(deque, segment(frames, segmenter), maxlen=0))
            segmenter.close()
            ratios.append(replayed / alone)
    return ratios


def _seconds(action: Callable[[], object]) -> float:
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def _replay_line(bag: Path, ratios: Sequence[float]) -> str:
    return (
        f"replay of {bag} over the method alone: {np.median(ratios):.2f} "
        f"(median of {len(ratios)} pairs of runs, {min(ratios):.2f} to {max(ratios):.2f})"
    )


def _methods(baselines: Sequence[str], parameters: Parameters) -> list[Method]:
    """Return the method and its baselines; the paper's with live ids, for no clip ends here."""
    methods: list[Method] = [TurbsegMethod(_METHOD, parameters)]
    for name in baselines:
        if name == "paper":
            paper = load_parameters(preset_path("paper"))
            methods.append(TurbsegMethod(name, paper.replace({"tracking.mode": "kalman"})))
        else:
            try:
                methods += background_subtractions(name)[:1]
            except UnknownBaselineError as error:
                raise UsageError(str(error)) from error
    return methods


def _scene(objects: int) -> Scene:
    """Return a street with so many objects, one behind the other, that come and go."""
    return Scene(
        "benchmark",
        "vehicles and people on a street",
        "town",
        Turbulence.typical(0.7, 864),
        tuple(_object(number, objects) for number in range(objects)),
        width=864,
        height=486,
        frames=_CLIP,
        rate_hz=_RATE_HZ,
    )


def _object(number: int, count: int) -> SceneObject:
    kind = _KINDS[number % len(_KINDS)]
    speed = (1.5 if kind == "person" else 4.0) * (-1) ** number
    x = 864 * (number + 0.5) / count - speed * _CLIP / 2
    y = 290.0 + 90.0 * number / count
    way = ObjectPath(((0, x, y), (_CLIP, x + speed * _CLIP, y)))
    return SceneObject(number + 1, kind, 50.0 if kind == "person" else 90.0, way)


def _table(case: _Case, frames: int) -> Iterator[str]:
    timing, needs = case.timing, case.needs
    width, height = timing.size
    yield (
        f"{width}x{height}, {case.objects} objects, {frames} frames: "
        f"{needs.mebibytes:.0f} MiB, ready after {needs.start_seconds:.1f} s, "
        f"first result {needs.first_result_seconds:.1f} s later"
    )
    head = ("p50 ms", "p95 ms", "p99 ms", "flows", "cpu ms", "flows")
    yield f"{'':16} " + " ".join(f"{title:>8}" for title in head)
    rows = {**timing.frames, "flow": timing.yardstick}
    for name, cost in rows.items():
        flows = cost.p50 / timing.yardstick.p50
        processor_flows = cost.processors / timing.yardstick.processors
        yield (
            f"{name:16} {cost.p50:8.1f} {cost.p95:8.1f} {cost.p99:8.1f} {flows:8.2f} "
            f"{cost.processors:8.1f} {processor_flows:8.2f}"
        )
    yield f"{'stage':16} {'mean ms':>8} {'flows':>26}"
    for name, milliseconds in timing.stages.items():
        yield f"{name:16} {milliseconds:8.2f} {milliseconds / timing.yardstick.p50:26.2f}"


def _report(
    cases: Sequence[_Case], ratios: Sequence[float], frames: int, parameters: Parameters
) -> dict[str, Any]:
    """Return everything that was measured, as JSON has it."""
    return {
        "machine": {
            "cores": len(os.sched_getaffinity(0)),
            "processor": platform.processor() or platform.machine(),
            "python": platform.python_version(),
            "opencv": cv2.__version__,
            "numpy": np.__version__,
        },
        "frames": frames,
        "parameters": parameters.as_mapping(),
        "cases": [
            {
                "objects": case.objects,
                **dataclasses.asdict(case.timing),
                "ratios": {name: case.timing.ratio(name) for name in case.timing.frames},
                "processor_ratios": {
                    name: case.timing.processor_ratio(name) for name in case.timing.frames
                },
                **dataclasses.asdict(case.needs),
            }
            for case in cases
        ],
        "replay_over_method": list(ratios),
    }
