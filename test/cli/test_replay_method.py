"""The method itself through turbseg_replay, on a bag that is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import LABELS_TOPIC
from turbseg_ros.cli import evaluate, replay
from turbseg_ros.evaluation.labels import read_labels

STAMPS = [number * 33_000_000 for number in range(20)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drawn_bag(tmp_path_factory.mktemp("drawn") / "bag", STAMPS)


def replayed(bag: Path, out: Path, *options: str) -> list[tuple[int, bytes]]:
    assert replay.main([str(bag), "-o", str(out), *options]) == 0
    labels = read_labels(BagReader(out), LABELS_TOPIC)
    return [(item.stamp, item.labels.tobytes()) for item in labels]


def test_two_replays_give_the_same_labels(bag: Path, tmp_path: Path) -> None:
    first, second = replayed(bag, tmp_path / "first"), replayed(bag, tmp_path / "second")
    assert [stamp for stamp, _ in first] == STAMPS
    assert any(any(labels) for _, labels in first)
    assert first == second


def test_on_one_thread_and_on_two_the_labels_are_the_same(bag: Path, tmp_path: Path) -> None:
    one, two = (
        replayed(bag, tmp_path / f"out_{threads}", "-p", f"threads:={threads}")
        for threads in (1, 2)
    )
    assert any(any(labels) for _, labels in one)
    assert one == two


def test_replayed_labels_score_as_the_evaluation_says(bag: Path, tmp_path: Path) -> None:
    replayed(bag, tmp_path / "out")
    direct, recorded = tmp_path / "direct.json", tmp_path / "recorded.json"
    evaluate.main([str(bag), "--json", str(direct)])
    arguments = ["--predictions", str(tmp_path / "out"), "--json", str(recorded)]
    evaluate.main([str(bag), *arguments])
    assert quality(direct) == quality(recorded)


@pytest.fixture
def regions(tmp_path: Path) -> str:
    file = tmp_path / "regions.yaml"
    # What the square goes over at last.
    file.write_text("regions: [{name: last, polygon: [[0.4, 0], [1, 0], [1, 1], [0.4, 1]]}]")
    return f"regions.file:={file}"


def test_regions_are_ignored_alike_in_replay_and_evaluation(
    bag: Path, tmp_path: Path, regions: str
) -> None:
    everywhere = replayed(bag, tmp_path / "everywhere")
    watched = replayed(bag, tmp_path / "out", "-p", regions)
    assert any(any(labels) for _, labels in watched)
    assert watched != everywhere
    direct, recorded = tmp_path / "direct.json", tmp_path / "recorded.json"
    evaluate.main([str(bag), "--json", str(direct), "-p", regions])
    arguments = ["--predictions", str(tmp_path / "out"), "--json", str(recorded)]
    evaluate.main([str(bag), *arguments, "-p", regions])
    assert quality(direct) == quality(recorded)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("regions.file", "regions: [{polygon: [[0, 0]]}]", "a polygon has 3 to 500 corners"),
        (
            "regions.file",
            "image_size: [9, 90]\nregions: [{polygon: [[0, 0], [9, 0], [9, 9]]}]",
            "9x",
        ),
        ("regions.ignore", "no picture", "not a picture"),
        ("regions.include", None, "No such file or directory"),
    ],
)
@pytest.mark.parametrize("executable", ["replay", "evaluate"])
def test_regions_that_are_wrong_are_one_line(
    executable: str,
    name: str,
    content: str | None,
    said: str,
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "given"
    if content is not None:
        file.write_text(content)
    arguments = [str(bag), "-p", f"{name}:={file}"]
    if executable == "replay":
        status = replay.main([*arguments, "-o", str(tmp_path / "out")])
    else:
        status = evaluate.main(arguments)
    (line,) = capsys.readouterr().err.strip().splitlines()
    # What an evaluation fails in may be one of many bags.
    assert status == {"replay": 2, "evaluate": 1}[executable]
    assert line.startswith(f"turbseg_{executable}: parameter {name}: {file}: ")
    assert said in line
    assert not (tmp_path / "out").exists()


def quality(file: Path) -> dict[str, object]:
    (scores,) = json.loads(file.read_text())["bags"]
    return {name: scores[name] for name in ("frames", "j", "dice", "boundary_f", "id_switches")}
