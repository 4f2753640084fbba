"""What can't be written is refused at once, in one line, and before any work."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.cli import benchmark, demo, evaluate, import_, replay, simulate, stages, train
from turbseg_ros.overlay import write_picture

# Whatever segments, renders or reads a whole clip.
WORK = (
    "turbseg_ros.cli.replay.clip_segmenter",
    "turbseg_ros.cli.evaluate._evaluate",
    "turbseg_ros.cli.benchmark.render",
    "turbseg_ros.cli.simulate.render",
    "turbseg_ros.cli.simulate.read_labels",
    "turbseg_ros.cli.import_.find_clip",
    "turbseg_ros.cli.stages.segment",
    "turbseg_ros.cli.train.gathered",
    "turbseg_ros.cli.demo._record_live",
)
CALLS = {
    "replay -o": (replay, ["BAG", "-o", "OUTPUT"]),
    "replay --overlay": (replay, ["BAG", "-o", "NEW", "--overlay", "OUTPUT.png"]),
    "evaluate --json": (evaluate, ["BAG", "--json", "OUTPUT"]),
    "evaluate --report": (evaluate, ["BAG", "--report", "OUTPUT"]),
    "evaluate --curves": (evaluate, ["BAG", "--tilt-curve", "1", "--curves", "OUTPUT"]),
    "benchmark --json": (benchmark, ["--json", "OUTPUT"]),
    "simulate --scene": (simulate, ["--scene", "normal", "-o", "OUTPUT"]),
    "simulate all": (simulate, ["--scene", "all", "-o", "OUTPUT"]),
    "simulate --warp": (simulate, ["--warp", "BAG", "--tilt", "1", "-o", "OUTPUT"]),
    "import": (import_, ["FOLDER", "OUTPUT"]),
    "stages": (stages, ["BAG", "-o", "OUTPUT.png", "--frame", "3"]),
    "train": (train, ["-o", "OUTPUT"]),
    "demo": (demo, ["--bag", "BAG", "--out", "OUTPUT"]),
}
every_call = pytest.mark.parametrize(("module", "arguments"), CALLS.values(), ids=list(CALLS))


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """What a call may name; no work is done on any of it."""
    bag = write_drawn_bag(tmp_path / "bag", [10**9 + n * 10**8 for n in range(6)])
    folder = tmp_path / "folder"
    folder.mkdir()
    monkeypatch.setattr("turbseg_ros.cli.train.require_torch", lambda _what: None)
    for name in WORK:
        monkeypatch.setattr(name, mock.Mock(side_effect=AssertionError("work was begun")))
    return {"BAG": str(bag), "FOLDER": str(folder), "NEW": str(tmp_path / "new")}


def refusal(module, arguments, places, output, capsys) -> str:
    """Return the one line by which a call is refused."""
    named = {**places, "OUTPUT": str(output), "OUTPUT.png": f"{output}.png"}
    assert module.main([named.get(argument, argument) for argument in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err


@every_call
def test_an_output_below_a_file_is_refused_before_the_work(
    module, arguments, places, tmp_path, capsys
):
    (tmp_path / "file").touch()
    line = refusal(module, arguments, places, tmp_path / "file" / "output", capsys)
    assert str(tmp_path / "file") in line


@every_call
def test_an_output_where_nothing_can_be_written_is_refused_before_the_work(
    module, arguments, places, capsys
):
    # Not even the superuser writes there.
    line = refusal(module, arguments, places, Path("/proc/output"), capsys)
    assert "/proc" in line


@pytest.mark.parametrize(
    "name", ["replay -o", "simulate --warp", "simulate --scene", "import", "train"]
)
def test_what_is_there_already_is_not_written_over(name, places, tmp_path, capsys):
    (tmp_path / "output").mkdir()
    line = refusal(*CALLS[name], places, tmp_path / "output", capsys)
    assert "exists already; remove it or choose another output" in line


@pytest.mark.parametrize(
    "name", ["evaluate --json", "benchmark --json", "replay --overlay", "stages"]
)
def test_a_folder_in_the_place_of_a_file_is_refused_before_the_work(
    name, places, tmp_path, capsys
):
    for folder in ("output", "output.png"):
        (tmp_path / folder).mkdir()
    assert "is a folder; name a file" in refusal(*CALLS[name], places, tmp_path / "output", capsys)


@pytest.mark.parametrize("name", ["x.mp4", "x.pdf", "x", "x.jpg.txt"])
@pytest.mark.parametrize("call", ["replay --overlay", "stages"])
def test_a_picture_of_no_known_format_is_refused_before_the_work(
    call, name, places, tmp_path, capsys
):
    module, arguments = CALLS[call]
    given = [str(tmp_path / name) if word == "OUTPUT.png" else word for word in arguments]
    line = refusal(module, given, places, tmp_path, capsys)
    assert name in line and ".png, .jpg, .jpeg, " in line
    assert not (tmp_path / name).exists()


def test_a_picture_within_the_bag_to_be_written_is_refused(places, tmp_path, capsys):
    picture = str(tmp_path / "new" / "x.png")
    line = refusal(replay, ["BAG", "-o", "NEW", "--overlay", picture], places, tmp_path, capsys)
    assert "lies in the bag to be written" in line


MAGIC = {
    ".png": b"\x89PNG",
    ".jpg": b"\xff\xd8\xff",
    ".jpeg": b"\xff\xd8\xff",
    ".JPG": b"\xff\xd8\xff",
    ".webp": b"RIFF",
    ".bmp": b"BM",
    ".tif": b"II*\0",
    ".tiff": b"II*\0",
}


@pytest.mark.parametrize(("suffix", "magic"), MAGIC.items(), ids=list(MAGIC))
def test_a_picture_is_what_its_name_says(suffix, magic, tmp_path):
    if not cv2.haveImageWriter(f"x{suffix.lower()}"):
        pytest.skip(f"this OpenCV writes no {suffix}")
    path = tmp_path / f"picture{suffix}"
    drawn = np.full((40, 60, 3), (10, 200, 90), np.uint8)
    write_picture(path, drawn)
    assert path.read_bytes().startswith(magic)
    read = cv2.imread(str(path))
    assert read is not None
    assert np.abs(read.astype(int) - drawn).max() <= 4
