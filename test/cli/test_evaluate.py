"""turbseg_evaluate's comparisons and curves, in one process; the method here is a threshold."""

from __future__ import annotations

import json
import math
import re
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.evaluate import main
from turbseg_ros.evaluation import baselines
from turbseg_ros.evaluation.experiments import VARIANTS
from turbseg_ros.messages.images import message_from_image
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

FRAMES = 10
STAMPS = [number * 33_000_000 for number in range(FRAMES)]
TIMES = ("fps", "ms_p50", "ms_p95")
SCORE_KEYS = 29


class DarkAreas:
    """Finds what is darker than the drawn ground ever is; its parameters make it see less."""

    made: list[Parameters]

    def __init__(self, parameters: Parameters) -> None:
        self.made.append(parameters)
        self._last_row = 75 - parameters.flow.interval

    def push(self, frame: Frame) -> list[SegmentationResult]:
        labels = (frame.image < 60).astype(np.uint16)
        labels[self._last_row :] = 0
        return [SegmentationResult(frame, labels, (), np.zeros((0, 0), np.float32), math.nan, "")]

    def flush(self) -> list[SegmentationResult]:
        return []


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch) -> list[Parameters]:
    """The parameters of every method that was made, in order."""
    monkeypatch.setattr(DarkAreas, "made", [], raising=False)
    monkeypatch.setattr(baselines, "clip_segmenter", DarkAreas)
    return DarkAreas.made


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_drawn_bag(tmp_path / "bag", STAMPS)


def evaluated(file: Path, *arguments: object, status: int = 0) -> dict[str, Any]:
    """Run in one process; return what was written as JSON."""
    words = [*map(str, arguments), "--workers", "1", "--json", str(file)]
    assert main(words) == status
    content: dict[str, Any] = json.loads(file.read_text())
    return content


def j_of(rows: Sequence[dict[str, Any]]) -> list[float]:
    return [row["mean"]["j"] for row in rows]


def test_rivals_are_scored_beside_the_method(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = evaluated(tmp_path / "out.json", bag, "--baselines", "mog2,knn")
    rows = content["baselines"]
    names = ["turbseg", "mog2", "mog2 stabilised", "knn", "knn stabilised"]
    assert [row["segmenter"] for row in rows] == names
    assert rows[0]["bags"] == content["bags"]
    assert rows[0]["mean"]["id_switches"] == 0
    for row in rows[1:]:
        assert len(row["bags"][0]) == SCORE_KEYS
        assert row["bags"][0]["bag"] == str(bag)
        assert row["mean"]["id_switches"] is None
    printed = capsys.readouterr().out
    assert all(f"\n{name} " in printed for name in names)


def test_what_is_marked_to_be_ignored_is_left_out_for_rivals_as_well(
    bag: Path, tmp_path: Path
) -> None:
    mask = np.zeros((120, 208), np.uint8)
    mask[:, 50:] = 255
    cv2.imwrite(str(tmp_path / "right.png"), mask)
    folder = tmp_path / "theirs" / "bag"
    folder.mkdir(parents=True)
    for number in range(FRAMES):
        # They see no more than what is left of it.
        mask = np.zeros((120, 208), np.uint8)
        mask[50:75, 20 + 3 * number : 50] = 255
        cv2.imwrite(str(folder / f"{number:05}.png"), mask)
    options = ["--baselines", f"theirs={folder.parent}"]
    whole = evaluated(tmp_path / "whole.json", bag, *options)
    options += ["-p", f"regions.ignore:={tmp_path / 'right.png'}"]
    rest = evaluated(tmp_path / "rest.json", bag, *options)
    assert j_of(whole["baselines"])[1] < 0.7
    assert j_of(rest["baselines"])[1] == 1.0
    predictions = tmp_path / "predictions"
    with BagWriter(predictions) as writer:
        for number, stamp in enumerate(STAMPS):
            labels = np.zeros((120, 208), np.uint16)
            labels[50:75, 20 + 3 * number : 50] = 1
            writer.write("/turbseg/labels", message_from_image(labels, "mono16", stamp), stamp)
    recorded = ["--predictions", predictions, *options[2:]]
    (scores,) = evaluated(tmp_path / "recorded.json", bag, *recorded)["bags"]
    assert scores["j"] == 1.0


def test_masks_of_others_are_scored_beside_ours_and_have_no_time(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "theirs" / "bag"
    folder.mkdir(parents=True)
    for number in range(FRAMES):
        mask = np.zeros((120, 208), np.uint8)
        mask[50:75, 20 + 3 * number : 60 + 3 * number] = 255
        cv2.imwrite(str(folder / f"{number:05}.png"), mask)
    options = ["--baselines", f"theirs={folder.parent}", "--tilt-curve", "1"]
    content = evaluated(tmp_path / "out.json", bag, *options)
    theirs = content["baselines"][1]
    assert theirs["segmenter"] == "theirs"
    assert (theirs["mean"]["j"], theirs["mean"]["fps"]) == (1.0, None)
    assert [row["segmenter"] for row in content["tilt_curve"]] == ["turbseg"]
    assert "\ntheirs " in capsys.readouterr().out
    assert main([str(bag), *options, "--duration", "1"]) == 2
    assert "leave out --start, --duration" in capsys.readouterr().err


def test_the_method_runs_once_for_all_that_needs_it(
    bag: Path, tmp_path: Path, made: list[Parameters]
) -> None:
    comparisons = ["--baselines", "mog2", "--tilt-curve", "0", "--ablation"]
    evaluated(tmp_path / "out.json", bag, *comparisons, "-p", "flow.interval:=5")
    # `interval 5` and the bag without added turbulence are the method as it was configured.
    assert len(made) == len(set(made)) == len(VARIANTS) - 1


def test_ablation_changes_one_thing_at_a_time(
    bag: Path, tmp_path: Path, made: list[Parameters]
) -> None:
    content = evaluated(tmp_path / "out.json", bag, "--ablation", "-p", "max_objects:=3")
    rows = {row["variant"]: row for row in content["ablation"]}
    assert list(rows) == list(VARIANTS)
    assert all(parameters.max_objects == 3 for parameters in made)
    assert rows["interval 2"]["parameters"] == {"flow.interval": 2}
    assert rows["growing only"]["parameters"] == {"outline.method": "none"}
    # This method sees a row less with each interval.
    assert j_of([rows[f"interval {k}"] for k in (2, 3, 4, 5)]) == pytest.approx(
        [0.92, 0.88, 0.84, 0.8]
    )


def test_a_change_is_compared_with_how_it_was_configured(
    bag: Path, tmp_path: Path, made: list[Parameters]
) -> None:
    changes = ["--variant", "flow.interval:=2", "--variant", "flow.interval:=5"]
    content = evaluated(tmp_path / "out.json", bag, *changes, "-p", "max_objects:=3")
    names = [row["variant"] for row in content["comparison"]]
    assert names == ["as configured", "flow.interval 2", "flow.interval 5"]
    assert content["comparison"][1]["parameters"] == {"flow.interval": 2}
    assert j_of(content["comparison"][1:]) == pytest.approx([0.92, 0.8])
    assert len(made) == 3


def test_a_change_that_is_none_is_refused_in_one_line(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for change in ("flow.interval", "flow.intervall:=2", "flow.interval:=many"):
        assert main([str(bag), "--variant", change]) == 2
        said = capsys.readouterr().err
        assert "flow.interval" in said
        assert said.count("\n") == 1


def test_sensitivity_halves_and_doubles_the_methods_numbers(
    bag: Path, tmp_path: Path, made: list[Parameters], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["-p", "flow.interval:=1", "-p", "growing.delta:=0.8", "-p", "max_objects:=3"]
    content = evaluated(tmp_path / "out.json", bag, "--sensitivity", *given)
    rows = {row["variant"]: row for row in content["sensitivity"]}
    assert all(parameters.max_objects == 3 for parameters in made)
    assert next(iter(rows)) == "as configured"
    changes = [row["parameters"] for row in content["sensitivity"][1:]]
    assert all(len(change) == 1 for change in changes)
    named = {name for change in changes for name in change}
    assert {"seed.delta1", "tracking.max_age"} <= named
    # What changes nothing stands apart, with the reason.
    idle = {"outline.threshold", "refine.epochs", "latency.coast_from", "latency.sparse_from"}
    assert not idle & named
    assert {name.split()[0] for name in content["sensitivity_idle"]} == idle
    assert content["sensitivity_idle"]["outline.threshold 5.0"] == (
        "outline.threshold has no effect while refine.mode is pretrained; "
        "it is used with refine.mode none or optimise"
    )
    assert not [name for name in named if name.split(".")[0] in ("qos", "diagnostics")]
    assert {"queue_size", "max_objects", "motion.measure"}.isdisjoint(named)
    # Half of an interval of 1 rounds to 0, which the range makes 1 again; a delta is 0.8 at most.
    assert [change for change in changes if "flow.interval" in change] == [{"flow.interval": 2}]
    assert [change for change in changes if "growing.delta" in change] == [{"growing.delta": 0.4}]
    assert {"seed.size": 4} in changes
    assert {"seed.delta1": 10.0} in changes
    # This method sees a row less with each interval.
    assert rows["flow.interval 2"]["mean"]["j"] < rows["as configured"]["mean"]["j"]
    printed = capsys.readouterr().out
    assert "\nflow.interval 2 " in printed
    assert printed.count("\nnot run: outline.threshold has no effect while") == 1


def test_sensitivity_runs_what_the_mode_uses(bag: Path, tmp_path: Path) -> None:
    content = evaluated(tmp_path / "out.json", bag, "--sensitivity", "-p", "refine.mode:=none")
    named = {name for row in content["sensitivity"][1:] for name in row["parameters"]}
    assert "outline.threshold" in named
    assert "refine.epochs" not in named


def test_an_ablation_that_changes_nothing_is_not_run(bag: Path, tmp_path: Path) -> None:
    given = ["--ablation", "-p", "motion.measure:=sampson"]
    content = evaluated(tmp_path / "out.json", bag, *given)
    assert list(content["ablation_idle"]) == ["mean flow (eq. 1)"]
    assert "mean flow (eq. 1)" not in [row["variant"] for row in content["ablation"]]


def test_what_is_ahead_is_said(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluated(tmp_path / "out.json", bag, "--ablation")
    said = capsys.readouterr().err.splitlines()
    assert said[0] == f"turbseg_evaluate: {len(VARIANTS) - 1} runs ahead, 1 at a time"
    assert re.fullmatch(
        rf"turbseg_evaluate: {len(VARIANTS) - 3} runs are left, about \d+ (s|min)", said[1]
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_evaluation_keeps_the_runs_that_are_done(
    number: signal.Signals,
    bag: Path,
    tmp_path: Path,
    made: list[Parameters],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Interrupting(DarkAreas):
        def push(self, frame: Frame) -> list[SegmentationResult]:
            if len(made) == 4:
                signal.raise_signal(number)
            return super().push(frame)

    monkeypatch.setattr(baselines, "clip_segmenter", Interrupting)
    report = tmp_path / "report"
    arguments = [bag, "--ablation", "--report", report]
    content = evaluated(tmp_path / "out.json", *arguments, status=128 + number)
    partial = f"interrupted after 3 of {len(VARIANTS) - 1} runs"
    assert content["partial"] == partial
    done = [*list(VARIANTS)[:3], "interval 4"]
    assert [row["variant"] for row in content["ablation"]] == done
    assert content["bags"][0]["j"] is not None
    assert f"Partial: {partial}" in (report / "index.html").read_text()
    printed = capsys.readouterr()
    assert f"turbseg_evaluate: {partial}; what is done is kept\n" in printed.err
    assert "\ninterval 2 " in printed.out
    assert "\ninterval 5 " not in printed.out


def test_an_evaluation_interrupted_in_its_first_run_writes_nothing(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Interrupting(DarkAreas):
        def push(self, frame: Frame) -> list[SegmentationResult]:
            signal.raise_signal(signal.SIGINT)
            return super().push(frame)

    monkeypatch.setattr(baselines, "clip_segmenter", Interrupting)
    file = tmp_path / "out.json"
    assert main([str(bag), "--workers", "1", "--json", str(file)]) == 130
    assert not file.exists()
    assert "interrupted after 0 of 1 runs; nothing to keep" in capsys.readouterr().err


@pytest.mark.parametrize("curve", ["tilt", "shake"])
def test_a_curve_has_a_point_for_every_strength(
    curve: str, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [f"--{curve}-curve", "2,0,0.5", "--baselines", "knn"]
    content = evaluated(tmp_path / "out.json", bag, *arguments)
    rows = content[f"{curve}_curve"]
    assert [(row["segmenter"], row[f"added_{curve}_px"]) for row in rows] == [
        (name, strength)
        for name in ("turbseg", "knn", "knn stabilised")
        for strength in (0, 0.5, 2)
    ]
    assert f"added_{curve}_px  J turbseg  J knn  J knn stabilised" in capsys.readouterr().out


def test_turbulence_blurs_what_the_method_sees(bag: Path, tmp_path: Path) -> None:
    content = evaluated(tmp_path / "out.json", bag, "--tilt-curve", "0,3")
    clear, turbulent = j_of(content["tilt_curve"])
    assert clear == content["mean"]["j"]
    assert turbulent < clear - 0.05


def test_seeds_make_other_turbulence(bag: Path, tmp_path: Path) -> None:
    arguments = [bag, "--tilt-curve", "1"]
    one = evaluated(tmp_path / "one.json", *arguments)
    again = evaluated(tmp_path / "again.json", *arguments, "--seed", "0")
    other = evaluated(tmp_path / "other.json", *arguments, "--seed", "1")
    assert j_of(one["tilt_curve"]) == j_of(again["tilt_curve"])
    assert j_of(one["tilt_curve"]) != j_of(other["tilt_curve"])


def test_two_runs_give_the_same_figures(bag: Path, tmp_path: Path) -> None:
    arguments = [bag, "--baselines", "mog2,knn", "--tilt-curve", "0,1", "--shake-curve", "1"]
    one, other = (untimed(evaluated(tmp_path / name, *arguments)) for name in ("1", "2"))
    assert one == other


def untimed(content: Any) -> Any:
    """What was written, without what depends on the clock."""
    if isinstance(content, dict):
        return {key: untimed(value) for key, value in content.items() if key not in TIMES}
    return [untimed(item) for item in content] if isinstance(content, list) else content


def test_a_bag_that_fails_is_reported_once_and_left_out(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [tmp_path / "missing", bag, "--baselines", "mog2"]
    content = evaluated(tmp_path / "out.json", *arguments, status=1)
    assert [scores["bag"] for scores in content["bags"]] == [str(bag)]
    assert [len(row["bags"]) for row in content["baselines"]] == [1, 1, 1]
    assert capsys.readouterr().err.count("no such bag") == 1


def test_a_shake_too_wide_for_a_bag_is_reported(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = evaluated(tmp_path / "out.json", bag, "--shake-curve", "20", status=1)
    assert content["shake_curve"][0]["bags"] == []
    assert f"{bag}: a shake of 20 px moves the picture" in capsys.readouterr().err


def test_an_unforeseen_error_in_one_bag_does_not_stop_the_rest(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Fragile(DarkAreas):
        def push(self, frame: Frame) -> list[SegmentationResult]:
            if frame.image.shape == (4, 4):
                raise RuntimeError("too small")
            return super().push(frame)

    monkeypatch.setattr(baselines, "clip_segmenter", Fragile)
    small = tmp_path / "small"
    with BagWriter(small) as writer:
        for topic in ("/camera/image_raw", TRUTH_TOPIC):
            writer.write(topic, message_from_image(np.zeros((4, 4), np.uint8), "mono8", 1), 1)
    content = evaluated(tmp_path / "out.json", small, bag, status=1)
    assert [scores["bag"] for scores in content["bags"]] == [str(bag)]
    assert f"{small}: RuntimeError: too small" in capsys.readouterr().err


def test_without_any_scores_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, report = tmp_path / "out.json", tmp_path / "report"
    arguments = [str(tmp_path / "missing"), "--json", str(file), "--report", str(report)]
    assert main([*arguments, "--ablation", "--workers", "1"]) == 1
    assert not file.exists()
    assert not list(report.iterdir())
    said = [line for line in capsys.readouterr().err.splitlines() if "runs ahead" not in line]
    assert len(said) == 1


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--baselines", "mogg2"], "no baseline 'mogg2'; did you mean mog2?"),
        (["--baselines", "theirs=nowhere"], "no such folder: nowhere"),
        (["--baselines", "nowhere:Class"], "baseline is nowhere:Class"),
        (["--tilt-curve", "0,-1"], "0,-1: give 0 to 20 pixels"),
        (["--tilt-curve", "nan"], "nan: give 0 to 20 pixels"),
        (["--shake-curve", "a,b"], "--shake-curve"),
        (["--seed", "-1"], "--seed"),
        (["--workers", "0"], "0 is not above 0"),
        (["--predictions", "x", "--ablation"], "--ablation segments anew"),
        (["--predictions", "x", "--sensitivity"], "--sensitivity segments anew"),
        (["--predictions", "x", "--tilt-curve", "1"], "--tilt-curve segments anew"),
        (["--predictions", "x", "--report", "r"], "--report segments anew"),
        (["--predictions", "x", "--curves", "c"], "--curves segments anew"),
        (["--curves", "c", "--ablation"], "--curves draws those of --tilt-curve"),
        (["bag"], "a BAG is named twice"),
    ],
)
def test_a_mistake_is_refused_before_anything_runs(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["bag", *arguments])
    except SystemExit as stop:  # as argparse refuses
        status = stop.code if isinstance(stop.code, int) else 1
    assert status == 2
    assert complaint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_every_table_is_written_as_csv_and_latex(bag: Path, tmp_path: Path) -> None:
    options = ["--baselines", "mog2", "--tilt-curve", "0,1"]
    evaluated(
        tmp_path / "out.json", bag, *options, "--csv", tmp_path / "c", "--latex", tmp_path / "l"
    )
    names = {"bags", "baselines", "tilt_curve"}
    assert {path.stem for path in (tmp_path / "c").glob("*.csv")} == names
    assert {path.stem for path in (tmp_path / "l").glob("*.tex")} == names
    assert "turbseg 1 px," in (tmp_path / "c" / "tilt_curve.csv").read_text()
