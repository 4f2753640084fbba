from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import SetBool

from support.node_harness import BEST_EFFORT, TIMEOUT, Probe
from turbseg_ros.bag.records import Record, Topic
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.play import main
from turbseg_ros.messages.images import image_from_message, message_from_image, stamp_to_ns
from turbseg_ros.nodes.player import Extent, Timeline, lossless_qos, recorded_qos

SECOND = 10**9
FRAMES = 15
PERIOD = SECOND // 30
IMAGES = "/camera/image_raw"


class SteadyClock:
    def __init__(self) -> None:
        self.now = 12345

    def __call__(self) -> int:
        return self.now


@given(st.floats(0.01, 100), st.integers(0, 2**60), st.integers(0, 10**12))
def test_time_runs_at_its_rate(rate, start, passed):
    clock = SteadyClock()
    timeline = Timeline(rate, steady_ns=clock)
    timeline.set(start)
    clock.now += passed
    assert timeline.stamp_ns() == start + round(passed * rate)
    assert timeline.seconds_until(start) == pytest.approx(-passed * 1e-9, abs=1e-7)


def test_time_stands_still_while_paused():
    clock = SteadyClock()
    timeline = Timeline(2.0, steady_ns=clock)
    timeline.set(100)
    clock.now += 50
    timeline.pause(True)
    clock.now += 10**12
    assert timeline.stamp_ns() == 200
    assert timeline.seconds_until(0) == float("inf")
    timeline.pause(False)
    clock.now += 50
    assert timeline.stamp_ns() == 300


def topic_of(*profiles: QoSProfile) -> Topic:
    return Topic("/topic", "std_msgs/msg/String", 1, profiles)


HASTY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
STEADY = QoSProfile(depth=7, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_every_topic_is_offered_reliably_and_latched_where_it_was():
    for profiles in ((), (HASTY,), (LATCHED, HASTY)):
        qos = lossless_qos(topic_of(*profiles))
        assert qos.reliability == ReliabilityPolicy.RELIABLE
        assert qos.durability == DurabilityPolicy.VOLATILE
    qos = lossless_qos(topic_of(LATCHED))
    assert (qos.durability, qos.depth) == (DurabilityPolicy.TRANSIENT_LOCAL, 3)


def test_the_recorded_qos_is_what_all_recorded_publishers_offered():
    assert recorded_qos(topic_of(HASTY)).reliability == ReliabilityPolicy.BEST_EFFORT
    assert recorded_qos(topic_of(STEADY, HASTY)).reliability == ReliabilityPolicy.BEST_EFFORT
    steady = recorded_qos(topic_of(STEADY))
    assert (steady.reliability, steady.depth) == (ReliabilityPolicy.RELIABLE, 7)
    assert recorded_qos(topic_of(LATCHED)).durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert recorded_qos(topic_of()) == lossless_qos(topic_of())


def recorded_pictures():
    """Return what the bag's images show."""
    return np.random.default_rng(0).integers(0, 255, (FRAMES, 480, 640), np.uint8)


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("play") / "bag"
    with BagWriter(path) as writer:
        for i, image in enumerate(recorded_pictures()):
            stamp = 5 * SECOND + i * PERIOD
            writer.write(IMAGES, message_from_image(image, "mono8", stamp, "camera"), stamp)
            writer.write("/ground_truth/labels", Image(), stamp)
            writer.write("/chatter", String(data=f"word {i}"), stamp)
    return path


@pytest.fixture
def probe() -> Iterator[Probe]:
    probe = Probe()
    yield probe
    probe.close()


@pytest.fixture
def play(bag) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start players of the bag; none outlives the test."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "turbseg_ros.cli", "play", str(bag), *arguments]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate(timeout=TIMEOUT)


def test_every_message_arrives_unchanged(play, probe):
    process = play("--wait", str(TIMEOUT))
    images = probe.listen(IMAGES, Image)
    probe.wait_for(lambda: len(images) == FRAMES, "all images")
    assert process.wait(TIMEOUT) == 0
    assert [stamp_to_ns(image.header.stamp) for image in images] == [
        5 * SECOND + i * PERIOD for i in range(FRAMES)
    ]
    shown = [image_from_message(image) for image in images]
    np.testing.assert_array_equal(shown, recorded_pictures())


def test_it_plays_as_many_times_faster_as_asked(play, probe):
    process = play("--rate", "0.25", "--wait", str(TIMEOUT))
    images = probe.listen(IMAGES, Image)
    probe.wait_for(lambda: images, "the first image")
    began = time.monotonic()
    probe.wait_for(lambda: len(images) == FRAMES, "all images")
    taken = time.monotonic() - began
    _, log = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    late = float(re.findall(r"at most ([\d.]+) ms late", log)[-1]) / 1e3
    # In its own time, but for what a busy machine makes the player and this process late by.
    assert 0.5 < taken / ((FRAMES - 1) / 30 * 4) < 2.0 + late


def test_only_the_topics_asked_for_are_played(play, probe):
    play("--topics", "/chatter", "--loop")
    images: list[Image] = []
    probe.node.create_subscription(Image, IMAGES, images.append, 100)
    words = probe.listen("/chatter", String)
    probe.wait_for(lambda: len(words) > 2 * FRAMES, "words")
    assert not images


def test_a_sensor_data_subscriber_hears_it_too(play, probe):
    play("--wait", str(TIMEOUT), "--loop")
    images = probe.listen(IMAGES, Image, BEST_EFFORT)
    probe.wait_for(lambda: images, "an image")


@pytest.mark.parametrize(
    ("options", "offered"),
    [((), ReliabilityPolicy.RELIABLE), (("--recorded-qos",), ReliabilityPolicy.BEST_EFFORT)],
    ids=str,
)
def test_the_recorded_qos_is_offered_when_asked_for(tmp_path, probe, options, offered):
    with BagWriter(tmp_path / "hasty") as writer:
        writer.add_topic("/hasty", "std_msgs/msg/String", BEST_EFFORT)
        writer.write("/hasty", String(data="once"), SECOND)
    command = [sys.executable, "-m", "turbseg_ros.cli", "play", str(tmp_path / "hasty")]
    with subprocess.Popen([*command, "--start-paused", *options]) as process:
        try:
            probe.wait_for(lambda: probe.node.count_publishers("/hasty"), "the publisher")
            (publisher,) = probe.node.get_publishers_info_by_topic("/hasty")
            assert publisher.qos_profile.reliability == offered
        finally:
            process.terminate()


def test_the_clock_runs_with_the_bag(play, probe):
    process = play("--clock", "--wait", str(TIMEOUT), "--rate", "0.5")
    ticks = probe.listen("/clock", Clock)
    images = probe.listen(IMAGES, Image)
    probe.wait_for(lambda: len(images) == FRAMES, "all images")
    assert process.wait(TIMEOUT) == 0
    last = 5 * SECOND + (FRAMES - 1) * PERIOD
    times = [stamp_to_ns(tick.clock) for tick in ticks]
    # A tick that nobody has fetched goes with its publisher, and on a busy machine many are late.
    assert len(times) > FRAMES
    assert times[-1] > 5 * SECOND + FRAMES // 2 * PERIOD
    assert times == sorted(times)
    assert times[0] >= 5 * SECOND
    assert times[-1] < last + SECOND


def test_it_starts_paused_and_goes_on_when_told(play, probe):
    play("--start-paused", "--loop")
    words = probe.listen("/chatter", String)
    probe.spin(0.5)
    assert not words
    assert probe.call("/turbseg_play/pause", SetBool, SetBool.Request(data=False)).success
    probe.wait_for(lambda: words, "the first word")


def test_a_loop_goes_on_in_time(play, probe):
    process = play("--loop", "--clock", "--rate", "3", "--wait", str(TIMEOUT))
    ticks = probe.listen("/clock", Clock)
    images = probe.listen(IMAGES, Image)
    truths = probe.listen("/ground_truth/labels", Image)
    # Listeners are found one after the other.
    probe.wait_for(lambda: len(images) > 3 * FRAMES and truths, "three rounds")
    process.send_signal(signal.SIGINT)
    stamps = [stamp_to_ns(image.header.stamp) for image in images]
    assert stamps == sorted(set(stamps))
    # The step from the last frame to the first is the usual one. Of images that come this fast, a
    # listener on a busy machine may miss some.
    pictures = recorded_pictures()
    for stamp, image in zip(stamps, images, strict=True):
        number, off = divmod(stamp - 5 * SECOND, PERIOD)
        assert off == 0
        np.testing.assert_array_equal(image_from_message(image), pictures[number % FRAMES])
    # A stamp of 0 is none.
    assert {stamp_to_ns(truth.header.stamp) for truth in truths} == {0}
    times = [stamp_to_ns(tick.clock) for tick in ticks]
    assert times == sorted(times)
    assert times[-1] > 5 * SECOND + 2 * FRAMES * PERIOD


def test_messages_are_stamped_with_the_time_of_publishing(play, probe):
    process = play("--loop", "--stamp-now", "--wait", str(TIMEOUT))
    began = time.time_ns()
    images = probe.listen(IMAGES, Image)
    probe.wait_for(lambda: len(images) > FRAMES, "a second round")
    process.send_signal(signal.SIGINT)
    stamps = [stamp_to_ns(image.header.stamp) for image in images]
    assert began < stamps[0]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] < time.time_ns()
    shown = [image_from_message(image) for image in images[:FRAMES]]
    np.testing.assert_array_equal(shown, recorded_pictures())


def test_what_was_taken_at_one_time_is_so_when_stamped_anew(tmp_path, probe):
    with BagWriter(tmp_path / "pairs") as writer:
        for number in range(5):
            stamp = SECOND + number * PERIOD
            stamped = message_from_image(np.zeros((2, 2), np.uint8), "mono8", stamp)
            writer.write("/left", stamped, stamp)
            writer.write("/right", stamped, stamp + PERIOD // 2)
    command = [sys.executable, "-m", "turbseg_ros.cli", "play", str(tmp_path / "pairs")]
    with subprocess.Popen([*command, "--stamp-now", "--wait", str(TIMEOUT)]) as process:
        left, right = probe.listen("/left", Image), probe.listen("/right", Image)
        probe.wait_for(lambda: len(left) == len(right) == 5, "all images")
        assert process.wait(TIMEOUT) == 0
    assert [image.header.stamp for image in left] == [image.header.stamp for image in right]


@pytest.mark.parametrize(
    ("stamps", "headers", "period"),
    [
        # As fast as it was recorded; a hold-up at the end changes nothing.
        ([0, 10, 20, 30], [0, 10, 20, 30], 40),
        ([0, 10, 20, 300], [0, 10, 20, 30], 310),
        # The first image was late, so that the stamps span more than what was recorded.
        ([5, 10, 20, 30], [-5, 10, 20, 30], 45),
        # Stamps that are no clock's tell nothing.
        ([0, 10, 20, 30], [0, 10, 10**12, 30], 40),
        ([0], [0], SECOND),
    ],
    ids=str,
)
def test_a_round_lasts_until_the_next_image_is_due(stamps, headers, period):
    extent = Extent()
    for stamp, header in zip(stamps, headers, strict=True):
        image = message_from_image(np.zeros((2, 2), np.uint8), "mono8", 10**9 + header)
        data = serialize_message(image)
        extent.add(Record(IMAGES, "sensor_msgs/msg/Image", stamp, data), Image)
        extent.add(Record("/chatter", "std_msgs/msg/String", stamp, b""), String)
    assert extent.period({IMAGES}) == period


@pytest.mark.parametrize("first", [0, 1, 1000 * SECOND])
def test_nobody_waits_from_a_time_that_was_not_set_to_one_that_was(tmp_path, first):
    """A latched message at time 0 would be played 56 years before the images."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/chatter", String(data="latched"), first)
        for i in range(FRAMES):
            writer.write("/chatter", String(data=f"word {i}"), 1772366400 * SECOND + i * PERIOD)
    command = [sys.executable, "-m", "turbseg_ros.cli", "play", str(tmp_path / "bag")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
    assert ended.returncode == 0
    assert ended.stderr.count("the time between is left out") == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_loop_goes_on_until_a_signal_and_ends_well(play, probe, number):
    process = play("--loop", "--rate", "3")
    words = probe.listen("/chatter", String)
    probe.wait_for(lambda: [word.data for word in words].count("word 3") >= 2, "a second round")
    process.send_signal(number)
    time.sleep(0.02)
    process.send_signal(number)
    _, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    assert "Traceback" not in errors


def test_nobody_listening_is_one_line(bag, capsys):
    assert main([str(bag), "--wait", "0.3"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "fewer than 1 subscribed to /camera/image_raw" in complaint


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--topics", "/nope"], "has no /nope; its topics: /camera/image_raw, /ground_truth"),
        (["--ros-args", "-r", "nonsense"], "remap rule"),
        (["--clock", "--stamp-now"], "choose one of them"),
    ],
)
def test_what_cannot_be_played_is_one_line(bag, capsys, arguments, complaint):
    assert main([str(bag), *arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert complaint in printed


def test_no_such_bag_is_one_line(tmp_path, capsys):
    assert main([str(tmp_path / "missing")]) == 2
    assert capsys.readouterr().err == f"turbseg_play: no such bag: {tmp_path / 'missing'}\n"


@pytest.mark.parametrize(
    "name", ["/..", "a b", "/x" * 2000, "/\x1b[2J"], ids=["dots", "space", "long", "control"]
)
def test_a_name_that_is_no_topic_is_left_out_and_told(tmp_path, capfd, name):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(name, String(data="odd"), 1)
        writer.write("/chatter", String(data="sound"), 1)
    assert main([str(tmp_path / "bag")]) == 0
    told = capfd.readouterr().err
    assert "is not played: the bag names no ROS topic" in told
    assert "played 1 messages" in told
    assert main([str(tmp_path / "bag"), "--topics", name]) == 2
    refusal = capfd.readouterr().err.strip()
    assert refusal.isprintable()
    assert refusal.startswith("turbseg_play: the bag names no ROS topic")
