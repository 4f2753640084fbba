"""The table of what moved in a recording."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.exports.object_table import COLUMNS, ObjectTable
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

STEP = 100_000_000
START = 1_700_000_000_000_000_000


def results() -> list[SegmentationResult]:
    """Object 3 from frame 1 to 4, 20 pixels a second to the right; object 8 in frame 3 only."""
    made = []
    for number in range(6):
        labels = np.zeros((60, 100), np.uint16)
        if 1 <= number <= 4:
            labels[20:30, 10 + 2 * number : 22 + 2 * number] = 3
        if number == 3:
            labels[40:44, 60:63] = 8
        velocity = {3: (2.0, 0.0), 8: (0.0, 0.0)}
        objects = tuple(
            MovingObject.from_mask(labels == id, id, velocity=velocity[id], period=STEP * 1e-9)
            for id in (3, 8)
            if (labels == id).any()
        )
        image = np.where(labels > 0, 200, 50).astype(np.uint8)
        frame = Frame(START + number * STEP, image)
        motion = np.zeros((6, 9), np.float32)
        made.append(SegmentationResult(frame, labels, objects, motion, 0.0, "affine"))
    return made


def table(pictures: bool = False) -> ObjectTable:
    made = ObjectTable(pictures)
    for result in results():
        made.add(result)
    return made


def test_each_object_has_a_row() -> None:
    first, second = table().rows()
    assert first == {
        "id": 3,
        "from_s": 0.1,
        "to_s": 0.4,
        "from_stamp": START + STEP,
        "to_stamp": START + 4 * STEP,
        "frames": 4,
        "from_x": 17.5,
        "from_y": 24.5,
        "to_x": 23.5,
        "to_y": 24.5,
        "way_px": 6.0,
        "speed_px_s": 20.0,
        "width": 12,
        "height": 10,
        "area": 120,
        "picture": "",
    }
    assert (second["id"], second["frames"], second["way_px"]) == (8, 1, 0.0)


def test_the_rows_are_written_as_csv(tmp_path: Path) -> None:
    table().write(tmp_path / "objects.csv")
    with (tmp_path / "objects.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(COLUMNS)
    assert [row["id"] for row in rows] == ["3", "8"]
    assert int(rows[0]["from_stamp"]) == START + STEP


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="PyArrow is missing")
def test_the_rows_are_written_as_parquet(tmp_path: Path) -> None:
    import pyarrow.parquet  # type: ignore[import-untyped,import-not-found,unused-ignore]

    table().write(tmp_path / "objects.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "objects.parquet").to_pylist() == table().rows()


def test_an_objects_picture_shows_it(tmp_path: Path) -> None:
    made = table(pictures=True)
    made.write_pictures(tmp_path)
    names = [row["picture"] for row in made.rows()]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(map(str, names))
    picture = cv2.imread(str(tmp_path / str(names[0])), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert picture.shape == (26, 28)
    assert picture[13, 14] > 150 > 100 > picture[1, 1]


def test_a_summary_says_what_there_was() -> None:
    assert table().summary() == "2 objects moved, seen from 0.1 s to 0.4 s of 0.5 s"
    assert ObjectTable().summary() == "nothing moved"


def test_without_objects_there_is_a_head_only(tmp_path: Path) -> None:
    ObjectTable().write(tmp_path / "none.csv")
    assert (tmp_path / "none.csv").read_text() == ",".join(COLUMNS) + "\n"
