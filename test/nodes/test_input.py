"""Cameras as they come and go, the method left out: see `stub_node.py`."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CompressedImage
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from support.node_harness import (
    BEST_EFFORT,
    PERIOD,
    RELIABLE,
    SECOND,
    Camera,
    NodeProcess,
    Probe,
    figures,
    stamps_of,
    texture,
)
from support.paths import SUPPORT
from turbseg_ros.messages.images import message_from_image

STUB = SUPPORT / "stub_node.py"
IMAGE = message_from_image(texture(np.random.default_rng(0), (120, 160), 0, 255), "mono8", 0)

UNHEARD = "offers less than reliable"
LENS = ("-r", "image_raw:=/lens/image_raw")
READY = (*LENS, "-p", "qos.reliability:=best_effort")


def stub_node(output: Path, *ros_arguments: str, cost: float = 0.0) -> NodeProcess:
    """Return a node that takes so many seconds for an image, and nothing else."""
    command = (sys.executable, str(STUB), "--cost", str(cost))
    return NodeProcess(output, *ros_arguments, command=command)


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


def answered(centroids: list[MarkerArray]) -> list[int]:
    """Return the stamps of the frames that were answered: the stub sees an object in each."""
    shown = (array.markers[0] for array in centroids)
    return stamps_of(marker for marker in shown if marker.action == Marker.ADD)


@pytest.mark.parametrize(
    ("offered", "asked"),
    [
        (RELIABLE, {"auto", "reliable", "best_effort"}),
        (BEST_EFFORT, {"auto", "best_effort"}),
    ],
    ids=["reliable", "best effort"],
)
def test_a_camera_is_heard_by_all_that_ask_for_what_it_offers(tmp_path, probe, offered, asked):
    with contextlib.ExitStack() as stack:
        nodes, heard = {}, {}
        for name in ("auto", "reliable", "best_effort"):
            arguments = ("-r", f"__ns:=/{name}", "-r", "image_raw:=/lens/image_raw")
            node = stub_node(tmp_path / name, *arguments, "-p", f"qos.reliability:={name}")
            nodes[name] = stack.enter_context(node)
        for name in nodes:
            heard[name] = probe.listen(f"/{name}/turbseg/centroids", MarkerArray)
        camera = Camera(probe, "/lens/image_raw", qos=offered, rate=30.0)
        sent = send_until(probe, camera, lambda: all(heard[name] for name in asked))
        for name in nodes.keys() - asked:
            probe.wait_for(lambda name=name: UNHEARD in nodes[name].output, f"{name}'s warning")
        assert {name for name in nodes if heard[name]} == asked
        assert [node.stop(signal.SIGINT) for node in nodes.values()] == [0, 0, 0]
    for name, node in nodes.items():
        assert in_order_and_among(answered(heard[name]), sent)
        assert (UNHEARD in node.output) == (name not in asked)


def send_until(probe, camera, condition):
    """Send images until a condition holds; return the stamps of all.

    Any of them may be lost where a camera offers no more than its best.
    """
    sent = []
    probe.wait_for(
        lambda: sent.append(camera.send(IMAGE)) or condition(), "what images should bring about"
    )
    return sent


def in_order_and_among(answers, sent):
    return answers == sorted(set(answers) & set(sent))


def test_a_best_effort_camera_that_joins_late_is_heard_soon(tmp_path, probe):
    with (
        stub_node(tmp_path / "ready", "-r", "__ns:=/ready", *READY) as ready,
        stub_node(tmp_path / "auto", "-r", "__ns:=/auto", *LENS) as auto,
    ):
        first = probe.listen("/ready/turbseg/centroids", MarkerArray)
        centroids = probe.listen("/auto/turbseg/centroids", MarkerArray)
        camera = Camera(probe, "/lens/image_raw", qos=BEST_EFFORT, rate=30.0, heard=False)
        sent = send_until(probe, camera, lambda: first and len(centroids) >= 30)
        assert [node.stop(signal.SIGINT) for node in (ready, auto)] == [0, 0]
    # What finding one another takes, both wait for; the change itself takes a fifth of a second
    # by design, and ten times as long on a busy machine.
    assert answered(centroids)[0] - answered(first)[0] <= 2 * SECOND
    assert in_order_and_among(answered(centroids), sent)


def test_a_camera_that_goes_silent_is_reported_and_heard_when_it_is_back(tmp_path, probe):
    with stub_node(tmp_path / "output") as node:
        centroids = probe.listen("/turbseg/centroids", MarkerArray)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe, qos=BEST_EFFORT, rate=30.0)
        send_until(probe, camera, lambda: centroids)
        camera.close()
        probe.wait_for(lambda: told(diagnostics, "no image on /image_raw for"), "an error")
        assert diagnostics[-1].status[0].level == DiagnosticStatus.ERROR
        centroids.clear()
        # It counts its time from its start, as many cameras do.
        camera = Camera(probe, qos=BEST_EFFORT, rate=30.0)
        camera.stamp = 5 * SECOND
        sent = send_until(probe, camera, lambda: centroids and told(diagnostics, "stamps are"))
        assert in_order_and_among(answered(centroids), sent)
        assert node.stop(signal.SIGINT) == 0
    assert node.output.count("new window: time jumped back by") == 1


def told(diagnostics: list[DiagnosticArray], text: str) -> bool:
    return bool(diagnostics) and diagnostics[-1].status[0].message.startswith(text)


def test_each_kind_of_bad_image_is_warned_about_once(tmp_path, probe):
    unknown = message_from_image(np.zeros((4, 4), np.uint8), "mono8", 0)
    unknown.encoding = "jpeg?"
    cut = message_from_image(np.zeros((4, 4), np.uint8), "mono8", 0)
    cut.data = cut.data[:5]
    empty = message_from_image(np.zeros((4, 4), np.uint8), "mono8", 0)
    empty.width = 0
    with stub_node(tmp_path / "output", "-p", "queue_size:=100") as node:
        centroids = probe.listen("/turbseg/centroids", MarkerArray)
        camera = Camera(probe)
        for _ in range(10):
            for bad in (unknown, cut, empty):
                camera.send(bad)
        last = camera.send(IMAGE)
        camera.stamp -= PERIOD
        camera.send(IMAGE)
        probe.wait_for(lambda: answered(centroids) == [last], "the only answer")
        probe.wait_for(lambda: "has the stamp of the frame before" in node.output, "the last")
        assert node.stop(signal.SIGINT) == 0
    warnings = [line for line in node.output.splitlines() if "image skipped" in line]
    assert len(warnings) == 4


def lines(node: NodeProcess, text: str) -> list[str]:
    return [line for line in node.output.splitlines() if text in line]


def test_a_node_on_stand_by_hears_nothing_until_it_is_enabled(tmp_path, probe):
    remapping = ("-r", "__ns:=/rests", "-r", "image_raw:=/rests_lens/image_raw")
    inputs = ("/rests_lens/image_raw", "/rests_lens/camera_info")
    with stub_node(tmp_path / "output", *remapping, "-p", "enabled:=false") as node:
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        probe.wait_for(lambda: diagnostics, "diagnostics")
        assert diagnostics[-1].status[0].level == DiagnosticStatus.OK
        assert "disabled" in diagnostics[-1].status[0].message
        assert [probe.node.count_subscribers(topic) for topic in inputs] == [0, 0]
        centroids = probe.listen("/rests/turbseg/centroids", MarkerArray)
        # There is nothing yet that could be reset.
        assert probe.call("/rests/turbseg/reset", Trigger, Trigger.Request()).success
        assert probe.call("/rests/turbseg/enable", SetBool, SetBool.Request(data=True)).success
        camera = Camera(probe, inputs[0], rate=30.0)
        send_until(probe, camera, lambda: answered(centroids))
        assert probe.call("/rests/turbseg/enable", SetBool, SetBool.Request(data=False)).success
        probe.wait_for(
            lambda: not any(map(probe.node.count_subscribers, inputs)), "what it heard to go"
        )
        assert node.stop(signal.SIGINT) == 0


def test_a_node_hears_images_again_once_somebody_listens_to_results(tmp_path, probe):
    lens = "/lazy_lens/image_raw"
    remapping = ("-r", "__ns:=/lazy", "-r", f"image_raw:={lens}")
    with stub_node(tmp_path / "output", *remapping, "-p", "idle_after:=0.5") as node:
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        probe.wait_for(lambda: lines(node, "idle: nobody has listened"), "it to stand by")
        probe.wait_for(lambda: not probe.node.count_subscribers(lens), "its subscription to go")
        probe.wait_for(
            lambda: diagnostics and "nobody listens" in diagnostics[-1].status[0].message,
            "diagnostics to tell it",
        )
        assert diagnostics[-1].status[0].level == DiagnosticStatus.OK
        centroids = probe.listen("/lazy/turbseg/centroids", MarkerArray)
        probe.wait_for(lambda: probe.node.count_subscribers(lens), "it to listen again")
        camera = Camera(probe, lens, rate=30.0)
        send_until(probe, camera, lambda: answered(centroids))
        assert node.stop(signal.SIGINT) == 0
    assert len(lines(node, "listening to")) == 2


def test_what_cannot_be_had_is_told_when_a_node_is_enabled(tmp_path, probe):
    command = (sys.executable, "-m", "turbseg_ros.cli", "node")
    arguments = ("-r", "__ns:=/lacks", "-p", "enabled:=false", "-p", "flow.backend:=no_such:Flow")
    with NodeProcess(tmp_path / "output", *arguments, command=command) as node:
        answer = probe.call("/lacks/turbseg/enable", SetBool, SetBool.Request(data=True))
        assert not answer.success
        assert "no_such" in answer.message
        assert node.stop(signal.SIGINT) == 0


def test_the_log_tells_of_start_first_image_enable_and_reset(tmp_path, probe):
    remapping = ("-r", "__ns:=/told", "-r", "image_raw:=/told_lens/image_raw")
    with stub_node(tmp_path / "output", *remapping) as node:
        probe.wait_for(lambda: "listening to" in node.output, "the first line")
        (begun,) = lines(node, "listening to")
        assert "/told_lens/image_raw (sensor_msgs/msg/Image), QoS reliable, or less" in begun
        assert "latency mode centred" in begun
        camera = Camera(probe, "/told_lens/image_raw", rate=30.0)
        send_until(probe, camera, lambda: "first image: 160x120 'mono8'" in node.output)
        send_until(probe, camera, lambda: "object 1 entered at (" in node.output)
        for wanted, told in ((False, "disabled"), (True, "enabled")):
            probe.call("/told/turbseg/enable", SetBool, SetBool.Request(data=wanted))
            probe.wait_for(lambda told=told: lines(node, f": {told}"), told)
        assert probe.call("/told/turbseg/reset", Trigger, Trigger.Request()).success
        probe.wait_for(lambda: "reset was called" in node.output, "the reset")
        assert node.stop(signal.SIGINT) == 0
    assert len(lines(node, "listening to")) == 2
    assert len(lines(node, "first image")) == 1
    assert "frame_id 'camera'" in node.output
    # A busy machine may be silent for three seconds, and be told so.
    assert [line for line in lines(node, "[WARN]") if "no image on" not in line] == []


def test_what_waited_while_the_node_was_disabled_is_not_its_first_image(tmp_path, probe):
    remapping = ("-r", "__ns:=/waits", "-r", "image_raw:=/waits_lens/image_raw")
    with stub_node(tmp_path / "output", *remapping, "-p", "queue_size:=20", cost=0.5) as node:
        centroids = probe.listen("/waits/turbseg/centroids", MarkerArray)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe, "/waits_lens/image_raw", rate=30.0)
        stamps = [camera.send(IMAGE) for _ in range(8)]
        # What is still under way when the node is disabled never comes.
        probe.wait_for(lambda: figures(diagnostics)["images received"] == "8", "all images")
        for wanted in (False, True):
            probe.call("/waits/turbseg/enable", SetBool, SetBool.Request(data=wanted))
        probe.wait_for(lambda: answered(centroids)[-1:] == stamps[-1:], "the last answer")
        assert node.stop(signal.SIGINT) == 0
    assert len(lines(node, "first image")) == 1


@pytest.mark.parametrize(
    ("topic", "reason", "diagnosed"),
    [
        (
            "/mute_lens/image_raw",
            "nobody publishes it; image topics: ",
            "no image yet on /mute/image_raw (0 publishers)",
        ),
        (
            "/mute/image_raw",
            "/mute/image_raw carries sensor_msgs/msg/CompressedImage, not ",
            "/mute/image_raw carries sensor_msgs/msg/CompressedImage, not ",
        ),
    ],
)
def test_silence_names_the_images_that_there_are(tmp_path, probe, topic, reason, diagnosed):
    advertised = f"{topic}/compressed" if "lens" in topic else topic
    publisher = probe.advertise(advertised, CompressedImage, heard=False)
    with stub_node(tmp_path / "output", "-r", "__ns:=/mute") as node:
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        # A first warning may come before the node has heard of the publisher.
        probe.wait_for(lambda: lines(node, reason), "a warning")
        probe.wait_for(lambda: told(diagnostics, diagnosed), "diagnostics")
        assert node.stop(signal.SIGINT) == 0
    warning = lines(node, reason)[-1]
    assert "[WARN]" in warning
    assert "no image on /mute/image_raw for " in warning
    assert f"-r image_raw:={topic} -p image_transport:=compressed" in warning
    # As it says.
    _, _, arguments = warning.rpartition("take it with ")
    if arguments != warning:
        with stub_node(tmp_path / "again", "-r", "__ns:=/mute", *arguments.split()) as node:
            probe.wait_for(publisher.get_subscription_count, "a subscription")
            assert node.stop(signal.SIGINT) == 0
    # Its own outputs are no cameras.
    assert "turbseg/" not in warning.partition("no image")[2]
    probe.withdraw(publisher)


@pytest.mark.parametrize(
    ("arguments", "heard"),
    [
        (("-r", "image_raw:=/lens/image_rect"), "/lens/camera_info"),
        (("-r", "image_raw:=/lens/image_raw", "-p", "image_transport:=compressed"), None),
        ((), "/beside/camera_info"),
        (("-r", "image_raw:=/lens/image_raw", "-r", "camera_info:=/other/info"), "/other/info"),
        (("-r", "image_raw:=/lens/image_raw", "-r", "camera_info:=camera_info"), None),
        (
            ("-r", "image_raw:=/lens/image_raw", "-r", "/lens/camera_info:=/other/info"),
            "/other/info",
        ),
        (("-r", "image_raw:=/image"), "/camera_info"),
    ],
    ids=["remapped", "compressed", "default", "both", "launch file", "by its full name", "root"],
)
def test_camera_info_is_heard_beside_the_image(tmp_path, probe, arguments, heard):
    heard = heard or "/lens/camera_info"
    with stub_node(tmp_path / "output", "-r", "__ns:=/beside", *arguments) as node:
        probe.wait_for(lambda: probe.node.count_subscribers(heard), heard)
        probe.wait_for(lambda: f"camera_info on {heard};" in node.output, "the first line")
        assert node.stop(signal.SIGINT) == 0
