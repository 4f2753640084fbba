"""turbseg_replay with several bags: side by side, on a cluster, and what is named after which."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli import replay
from turbseg_ros.cli.replay import Replayed, ReplayJob
from turbseg_ros.execution import Failure

# A worker imports ROS 2 and OpenCV, which takes its time on a busy machine.
pytestmark = pytest.mark.timeout(240)

# Small pictures, for the sake of time.
QUICK = ["resolution.processing:=208", "resolution.detail:=208", "refine.mode:=none"]
GIVEN = [word for each in QUICK for word in ("-p", each)]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    return [
        write_drawn_bag(folder / name, [n * 33_000_000 for n in range(frames)])
        for name, frames in (("short", 4), ("long", 6))
    ]


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch) -> list[ReplayJob]:
    """The jobs that are done, in order; nothing comes of them but a line."""
    done: list[ReplayJob] = []

    def run(job: ReplayJob, progress: object) -> Replayed:
        done.append(job)
        return Replayed((f"{job.name} done",))

    monkeypatch.setattr(ReplayJob, "run", run)
    return done


def messages(path: Path) -> list[tuple[str, object]]:
    topics = ["/turbseg/labels", "/turbseg/centroids", "/turbseg/annotations"]
    return [(record.topic, record.message()) for record in BagReader(path).messages(topics)]


def test_two_workers_write_what_each_bag_alone_gives(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "missing"
    words = [str(bags[0]), str(missing), str(bags[1]), "-o", str(tmp_path / "out"), *GIVEN]
    words += ["--workers", "2", "--objects", str(tmp_path / "of_{bag}.csv")]
    assert replay.main(words) == 1
    printed = capsys.readouterr()
    assert f"turbseg_replay: no such bag: {missing}\n" in printed.err
    for bag, frames in zip(bags, (4, 6), strict=True):
        assert f"{tmp_path / 'out' / bag.name}: {frames} results" in printed.out
        assert (tmp_path / f"of_{bag.name}.csv").is_file()
        alone = tmp_path / "alone" / bag.name
        assert replay.main([str(bag), "-o", str(alone), *GIVEN]) == 0
        assert messages(tmp_path / "out" / bag.name) == messages(alone)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"short", "long"}


def test_a_scheduler_is_used_also_for_one_bag(bags: list[Path], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    with distributed.LocalCluster(
        n_workers=1,
        # A thread of the worker does the work, where no signal can be answered.
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        local_directory=tmp_path / "dask",
    ) as cluster:
        words = ["-o", str(tmp_path / "out"), *GIVEN, "--scheduler", cluster.scheduler_address]
        assert replay.main([str(bags[0]), *words]) == 0
    assert BagReader(tmp_path / "out").topics["/turbseg/labels"].message_count == 4


def test_outputs_are_named_after_their_bags(
    bags: list[Path], jobs: list[ReplayJob], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--video", "films/{bag}.mp4", "--object-pictures", "{bag}/best"]
    assert replay.main([*map(str, bags), "-o", "out", "--workers", "1", *words]) == 0
    assert [job.out for job in jobs] == [tmp_path / "out" / name for name in ("short", "long")]
    assert [job.video for job in jobs] == [Path("films/short.mp4"), Path("films/long.mp4")]
    assert [job.object_pictures for job in jobs] == [Path("short/best"), Path("long/best")]
    assert all(job.overlay is None and job.bag.is_absolute() for job in jobs)


def test_braces_in_the_names_for_one_bag_are_its_own(
    bags: list[Path], jobs: list[ReplayJob], tmp_path: Path
) -> None:
    film = tmp_path / "{bag}.mp4"
    assert replay.main([str(bags[0]), "-o", str(tmp_path / "out"), "--video", str(film)]) == 0
    assert jobs[0].video == film


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--video", "a.mp4"], "--video a.mp4 is one for several bags; put {bag} where their"),
        (["--object-pictures", "best"], "as best_{bag}"),
        (["--objects", "{bag}.txt"], "end the name in .csv or .parquet"),
        (["elsewhere/long"], "two bags are called long"),
        (["--workers", "0"], "0 is not above 0"),
    ],
)
def test_a_mistake_is_refused_before_any_bag_is_replayed(
    arguments: list[str],
    complaint: str,
    bags: list[Path],
    jobs: list[ReplayJob],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        status = replay.main([*arguments, *map(str, bags), "-o", "out"])
    except SystemExit as stop:  # as argparse refuses
        status = stop.code if isinstance(stop.code, int) else 1
    assert status == 2
    assert complaint in " ".join(capsys.readouterr().err.split())
    assert not jobs


def test_a_result_that_exists_is_refused_before_the_others_are_made(
    bags: list[Path], jobs: list[ReplayJob], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out" / "long").mkdir(parents=True)
    assert replay.main([*map(str, bags), "-o", str(tmp_path / "out")]) == 2
    assert "out/long exists already" in capsys.readouterr().err
    assert not jobs


def test_a_bag_that_is_cut_ends_the_whole_with_its_status(
    bags: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def cut(jobs: list[ReplayJob], **_: object) -> Iterator[Replayed | Failure]:
        yield Replayed((f"{jobs[0].out} is partial: interrupted",), 130, cut=True)
        raise AssertionError("the next bag was begun")

    monkeypatch.setattr("turbseg_ros.execution.run_here", cut)
    words = [*map(str, bags), "-o", str(tmp_path / "out"), "--workers", "1"]
    assert replay.main(words) == 130
    error = capsys.readouterr().err
    assert "out/short is partial: interrupted\n" in error
    assert "interrupted after 0 of 2 bags; what was begun is marked as partial" in error


def test_an_interruption_reaches_bags_that_workers_have_begun(tmp_path: Path) -> None:
    long = [
        write_drawn_bag(tmp_path / name, [n * 33_000_000 for n in range(400)])
        for name in ("one", "two")
    ]
    out = tmp_path / "out"
    words = [*map(str, long), "-o", str(out), *GIVEN, "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "turbseg_ros.cli", "replay", *words],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        # Both have begun to write.
        while len(list(out.glob(".*"))) < 2 and process.poll() is None:
            signal.sigtimedwait([], 0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=200)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "interrupted after 0 of 2 bags" in errors
    for bag in long:
        result = out / bag.name
        assert not result.exists() or "partial" in (result / "metadata.yaml").read_text()
    assert not list(out.glob(".*"))
