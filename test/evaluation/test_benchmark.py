from __future__ import annotations

import itertools
import json
import signal
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from support.drawn_bag import write_drawn_bag
from support.drawn_scene import DrawnScene
from turbseg_ros.cli import benchmark as executable
from turbseg_ros.evaluation.baselines import BackgroundSubtraction, Method, TurbsegMethod
from turbseg_ros.evaluation.benchmark import (
    Cost,
    Footprint,
    StageClock,
    Timing,
    endless,
    footprint,
    measure,
)
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.observer import STAGES

SMALL = Parameters().replace(
    {"resolution.processing": 160, "resolution.detail": 160, "latency.warm_up": 0}
)


@dataclass(frozen=True)
class Rendered:
    image: np.ndarray


def work() -> None:
    sum(range(50_000))


def drawn_frames(count):
    clip = list(DrawnScene().images(20))
    return itertools.islice(endless(clip, (160, 96), rate_hz=30.0), count)


def test_a_clip_goes_forward_and_backward_at_a_steady_rate():
    clip = [np.full((4, 6), value, np.uint8) for value in (10, 20, 30)]
    frames = list(itertools.islice(endless(clip, (6, 4), rate_hz=10.0), 6))
    assert [int(frame.image[0, 0]) for frame in frames] == [10, 20, 30, 20, 10, 20]
    assert {b.stamp - a.stamp for a, b in itertools.pairwise(frames)} == {100_000_000}


@pytest.mark.parametrize("size", [(64, 48), (192, 96), (160, 160)])
def test_a_clip_is_cut_to_another_shape_without_being_stretched(size):
    ramp = np.add.outer(np.arange(96), np.arange(160)).astype(np.uint8)
    frame = next(endless([ramp], size, rate_hz=30.0))
    across, down = (
        np.diff(frame.image.astype(int), axis=1),
        np.diff(frame.image.astype(int), axis=0),
    )
    assert frame.image.shape == (size[1], size[0])
    assert across.mean() == pytest.approx(down.mean(), rel=0.05)


def test_the_clock_tells_a_stage_from_those_within_it():
    clock = StageClock()
    clock.running = True
    with clock.stage("outer"), clock.stage("inner"):
        work()
    assert clock.seconds["inner"] > 4 * clock.seconds["outer"] > 0.0


def test_the_clock_counts_only_while_it_runs():
    clock = StageClock()
    with clock.stage("idle"):
        work()
    assert not clock.seconds


def test_the_clock_lets_errors_pass_and_counts_their_stage():
    clock = StageClock()
    clock.running = True
    with pytest.raises(ValueError, match="as it was"), clock.stage("failing"):
        raise ValueError("as it was")
    assert clock.seconds["failing"] > 0.0


def test_every_stage_is_seen_at_work():
    methods: list[Method] = [
        TurbsegMethod("turbseg", SMALL.replace({"seed.standing_out": True})),
        BackgroundSubtraction("mog2", stabilised=False),
    ]
    timing = measure(methods, drawn_frames(30), warm_up=4, size=(160, 96))
    assert set(timing.stages) == set(STAGES)
    assert set(timing.frames) == {"turbseg", "mog2"}
    assert timing.ratio("turbseg") > timing.ratio("mog2") > 0.0
    assert timing.processor_ratio("turbseg") > timing.processor_ratio("mog2") > 0.0
    cost = timing.frames["turbseg"]
    assert 0.0 < cost.p50 <= cost.p95 <= cost.p99


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is told by /proc")
def test_the_footprint_is_that_of_a_process_of_its_own():
    needs = footprint(SMALL, drawn_frames(20))
    assert 30.0 < needs.mebibytes < 400.0
    assert 0.0 < needs.start_seconds < 60.0
    assert 0.0 < needs.first_result_seconds < 60.0


def test_the_executable_writes_what_it_prints(monkeypatch, tmp_path, capsys):
    drawn = [Rendered(image) for image in DrawnScene().images(20)]
    monkeypatch.setattr(executable, "render", lambda scene, seed: drawn)
    monkeypatch.setattr(executable, "_WARM_UP", 3)
    file = tmp_path / "new" / "figures.json"
    arguments = ["--sizes", "160x96", "--frames", "2", "--baselines", "knn", "--json", str(file)]
    assert executable.main(arguments) == 0
    (case,) = json.loads(file.read_text())["cases"]
    assert case["size"] == [160, 96]
    assert set(case["ratios"]) == {"turbseg", "knn"}
    printed = capsys.readouterr().out
    assert f"{case['frames']['turbseg']['p50']:.1f}" in printed
    assert "160x96, 2 objects, 2 frames" in printed


@pytest.mark.parametrize(
    "arguments",
    [["--sizes", "640"], ["--sizes", "8x8"], ["--baselines", "mog3"], ["--frames", "0"]],
)
def test_the_executable_refuses_what_makes_no_sense(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        executable.main(arguments)
    assert ended.value.code == 2
    assert arguments[1] in capsys.readouterr().err or "mog3" in arguments


@pytest.mark.parametrize("count", ["-1", "33", "2,33", "two"])
def test_the_executable_refuses_a_crowd(count, capsys):
    with pytest.raises(SystemExit) as ended:
        executable.main([f"--objects={count}"])
    assert ended.value.code == 2
    assert count in capsys.readouterr().err


def test_cases_of_several_objects_and_replay_are_told(monkeypatch, tmp_path, capsys):
    bag = tmp_path / "bag"
    write_drawn_bag(bag, [number * 40_000_000 for number in range(12)])
    monkeypatch.setattr(executable, "render", lambda scene, seed: rendered_for(scene))
    monkeypatch.setattr(executable, "_WARM_UP", 3)
    monkeypatch.setattr(executable, "_PAIRS", 2)
    file = tmp_path / "figures.json"
    arguments = ["--sizes", "160x96", "--frames", "2", "--baselines", "", "--objects", "0,3"]
    assert executable.main([*arguments, "--replay", str(bag), "--json", str(file)]) == 0
    report = json.loads(file.read_text())
    assert [case["objects"] for case in report["cases"]] == [0, 3]
    assert len(report["replay_over_method"]) == 2
    assert min(report["replay_over_method"]) > 0.0
    printed = capsys.readouterr().out
    assert "160x96, 3 objects, 2 frames" in printed
    assert f"replay of {bag} over the method alone: " in printed


def rendered_for(scene):
    """Return a clip, not the same for scenes with and without objects."""
    drawn = DrawnScene() if scene.objects else DrawnScene(velocity=None)
    return [Rendered(image) for image in drawn.images(20)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_benchmark_keeps_the_cases_that_are_done(
    number, monkeypatch, tmp_path, capsys
):
    def case(clip, objects, size, *_):
        if size == (128, 96):
            signal.raise_signal(number)
        cost = Cost(1.0, 1.0, 1.0, 1.0)
        timing = Timing(size, {"turbseg": cost}, cost, {})
        return executable._Case(objects, timing, Footprint(1.0, 1.0, 1.0))

    monkeypatch.setattr(executable, "render", lambda *_: iter([Rendered(np.zeros((4, 4)))]))
    monkeypatch.setattr(executable, "_case", case)
    file = tmp_path / "figures.json"
    arguments = ["--sizes", "64x64,128x96,256x192", "--baselines", "", "--json", str(file)]
    assert executable.main(arguments) == 128 + number
    content = json.loads(file.read_text())
    assert [each["size"] for each in content["cases"]] == [[64, 64]]
    assert content["partial"] == "interrupted after 1 of 3 cases"
    assert capsys.readouterr().err == f"turbseg_benchmark: {content['partial']}\n"
