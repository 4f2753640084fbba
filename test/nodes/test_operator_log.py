"""What a person reads in the log of the node."""

from __future__ import annotations

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from turbseg_ros.messages.events import Event, EventKind
from turbseg_ros.nodes.operator_log import (
    COMPRESSED_TYPE,
    IMAGE_TYPE,
    EventLog,
    InputWatch,
    incompatible_text,
    mismatch_text,
    missing_image_text,
)
from turbseg_ros.segmentation.frame import MovingObject
from turbseg_ros.throttle import ThrottledLogger

PERIOD = 100_000_000


class Log:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, text: str) -> None:
        self.lines.append(text)

    warning = info


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def entered(number: int) -> Event:
    seen = MovingObject(number, 0, (20.0, 5.0), (1.0, 0.0), 20, (0, 0, 5, 4))
    return Event(EventKind.ENTERED, number * PERIOD, seen, 0.0)


def test_the_log_tells_what_happens_in_the_events_words() -> None:
    log = Log()
    events = EventLog(ThrottledLogger(log, period=0.0))
    for event in (entered(2), Event(EventKind.CAMERA_SLEWING, PERIOD)):
        events.add(event)
    assert log.lines == ["object 2 entered at (20, 5), 5x4 px", "the camera slews"]


def test_many_objects_are_a_few_lines_and_a_count_and_hide_no_other_event() -> None:
    log, clock = Log(), Clock()
    throttled = ThrottledLogger(log, period=10.0, clock=clock, burst=5)
    events = EventLog(throttled)
    for number in range(40):
        clock.now = 0.1 * number
        events.add(entered(number))
        events.catch_up()
    assert len(log.lines) == 5
    events.add(Event(EventKind.BLINDED, PERIOD))
    assert "nothing of the picture" in log.lines[-1]
    clock.now = 10.5
    events.catch_up()
    assert log.lines[6:] == ["more happened to objects: 35"]


def test_silence_is_told_once_and_again_when_the_reason_changes() -> None:
    log = Log()
    watch = InputWatch(log)
    steps = [(1.0, "a", 0), (3.2, "a", 0), (0.1, "a", 1)]  # its first image is told elsewhere
    steps += [(3.2, "a", 9), (4.2, "a", 9), (5.2, "b", 9), (0.1, "b", 10), (0.2, "", 11)]
    for silence, reason, received in steps:
        watch.check("/image_raw", silence, 1.0, received, lambda reason=reason: reason)
    assert log.lines == [
        "no image on /image_raw for 3 s: a",
        "no image on /image_raw for 3 s: a",
        "no image on /image_raw for 5 s: b",
        "images come again on /image_raw",
    ]


def test_a_slow_camera_is_not_silent() -> None:
    log = Log()
    InputWatch(log).check("/image_raw", 8.0, 10.0, 2, lambda: "why")
    assert log.lines == []


@pytest.mark.parametrize(
    ("published", "told"),
    [
        ({}, ["nobody publishes it, nor any other image", "ROS_DOMAIN_ID"]),
        ({"/image_raw": ["sensor_msgs/msg/Joy"]}, ["/image_raw carries sensor_msgs/msg/Joy, not"]),
        ({"/image_raw": [IMAGE_TYPE]}, ["published, but nothing arrives (asked for as reliable)"]),
        (
            {"/a/mask": [IMAGE_TYPE], "/cam/image_raw": [IMAGE_TYPE], "/imu": ["x/msg/Imu"]},
            [
                "nobody publishes it; image topics: "
                f"/cam/image_raw ({IMAGE_TYPE}), /a/mask ({IMAGE_TYPE}); ",
                "-r image_raw:=/cam/image_raw -p image_transport:=raw",
            ],
        ),
        (
            {"/cam/image_raw/compressed": [COMPRESSED_TYPE]},
            ["-r image_raw:=/cam/image_raw -p image_transport:=compressed takes it"],
        ),
        ({f"/c{n}/image_raw": [IMAGE_TYPE] for n in range(20)}, [" and 12 more;"]),
    ],
    ids=["nothing", "other type", "mute", "elsewhere", "compressed", "many"],
)
def test_the_reason_names_what_to_do(published: dict[str, list[str]], told: list[str]) -> None:
    text = missing_image_text("/image_raw", IMAGE_TYPE, "reliable", published)
    assert all(part in text for part in told), text
    assert "Imu" not in text
    assert "\n" not in text


def test_the_other_transport_is_named() -> None:
    topic = "/cam/image_raw/compressed"
    text = mismatch_text(topic, IMAGE_TYPE, [COMPRESSED_TYPE])
    assert text.startswith(f"{topic} carries {COMPRESSED_TYPE}, not {IMAGE_TYPE}; take it with ")
    assert text.endswith("-r image_raw:=/cam/image_raw -p image_transport:=compressed")
    assert mismatch_text(topic, COMPRESSED_TYPE, [COMPRESSED_TYPE, IMAGE_TYPE]) == ""
    assert mismatch_text(topic, IMAGE_TYPE, []) == ""


def qos(reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )


@pytest.mark.parametrize(
    ("asked", "offered", "forced", "told"),
    [
        (qos(), [], False, ""),
        (qos(), [qos(latched=True)], False, ""),
        (qos(), [qos(reliable=False), qos()], True, ""),
        (qos(), [qos(reliable=False)], True, "-p qos.reliability:=auto takes it"),
        (
            qos(),
            [qos(reliable=False)],
            False,
            "-p qos_overrides./a.subscription.reliability:=best_effort takes it",
        ),
    ],
)
def test_what_is_asked_for_and_not_offered_is_named(
    asked: QoSProfile, offered: list[QoSProfile], forced: bool, told: str
) -> None:
    text = incompatible_text("/a", asked, offered, forced)
    assert text.endswith(told)
    assert bool(text) == bool(told)
    if told:
        published = {"/a": [IMAGE_TYPE]}
        assert missing_image_text("/a", IMAGE_TYPE, "reliable", published, text) == text


def test_a_misspelt_topic_is_answered_by_the_one_most_like_it() -> None:
    published = {"/a/image_raw": [IMAGE_TYPE], "/camera_1/imge": [IMAGE_TYPE]}
    text = missing_image_text("/camera_1/image", IMAGE_TYPE, "reliable", published)
    assert text.endswith("-r image_raw:=/camera_1/imge -p image_transport:=raw takes it")


@pytest.mark.parametrize(
    ("topic", "wanted", "carried", "arguments"),
    [
        # Not below a raw topic: the compressed topic itself is remapped.
        (
            "/c/image_raw",
            IMAGE_TYPE,
            COMPRESSED_TYPE,
            "-r image_raw:=/c/image_raw -p image_transport:=compressed "
            "-r /c/image_raw/compressed:=/c/image_raw",
        ),
        (
            "/c/image_raw/compressed",
            COMPRESSED_TYPE,
            IMAGE_TYPE,
            "-r image_raw:=/c/image_raw/compressed -p image_transport:=raw",
        ),
    ],
)
def test_a_type_where_the_other_is_expected_is_taken_by_its_transport(
    topic: str, wanted: str, carried: str, arguments: str
) -> None:
    text = mismatch_text(topic, wanted, [carried])
    assert text == f"{topic} carries {carried}, not {wanted}; take it with {arguments}"
