"""The node with its whole method and cameras at their own pace: what is answered, and how late."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from node_harness import Camera, NodeProcess, Probe
from sensor_msgs.msg import Image

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.evaluation.replay import BagFrames
from turbseg_ros.ros.image_conversion import message_from_image

BAG = Path(__file__).parent.parent / "bags" / "normal"
SECONDS = 20


def pictures(size: tuple[int, int]) -> Iterator[Image]:
    """Give a bag's frames as colour images of a size (width, height), forward and backward."""
    reader = BagReader(BAG)
    frames = BagFrames(reader, reader.find_image_topic(None))
    messages = [
        message_from_image(
            cv2.cvtColor(cv2.resize(frame.image, size), cv2.COLOR_GRAY2BGR), "bgr8", 0
        )
        for frame in frames
    ]
    return itertools.cycle([*messages, *messages[-2:0:-1]])


@pytest.mark.soak
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("cameras", "size", "rate", "mode"),
    [
        (1, (1920, 1080), 30, "centred"),
        (1, (1280, 720), 30, "centred"),
        (1, (1280, 720), 30, "causal"),
        (1, (640, 480), 15, "centred"),
        (4, (640, 480), 10, "centred"),
    ],
    ids=["1080p30", "720p30", "720p30-causal", "480p15", "four-480p10"],
)
def test_every_image_is_answered_or_counted(
    tmp_path: Path, cameras: int, size: tuple[int, int], rate: int, mode: str
) -> None:
    images = pictures(size)
    with ExitStack() as stack:
        names = [f"/camera_{number}" for number in range(cameras)]
        nodes = [
            stack.enter_context(
                NodeProcess(
                    tmp_path / name[1:], "-r", f"__ns:={name}", "-p", f"latency.mode:={mode}"
                )
            )
            for name in names
        ]
        probe = stack.enter_context(Probe())
        labels = [probe.count(f"{name}/turbseg/labels", Image) for name in names]
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        sources = [Camera(probe, f"{name}/image_raw", rate=rate) for name in names]
        sent = SECONDS * rate
        for source in sources:
            source.send(next(images))
        # What is lost before anything came can't be told from what was sent before.
        probe.wait_for(
            lambda: all(
                latest(diagnostics, names).get(name, {}).get("images received") == "1"
                for name in names
            ),
            "the first images",
        )
        for _ in range(sent - 1):
            for source in sources:
                source.send(next(images))
        during = latest(diagnostics, names)
        # A pause ends the stream, and what waits is answered.
        probe.spin(6.0)
        after = latest(diagnostics, names)
        memory = [node.resident_megabytes for node in nodes]
        assert [node.stop(signal.SIGINT) for node in nodes] == [0] * cameras
    for name, heard, megabytes in zip(names, labels, memory, strict=True):
        counts = {key: int(value) for key, value in after[name].items() if "images" in key}
        late = {key: value for key, value in during[name].items() if "from arrival" in key}
        print(f"{name}: {heard.count} of {sent} answered, {late}, {megabytes:.0f} MB")
        never_received = counts["images lost by the middleware"]
        assert counts["images received"] + never_received == sent
        assert counts["images answered"] + counts["images dropped"] + never_received == sent


def latest(diagnostics: list[DiagnosticArray], names: list[str]) -> dict[str, dict[str, str]]:
    """Give what each camera's node told last."""
    found = {}
    for array in diagnostics:
        for status in array.status:
            for name in names:
                if name[1:] in status.name:
                    found[name] = {value.key: value.value for value in status.values}
    return found
