"""What happens in a stream of results, told once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from turbseg_ros.messages.events import (
    Event,
    EventKind,
    EventMessages,
    EventWatch,
    event_message,
)
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

PERIOD = 100_000_000
SIDE = 20


def result(
    number: int,
    *objects: MovingObject,
    camera: CameraState = CameraState.STILL,
    condition: Condition = Condition.SOUND,
) -> SegmentationResult:
    empty = SegmentationResult.empty(Frame(number * PERIOD, np.zeros((8, 9), np.uint8), "lens"))
    return replace(empty, objects=objects, camera=camera, condition=condition)


def seen(id: int, *way: float) -> MovingObject:
    """An object that has come along x by `way`, one place a frame."""
    trail = tuple((x, 5.0) for x in way)
    return MovingObject(id, 0, (way[-1], 5.0), (0.0, 0.0), SIDE**2, (0, 0, SIDE, SIDE), trail)


def along(places: Iterable[float], max_age: int = 3) -> list[tuple[EventKind, int]]:
    """Return what happens, and in which frame, to an object that is at places along x."""
    watch, way, told = EventWatch(lambda: max_age), list[float](), []
    for number, place in enumerate(places):
        way.append(place)
        told += watch.events(result(number, seen(1, *way)))
    return [(event.kind, event.stamp // PERIOD) for event in told]


def kinds(results: Iterable[SegmentationResult], max_age: int = 3) -> list[str]:
    watch = EventWatch(lambda: max_age)
    return [event.kind.value for each in results for event in watch.events(each)]


def test_objects_enter_and_leave_once_though_they_hide() -> None:
    watch, told = EventWatch(lambda: 3), list[Event]()
    # Object 2 is hidden for as long as it may be.
    for number, ids in enumerate(
        [(), (2,), (2,), (), (), (), (2,), (2, 3), (3,), (3,), (3,), (3,)]
    ):
        told += watch.events(result(number, *(seen(id, 10.0 * id) for id in ids)))
    assert [event.text for event in told] == [
        "object 2 entered at (20, 5), 20x20 px",
        "object 3 entered at (30, 5), 20x20 px",
        "object 2 left at (20, 5), seen for 0.6 s",
    ]
    # It left when it was seen last, not when that was certain.
    assert told[-1].stamp == 7 * PERIOD


def test_what_is_there_has_left_when_the_stream_ends() -> None:
    told: list[Event] = []
    messages = EventMessages(EventWatch(lambda: 3), tell=told.append)
    last = result(0, seen(4, 1.0))
    assert [message.name for message in messages.messages(last)] == ["entered"]
    (left,) = messages.removal(last.frame)
    assert (left.name, left.hardware_id) == ("left", "lens")
    assert not messages.removal(last.frame)
    assert [event.kind.value for event in told] == ["entered", "left"]


def test_an_object_stops_and_moves_again() -> None:
    moves, stands = [2.0 * n for n in range(10)], [18.0] * 10
    again = [18.0 + 2.0 * n for n in range(1, 8)]
    told = along([*moves, *stands, *again])
    assert [kind for kind, _ in told] == [EventKind.ENTERED, EventKind.STOPPED, EventKind.MOVING]
    # Half a second after it stood still, and once it has come an eighth of its size.
    assert told[1][1] == pytest.approx(14, abs=1)
    assert told[2][1] == pytest.approx(21, abs=1)


def test_what_jitters_neither_stops_nor_moves_again_and_again() -> None:
    jitters = [18.0 + 1.4 * (n % 2) for n in range(40)]
    told = along([*(2.0 * n for n in range(10)), *jitters])
    assert [kind for kind, _ in told] == [EventKind.ENTERED, EventKind.STOPPED]


def test_what_is_small_and_slow_does_not_stop() -> None:
    assert [kind for kind, _ in along(0.4 * n for n in range(40))] == [EventKind.ENTERED]


def test_coming_out_of_hiding_is_no_stop() -> None:
    watch = EventWatch(lambda: 30)
    way = [2.0 * n for n in range(10)]
    results = [result(n, seen(1, *way[: n + 1])) for n in range(8)]
    results += [result(n) for n in range(8, 18)]
    # Its trail has a place for each frame in which it was seen.
    results.append(result(18, seen(1, *way[:8], 36.0)))
    results.append(result(19, seen(1, *way[:8], 36.0, 36.5)))
    told = [event.kind for each in results for event in watch.events(each)]
    assert told == [EventKind.ENTERED]


def test_what_stood_for_long_becomes_background_once_and_does_not_leave() -> None:
    watch, told = EventWatch(lambda: 3), list[Event]()
    way = [2.0 * n for n in range(10)]
    last = result(10, replace(seen(1, *way), absorbed=True))
    # The frame that it is told of is repeated.
    for each in [*(result(n, seen(1, *way[: n + 1])) for n in range(10)), last, last]:
        told += watch.events(each)
    told += [event for n in range(11, 20) for event in watch.events(result(n))]
    assert [event.kind.value for event in told] == ["entered", "background"]
    assert told[1].stamp == 10 * PERIOD
    assert told[1].text == (
        "object 1 stands for so long that it is background at (18, 5), seen for 1.0 s"
    )
    assert not watch.end()


def states(*spans: tuple[CameraState, int]) -> list[SegmentationResult]:
    each = [state for state, frames in spans for _ in range(frames)]
    return [result(number, camera=state) for number, state in enumerate(each)]


def test_the_camera_is_told_of_once_it_has_done_so_for_a_while() -> None:
    assert not kinds(states((CameraState.STILL, 20)))
    assert not kinds(states((CameraState.STILL, 9), (CameraState.LOST, 3), (CameraState.STILL, 9)))
    assert kinds(
        states((CameraState.STILL, 9), (CameraState.FOLLOWING, 9), (CameraState.LOST, 9))
    ) == ["camera_following", "camera_lost"]


def test_a_slew_is_told_at_once() -> None:
    told = kinds(states((CameraState.STILL, 9), (CameraState.SLEWING, 2), (CameraState.STILL, 9)))
    assert told == ["camera_slewing", "camera_still"]


def test_blindness_is_told_once_and_what_the_camera_does_when_it_sees_again() -> None:
    blind: Callable[[int], SegmentationResult] = lambda number: result(  # noqa: E731
        number, camera=CameraState.LOST, condition=Condition.BLIND
    )
    flickers = [blind(n) if n % 2 else result(n) for n in range(10)]
    assert kinds([*flickers, *(result(n) for n in range(10, 30))]) == ["blinded", "camera_still"]
    sees = [result(n) for n in range(10, 30)]
    assert kinds([blind(0), *sees, blind(30)]) == ["blinded", "camera_still", "blinded"]


def test_the_message_names_the_event_and_says_where() -> None:
    found = replace(seen(7, 10.25), box=(1, 2, 3, 4))
    message = event_message(Event(EventKind.ENTERED, 12 * 10**9 + 34, found, 0.0), "lens")
    assert (message.name, message.level) == ("entered", DiagnosticStatus.OK)
    assert message.message == "object 7 entered at (10, 5), 3x4 px"
    assert {value.key: value.value for value in message.values} == {
        "id": "7",
        "stamp": "12.000000034",
        "box": "1,2,3,4",
        "place": "10.2,5.0",
    }
    blinded = event_message(Event(EventKind.BLINDED, 10**9))
    assert (blinded.name, blinded.level) == ("blinded", DiagnosticStatus.WARN)
    assert [value.key for value in blinded.values] == ["stamp"]
