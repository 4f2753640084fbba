"""What a viewer knows: who is there, since when, and what may be set."""

from __future__ import annotations

import json
import math

import pytest

from turbseg_ros.view.state import (
    DRAWN,
    LiveParameter,
    Result,
    ShownObject,
    Status,
    Value,
    ViewState,
)

SECOND = 10**9


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def state(clock: Clock) -> ViewState:
    return ViewState(clock=clock)


def shown(number: int, *outlines: tuple[tuple[float, float], ...]) -> ShownObject:
    return ShownObject(number, "#ff0000", outlines, speed=12.0)


def status(**figures: str) -> Status:
    return Status("/turbseg", "ok", "segmenting", figures)


def test_the_size_is_that_of_the_box_around_all_outlines() -> None:
    one, other = ((10.0, 20.0), (13.0, 20.0), (13.0, 22.0)), ((8.0, 21.0),)
    assert shown(1, one, other).size == (6, 3)
    assert shown(1).size is None


def test_an_object_counts_from_where_it_was_seen_first(state: ViewState) -> None:
    state.tell_status(status())
    state.tell_result(Result(5 * SECOND, (shown(1),)))
    state.tell_result(Result(6 * SECOND, (shown(1), shown(2))))
    state.tell_result(Result(8 * SECOND, (shown(1), shown(2))))
    first, second = state.summary()["objects"]
    assert (first["id"], first["seen"], first["whole"]) == (1, 3.0, False)
    assert (second["id"], second["seen"], second["whole"]) == (2, 2.0, True)


def test_an_id_that_comes_back_counts_anew(state: ViewState) -> None:
    state.tell_status(status())
    for stamp, objects in ((1, [1]), (2, []), (3, [1]), (4, [1])):
        state.tell_result(Result(stamp * SECOND, tuple(map(shown, objects))))
    (again,) = state.summary()["objects"]
    assert (again["seen"], again["whole"]) == (1.0, True)


def test_objects_go_when_the_node_takes_them_away(state: ViewState) -> None:
    state.tell_status(status())
    state.tell_result(Result(SECOND, (shown(1),)))
    state.end_results()
    assert state.summary()["objects"] == []


def test_a_node_that_falls_silent_is_away_and_shows_no_objects(
    state: ViewState, clock: Clock
) -> None:
    assert not state.summary()["there"] and state.summary()["silent"] is None
    state.tell_status(status())
    state.tell_result(Result(SECOND, (shown(1),)))
    assert state.is_there and state.summary()["objects"]
    clock.now += 10
    assert not state.is_there
    assert state.summary()["silent"] == 10
    assert state.summary()["objects"] == []
    state.tell_status(status())
    assert state.is_there


def test_curves_hold_numbers_and_gaps(state: ViewState) -> None:
    state.tell_status(status(**{"input rate (Hz)": "29.9", "turbulence (px)": "nan"}))
    count, (point,) = state.points_since(0)
    assert dict(zip(DRAWN, point, strict=True))["input rate (Hz)"] == 29.9
    assert dict(zip(DRAWN, point, strict=True))["turbulence (px)"] is None
    assert state.points_since(count) == (1, [])


def test_curves_are_kept_for_ten_minutes(state: ViewState) -> None:
    for second in range(700):
        state.tell_status(status(**{"input rate (Hz)": str(second)}))
    count, points = state.points_since(0)
    assert (count, len(points)) == (700, 600)
    assert [point[0] for point in state.points_since(698)[1]] == [698.0, 699.0]


def test_a_summary_is_json_whatever_the_node_says(state: ViewState) -> None:
    state.tell_status(status(**{"turbulence (px)": "nan", "camera": "still"}))
    state.tell_other("/north/turbseg")
    state.tell_result(Result(SECOND, (shown(1, ((0.0, 0.0), (1.0, 1.0))),)))
    told = json.loads(json.dumps(state.summary(), allow_nan=False))
    assert told["figures"]["camera"] == "still"
    assert told["others"] == ["/north/turbseg"]


def test_whoever_listens_is_told_of_changes_once(state: ViewState) -> None:
    told: list[int] = []
    state.on_change = lambda: told.append(1)
    parameter = LiveParameter("a", "int", 1)
    state.tell_parameters([parameter])
    state.tell_parameters([parameter])
    assert len(told) == 1
    assert state.parameters == (1, (parameter,))


@pytest.mark.parametrize(
    ("kind", "given", "taken"),
    [
        ("float", 3, 3.0),
        ("float", 2.5, 2.5),
        ("int", 3.0, 3),
        ("bool", True, True),
        ("str", "auto", "auto"),
        ("list", ["a", "b"], ["a", "b"]),
    ],
)
def test_values_are_taken_in_the_parameters_type(kind: str, given: object, taken: Value) -> None:
    value = LiveParameter("a", kind, taken).checked(given)
    assert value == taken and type(value) is type(taken)


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        *[("float", value) for value in ("3", None, True, math.nan, math.inf, 10**400, [])],
        *[("int", value) for value in (2.5, "3", False, math.inf, math.nan, 2**63)],
        *[("bool", value) for value in (1, "true", None)],
        *[("str", value) for value in (1, None, True, "\ud800")],
        *[("list", value) for value in ("a", [1], ["\ud800"], {})],
        ("unknown", "x"),
    ],
)
def test_what_a_message_can_not_hold_is_refused_by_name(kind: str, given: object) -> None:
    with pytest.raises(ValueError, match=r"seed\.size can't be"):
        LiveParameter("seed.size", kind, 0).checked(given)
