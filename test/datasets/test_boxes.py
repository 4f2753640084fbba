"""True boxes and still regions of data sets, and what becomes of them in a bag."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.import_ import main
from turbseg_ros.datasets.boxes import read_boxes
from turbseg_ros.datasets.regions import read_region
from turbseg_ros.messages.detections import (
    IGNORED,
    Detection,
    detections_from,
    serialised_detections,
)
from turbseg_ros.messages.images import image_from_message
from turbseg_ros.parameters import ParameterError

SHAPE = (20, 30)
LISTS = {"near": [[1, 2, 3, 4], None, [5, 6, 7, 8]], "far": [None]}
COCO = {
    "videos": [{"id": 4, "name": "far"}, {"id": 5, "name": "near"}],
    "images": [
        {"id": 10, "video_id": 5, "frame_id": 1},
        {"id": 11, "video_id": 5, "frame_id": 0},
        {"id": 12, "video_id": 4, "frame_id": 0},
    ],
    "annotations": [
        {"id": 1, "image_id": 10, "bbox": [1, 2, 3, 4], "instance_id": 8, "category_id": 2},
        {"id": 2, "image_id": 11, "bbox": [5, 6, 7, 8], "track_id": 9, "iscrowd": 1},
        {"id": 3, "image_id": 12, "bbox": [9, 9, 9, 9]},
    ],
    "categories": [{"id": 2, "name": "bird"}],
}
MOT = """1,4,1,2,3,4,1,1,1.0
3, 5, 5.5, 6, 7, 8, 1

3,6,9,9,9,9,0,1,0.2
"""


def written(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_motchallenge_text_counts_frames_from_one(tmp_path: Path) -> None:
    truth = read_boxes(written(tmp_path / "gt.txt", MOT), "any")
    assert truth.at(0) == (Detection((1, 2, 3, 4), "4"),)
    assert truth.at(1) == ()
    assert truth.at(2) == (
        Detection((5.5, 6, 7, 8), "5"),
        Detection((9, 9, 9, 9), "6", IGNORED),
    )


def test_coco_vid_gives_the_boxes_of_the_clip_in_the_order_of_its_frames(tmp_path: Path) -> None:
    truth = read_boxes(written(tmp_path / "vid.json", COCO), "near")
    assert truth.at(0) == (Detection((5, 6, 7, 8), "9", IGNORED),)
    assert truth.at(1) == (Detection((1, 2, 3, 4), "8", "bird"),)
    assert truth.frames == 2


def test_lists_have_a_box_or_nothing_a_frame(tmp_path: Path) -> None:
    truth = read_boxes(written(tmp_path / "boxes.json", LISTS), "near")
    assert [truth.at(number) for number in range(4)] == [
        (Detection((1, 2, 3, 4), "1"),),
        (),
        (Detection((5, 6, 7, 8), "1"),),
        None,
    ]


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("gt.txt", "1,4,1,2,3", "line 1: too few columns"),
        ("gt.txt", "1,4,1,2,3,4\n0,4,1,2,3,4", "line 2: frames count from 1"),
        ("gt.txt", "1,4,1,2,-3,4", "line 1: no box"),
        ("gt.txt", "one,4,1,2,3,4", "line 1: could not convert"),
        ("boxes.json", "{", "holds no boxes"),
        ("boxes.json", [1, 2], "holds no boxes"),
        ("boxes.json", {"near": [[1, 2]]}, "holds no boxes"),
        ("boxes.json", {"north": [], "south": []}, "no clips called near"),
        ("vid.json", {"images": [{}], "annotations": []}, "holds no boxes"),
        # No field of text may be as long as these for Python's reader of CSV.
        ("gt.txt", "x" * 200_000, "line 1: too few columns"),
        ("gt.txt", "1,4,1,2,1e308,1.7e308", "line 1: no box"),
        ("boxes.json", {"near": [[10**400, 2, 3, 4]]}, "holds no boxes"),
        ("boxes.json", {"near": [[1e308, 2, 1.7e308, 4]]}, "holds no boxes"),
    ],
)
def test_what_holds_no_boxes_is_refused(
    tmp_path: Path, name: str, content: Any, complaint: str
) -> None:
    with pytest.raises(ClipError, match=complaint):
        read_boxes(written(tmp_path / name, content), "near")


def test_names_that_are_no_text_are_written_as_text(tmp_path: Path) -> None:
    # Half of a character, as JSON may hold it.
    odd = {"id": 1, "image_id": 10, "bbox": [1, 2, 3, 4], "instance_id": "a\ud800"}
    content = {"images": [{"id": 10}], "annotations": [odd]}
    boxes = read_boxes(written(tmp_path / "vid.json", content), "near").at(0)
    assert boxes is not None
    _, read = detections_from(memoryview(serialised_detections(boxes, 0)))
    assert [each.id for each in read] == ["a?"]


def polygons(*corners: list[list[float]], kind: str = "include") -> dict[str, Any]:
    return {
        "image_size": [SHAPE[1], SHAPE[0]],
        "regions": [{"kind": kind, "polygon": polygon} for polygon in corners],
    }


def test_a_region_is_a_picture_or_polygons(tmp_path: Path) -> None:
    picture = np.zeros(SHAPE, np.uint8)
    picture[2:5, 3:9] = 255
    cv2.imwrite(str(tmp_path / "still.png"), picture)
    corners: list[list[float]] = [[3, 2], [9, 2], [9, 5], [3, 5]]
    included = written(tmp_path / "still.json", polygons(corners))
    ignored = written(tmp_path / "moving.json", polygons(corners, kind="ignore"))
    drawn = read_region(included, SHAPE)
    np.testing.assert_array_equal(read_region(tmp_path / "still.png", SHAPE), picture != 0)
    assert np.count_nonzero(drawn != (picture != 0)) <= 10  # of the border's pixels
    np.testing.assert_array_equal(read_region(ignored, SHAPE), ~drawn)


@pytest.mark.parametrize("name", ["still.json", "still.yaml", "still.png"])
def test_what_is_no_region_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ParameterError, match=name):
        read_region(written(tmp_path / name, "[1, 2]"), SHAPE)


def test_a_region_of_another_size_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "still.png"), np.full((4, 5), 255, np.uint8))
    with pytest.raises(ClipError, match="is 5x4, the frames 30x20"):
        read_region(tmp_path / "still.png", SHAPE)


def write_frames(folder: Path, count: int) -> Path:
    folder.mkdir(parents=True)
    for number in range(count):
        cv2.imwrite(str(folder / f"{number}.png"), np.full(SHAPE, 10 * number, np.uint8))
    return folder


def boxes_of(bag: Path) -> list[tuple[Detection, ...]]:
    records = BagReader(bag).messages(["/ground_truth/detections"])
    return [detections_from(memoryview(record.data))[1] for record in records]


def ignored_of(bag: Path) -> list[np.ndarray]:
    records = BagReader(bag).messages(["/ground_truth/ignored"])
    return [image_from_message(record.message()) for record in records]


def test_boxes_of_a_clip_are_found_by_its_name_and_lie_beside_its_frames(tmp_path: Path) -> None:
    frames = write_frames(tmp_path / "near" / "frames", 4)
    file = written(tmp_path / "boxes.json", LISTS)
    assert main([str(frames), str(tmp_path / "bag"), "--boxes", str(file)]) == 0
    near = (Detection((1, 2, 3, 4), "1"),)
    # Of the fourth frame the file doesn't tell.
    assert boxes_of(tmp_path / "bag") == [near, (), (Detection((5, 6, 7, 8), "1"),)]
    assert ignored_of(tmp_path / "bag") == []
    assert BagReader(tmp_path / "bag").find_image_topic() == "/camera/image_raw"


def test_a_part_of_a_clip_keeps_its_boxes(tmp_path: Path) -> None:
    frames = write_frames(tmp_path / "near" / "frames", 3)
    file = written(tmp_path / "boxes.json", LISTS)
    words = [str(frames), str(tmp_path / "bag"), "--boxes", str(file)]
    assert main([*words, "--skip", "1", "--frames", "2", "--partial-truth"]) == 0
    assert boxes_of(tmp_path / "bag") == [(), (Detection((5, 6, 7, 8), "1"),)]
    (ignored,) = ignored_of(tmp_path / "bag")
    assert ignored.shape == SHAPE
    assert ignored.all()


def test_boxes_of_a_longer_clip_are_refused(tmp_path: Path, capsys: Any) -> None:
    frames = write_frames(tmp_path / "near" / "frames", 2)
    file = written(tmp_path / "boxes.json", LISTS)
    assert main([str(frames), str(tmp_path / "bag"), "--boxes", str(file)]) == 2
    assert "boxes for 3 frames, the clip has 2" in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


def test_where_nothing_moves_truth_is_empty_and_the_rest_is_ignored(tmp_path: Path) -> None:
    frames = write_frames(tmp_path / "frames", 2)
    top: list[list[float]] = [[0, 0], [30, 0], [30, 10], [0, 10]]
    still = written(tmp_path / "still.json", polygons(top))
    assert main([str(frames), str(tmp_path / "part"), "--still", str(still)]) == 0
    assert boxes_of(tmp_path / "part") == [(), ()]
    (ignored,) = ignored_of(tmp_path / "part")
    assert not ignored[:9].any()
    assert ignored[11:].all()
    assert main([str(frames), str(tmp_path / "whole"), "--still", "all"]) == 0
    assert boxes_of(tmp_path / "whole") == [(), ()]
    assert ignored_of(tmp_path / "whole") == []


def test_what_is_said_of_boxes_needs_boxes(tmp_path: Path, capsys: Any) -> None:
    frames = write_frames(tmp_path / "frames", 2)
    assert main([str(frames), str(tmp_path / "bag"), "--partial-truth"]) == 2
    assert "say something of --boxes" in capsys.readouterr().err
