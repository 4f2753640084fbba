"""`turbseg_train`: scenes rendered, windows taken, Refine-Net trained and exported."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import cv2

from turbseg_ros.cli.errors import (
    StopRequest,
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import with_progress
from turbseg_ros.cli.outputs import check_new
from turbseg_ros.cli.parsers.train import build_parser
from turbseg_ros.learning.examples import Examples, examples_from, rendered_clip
from turbseg_ros.learning.torch_import import require_torch
from turbseg_ros.parameters import Parameters
from turbseg_ros.worker_pool import WorkerPool

# Every so many scenes, one is held out from training.
_HELD_OUT = 10
_REPORTS = 20


@executable("turbseg_train")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    require_torch("turbseg_train")
    check_new(options.out)
    if options.scenes < 2:
        raise UsageError("--scenes 1: give 2 or more, for some are held out")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    scenes = range(options.first_scene, options.first_scene + options.scenes)
    with (
        stopping_at_signals("turbseg_train") as stop,
        tempfile.TemporaryDirectory(dir=options.out.parent) as scratch,
    ):
        trained_on, held_out = _examples(scenes, options.frames, options.workers, stop)
        written = Path(scratch) / "weights"
        written.mkdir()
        record = _train(options, trained_on, held_out, written, stop)
        (written / "training.json").write_text(json.dumps(record, indent=1) + "\n")
        written.rename(options.out)
    if stop.cut:
        print(f"turbseg_train: {options.out} is partial: {record['partial']}", file=sys.stderr)
    return stop.status


def _examples(
    scenes: Sequence[int], frames: int, workers: int, stop: StopRequest
) -> tuple[Examples, Examples]:
    """Render scenes and take their windows: those to train on, and those held out.

    :raises Interrupted: when it is stopped: what would come of a part is another training.
    """
    kept: list[Examples] = []
    held: list[Examples] = []
    with WorkerPool(workers) as pool:
        taken = pool.run(functools.partial(_windows_of, frames=frames), scenes)
        shown = with_progress(taken, "rendering", unit="scene", total=len(scenes))
        for number, future in enumerate(shown):
            stop.check()
            try:
                examples = future.result()
            except BrokenProcessPool as error:
                reason = f"scene {scenes[number]}: the process that rendered it died"
                raise UsageError(f"{reason}; fewer --workers take less memory") from error
            (held if number % _HELD_OUT == 0 else kept).append(examples)
    trained_on, held_out = Examples.joined(kept), Examples.joined(held)
    if not (len(trained_on) and len(held_out)):
        raise UsageError(f"nothing moved in {len(scenes)} scenes; render more, or longer ones")
    return trained_on, held_out


def _windows_of(scene: int, frames: int) -> Examples:
    return examples_from(rendered_clip(scene, frames), Parameters())


def _train(
    options: argparse.Namespace,
    examples: Examples,
    held_out: Examples,
    folder: Path,
    stop: StopRequest,
) -> dict[str, Any]:
    """Train until stopped, show how it goes, and write the network; return the record of it."""
    from turbseg_ros.learning.export import write_onnx, write_weights
    from turbseg_ros.learning.training import held_out_scores, train

    every = max(options.steps // _REPORTS, 1)
    curve: list[dict[str, float]] = []
    reports = train(examples, options.seed, options.steps, report_every=every)
    for number, (loss, net) in enumerate(reports, start=1):
        scores = held_out_scores(net, held_out)
        step = min(number * every, options.steps)
        curve.append({"step": step, "loss": round(loss, 4), "held_out_j": round(scores.j, 4)})
        print(
            f"step {step:5}  loss {loss:.3f}  held-out J {scores.j:.3f}, by rules"
            f" {scores.j_ruled:.3f}  alarms {scores.alarms:.2f}, by rules"
            f" {scores.alarms_ruled:.2f}",
            flush=True,
        )
        if stop.received and step < options.steps:
            stop.cut = True
            break
    partial = {"partial": interrupted_after(step, options.steps, "steps")} if stop.cut else {}
    write_onnx(net, folder / "refine_net.onnx")
    write_weights(net, folder / "refine_net.safetensors")
    return {
        "command": f"turbseg_train --first-scene {options.first_scene} --scenes {options.scenes}"
        f" --frames {options.frames} --steps {options.steps} --seed {options.seed} -o OUT",
        "windows": len(examples),
        "held_out": dataclasses.asdict(scores),
        "curve": curve,
        **partial,
    }
