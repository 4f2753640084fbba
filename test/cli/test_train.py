"""turbseg_train, with scenes and training that take no time."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: make test-learning")

from turbseg_ros.cli import train as cli
from turbseg_ros.cli.train import main
from turbseg_ros.learning import training
from turbseg_ros.learning.examples import Examples
from turbseg_ros.learning.refine_net import RefineNet
from turbseg_ros.learning.training import HeldOut
from turbseg_ros.learning.window_input import CHANNELS, SIDE

STEPS = 40
ARGUMENTS = ["--scenes", "2", "--steps", str(STEPS)]


def examples() -> Examples:
    maps = np.zeros((1, SIDE, SIDE), np.float16)
    return Examples(np.zeros((1, len(CHANNELS), SIDE, SIDE), np.float16), maps, maps)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    def train(
        examples: Examples, seed: int, steps: int, report_every: int
    ) -> Iterator[tuple[float, RefineNet]]:
        net = RefineNet(len(CHANNELS))
        for step in range(report_every, steps + 1, report_every):
            if step == 3 * report_every:
                signal.raise_signal(signal.SIGTERM)
            yield 0.5, net

    monkeypatch.setattr(cli, "_examples", lambda *_: (examples(), examples()))
    monkeypatch.setattr(training, "train", train)
    monkeypatch.setattr(training, "held_out_scores", lambda *_: HeldOut(1, 0.5, 0.5, 0.0, 0.0))


def test_an_interrupted_training_keeps_the_network_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "weights"
    assert main([*ARGUMENTS, "-o", str(out)]) == 128 + signal.SIGTERM
    record: dict[str, Any] = json.loads((out / "training.json").read_text())
    assert record["partial"] == f"interrupted after 6 of {STEPS} steps"
    assert [report["step"] for report in record["curve"]] == [2, 4, 6]
    assert (out / "refine_net.onnx").stat().st_size > 0
    said = capsys.readouterr().err
    assert said == f"turbseg_train: {out} is partial: {record['partial']}\n"


def test_interrupted_while_scenes_are_rendered_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(scenes: Any, frames: int, workers: int, stop: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        stop.check()

    monkeypatch.setattr(cli, "_examples", interrupted)
    with pytest.raises(SystemExit) as ended:
        main([*ARGUMENTS, "-o", str(tmp_path / "weights")])
    assert ended.value.code == 130
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().err == "turbseg_train: interrupted; nothing of it is kept\n"
