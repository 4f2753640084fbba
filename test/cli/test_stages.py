"""The picture of the method's stages."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.cli.stages import main

# Which tile shows what places move by: next to nothing, on a ground that stands still.
CLUTTER = 3
SMALL = ["-p", "resolution.processing:=160"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    stamps = [10**9 + number * 33_000_000 for number in range(24)]
    return write_drawn_bag(tmp_path_factory.mktemp("stages") / "bag", stamps)


def test_every_stage_shows_what_moves(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "docs" / "stages.png"
    assert main([str(bag), "--frame", "12", "-o", str(out), *SMALL]) == 0
    picture = cv2.imread(str(out))
    assert picture is not None
    height, width = (picture.shape[0] - 4) // 2, (picture.shape[1] - 12) // 4
    for number in range(7):
        row, column = divmod(number, 4)
        top, left = row * (height + 4), column * (width + 4)
        tile = picture[top + 40 : top + height, left : left + width]
        assert tile.std() > (1.0 if number == CLUTTER else 5.0)


@pytest.mark.parametrize("frame", [-1, 24])
def test_a_frame_that_is_not_there_is_one_line(bag: Path, tmp_path: Path, capsys, frame) -> None:
    assert main([str(bag), "--frame", str(frame), "-o", str(tmp_path / "x.png"), *SMALL]) == 2
    assert capsys.readouterr().err == f"stages: --frame {frame}: {bag} has 24 frames\n"
