"""Files of regions: what is drawn is what is read, and what is in them stays."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from turbseg_ros.parameters import ParameterError
from turbseg_ros.view.regions import RegionFile

TRIANGLE = [[0.1, 0.2], [0.5, 0.2], [0.5, 0.9]]
ROAD = {"name": "road", "kind": "ignore", "polygon": TRIANGLE}


@pytest.fixture
def file(tmp_path: Path) -> RegionFile:
    return RegionFile(tmp_path / "regions.yaml")


def test_without_a_file_there_are_no_regions(file: RegionFile) -> None:
    assert file.read() == []


def test_regions_are_written_in_pixels_and_read_in_fractions(file: RegionFile) -> None:
    file.write([ROAD], (400, 200))
    tree = yaml.safe_load(file.path.read_text())
    assert tree["image_size"] == [400, 200]
    (region,) = tree["regions"]
    assert region["polygon"] == [[40.0, 40.0], [200.0, 40.0], [200.0, 180.0]]
    (read,) = file.read()
    assert read["name"] == "road" and read["kind"] == "ignore"
    for given, found in zip(TRIANGLE, read["polygon"], strict=True):
        assert found == pytest.approx(given, abs=1e-3)


def test_a_file_whose_name_says_so_is_json(tmp_path: Path) -> None:
    file = RegionFile(tmp_path / "regions.JSON")
    file.write([{**ROAD, "name": "straße"}], None)
    assert json.loads(file.path.read_text())["regions"][0]["name"] == "straße"
    assert file.read()[0]["name"] == "straße"


def test_without_a_picture_corners_stay_fractions(file: RegionFile) -> None:
    file.write([ROAD], None)
    assert "image_size" not in yaml.safe_load(file.path.read_text())
    assert file.read() == [ROAD]


def test_corners_at_the_edge_stay_in_the_picture(file: RegionFile) -> None:
    whole = {"name": "all", "kind": "include", "polygon": [[0, 0], [1, 0], [1, 1], [0, 1]]}
    file.write([whole], (640, 480))
    (region,) = yaml.safe_load(file.path.read_text())["regions"]
    assert all(0 <= x <= 640 and 0 <= y <= 480 for x, y in region["polygon"])
    file.write(file.read(), (640, 480))
    (again,) = yaml.safe_load(file.path.read_text())["regions"]
    assert again == region


def test_a_files_own_size_and_limits_are_kept(file: RegionFile) -> None:
    file.path.write_text(
        "image_size: [100, 50]\nregions:\n"
        "- {name: gate, kind: include, polygon: [[0, 0], [9, 0], [9, 9]], min_size: 4}\n"
    )
    file.write(file.read(), (400, 200))
    tree = yaml.safe_load(file.path.read_text())
    assert tree["image_size"] == [100, 50]
    assert tree["regions"][0]["min_size"] == 4
    assert tree["regions"][0]["polygon"] == [[0, 0], [9, 0], [9, 9]]


def test_regions_without_a_name_get_one(file: RegionFile) -> None:
    file.path.write_text("regions: [{polygon: [[0, 0], [1, 0], [1, 1]]}]")
    assert file.read()[0]["name"] == "region 1"
    assert file.read()[0]["kind"] == "ignore"


@pytest.mark.parametrize(
    "text", ["", "regions: 3", "- 1", "{", "image_size: 3\nregions: []", "\xff\x00"]
)
def test_another_file_is_refused_and_not_overwritten(file: RegionFile, text: str) -> None:
    file.path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ParameterError, match=r"regions\.yaml: "):
        file.read()
    with pytest.raises(ParameterError):
        file.write([ROAD], (640, 480))
    assert file.path.read_bytes() == text.encode("latin-1")


@pytest.mark.parametrize(
    "regions",
    [
        None,
        "road",
        [3],
        [ROAD] * 101,
        [{**ROAD, "kind": "watch"}],
        [{**ROAD, "name": "two\nlines"}],
        [{**ROAD, "name": "n" * 61}],
        [{**ROAD, "polygon": TRIANGLE[:2]}],
        [{**ROAD, "polygon": [[0.5, 0.5]] * 501}],
        [{**ROAD, "polygon": [*TRIANGLE, [1.1, 0.5]]}],
        [{**ROAD, "polygon": [*TRIANGLE, [math.nan, 0.5]]}],
        [{**ROAD, "polygon": [*TRIANGLE, [0.5]]}],
        [{**ROAD, "polygon": [*TRIANGLE, ["a", "b"]]}],
        [{**ROAD, "polygon": "corners"}],
        [{**ROAD, "polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}],
        [{**ROAD, "min_size": -1}],
    ],
)
def test_what_is_no_region_is_refused_in_one_line_before_anything_is_written(
    file: RegionFile, regions: Any
) -> None:
    with pytest.raises(ParameterError) as refused:
        file.write(regions, (640, 480))
    assert "\n" not in str(refused.value)
    assert not file.path.exists()


def test_nothing_but_the_file_is_left_behind(file: RegionFile) -> None:
    file.write([ROAD], None)
    file.write([], None)
    assert [path.name for path in file.path.parent.iterdir()] == ["regions.yaml"]
    assert file.read() == []
