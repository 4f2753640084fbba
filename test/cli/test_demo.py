"""The demonstration as its user runs it: processes over DDS, and none of them left behind."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import cast

import cv2
import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import LABELS_TOPIC
from turbseg_ros.cli import demo, processes
from turbseg_ros.cli.processes import ProcessError, child_process, executable_process
from turbseg_ros.nodes.recorder import Recorder

Start = Callable[..., subprocess.Popen[str]]

FRAMES = 16


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Frames at 10 Hz."""
    start = 1_700_000_000_000_000_000
    return write_drawn_bag(
        tmp_path / "bag", [start + number * 100_000_000 for number in range(FRAMES)]
    )


@pytest.fixture
def out(tmp_path: Path) -> Iterator[Path]:
    """Return the demonstration's directory; whatever it started must be gone in the end."""
    directory = tmp_path / "out"
    yield directory
    assert not processes_of(directory)


def processes_of(out: Path) -> list[str]:
    """Return the command lines of the processes that log below `out`: the demonstration's."""
    marker = f"ROS_LOG_DIR={out}".encode()
    return [
        proc_file(process / "cmdline").replace(b"\0", b" ").decode()
        for process in Path("/proc").glob("[0-9]*")
        if marker in proc_file(process / "environ")
    ]


def proc_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # the process has ended, or is not ours
        return b""


@pytest.fixture
def start(bag: Path, out: Path) -> Iterator[Start]:
    """Return a function that starts the demonstration with further arguments."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "turbseg_ros.cli", "demo"]
        command += ["--bag", str(bag), "--out", str(out)]
        pipe = subprocess.PIPE
        started.append(
            subprocess.Popen([*command, *arguments], stdout=pipe, stderr=pipe, text=True)
        )
        return started[-1]

    yield start
    for process in started:
        process.terminate()
        process.communicate(timeout=60)


def wait_for(condition: Callable[[], bool], limit: float = 60.0) -> None:
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.timeout(180)
def test_every_frame_is_answered_scored_and_drawn(start: Start, out: Path) -> None:
    process = start("--minimum-j", "0")
    printed, errors = process.communicate(timeout=150)
    assert process.returncode == 0, errors
    topics = BagReader(out / "bag").topics
    assert topics["/turbseg/labels"].message_count == FRAMES
    assert "/diagnostics" in topics
    (scores,) = json.loads((out / "scores.json").read_text())["bags"]
    assert (scores["frames"], scores["scored_frames"]) == (FRAMES, FRAMES)
    assert f"{scores['j']:.3f}" in printed
    assert cv2.imread(str(out / "overlay.png")) is not None


class RecorderOf:
    """A recorder that gets one message after the other, told by their topics."""

    def __init__(self, coming: Iterable[str]) -> None:
        self._coming = iter(coming)
        self._received: Counter[str] = Counter()

    def step(self) -> None:
        self._received[next(self._coming)] += 1

    def received(self, topic: str) -> int:
        return self._received[topic]


def test_messages_that_take_marks_away_stand_for_no_frame() -> None:
    markers, labels = "/turbseg/centroids", LABELS_TOPIC
    late = [markers] * (FRAMES + 1) + [labels] * FRAMES
    recorder = RecorderOf(late)
    demo._await_results(cast(Recorder, recorder), [markers, labels], FRAMES, recorder.step)
    assert recorder.received(labels) == FRAMES


@pytest.mark.timeout(180)
def test_a_score_below_the_minimum_fails_in_one_line(start: Start) -> None:
    process = start("--minimum-j", "1.01")
    _, errors = process.communicate(timeout=150)
    assert process.returncode == 1
    assert errors.startswith("demo: J is ")
    assert errors.count("\n") == 1


@pytest.mark.timeout(180)
@pytest.mark.parametrize("name", ["node", "play"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_processes(
    name: str, number: signal.Signals, start: Start, out: Path
) -> None:
    process = start()
    wait_for(lambda: any(f"turbseg_ros.cli {name}" in command for command in processes_of(out)))
    process.send_signal(number)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert errors == ""
    assert sorted(entry.name for entry in out.iterdir()) == ["log"]


def test_an_output_that_is_no_bag_is_not_removed(
    bag: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (out / "bag").mkdir(parents=True)
    (out / "bag" / "diary.txt").write_text("dear diary")
    assert demo.main(["--bag", str(bag), "--out", str(out)]) == 2
    assert "is no bag; remove it or choose another --out" in capsys.readouterr().err
    assert (out / "bag" / "diary.txt").exists()


def test_a_process_that_fails_is_told_with_its_last_words(tmp_path: Path) -> None:
    missing, log = tmp_path / "missing", tmp_path / "log.txt"
    with executable_process("play", [str(missing)], log) as play:
        play.process.wait(60)
        with pytest.raises(ProcessError, match=r"turbseg_play ended with status 2: .*no such bag"):
            play.check()


def test_a_process_that_ignores_being_asked_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stubbornly = (
        "import signal, time\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "print('ready', flush=True)\n"
        "time.sleep(100)\n"
    )
    monkeypatch.setattr(processes, "_STOP_LIMIT", 0.3)
    log = tmp_path / "log.txt"
    with child_process("stubborn", [sys.executable, "-c", stubbornly], log) as stubborn:
        wait_for(lambda: "ready" in log.read_text())
        stubborn.check()
    assert stubborn.process.returncode == -signal.SIGKILL
