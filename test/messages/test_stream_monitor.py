"""Judging whether a frame goes on where the one before it stopped."""

import numpy as np
import pytest

from turbseg_ros.messages.stream_monitor import Action, StreamMonitor
from turbseg_ros.segmentation.frame import Frame

MS = 1_000_000
PERIOD = 40 * MS


def frame(stamp, size=(8, 8), dtype=np.uint8):
    return Frame(stamp, np.zeros(size, dtype))


@pytest.fixture
def monitor():
    """A monitor that has seen a second of a steady stream; the last stamp is 1000 ms."""
    monitor = StreamMonitor()
    for number in range(26):
        assert monitor.judge(frame(number * PERIOD), number * PERIOD).action is Action.CONTINUE
    return monitor


@pytest.mark.parametrize(
    ("stamp", "expected"),
    [
        (1040, Action.CONTINUE),
        (1200, Action.CONTINUE),  # frames were dropped in between
        (1990, Action.CONTINUE),
        (1000, Action.SKIP),
        (960, Action.SKIP),  # out of order
        (880, Action.SKIP),
        (870, Action.RESTART),
        (0, Action.RESTART),  # a bag that loops
        (2010, Action.RESTART),
    ],
)
def test_judges_a_frame_by_its_stamp(monitor, stamp, expected):
    assert monitor.judge(frame(stamp * MS), 26 * PERIOD).action is expected


def test_a_hole_of_dropped_frames_is_no_pause(monitor):
    assert (
        monitor.judge(frame(5000 * MS), 125 * PERIOD, after_drops=True).action is Action.CONTINUE
    )


@pytest.mark.parametrize(
    "changed", [{"size": (8, 9)}, {"size": (8, 8, 3)}, {"dtype": np.uint16}], ids=str
)
def test_restarts_on_another_size_or_type(monitor, changed):
    verdict = monitor.judge(frame(1040 * MS, **changed), 26 * PERIOD)
    assert verdict.action is Action.RESTART
    assert "8x8x1 uint8" in verdict.reason


def test_goes_on_after_a_restart(monitor):
    assert monitor.judge(frame(0), 26 * PERIOD).action is Action.RESTART
    assert monitor.judge(frame(PERIOD), 27 * PERIOD).action is Action.CONTINUE


def test_a_skipped_frame_changes_nothing(monitor):
    monitor.judge(frame(960 * MS, (4, 4)), 26 * PERIOD)
    assert monitor.judge(frame(1040 * MS), 27 * PERIOD).action is Action.CONTINUE


def test_takes_a_slow_camera_for_steady():
    monitor = StreamMonitor()
    for number in range(3):
        monitor.judge(frame(number * 800 * MS), number * 800 * MS)
    assert monitor.judge(frame(2 * 800 * MS + 7900 * MS), 0).action is Action.CONTINUE
    assert monitor.patience == pytest.approx(8.0)


def test_waits_a_second_at_least_for_the_next_frame(monitor):
    assert StreamMonitor().patience == 1.0
    assert monitor.patience == 1.0
