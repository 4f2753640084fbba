"""From frames to a bag's scores, from those to table and JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from turbseg_ros.evaluation.scores import (
    COLUMNS,
    OBJECT_COLUMNS,
    BagScores,
    Column,
    Measurements,
    Scorer,
    Table,
    mean_scores,
    short_names,
    write_json,
)

KEYS = [
    "bag",
    "frames",
    "scored_frames",
    "j",
    "dice",
    "g",
    "boundary_f",
    "j_object",
    "false_alarm_frames",
    "false_alarm_area",
    "false_objects",
    "id_switches",
    "pixel_f",
    "hits",
    "hits_50",
    "box_iou",
    "false_object_frames",
    "false_ids",
    "ids_per_object",
    "missed",
    "mota",
    "idf1",
    "hota",
    "objects",
    "fps",
    "ms_p50",
    "ms_p95",
    "tilt_px",
    "score_bins",
]

OBJECT = np.zeros((40, 50), np.uint16)
OBJECT[10:20, 10:20] = 1
EMPTY = np.zeros_like(OBJECT)


def scored(*pairs: tuple[np.ndarray, np.ndarray], bag: str = "one") -> BagScores:
    scorer = Scorer()
    for prediction, truth in pairs:
        scorer.add(prediction, truth)
    return scorer.scores(bag, len(pairs), Measurements())


def test_overlap_is_averaged_over_frames_with_an_object() -> None:
    scores = scored((OBJECT, OBJECT), (EMPTY, OBJECT), (EMPTY, EMPTY))
    assert (scores.frames, scores.scored_frames) == (3, 3)
    assert scores.j == scores.dice == scores.g == scores.boundary_f == 0.5
    assert (scores.false_alarm_frames, scores.false_alarm_area) == (0, 0.0)


def test_g_is_the_mean_of_j_and_dice() -> None:
    half = OBJECT.copy()
    half[10:15] = 0
    scores = scored((half, OBJECT))
    assert (scores.j, scores.dice) == pytest.approx((0.5, 2 / 3))
    assert scores.g == pytest.approx((0.5 + 2 / 3) / 2)


def test_alarms_are_counted_in_frames_without_an_object() -> None:
    scores = scored((OBJECT, EMPTY), (EMPTY, EMPTY), (OBJECT, OBJECT))
    assert scores.false_alarm_frames == 1
    assert scores.false_alarm_area == pytest.approx(0.05 / 2)
    assert scores.j == 1.0


def test_false_objects_are_counted_in_every_frame_with_truth() -> None:
    stray = OBJECT.copy()
    stray[30:35, 30:35] = 2
    scores = scored((stray, OBJECT), (stray, EMPTY), (OBJECT, OBJECT))
    assert scores.false_objects == pytest.approx((1 + 2 + 0) / 3)
    # Frames with a true object are no alarms: they were not counted at all.
    assert scores.false_alarm_frames == 1


def test_a_union_truth_counts_false_objects_and_no_scores_by_object() -> None:
    union = (OBJECT * 255).astype(np.uint16)
    stray = OBJECT.copy()
    stray[30:35, 30:35] = 2
    scores = scored((stray, union))
    assert (scores.false_objects, scores.j_object) == (1.0, None)


def test_objects_that_steal_each_others_pixels_lower_the_score_by_object_only() -> None:
    truth = OBJECT.copy()
    truth[10:20, 20:30] = 2
    stolen = truth.copy()
    stolen[10:20, 15:20] = 2
    scores = scored((stolen, truth))
    assert scores.j == 1.0
    assert scores.j_object == pytest.approx((0.5 + 2 / 3) / 2)
    assert scores.without_ids().j_object is None


def test_an_object_found_in_under_a_tenth_of_its_frames_is_missed() -> None:
    truth = OBJECT.copy()
    truth[30:35, 30:35] = 2
    seldom = scored((truth, truth), *[(OBJECT, truth)] * 10)
    assert seldom.missed == 0.5
    assert {each.id: each.found for each in seldom.objects} == {1: 1.0, 2: pytest.approx(1 / 11)}
    assert scored((truth, truth), *[(OBJECT, truth)] * 9).missed == 0.0


def test_means_over_items_weigh_each_object_alike() -> None:
    two = OBJECT.copy()
    two[30:35, 30:35] = 2
    half = OBJECT.copy()
    half[10:15] = 0
    mean = mean_scores([scored((two, two)), scored((half, OBJECT))])
    assert mean["miou"] == pytest.approx((1 + 1 + 1 / 2) / 3)
    assert mean["mdice"] == pytest.approx((1 + 1 + 2 / 3) / 3)
    assert mean["j_object"] == pytest.approx((1 + 1 / 2) / 2)


def test_an_id_that_was_true_once_is_not_counted_as_false() -> None:
    stray = OBJECT.copy()
    stray[30:35, 30:35] = 2
    scores = scored((stray, OBJECT), (OBJECT, EMPTY))
    assert (scores.false_object_frames, scores.false_ids) == (2, 1)


def test_ids_per_object_leaves_out_what_was_never_found() -> None:
    truth = OBJECT.copy()
    truth[30:35, 30:35] = 2
    scores = scored((OBJECT, truth), (OBJECT * 3, truth), (OBJECT, truth))
    assert (scores.ids_per_object, scores.id_switches) == (2.0, 2)


def test_ignored_pixels_are_neither_right_nor_wrong() -> None:
    ignored = np.zeros_like(OBJECT)
    ignored[:15] = 1
    wide = OBJECT.copy()
    wide[0:10] = 2
    scorer = Scorer()
    scorer.add(wide, OBJECT, ignored)
    scores = scorer.scores("one", 1, Measurements())
    assert (scores.j, scores.pixel_f, scores.false_objects) == (1.0, 1.0, 0.0)
    scorer.add(EMPTY, OBJECT, np.ones_like(OBJECT))
    assert scorer.scores("one", 2, Measurements()).scored_frames == 1


def test_what_cannot_be_told_is_none() -> None:
    scores = scored((EMPTY, EMPTY))
    assert (scores.j, scores.dice, scores.g, scores.boundary_f) == (None,) * 4
    assert (scores.fps, scores.ms_p50, scores.ms_p95, scores.tilt_px) == (None,) * 4
    assert scored((OBJECT, OBJECT)).false_alarm_area is None


def test_truth_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="truth of 50x40 doesn't fit labels of 25x20 pixels"):
        Scorer().add(OBJECT[::2, ::2], OBJECT)


def test_measurements_sum_up_time_and_turbulence() -> None:
    measured = Measurements([0.01] * 9 + [0.1], flush_seconds=0.01, tilts=[math.nan, 0.2, 0.4])
    assert measured.fps == pytest.approx(10 / 0.2)
    assert measured.push_milliseconds(50) == pytest.approx(10.0)
    assert measured.push_milliseconds(95) == pytest.approx(59.5)
    assert measured.median_tilt == pytest.approx(0.3)


def test_means_pass_over_what_a_bag_does_not_have() -> None:
    mean = mean_scores([scored((OBJECT, OBJECT)), scored((EMPTY, EMPTY))])
    assert mean["j"] == 1.0
    assert mean["false_alarm_area"] == 0.0
    assert mean["tilt_px"] is None


def test_json_has_the_documented_keys(tmp_path: Path) -> None:
    path = tmp_path / "scores.json"
    write_json(path, [scored((OBJECT, OBJECT)), scored((EMPTY, EMPTY))], {"flow.interval": 4})
    content = json.loads(path.read_text())
    assert list(content) == ["bags", "mean", "parameters"]
    assert [list(bag) for bag in content["bags"]] == [KEYS, KEYS]
    figures = [key for key in KEYS[1:] if key not in ("objects", "score_bins")]
    assert list(content["mean"]) == [*figures, "miou", "mdice"]
    assert content["parameters"] == {"flow.interval": 4}
    assert content["bags"][1]["j"] is None
    assert [entry.name for entry in tmp_path.iterdir()] == ["scores.json"]


def test_table_lines_are_aligned() -> None:
    bags = [scored((OBJECT, OBJECT), bag="a_long_name"), scored((EMPTY, EMPTY), bag="b")]
    full = dataclasses.replace(bags[0], fps=31.25, ms_p50=9.9, ms_p95=1234.5, tilt_px=0.25)
    table = Table.of([bag.bag for bag in bags])
    lines = [table.head, table.row(full), table.row(bags[1]), table.mean([full, bags[1]])]
    assert len({len(line) for line in lines}) == 1
    assert lines[1].split()[:4] == ["a_long_name", "1", "1", "1.000"]
    assert lines[2].split()[3] == "-"
    assert lines[3].startswith("mean")


@pytest.mark.parametrize("width", [40, 80, 100, 160, 400])
@pytest.mark.parametrize("columns", [COLUMNS, OBJECT_COLUMNS])
def test_a_table_is_shared_out_to_what_the_terminal_has_room_for(
    width: int, columns: tuple[Column, ...]
) -> None:
    bags = [scored((OBJECT, OBJECT), bag=name) for name in ("in/one", "in/" + "long_" * 20)]
    full = dataclasses.replace(bags[1], fps=31.25, ms_p50=99.9, ms_p95=1234.5, tilt_px=0.25)
    whole = Table.of_bags([bag.bag for bag in bags], columns)
    parts = whole.fitted(width)
    assert [column for part in parts for column in part.columns] == list(columns)
    for part in parts:
        lines = [part.head, part.row(bags[0]), part.row(full), part.mean(bags)]
        assert len({len(line) for line in lines}) == 1
        assert len(lines[0]) <= width
        assert lines[1].startswith("one ")
        assert lines[2].startswith("long_")
    assert (len(parts) == 1) == (width == 400)


def test_usual_names_take_two_tables_of_80_columns() -> None:
    for columns in (COLUMNS, OBJECT_COLUMNS):
        table = Table.of(["mog2 stabilised"], "segmenter", columns)
        assert len(table.fitted(80)) == 2


def test_the_width_is_that_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert len(Table.of(["one"]).fitted()) == 1
    monkeypatch.setenv("COLUMNS", "80")
    assert len(Table.of(["one"]).fitted()) == 2


def test_bags_are_named_without_the_folders_that_they_share() -> None:
    assert short_names(["a/b/one", "a/b/two"]) == {"a/b/one": "one", "a/b/two": "two"}
    assert short_names(["a/one", "b/one"]) == {"a/one": "a/one", "b/one": "b/one"}
    assert short_names(["bags/one"]) == {"bags/one": "one"}
