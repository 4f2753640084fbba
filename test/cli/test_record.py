"""A running node is recorded while it shows an object, with what was before."""

from __future__ import annotations

import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker, MarkerArray

from support.node_harness import RELIABLE, TIMEOUT, Camera, NodeProcess, Probe, texture
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli import record
from turbseg_ros.messages.images import message_from_image

IMAGE = message_from_image(texture(np.random.default_rng(0), (12, 16), 0, 255), "mono8", 0)
OBJECT = MarkerArray(markers=[Marker(ns="centroid", id=1, action=Marker.ADD)])
NOTHING = MarkerArray(markers=[Marker(ns="centroid", id=1, action=Marker.DELETE)])


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


def record_command(out: Path, post_roll: int) -> list[str]:
    """Return what records before and after objects of the test's own node, to a folder."""
    command = [sys.executable, "-m", "turbseg_ros.cli", "record", "-o", str(out)]
    return [*command, "--node", "/probe", "--pre-roll", "600", "--post-roll", str(post_roll)]


def wait_until_heard(*publishers: Publisher) -> None:
    """Wait until all that was published has come to those who listen, who may not have read it."""
    for publisher in publishers:
        assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT))


def test_a_bag_begins_before_an_object_and_ends_after_it(tmp_path: Path, probe: Probe) -> None:
    # The test's own node stands for the one that segments.
    out = tmp_path / "out"
    command = record_command(out, post_roll=1)
    centroids = probe.advertise("/probe/centroids", MarkerArray, heard=False)
    with NodeProcess(tmp_path / "log", command=command) as recorder:
        camera = Camera(probe, "/lens/image_raw", rate=30.0, heard=False)
        probe.listen("/lens/image_raw", Image)
        for topic in ("/lens/image_raw", "/probe/centroids"):
            probe.wait_for(
                lambda topic=topic: f"recording {topic} (" in recorder.output, f"its {topic}"
            )
        # Both are heard by now: the watch, and what writes it.
        probe.wait_for(lambda: centroids.get_subscription_count() == 2, "both subscriptions")
        for _ in range(5):
            centroids.publish(NOTHING)
            camera.send(IMAGE)
        centroids.publish(OBJECT)
        probe.wait_for(lambda: f"{out}/" in recorder.output, "the bag to begin")
        sent = 5

        def goes_on() -> bool:
            nonlocal sent
            camera.send(IMAGE)
            sent += 1
            return "messages" in recorder.output

        probe.wait_for(goes_on, "the bag to end")
        assert recorder.stop(signal.SIGINT) == 0
    (bag,) = out.iterdir()
    counts = Counter(message.topic for message in BagReader(bag).messages())
    assert counts["/probe/centroids"] == 6
    # Images are published reliably: those before the object are all there.
    assert 5 < counts["/lens/image_raw"] <= sent


def test_a_camera_that_comes_after_the_recorder_is_recorded_from_its_first_image_on(
    tmp_path: Path, probe: Probe
) -> None:
    out = tmp_path / "out"
    command = record_command(out, post_roll=600)
    # What the node listens to, though nothing is there yet.
    probe.node.create_subscription(Image, "/lens/image_raw", lambda _: None, RELIABLE)
    with NodeProcess(tmp_path / "log", command=command) as recorder:
        probe.wait_for(
            lambda: probe.node.count_subscribers("/lens/image_raw") == 2, "its subscription"
        )
        camera = probe.advertise("/lens/image_raw", Image, heard=False)
        centroids = probe.advertise("/probe/centroids", MarkerArray, heard=False)
        for publisher in (camera, centroids):
            probe.wait_for(lambda it=publisher: it.get_subscription_count() == 2, "the recorder")
        for _ in range(5):
            camera.publish(IMAGE)
        probe.wait_for(lambda: "recording /lens/image_raw (" in recorder.output, "its word")
        for _ in range(5):
            camera.publish(IMAGE)
        centroids.publish(OBJECT)
        probe.wait_for(lambda: f"{out}/" in recorder.output, "the bag to begin")
        wait_until_heard(camera, centroids)
        assert recorder.stop(signal.SIGINT) == 0
    (bag,) = out.iterdir()
    counts = Counter(message.topic for message in BagReader(bag).messages())
    assert counts == {"/lens/image_raw": 10, "/probe/centroids": 1}


def test_what_has_come_when_the_recorder_is_stopped_is_recorded(
    tmp_path: Path, probe: Probe
) -> None:
    out = tmp_path / "out"
    centroids = probe.advertise("/probe/centroids", MarkerArray, heard=False)
    with NodeProcess(tmp_path / "log", command=record_command(out, post_roll=600)) as recorder:
        probe.wait_for(lambda: centroids.get_subscription_count() == 2, "both subscriptions")
        # No more than the publisher keeps until they are heard.
        for _ in range(RELIABLE.depth):
            centroids.publish(OBJECT)
        wait_until_heard(centroids)
        assert recorder.stop(signal.SIGINT) == 0
    (bag,) = out.iterdir()
    counts = Counter(message.topic for message in BagReader(bag).messages())
    assert counts == {"/probe/centroids": RELIABLE.depth}


def test_a_camera_that_offers_less_than_the_node_asks_for_is_recorded_all_the_same(
    tmp_path: Path, probe: Probe
) -> None:
    out = tmp_path / "out"
    command = record_command(out, post_roll=600)
    probe.node.create_subscription(Image, "/lens/image_raw", lambda _: None, RELIABLE)
    centroids = probe.advertise("/probe/centroids", MarkerArray, heard=False)
    with NodeProcess(tmp_path / "log", command=command) as recorder:
        probe.wait_for(
            lambda: probe.node.count_subscribers("/lens/image_raw") == 2, "its subscription"
        )
        # Neither the node nor the recorder hears it as they asked at first.
        camera = probe.advertise("/lens/image_raw", Image, qos_profile_sensor_data, heard=False)
        probe.wait_for(camera.get_subscription_count, "the recorder")
        probe.wait_for(lambda: centroids.get_subscription_count() == 2, "both subscriptions")
        for _ in range(20):
            camera.publish(IMAGE)
            probe.spin(0.02)
        centroids.publish(OBJECT)
        probe.wait_for(lambda: f"{out}/" in recorder.output, "the bag to begin")
        assert recorder.stop(signal.SIGINT) == 0
    (bag,) = out.iterdir()
    counts = Counter(message.topic for message in BagReader(bag).messages())
    assert counts["/lens/image_raw"] > 0


def test_a_folder_that_cannot_be_made_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert record.main(["-o", str(tmp_path / "file" / "bags")]) == 2
    assert "can't be made" in capsys.readouterr().err
