"""A network that loses packets: what is received is answered once, what isn't is counted."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from support.node_harness import (
    BEST_EFFORT,
    PERIOD,
    RELIABLE,
    Camera,
    NodeProcess,
    Probe,
    figures,
    stamps_of,
    texture,
)
from support.paths import SUPPORT
from turbseg_ros.messages.images import message_from_image

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")

RATE, SECONDS = 30, 60
# Without shared memory, on which nothing gets lost.
UDP_ALONE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>udp</transport_id>
      <type>UDPv4</type>
      <receiveBufferSize>8388608</receiveBufferSize>
      <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="udp_alone" is_default_profile="true"><rtps>
    <userTransports><transport_id>udp</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles></dds>
"""


@pytest.fixture
def lossy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes that are started lose 3 of 100 UDP packets that they get, and use no other."""
    library = tmp_path / "lossy_socket.so"
    source = SUPPORT / "lossy_socket.c"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    preloaded = os.pathsep.join(filter(None, (str(library), os.environ.get("LD_PRELOAD"))))
    monkeypatch.setenv("LD_PRELOAD", preloaded)
    monkeypatch.setenv("LOSS", "3")
    profiles = tmp_path / "udp.xml"
    profiles.write_text(UDP_ALONE)
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profiles))
    # LOCALHOST would bring shared memory, whatever the profile says; that names localhost, too.
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT")


@pytest.fixture
def probe(lossy: None) -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@pytest.mark.soak
@pytest.mark.timeout(400)
@pytest.mark.parametrize("qos", [BEST_EFFORT, RELIABLE], ids=["best effort", "reliable"])
def test_what_is_received_over_a_lossy_network_is_answered_once(
    tmp_path: Path, probe: Probe, qos: QoSProfile
) -> None:
    # Five datagrams an image.
    image = message_from_image(texture(np.random.default_rng(0), (480, 640), 0, 255), "mono8", 0)
    command = (sys.executable, str(SUPPORT / "stub_node.py"))
    with NodeProcess(tmp_path / "output", "-p", "queue_size:=90", command=command) as node:
        labels = probe.listen("/turbseg/labels", Image)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        camera = Camera(probe, qos=qos, rate=RATE)
        # What is lost before anything came can't be told from what was sent before.
        while not labels:
            camera.send(image)
        first = stamps_of(labels[:1])[0]
        stamps = [camera.send(image) for _ in range(RATE * SECONDS)]
        # Nor can what is lost after the last that comes.
        while stamps_of(labels[-1:]) != stamps[-1:]:
            stamps.append(camera.send(image))
            probe.spin(0.5)
        seen = len(diagnostics)
        probe.wait_for(lambda: len(diagnostics) > seen + 1, "the last count")
        shown = {key: int(value) for key, value in figures(diagnostics).items() if "images" in key}
        assert node.stop(signal.SIGINT) == 0
    answered = stamps_of(labels)
    sent = 1 + (stamps[-1] - first) // PERIOD
    lost = shown["images lost by the middleware"]
    print(f"{sent} sent, {lost} lost, {shown['images dropped']} dropped, {len(answered)} answered")
    assert answered == sorted(set(answered))
    assert len(answered) == shown["images answered"]
    assert shown["images received"] == shown["images answered"] + shown["images dropped"]
    assert shown["images received"] + lost == sent
    # Without reliability about one in seven, with it what took longer than the camera keeps.
    assert (lost > sent / 20) == (qos.reliability is ReliabilityPolicy.BEST_EFFORT)
