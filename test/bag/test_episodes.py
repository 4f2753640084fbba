"""Bags that hold what is worth keeping, and what came before it."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from turbseg_ros.bag.episodes import Episodes, PreRoll
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.records import Record

START = 1_700_000_000 * 10**9
SECOND = 10**9


def message(second: float, topic: str = "/a", size: int = 10) -> Record:
    cdr = bytes(serialize_message(String(data="x" * size)))
    return Record(topic, "std_msgs/msg/String", at(second), cdr)


def at(second: float) -> int:
    return START + round(second * SECOND)


def seconds(bag: Path, topic: str = "/a") -> list[float]:
    return [(each.stamp_ns - START) / SECOND for each in BagReader(bag).messages([topic])]


def bags(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def test_a_bag_holds_what_was_before_what_happened_and_after(tmp_path: Path) -> None:
    ended: list[tuple[Path, int]] = []
    episodes = Episodes(
        tmp_path, 2.0, 3.0, 10**6, on_end=lambda path, count: ended.append((path, count))
    )
    for second in range(20):
        episodes.write(message(second))
        if second in (6, 7):
            episodes.happens(at(second))
    (bag,) = bags(tmp_path)
    assert bag.name == "2023-11-14T22-13-24"
    # Two seconds before the first, three after the last.
    assert seconds(bag) == [4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
    assert ended == [(bag, 7)]
    assert not episodes.recording


def test_each_time_has_a_bag_and_nothing_is_in_two(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 5.0, 1.0, 10**6)
    for second in range(12):
        episodes.write(message(second))
        if second in (3, 8):
            episodes.happens(at(second))
    episodes.close()
    first, second_bag = bags(tmp_path)
    assert seconds(first) == [0.0, 1.0, 2.0, 3.0, 4.0]
    # What was before it lies in the first bag.
    assert seconds(second_bag) == [5.0, 6.0, 7.0, 8.0, 9.0]


def test_what_is_still_written_is_complete_once_closed(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 5.0, 1.0, 10**6)
    episodes.write(message(0))
    episodes.happens(at(0))
    episodes.close()
    (bag,) = bags(tmp_path)
    assert seconds(bag) == [0.0]


def test_nothing_is_written_where_nothing_happens(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 1.0, 1.0, 10**6)
    for second in range(10):
        episodes.write(message(second))
    episodes.close()
    assert not bags(tmp_path)


def test_a_long_one_goes_on_in_another_bag(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 0.0, 100.0, 10**6, max_seconds=4.0)
    for second in range(10):
        episodes.happens(at(second))
        episodes.write(message(second))
    episodes.close()
    assert [seconds(bag) for bag in bags(tmp_path)] == [
        [0.0, 1.0, 2.0, 3.0, 4.0],
        [5.0, 6.0, 7.0, 8.0, 9.0],
    ]


def test_what_is_latched_is_in_every_bag(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 1.0, 1.0, 10**6)
    episodes.add_topic("/map", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    episodes.write(message(0, "/map"))
    for second in range(30):
        episodes.write(message(second))
        if second in (10, 20):
            episodes.happens(at(second))
    found = bags(tmp_path)
    assert [seconds(bag, "/map") for bag in found] == [[9.0], [19.0]]
    for bag in found:
        (profile,) = BagReader(bag).topics["/map"].qos
        assert profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_the_pre_roll_takes_no_more_memory_than_it_may() -> None:
    size = len(message(0).data)
    kept = PreRoll(seconds=10.0, max_bytes=5 * size)
    for second in range(5):
        kept.add(message(second))
    assert kept.cut_to is None
    for second in range(5, 9):
        kept.add(message(second))
    assert kept.cut_to == pytest.approx(4.0)
    assert [each.stamp_ns for each in kept.take()] == [at(second) for second in range(4, 9)]
    assert not kept.take()
    # One message that is larger than all of it.
    kept.add(message(9, size=10**4))
    assert not kept.take()
    assert kept.cut_to == 0.0


def test_two_bags_of_one_second_have_two_names(tmp_path: Path) -> None:
    episodes = Episodes(tmp_path, 0.0, 0.1, 10**6)
    for tenth in range(9):
        episodes.write(message(tenth / 10))
        if tenth in (1, 6):
            episodes.happens(at(tenth / 10))
            episodes.write(message(tenth / 10))
    episodes.close()
    assert len(bags(tmp_path)) == 2
