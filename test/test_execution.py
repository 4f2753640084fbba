"""turbseg_evaluate in several processes: the same figures as in one, and what goes wrong there."""

from __future__ import annotations

import importlib
import json
import logging
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.deadly_method import Deadly
from support.drawn_bag import write_drawn_bag
from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.cli.evaluate import main
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation.baselines import BackgroundSubtraction
from turbseg_ros.evaluation.run import Run, RunResult, Source
from turbseg_ros.execution import ClusterError, Failure, remote_cluster, run_beside, run_on
from turbseg_ros.worker_pool import WorkerPool

# A worker imports ROS 2 and OpenCV, which takes its time on a busy machine.
pytestmark = pytest.mark.timeout(240)

# Small pictures, for the sake of time.
QUICK = ["resolution.processing:=208", "resolution.detail:=208", "flow.interval:=2"]
GIVEN = [word for each in QUICK for word in ("-p", each)]
COMPARISONS = ["--baselines", "knn", "--tilt-curve", "1"]
TIMES = ("fps", "ms_p50", "ms_p95")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two bags with different numbers of frames."""
    folder = tmp_path_factory.mktemp("bags")
    return [
        write_drawn_bag(folder / name, [n * 33_000_000 for n in range(frames)])
        for name, frames in (("short", 7), ("long", 9))
    ]


@pytest.fixture(scope="module")
def alone(bags: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What one process says of the bags."""
    file = tmp_path_factory.mktemp("alone") / "scores.json"
    words = [*map(str, bags), *COMPARISONS, *GIVEN, "--workers", "1"]
    assert main([*words, "--json", str(file)]) == 0
    return untimed(json.loads(file.read_text()))


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a cluster that runs already."""
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    with (
        importlib.import_module("dask").config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            local_directory=tmp_path_factory.mktemp("dask"),
            silence_logs=logging.ERROR,
        ) as cluster,
    ):
        yield cluster.scheduler_address


def untimed(content: Any) -> Any:
    """What was written, without what depends on the clock."""
    if isinstance(content, dict):
        return {key: untimed(value) for key, value in content.items() if key not in TIMES}
    return [untimed(item) for item in content] if isinstance(content, list) else content


def test_two_workers_give_the_figures_of_one_process(
    bags: list[Path], alone: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "scores.json"
    missing = tmp_path / "missing"
    words = [str(bags[0]), str(missing), str(bags[1]), *COMPARISONS, *GIVEN, "--workers", "2"]
    assert main([*words, "--json", str(file)]) == 1
    assert untimed(json.loads(file.read_text())) == alone
    error = capsys.readouterr().err
    assert f"turbseg_evaluate: no such bag: {missing}\n" in error
    assert "Traceback" not in error


def test_a_running_scheduler_is_used(
    bags: list[Path], alone: dict[str, Any], scheduler: str, tmp_path: Path
) -> None:
    file = tmp_path / "scores.json"
    words = [*map(str, bags), *GIVEN, "--scheduler", scheduler, "--json", str(file)]
    assert main(words) == 0
    assert untimed(json.loads(file.read_text()))["bags"] == alone["bags"]


@pytest.fixture(scope="module")
def with_a_deadly_one(bags: list[Path]) -> list[Run]:
    """Three runs, of which the first takes its process down."""
    sources = [Source(str(bag), bag, None, TRUTH_TOPIC) for bag in bags]
    return [
        Run(sources[0], Deadly()),
        *(Run(source, BackgroundSubtraction("knn", stabilised=False)) for source in sources),
    ]


def test_a_worker_that_dies_costs_its_run_only(
    bags: list[Path], with_a_deadly_one: list[Run]
) -> None:
    with WorkerPool(2) as pool:
        dead, *others = run_beside(pool, with_a_deadly_one)
    assert isinstance(dead, Failure)
    assert dead.reason.startswith(f"{bags[0]}: deadly: the process that ran it died")
    assert [type(outcome) for outcome in others] == [RunResult, RunResult]


def test_what_a_cluster_gives_up_is_a_failure(
    bags: list[Path], with_a_deadly_one: list[Run], scheduler: str
) -> None:
    with remote_cluster(scheduler) as client:
        (dead,) = run_on(client, with_a_deadly_one[:1])
    assert isinstance(dead, Failure)
    assert dead.reason.startswith(f"{bags[0]}: KilledWorker")


def test_a_scheduler_that_is_not_there_is_one_line(
    bags: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    monkeypatch.setattr("turbseg_ros.execution._CONNECT_SECONDS", 0.5)
    assert main([str(bags[0]), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    error = capsys.readouterr().err
    assert "turbseg_evaluate: no Dask scheduler answers at tcp://127.0.0.1:9" in error


def test_without_dask_a_cluster_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    missing = re.escape(how_to_install("distributed"))
    with pytest.raises(ClusterError, match=missing), remote_cluster("tcp://x"):
        pass


def test_dask_and_jinja_are_imported_only_when_needed() -> None:
    script = (
        "import sys, turbseg_ros.cli.evaluate\n"
        "print([m for m in ('dask', 'distributed', 'jinja2') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("workers", ["1", "2"])
def test_an_interrupted_process_keeps_what_its_workers_have_done(
    workers: str, bags: list[Path], tmp_path: Path
) -> None:
    file = tmp_path / "scores.json"
    words = [*map(str, bags), "--sensitivity", *GIVEN, "--workers", workers, "--json", str(file)]
    process = subprocess.Popen(
        [sys.executable, "-m", "turbseg_ros.cli", "evaluate", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stderr is not None
        # Said when the first runs are done.
        while "runs are left" not in process.stderr.readline():
            assert process.poll() is None
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    content = json.loads(file.read_text())
    assert [scores["bag"] for scores in content["bags"]] == [str(bag) for bag in bags]
    assert content["partial"] in errors
    assert "Traceback" not in errors
