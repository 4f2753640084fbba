"""Times in serialised messages."""

from __future__ import annotations

from typing import Any

import pytest
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header, String
from visualization_msgs.msg import ImageMarker, Marker, MarkerArray

from turbseg_ros.bag.stamps import header_stamp, restamped

SECOND = 10**9


def header(sec: int = 3, nanosec: int = 5) -> Header:
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id="lens")


def marker(stamped: Header) -> Marker:
    points = [Point(x=1.0, y=2.0)]
    return Marker(header=stamped, ns="a", lifetime=Duration(sec=7), points=points)


MESSAGES = [
    Image(header=header(), height=1, width=2, encoding="mono8", step=2, data=b"ab"),
    CompressedImage(header=header(), format="png", data=b"abc"),
    CameraInfo(header=header(), width=5, k=[1.5] * 9),
    ImageMarker(header=header(), lifetime=Duration(sec=7)),
    MarkerArray(markers=[marker(header()), marker(header())]),
    Clock(clock=Time(sec=3, nanosec=5)),
]


def changed_by_hand(message: Any, sec: int, nanosec: int) -> Any:
    """Return the message with its times set, by its fields' names."""
    copy = deserialize_message(serialize_message(message), type(message))
    for headed in getattr(copy, "markers", [copy]):
        time = headed.clock if isinstance(headed, Clock) else headed.header.stamp
        time.sec, time.nanosec = sec, nanosec
    return copy


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
@given(added=st.integers(-20 * SECOND, 10**18))
def test_all_times_change_and_nothing_else(message: Any, added: int) -> None:
    changed = restamped(serialize_message(message), type(message), lambda time: time + added)
    expected = changed_by_hand(message, *divmod(3 * SECOND + 5 + added, SECOND))
    assert deserialize_message(changed, type(message)) == expected


def test_messages_without_a_time_stay_to_the_byte() -> None:
    cdr = serialize_message(String(data="word"))
    assert restamped(cdr, String, lambda _: 1) == cdr


def test_what_is_not_set_stays_but_for_the_leading_header() -> None:
    array = MarkerArray(markers=[marker(header(0, 0))])
    cdr = restamped(serialize_message(array), MarkerArray, lambda _: SECOND)
    assert deserialize_message(cdr, MarkerArray) == array
    image = Image(header=header(0, 0))
    cdr = restamped(serialize_message(image), Image, lambda _: SECOND)
    assert deserialize_message(cdr, Image).header.stamp == Time(sec=1)


def test_big_endian_data_are_changed_in_their_own_order() -> None:
    cdr = b"\x00\x00\x00\x00" + (3).to_bytes(4, "big") + (5).to_bytes(4, "big") + bytes(40)
    changed = restamped(cdr, Image, lambda time: time + SECOND)
    assert changed[4:12] == (4).to_bytes(4, "big") + (5).to_bytes(4, "big")
    assert header_stamp(changed, Image) == 4 * SECOND + 5


@pytest.mark.parametrize("kind", [Image, MarkerArray], ids=lambda kind: kind.__name__)
@given(cdr=st.binary(max_size=11))
def test_damaged_data_are_left_as_they_are(kind: type[Any], cdr: bytes) -> None:
    assert restamped(cdr, kind, lambda time: time + SECOND) == cdr


def test_a_time_that_no_message_can_carry_is_not_written() -> None:
    cdr = serialize_message(MESSAGES[0])
    assert restamped(cdr, Image, lambda _: 2**31 * SECOND) == cdr


def test_only_messages_that_begin_with_a_header_have_its_stamp() -> None:
    assert header_stamp(serialize_message(MESSAGES[0]), Image) == 3 * SECOND + 5
    assert header_stamp(serialize_message(MESSAGES[4]), MarkerArray) is None
