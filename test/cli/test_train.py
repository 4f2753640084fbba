"""turbseg_train, with scenes and training that take no time."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.drawn_footage import DrawnFootage

pytest.importorskip("torch", reason="torch is not installed: make test-learning")

from safetensors.torch import load_file
from torch import Tensor
from torch.testing import assert_close

from turbseg_ros.cli import train as cli
from turbseg_ros.cli.train import Lessons, main
from turbseg_ros.learning import training
from turbseg_ros.learning.examples import Examples
from turbseg_ros.learning.export import write_weights
from turbseg_ros.learning.refine_net import WIDTHS, RefineNet
from turbseg_ros.learning.shown_clips import shown_clip
from turbseg_ros.learning.training import HeldOut
from turbseg_ros.learning.window_input import CHANNELS, SIDE

GATHERED = cli.gathered
STEPS = 40
ARGUMENTS = ["--scenes", "2", "--steps", str(STEPS)]


def examples() -> Examples:
    maps = np.zeros((1, SIDE, SIDE), np.float16)
    return Examples(np.zeros((1, len(CHANNELS), SIDE, SIDE), np.float16), maps, maps)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    def train(
        examples: Examples,
        seed: int,
        steps: int,
        report_every: int,
        start: RefineNet | None,
        shown: Examples,
    ) -> Iterator[tuple[float, RefineNet]]:
        net = RefineNet(len(CHANNELS), WIDTHS)
        for step in range(report_every, steps + 1, report_every):
            if step == 3 * report_every:
                signal.raise_signal(signal.SIGTERM)
            yield 0.5, net

    lessons = Lessons(*(examples() for _ in range(4)))
    monkeypatch.setattr(cli, "gathered", lambda *_: lessons)
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
    def interrupted(options: Any, scratch: Path, stop: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        stop.check()

    monkeypatch.setattr(cli, "gathered", interrupted)
    with pytest.raises(SystemExit) as ended:
        main([*ARGUMENTS, "-o", str(tmp_path / "weights")])
    assert ended.value.code == 130
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr().err == "turbseg_train: interrupted; nothing of it is kept\n"


def test_folders_that_hold_no_footage_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "gathered", GATHERED)
    empty = tmp_path / "empty"
    empty.mkdir()
    for option in ("--backgrounds", "--objects", "--held-out"):
        command = [*ARGUMENTS, "-o", str(tmp_path / "weights"), option, str(empty)]
        assert main(command) == 2
        said = capsys.readouterr().err
        assert said == f"turbseg_train: {empty} holds no pictures, videos or sequences\n"


def test_a_share_of_the_start_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ARGUMENTS, "-o", str(tmp_path / "weights"), "--keep", "0.5"]) == 2
    assert "--start" in capsys.readouterr().err
    start = tmp_path / "start.safetensors"
    write_weights(RefineNet(len(CHANNELS), WIDTHS), start)
    command = [*ARGUMENTS, "-o", str(tmp_path / "weights"), "--start", str(start)]
    assert main([*command, "--keep", "0.75"]) == 128 + signal.SIGTERM
    assert "with a share of 0.75 kept" in capsys.readouterr().out
    record = json.loads((tmp_path / "weights" / "training.json").read_text())
    assert "--keep 0.75" in record["command"]
    kept, written = (
        load_file(path) for path in (start, tmp_path / "weights" / "refine_net.safetensors")
    )
    fresh = {name: (written[name] - 0.75 * kept[name]) / 0.25 for name in kept}
    # The stand-in for training gives a new network, whose means are all 0.
    assert float(fresh["first.1.running_mean"].abs().max()) < 1e-6
    assert float(fresh["judge.weight"].abs().max()) > 0


def test_a_start_of_one_level_less_is_deepened_once_and_by_the_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts: list[dict[str, Tensor]] = []

    def untrained(*_: Any, start: RefineNet, **__: Any) -> Iterator[tuple[float, RefineNet]]:
        starts.append({name: value.clone() for name, value in start.state_dict().items()})
        yield 0.5, start

    monkeypatch.setattr(training, "train", untrained)
    shallow = tmp_path / "start.safetensors"
    write_weights(RefineNet(len(CHANNELS), WIDTHS[:-1]), shallow)
    for name in ("one", "again"):
        command = [*ARGUMENTS, "-o", str(tmp_path / name), "--start", str(shallow)]
        assert main([*command, "--keep", "0.5"]) == 0
    written = load_file(tmp_path / "one" / "refine_net.safetensors")
    for name, value in written.items():
        # What nothing was learnt since is half of itself and half of itself.
        assert_close(value, starts[0][name])
        assert_close(starts[1][name], starts[0][name], rtol=0.0, atol=0.0)


def test_a_start_that_is_no_network_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    start = tmp_path / "text.safetensors"
    start.write_text("no network")
    assert main([*ARGUMENTS, "-o", str(tmp_path / "weights"), "--start", str(start)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"turbseg_train: {start}: not a refining network's weights")
    assert said.count("\n") == 1


def test_composites_of_footage_are_learnt_from_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "gathered", GATHERED)
    footage = DrawnFootage(length=20)
    for name, folder in (("objects", "one"), ("held", "other")):
        for kind in ("frames", "masks"):
            (tmp_path / name / folder / kind).mkdir(parents=True)
        for number, (picture, mask) in enumerate(
            zip(footage.pictures(0, 20), footage.masks(0, 20) or [], strict=True)
        ):
            sequence = tmp_path / name / folder
            cv2.imwrite(str(sequence / "frames" / f"{number:03}.png"), picture)
            cv2.imwrite(str(sequence / "masks" / f"{number:03}.png"), 255 * mask.astype(np.uint8))
    still = Examples.joined([examples()])
    monkeypatch.setattr(cli, "rendered_clip", lambda seed, frames: shown_clip(footage))
    kept, held_out = tmp_path / "windows", tmp_path / "held"
    command = [
        *(*ARGUMENTS, "--composites", "2", "--frames", "16", "--windows", str(kept)),
        *("--shown", "2"),
        *("--objects", str(tmp_path / "objects"), "--held-out", str(held_out)),
    ]
    assert main([*command, "-o", str(tmp_path / "weights")]) == 128 + signal.SIGTERM
    record = json.loads((tmp_path / "weights" / "training.json").read_text())
    assert record["windows"] > 0
    assert record["windows_of_shown_footage"] > 0
    assert record["curve"][0]["footage_j"] == 0.5
    assert "--composites 2 --shown 2 --objects objects --held-out held -o OUT" in record["command"]
    assert sorted(path.name for path in kept.iterdir()) == [
        "composite_000000.npz",
        "composite_000001.npz",
        "footage_000000_held_out.npz",
        "scene_000100_held_out.npz",
        "scene_000101.npz",
        "shown_000000.npz",
        "shown_000001.npz",
    ]
    still.save(kept / "composite_000000.npz")
    still.save(kept / "composite_000001.npz")
    still.save(kept / "scene_000101.npz")
    main([*command, "-o", str(tmp_path / "again")])
    assert json.loads((tmp_path / "again" / "training.json").read_text())["windows"] == 3
