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
from visualization_msgs.msg import MarkerArray

from support.node_harness import (
    BEST_EFFORT,
    PERIOD,
    RELIABLE,
    SECOND,
    Camera,
    NodeProcess,
    Probe,
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


def stub_node(output: Path, *ros_arguments: str) -> NodeProcess:
    return NodeProcess(output, *ros_arguments, command=(sys.executable, str(STUB)))


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


def answered(centroids: list[MarkerArray]) -> list[int]:
    """Return the stamps of the frames that were answered: the stub sees an object in each."""
    return stamps_of(array.markers[0] for array in centroids)


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
        sent = send_until(probe, camera, lambda: centroids and told(diagnostics, "segmenting"))
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
