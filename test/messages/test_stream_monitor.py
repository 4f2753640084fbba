"""Judging whether a frame goes on where the one before it stopped."""

import numpy as np
import pytest

from turbseg_ros.messages.stream_monitor import Action, StreamMonitor, stamps_tell
from turbseg_ros.segmentation.frame import Frame

MS = 1_000_000
PERIOD = 40 * MS
EPOCH = 1_700_000_000 * 10**9


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


def test_goes_on_when_an_image_is_decoded_in_part():
    monitor = StreamMonitor()
    for number, (shown, whole) in enumerate([((8, 8), None), ((4, 4), (8, 8)), ((8, 8), None)]):
        stamp = number * PERIOD
        seen = Frame(stamp, np.zeros(shown, np.uint8), image_wanted=whole is None, whole=whole)
        assert monitor.judge(seen, stamp).action is Action.CONTINUE


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
    assert monitor.pause_timeout == pytest.approx(8.0)


def test_waits_a_second_at_least_for_the_next_frame(monitor):
    assert StreamMonitor().pause_timeout == 1.0
    assert monitor.pause_timeout == 1.0


def stream(monitor, stamps, arrivals, pictures=None):
    """Return the verdicts on frames, each with a picture of its own where none are given."""
    verdicts = []
    for number, (stamp, arrival) in enumerate(zip(stamps, arrivals, strict=True)):
        picture = number % 250 if pictures is None else pictures[number]
        judged = Frame(stamp, np.full((8, 8), picture, np.uint8))
        verdicts.append(monitor.judge(judged, arrival, received=EPOCH + arrival))
    return verdicts


@pytest.mark.parametrize("hz", [0.2, 0.8, 5.0, 30.0, 240.0])
@pytest.mark.parametrize("origin", [3 * 10**9, EPOCH])
def test_any_rate_is_one_stream(hz, origin):
    monitor = StreamMonitor()
    times = [round(number * 1e9 / hz) for number in range(40)]
    verdicts = stream(monitor, [origin + time for time in times], times)
    assert {verdict.action for verdict in verdicts} == {Action.CONTINUE}
    assert [verdict.frame.stamp for verdict in verdicts] == [origin + time for time in times]
    assert verdicts[-1].frame.period == pytest.approx(1 / hz)
    assert monitor.pause_timeout == pytest.approx(min(max(1.0, 10 / hz), 60.0))


@pytest.mark.parametrize("hz", [0.2, 0.8, 30.0, 240.0])
@pytest.mark.parametrize(("constant", "skipped"), [(0, 0), (77, 2), (EPOCH, 2)])
def test_stamps_that_stand_still_give_way_to_arrival(hz, constant, skipped):
    times = [round(number * 1e9 / hz) for number in range(40)]
    verdicts = stream(StreamMonitor(), [constant] * 40, times)
    # Until it is known that they are not the same message again.
    assert [v.action for v in verdicts[1 : 1 + skipped]] == [Action.SKIP] * skipped
    assert {v.action for v in verdicts[1 + skipped :]} == {Action.CONTINUE}
    stamps = [verdict.frame.stamp for verdict in verdicts]
    assert stamps[1 + skipped :] == [EPOCH + time for time in times[1 + skipped :]]
    assert stamps[0] == (constant or EPOCH)
    assert verdicts[-1].frame.period == pytest.approx(1 / hz)
    assert sum(bool(verdict.notice) for verdict in verdicts) == 1


def test_stamps_in_whole_seconds_give_way_to_arrival():
    times = [number * PERIOD for number in range(100)]
    stamps = [EPOCH + time // 10**9 * 10**9 for time in times]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert {verdict.action for verdict in verdicts[3:]} == {Action.CONTINUE}
    assert [verdict.frame.stamp for verdict in verdicts[5:]] == [EPOCH + t for t in times[5:]]


def test_stamps_that_jump_about_give_way_to_arrival():
    rng = np.random.default_rng(3)
    times = [number * PERIOD for number in range(100)]
    stamps = [EPOCH + time + int(rng.integers(-2 * PERIOD, 2 * PERIOD)) for time in times]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert all(verdict.action is Action.CONTINUE for verdict in verdicts[20:])
    assert sum(verdict.action is Action.SKIP for verdict in verdicts) <= 3


def test_a_still_picture_without_stamps_is_answered_after_a_second_at_most():
    times = [number * PERIOD for number in range(100)]
    verdicts = stream(StreamMonitor(), [0] * 100, times, pictures=[5] * 100)
    assert all(verdict.action is Action.CONTINUE for verdict in verdicts[26:])


def test_a_message_that_comes_twice_is_skipped_and_nothing_is_said():
    times = [number * PERIOD for number in range(40)]
    twice = [time for time in times for _ in range(2)]
    pictures = [number // 2 for number in range(80)]
    verdicts = stream(StreamMonitor(), [EPOCH + time for time in twice], twice, pictures)
    assert [verdict.action for verdict in verdicts] == [Action.CONTINUE, Action.SKIP] * 40
    assert not any(verdict.notice for verdict in verdicts)


def test_one_stamp_that_repeats_is_skipped_and_the_others_are_believed(monitor):
    repeated = Frame(1000 * MS, np.full((8, 8), 9, np.uint8))
    assert monitor.judge(repeated, 26 * PERIOD).action is Action.SKIP
    after = monitor.judge(frame(1080 * MS), 27 * PERIOD)
    assert (after.action, after.frame.stamp) == (Action.CONTINUE, 1080 * MS)


def test_stamps_that_are_sound_again_are_believed_again():
    times = [number * PERIOD for number in range(60)]
    stamps = [0] * 20 + [7 * 10**9 + time for time in times[20:]]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert {verdict.action for verdict in verdicts} == {Action.CONTINUE}
    assert [verdict.frame.stamp for verdict in verdicts[40:]] == stamps[40:]


def test_a_stream_that_becomes_slow_restarts_a_few_times_only(monitor):
    arrivals = [25 * PERIOD + number * 1_250 * MS for number in range(1, 12)]
    actions = [monitor.judge(frame(arrival), arrival).action for arrival in arrivals]
    assert Action.RESTART in actions[:3]
    assert set(actions[3:]) == {Action.CONTINUE}


def test_a_long_pause_does_not_make_the_monitor_patient(monitor):
    later = 25 * PERIOD + 40 * 10**9
    assert monitor.judge(frame(later), later).frame.begins_stream
    assert monitor.pause_timeout == 1.0


@pytest.mark.parametrize(
    ("stamps", "tell"),
    [([], True), ([5], True), ([1, 2, 3], True), ([0, 0, 0], False), ([7, 7, 8, 8, 8], False)],
)
def test_stamps_tell_messages_apart_where_most_differ(stamps, tell):
    assert stamps_tell(stamps) is tell


THIRTIETH = 10**9 // 30


@pytest.mark.parametrize(
    ("offset", "rate"),
    [(-150 * MS, 1.0), (37 * 10**9, 1.0), (-EPOCH + 1, 1.0), (0, 1.02)],
    ids=["stamped late", "another leap second", "since the camera began", "a clock that drifts"],
)
def test_a_clock_of_the_cameras_own_is_believed(offset, rate):
    times = [number * THIRTIETH for number in range(150)]
    stamps = [EPOCH + offset + round(time * rate) for time in times]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert {verdict.action for verdict in verdicts} == {Action.CONTINUE}
    assert [verdict.frame.stamp for verdict in verdicts] == stamps
    assert verdicts[-1].frame.period == pytest.approx(rate / 30, rel=1e-3)


def test_images_that_arrive_in_bursts_keep_the_rate_of_their_stamps():
    stamps = [EPOCH + number * THIRTIETH for number in range(150)]
    arrivals = [(number // 6 + 1) * 6 * THIRTIETH + number % 6 * MS for number in range(150)]
    verdicts = stream(StreamMonitor(), stamps, arrivals)
    assert {verdict.action for verdict in verdicts} == {Action.CONTINUE}
    assert verdicts[-1].frame.period == pytest.approx(1 / 30)


@pytest.mark.parametrize("burst", [2, 3, 4, 6])
def test_images_that_are_stamped_in_bursts_are_not_taken_for_a_fast_camera(burst):
    times = [
        (number // burst + 1) * burst * THIRTIETH + number % burst * MS for number in range(150)
    ]
    monitor = StreamMonitor()
    verdicts = stream(monitor, [EPOCH + time for time in times], times)
    assert {verdict.action for verdict in verdicts} == {Action.CONTINUE}
    assert 0.5 / 30 < verdicts[-1].frame.period < 2.1 / 30


@pytest.mark.parametrize("jump", [-120, 4.4, -2 * 10**8])
def test_a_clock_that_is_set_anew_begins_one_new_stream(jump):
    times = [number * THIRTIETH for number in range(150)]
    stamps = [EPOCH + time + round(jump * 1e9) * (time >= 2 * 10**9) for time in times]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert [verdict.action for verdict in verdicts].count(Action.RESTART) == 1
    assert Action.SKIP not in {verdict.action for verdict in verdicts}


def test_stamps_that_are_rounded_now_and_then_cost_those_that_seem_late():
    times = [number * THIRTIETH for number in range(160)]
    stamps = [EPOCH + time - 40 * MS * (number % 8 == 5) for number, time in enumerate(times)]
    verdicts = stream(StreamMonitor(), stamps, times)
    assert [verdict.action for verdict in verdicts].count(Action.SKIP) <= 20
    assert Action.RESTART not in {verdict.action for verdict in verdicts}
