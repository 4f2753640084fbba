"""The node with its whole method and cameras at their own pace: what is answered, and how late."""

from __future__ import annotations

import signal
import statistics
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image

from support.camera_process import ALL, FIRST
from support.node_harness import TIMEOUT, NodeProcess, Probe
from support.paths import CONFIG, SUPPORT

CAMERAS = SUPPORT / "camera_process.py"
SECONDS = 60
# Of JPEG, as image_transport sends it by default.
QUALITY = 95
COUNTED = ("images dropped", "images lost by the middleware", "images answered by coasting")


class Cameras:
    """Cameras in a process of their own, which take from the nodes as little as drivers do."""

    def __init__(
        self,
        output: Path,
        topics: list[str],
        size: tuple[int, int],
        rate: int,
        images: int,
        jpeg: int | None = None,
    ) -> None:
        options = ["--size", *map(str, size), "--rate", str(rate), "--images", str(images)]
        if jpeg is not None:
            options += ["--jpeg", str(jpeg)]
        self._output = output
        with output.open("w") as stream:
            self._process = subprocess.Popen(
                [sys.executable, str(CAMERAS), *options, *topics],
                stdin=subprocess.PIPE,
                stdout=stream,
                stderr=subprocess.STDOUT,
                text=True,
            )

    @property
    def output(self) -> str:
        """What they printed so far."""
        return self._output.read_text()

    @property
    def running(self) -> bool:
        """Whether they have not ended, well or badly."""
        return self._process.poll() is None

    def go_on(self) -> None:
        """Let them send the rest of the images or, after that, end."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def wait(self) -> int:
        """Return the exit status."""
        return self._process.wait(TIMEOUT)

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *_: object) -> None:
        if self.running:
            self._process.kill()
        self._process.communicate(timeout=TIMEOUT)


@pytest.mark.soak
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("cameras", "size", "rate", "settings"),
    [
        (1, (1920, 1080), 30, ""),
        (1, (1920, 1080), 30, "image_transport:=compressed"),
        (1, (1280, 720), 30, ""),
        (1, (1280, 720), 30, "low_latency.yaml"),
        (1, (640, 480), 15, ""),
        (4, (640, 480), 10, ""),
        # What 30 Hz are to a machine a third as fast.
        (1, (1920, 1080), 90, ""),
        (1, (1920, 1080), 90, "latency.sparse_from:=1001"),
    ],
    ids=[
        "1080p30",
        "1080p30-jpeg",
        "720p30",
        "720p30-low-latency",
        "480p15",
        "four-480p10",
        "1080p90",
        "1080p90-never-sparse",
    ],
)
def test_every_image_is_answered_or_counted(
    tmp_path: Path, cameras: int, size: tuple[int, int], rate: int, settings: str
) -> None:
    with ExitStack() as stack:
        names = [f"/camera_{number}" for number in range(cameras)]
        nodes = [
            stack.enter_context(
                NodeProcess(
                    tmp_path / name[1:],
                    *("-r", f"__ns:={name}"),
                    *ros_arguments(settings),
                )
            )
            for name in names
        ]
        probe = stack.enter_context(Probe())
        labels = [probe.count(f"{name}/turbseg/labels", Image) for name in names]
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        sent = SECONDS * rate
        packed = "compressed" in settings
        topics = [f"{name}/image_raw{'/compressed' if packed else ''}" for name in names]
        jpeg = QUALITY if packed else None
        source = stack.enter_context(Cameras(tmp_path / "cameras", topics, size, rate, sent, jpeg))
        probe.wait_for(lambda: FIRST in source.output, "the cameras")
        # What is lost before anything came can't be told from what was sent before.
        probe.wait_for(
            lambda: all(
                latest(diagnostics, names).get(name, {}).get("images received") == "1"
                for name in names
            ),
            "the first images",
        )
        source.go_on()
        spent = [node.processor_seconds for node in nodes]
        while source.running and ALL not in source.output:
            probe.spin(0.5)
        during = latest(diagnostics, names)
        # A pause ends the stream, and what waits is answered.
        probe.wait_for(
            lambda: all(accounted(latest(diagnostics, names)[name]) == sent for name in names),
            "every image to be answered or counted",
        )
        after = latest(diagnostics, names)
        memory = [node.resident_megabytes for node in nodes]
        spent = [node.processor_seconds - s for node, s in zip(nodes, spent, strict=True)]
        assert [node.stop(signal.SIGINT) for node in nodes] == [0] * cameras
        source.go_on()
        assert source.wait() == 0, source.output
    print(source.output.splitlines()[-1])
    for name, heard, megabytes, seconds in zip(names, labels, memory, spent, strict=True):
        late = {key: value for key, value in during[name].items() if "from arrival" in key}
        counted = {key: after[name][key] for key in COUNTED}
        pace = f"{1e3 * seconds / max(heard.count, 1):.1f} ms of processor time a frame"
        print(f"{name}: {heard.count} of {sent} answered, {pace}, {megabytes:.0f} MB")
        print(f"{late}, {counted}")
        never_received = int(after[name]["images lost by the middleware"])
        assert int(after[name]["images received"]) + never_received == sent


@pytest.mark.soak
@pytest.mark.timeout(120)
@pytest.mark.parametrize("rest", ["enabled:=false", "idle_after:=0.5"])
def test_a_node_at_rest_takes_a_hundredth_of_a_core_at_most(tmp_path: Path, rest: str) -> None:
    seconds, topic = 30.0, "/camera/image_raw"
    with (
        NodeProcess(tmp_path / "node", "-r", "__ns:=/camera", "-p", rest) as node,
        Probe() as probe,
        Cameras(tmp_path / "cameras", [topic], (1920, 1080), 30, 10_000) as source,
    ):
        # Somebody else listens to the camera.
        heard = probe.count(topic, Image)
        probe.wait_for(lambda: "disabled" in node.output or "idle" in node.output, "rest")
        # The first image may have gone to the node alone, before it rested.
        probe.wait_for(lambda: FIRST in source.output, "the camera")
        source.go_on()
        probe.wait_for(lambda: heard.count, "the camera's images")
        # What a start and a change of subscriptions cost is over soon.
        probe.spin(2.0)
        spent = node.processor_seconds
        probe.spin(seconds)
        share = (node.processor_seconds - spent) / seconds
        assert node.stop(signal.SIGINT) == 0
    print(f"{rest}: {100.0 * share:.2f} % of a core")
    assert share < 0.01


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_memory_and_time_a_frame_stay_flat_for_twenty_minutes(tmp_path: Path) -> None:
    minutes, rate, name = 20, 10, "/camera"
    sent = 60 * minutes * rate
    with (
        NodeProcess(tmp_path / "node", "-r", f"__ns:={name}") as node,
        Probe() as probe,
        Cameras(tmp_path / "cameras", [f"{name}/image_raw"], (640, 480), rate, sent) as source,
    ):
        labels = probe.count(f"{name}/turbseg/labels", Image)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        probe.wait_for(lambda: FIRST in source.output, "the camera")
        source.go_on()
        memory, pace, done, spent = [], [], 0, node.processor_seconds
        while source.running and ALL not in source.output:
            probe.spin(60.0)
            answered, seconds = labels.count, node.processor_seconds
            memory.append(node.resident_megabytes)
            pace.append(1000.0 * (seconds - spent) / max(answered - done, 1))
            done, spent = answered, seconds
            print(
                f"{answered} answered: {memory[-1]:.0f} MB, {pace[-1]:.1f} ms a frame", flush=True
            )
        counted = ("images received", "images dropped", "images lost by the middleware")
        print({key: latest(diagnostics, [name])[name][key] for key in counted})
        assert node.stop(signal.SIGINT) == 0
        source.go_on()
    # While the first window fills, memory grows.
    assert max(memory[2:]) - memory[2] < 30.0
    assert statistics.median(pace[-4:]) < 1.5 * statistics.median(pace[1:5])


def ros_arguments(settings: str) -> list[str]:
    """Return the arguments that give a node parameters, or a parameter file of the package."""
    arguments = []
    for setting in settings.split():
        is_file = setting.endswith(".yaml")
        arguments += ["--params-file", str(CONFIG / setting)] if is_file else ["-p", setting]
    return arguments


def accounted(shown: dict[str, str]) -> int:
    """Return how many images were answered, or counted as dropped or lost."""
    ends = ("images answered", "images dropped", "images lost by the middleware")
    return sum(int(shown[end]) for end in ends)


def latest(diagnostics: list[DiagnosticArray], names: list[str]) -> dict[str, dict[str, str]]:
    """Return what each camera's node told last."""
    found = {}
    for array in diagnostics:
        for status in array.status:
            for name in names:
                if name[1:] in status.name:
                    found[name] = {value.key: value.value for value in status.values}
    return found
