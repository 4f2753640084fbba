"""What the method reaches on the bags of the repository, with default parameters, is held.

After a change that makes it better, take the new floors, 0.02 below J and rounded down, and for
boxes 0.05 below hits and 0.05 above false objects, from

    turbseg_evaluate bags/*
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.evaluate import main
from turbseg_ros.evaluation.labels import LabelsByStamp, read_labels
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import segment

BAGS = Path(__file__).parents[1] / "bags"
FLOORS = {
    "normal": 0.89,
    "severe": 0.84,
    "shake": 0.83,
    "thermal": 0.79,
}
"""Least J of each bag whose objects have masks."""

LEAST_HITS, MOST_FALSE_OBJECTS = 0.95, 0.15
"""Of `far_target`, a real clip with boxes: share of frames, and objects a frame."""

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, dict[str, Any]]:
    """The scores of each bag by its name."""
    file = tmp_path_factory.mktemp("floor") / "scores.json"
    bags = sorted(path for path in BAGS.iterdir() if path.is_dir())
    assert main([*map(str, bags), "--json", str(file)]) == 0
    return {Path(each["bag"]).name: each for each in json.loads(file.read_text())["bags"]}


def test_every_bag_of_the_repository_has_a_floor(scores: Mapping[str, dict[str, Any]]) -> None:
    assert scores.keys() == {*FLOORS, "empty", "far_target"}


@pytest.mark.parametrize(("bag", "floor"), FLOORS.items())
def test_j_is_not_below_its_floor(
    bag: str, floor: float, scores: Mapping[str, dict[str, Any]]
) -> None:
    assert scores[bag]["j"] >= floor


def test_nothing_is_found_where_nothing_moves(scores: Mapping[str, dict[str, Any]]) -> None:
    assert scores["empty"]["j"] is None
    assert scores["empty"]["scored_frames"] > 0
    assert scores["empty"]["false_alarm_frames"] == 0


def test_a_real_helicopter_is_hit_and_little_else_found(
    scores: Mapping[str, dict[str, Any]],
) -> None:
    assert scores["far_target"]["hits"] >= LEAST_HITS
    assert scores["far_target"]["false_objects"] <= MOST_FALSE_OBJECTS


def test_vehicles_that_meet_take_no_pixels_of_each_other() -> None:
    reader = BagReader(BAGS / "normal")
    truth = LabelsByStamp(read_labels(reader, "/ground_truth/labels"))
    frames = BagFrames(reader, reader.find_image_topic(None))
    shared = np.zeros((3, 3), int)
    for result in segment(frames, motion_segmenter(Parameters())):
        true = truth.at(result.frame.stamp)
        assert true is not None
        np.add.at(shared, (true, result.labels), 1)
    own = shared[1:, 1:].max(axis=1)
    stolen = shared[1:, 1:].sum(axis=1) - own
    assert (own > 10_000).all()
    assert (stolen < 50).all()
