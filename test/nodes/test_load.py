"""The node under load and under faults, the method left out: see `stub_node.py`."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker, MarkerArray

from support.node_harness import (
    SECOND,
    Camera,
    NodeProcess,
    Probe,
    figures,
    quick_and_soak,
    stamps_of,
    texture,
)
from support.paths import SUPPORT
from turbseg_ros.messages.images import image_from_message, message_from_image

STUB = SUPPORT / "stub_node.py"


def stub_node(path: Path, *arguments: str, ros: tuple[str, ...] = ()) -> NodeProcess:
    return NodeProcess(path / "output", *ros, command=(sys.executable, str(STUB), *arguments))


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@pytest.mark.parametrize("seconds", quick_and_soak(2, 60))
@pytest.mark.timeout(300)
def test_full_hd_at_30_hz_is_answered_frame_by_frame(tmp_path, probe, seconds):
    frames = 30 * seconds
    colour = np.random.default_rng(0).integers(0, 255, (1080, 1920, 3), np.uint8)
    with stub_node(tmp_path, ros=("-p", "queue_size:=60")) as node:
        # Markers tell of every answer; labels are listened to for what they cost the node.
        centroids = probe.listen("/turbseg/centroids", MarkerArray)
        labels = probe.count("/turbseg/labels", Image)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe, rate=30.0)
        message = message_from_image(colour, "bgr8", 0)
        before = node.processor_seconds
        stamps = [camera.send(message) for _ in range(frames)]
        probe.wait_for(lambda: len(answered(centroids)) == frames, "all markers")
        cost = 1000.0 * (node.processor_seconds - before) / frames
        wait_for_last_count(probe, diagnostics)
        shown = figures(diagnostics)
        assert node.stop(signal.SIGINT) == 0
    print(f"{cost:.1f} ms of processor time a frame; {latencies(diagnostics)}")
    assert answered(centroids) == stamps
    assert shown["images dropped"] == shown["images lost by the middleware"] == "0"
    assert labels.count > 0


def answered(centroids: list[MarkerArray]) -> list[int]:
    """Return the stamps of the frames that markers came of.

    Where a busy machine lets the camera pause, they are deleted meanwhile.
    """
    return stamps_of(
        array.markers[0] for array in centroids if array.markers[0].action != Marker.DELETE
    )


def wait_for_last_count(probe: Probe, diagnostics: list[DiagnosticArray]) -> None:
    """Wait for diagnostics that were begun after now."""
    seen = len(diagnostics)
    probe.wait_for(lambda: len(diagnostics) > seen + 1, "the last count")


def latencies(diagnostics: list[DiagnosticArray]) -> dict[str, str]:
    """Return the latencies of the last second in which frames were answered."""
    for array in reversed(diagnostics):
        shown = {name: text for name, text in figures([array]).items() if "latency from" in name}
        if "nan" not in shown.values():
            return shown
    return {}


@pytest.mark.parametrize("seconds", quick_and_soak(4, 60))
@pytest.mark.timeout(300)
def test_too_many_images_cost_the_oldest_and_no_memory(tmp_path, probe, seconds):
    frames = 120 * seconds
    image = message_from_image(texture(np.random.default_rng(0), (480, 640), 0, 255), "mono8", 0)
    with stub_node(tmp_path, "--cost", "0.02", ros=("-p", "queue_size:=5")) as node:
        labels = probe.listen("/turbseg/labels", Image)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe, rate=120.0)
        began = time.monotonic()
        # What is lost before anything came can't be told from what was sent before.
        stamps = [camera.send(image)]
        probe.wait_for(lambda: labels, "the first answer")
        stamps += [camera.send(image) for _ in range(frames // 4)]
        early = node.resident_megabytes
        stamps += [camera.send(image) for _ in range(frames - len(stamps))]
        late = node.resident_megabytes
        probe.wait_for(
            lambda: labels and stamps_of(labels[-1:]) == stamps[-1:], "the newest to be answered"
        )
        wait_for_last_count(probe, diagnostics)
        counts = {
            key: int(value) for key, value in figures(diagnostics).items() if "images" in key
        }
        assert node.stop(signal.SIGINT) == 0
        taken = time.monotonic() - began
    answered = stamps_of(labels)
    assert answered == sorted(set(answered) & set(stamps))
    assert counts["images answered"] == len(answered)
    assert counts["images dropped"] > 0
    assert "dropping" in {figures([array]).get("load step") for array in diagnostics}
    never_received = counts["images lost by the middleware"]
    assert counts["images received"] + never_received == frames
    assert counts["images dropped"] == frames - never_received - len(answered)
    assert late - early < 20.0
    # Once in five seconds, however long the machine took for it.
    assert node.output.count("the oldest are dropped") <= 1 + taken / 5


def test_a_listener_that_stands_still_does_not_slow_the_node(tmp_path, probe):
    listener = textwrap.dedent(
        """
        import rclpy
        from sensor_msgs.msg import Image
        rclpy.init()
        node = rclpy.create_node("slow")
        node.create_subscription(Image, "/turbseg/labels", lambda _: print("one", flush=True), 10)
        rclpy.spin(node)
        """
    )
    image = message_from_image(texture(np.random.default_rng(0), (480, 640), 0, 255), "mono8", 0)
    with (
        stub_node(tmp_path, ros=("-p", "queue_size:=100")) as node,
        (tmp_path / "heard").open("w") as heard,
        subprocess.Popen([sys.executable, "-c", listener], stdout=heard) as slow,
    ):
        try:
            centroids = probe.listen("/turbseg/centroids", MarkerArray)
            camera = Camera(probe, rate=30.0)
            sent = [camera.send(image)]
            while not (tmp_path / "heard").read_text():
                sent.append(camera.send(image))
            probe.wait_for(lambda: answered(centroids)[-1:] == sent[-1:], "its answer")
            slow.send_signal(signal.SIGSTOP)
            centroids.clear()
            began = time.monotonic()
            stamps = [camera.send(image) for _ in range(90)]
            sending = time.monotonic() - began
            probe.wait_for(lambda: len(answered(centroids)) == 90, "all answers")
            # Were each to wait for the listener, for a tenth of a second only, it would take nine,
            # or thrice as long as sending. A busy machine is slow at both.
            assert time.monotonic() - began < 2.0 * sending + 1.0
            assert answered(centroids) == stamps
            assert node.stop(signal.SIGINT) == 0
        finally:
            slow.kill()


def test_a_frame_that_fails_is_answered_empty_and_the_rest_goes_on(tmp_path, probe):
    image = message_from_image(texture(np.random.default_rng(0), (120, 160), 0, 255), "mono8", 0)
    with stub_node(tmp_path, "--fail-every", "10", ros=("-p", "queue_size:=100")) as node:
        labels = probe.listen("/turbseg/labels", Image)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe)
        stamps = [camera.send(image) for _ in range(9)]
        failed = camera.send(image)
        probe.wait_for(lambda: len(labels) == 10, "the first failure's answer")
        probe.wait_for(lambda: "segmenting failed once" in told(diagnostics), "a warning")
        stamps += [failed, *(camera.send(image) for _ in range(30))]
        probe.wait_for(lambda: len(labels) == 40, "all labels")
        probe.wait_for(lambda: figures(diagnostics)["images failed"] == "4", "all failures")
        # Four at once are an error; where it takes long, the first ones are forgotten by the last.
        assert any(
            re.match("segmenting failed [234] times", array.status[0].message)
            for array in diagnostics
        )
        assert node.stop(signal.SIGINT) == 0
    assert stamps_of(labels) == stamps
    empty = [number for number, label in enumerate(labels) if not image_from_message(label).any()]
    assert empty == [9, 19, 29, 39]
    assert f"segmenting the image of {failed // SECOND}.{failed % SECOND:09d} s" in node.output
    assert "RuntimeError: frame 10 is one of those that fail" in node.output
    assert "frame 20" not in node.output


def told(diagnostics: list[DiagnosticArray]) -> str:
    return diagnostics[-1].status[0].message if diagnostics else ""
