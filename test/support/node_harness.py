"""A node process under test, and the camera and listener that the test plays itself."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from turbseg_ros.messages.images import message_from_image, ns_to_stamp, stamp_to_ns

RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
SECOND = 10**9
PERIOD = SECOND // 30
# Seconds; a busy machine takes ten times as long as an idle one.
TIMEOUT = 40.0
# Frames whose answers may be under way: more than the method's look-ahead, and fewer than a
# publisher keeps for a listener that is slow.
_MAX_UNANSWERED = 16
# Processes of all domains compete for shared memory ports from 7000 on; Fast DDS prints an error
# where another one held a port for long, and takes the next.
_TAKEN_PORT = re.compile("RTPS_TRANSPORT_SHM.*Failed init_port")


class NodeProcess:
    """`turbseg_node` as a process with `ros_arguments`, its output kept in a file."""

    def __init__(
        self,
        output: Path,
        *ros_arguments: str,
        command: Iterable[str] = (sys.executable, "-m", "turbseg_ros.cli", "node"),
        directory: Path | None = None,
    ) -> None:
        self._output = output
        with output.open("w") as stream:
            self.process = subprocess.Popen(
                [*command, "--ros-args", *ros_arguments],
                cwd=directory,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
            )

    @property
    def output(self) -> str:
        """What it printed so far, without what the middleware says of ports that were taken."""
        lines = self._output.read_text().splitlines(keepends=True)
        return "".join(line for line in lines if not _TAKEN_PORT.search(line))

    def blocks(self, number: signal.Signals) -> bool:
        """Whether it has blocked a signal."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        (blocked,) = [line for line in status.splitlines() if line.startswith("SigBlk:")]
        return bool(int(blocked.split()[1], 16) >> (number - 1) & 1)

    @property
    def processor_seconds(self) -> float:
        """Time that its threads have spent on a processor."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def resident_megabytes(self) -> float:
        """Memory that it holds."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        (line,) = [line for line in status.splitlines() if line.startswith("VmRSS:")]
        return int(line.split()[1]) / 1024

    def wait(self) -> int:
        """Return the exit status."""
        return self.process.wait(TIMEOUT)

    def stop(self, *signals: signal.Signals) -> int:
        """Send signals, one soon after the other; return the exit status."""
        for number in signals:
            self.process.send_signal(number)
            time.sleep(0.05)
        return self.wait()

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(TIMEOUT)


class Tally:
    """Counts messages, unread."""

    count = 0

    def add(self, _message: bytes) -> None:
        """Count one."""
        self.count += 1


class Probe:
    """A ROS node in the test's own process and thread, spun while it waits."""

    def __init__(self, namespace: str = "") -> None:
        self.context = Context()
        self.context.init()
        self.node = Node("probe", context=self.context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._subscriptions: list[Subscription] = []
        self._publishers: list[Publisher] = []

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_node(self, node: Node) -> None:
        """Spin another node, too."""
        self._executor.add_node(node)

    def forget(self) -> None:
        """Take back all that was subscribed to or published."""
        for subscription in self._subscriptions:
            self.node.destroy_subscription(subscription)
        for publisher in self._publishers:
            self.node.destroy_publisher(publisher)
        self._subscriptions, self._publishers = [], []

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Let messages come for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def wait_for(self, condition: Callable[[], object], what: str) -> None:
        """Spin until `condition` holds; fail after a while."""
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end, f"timed out waiting for {what}"
            self._executor.spin_once(timeout_sec=0.05)

    def listen(self, topic: str, message_type: type[Any], qos: QoSProfile = RELIABLE) -> list[Any]:
        """Return a list that fills with the topic's messages."""
        messages: list[Any] = []
        self._subscriptions.append(
            self.node.create_subscription(message_type, topic, messages.append, qos)
        )
        self.wait_for(lambda: self.node.count_publishers(topic), f"a publisher of {topic}")
        return messages

    def count(self, topic: str, message_type: type[Any]) -> Tally:
        """Return the number of a topic's messages, which are not read."""
        tally = Tally()
        self._subscriptions.append(
            self.node.create_subscription(message_type, topic, tally.add, RELIABLE, raw=True)
        )
        self.wait_for(lambda: self.node.count_publishers(topic), f"a publisher of {topic}")
        return tally

    def advertise(
        self,
        topic: str,
        message_type: type[Any],
        qos: QoSProfile = RELIABLE,
        heard: bool = True,
    ) -> Publisher:
        """Return a publisher, once it is heard."""
        publisher = self.node.create_publisher(message_type, topic, qos)
        self._publishers.append(publisher)
        if heard:
            self.wait_for(publisher.get_subscription_count, f"a subscription to {topic}")
        return publisher

    def withdraw(self, publisher: Publisher) -> None:
        """Take back a publisher."""
        self._publishers.remove(publisher)
        self.node.destroy_publisher(publisher)

    def call(self, service: str, service_type: type[Any], request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service_type, service)
        self.wait_for(client.service_is_ready, f"service {service}")
        future = client.call_async(request)
        self.wait_for(future.done, f"the answer of {service}")
        self.node.destroy_client(client)
        return future.result()


class Camera:
    """Publishes images, as fast as they go or at a `rate` in Hz, stamped 30 Hz.

    Each camera's stamps begin far after those of the one before it.
    """

    _last_stamp = 0

    def __init__(
        self,
        probe: Probe,
        topic: str = "/image_raw",
        message_type: type[Any] = Image,
        qos: QoSProfile = RELIABLE,
        rate: float = math.inf,
        heard: bool = True,
    ) -> None:
        self._probe = probe
        self._publisher = probe.advertise(topic, message_type, qos, heard)
        self._step = 1.0 / rate
        self._due = time.monotonic()
        self.stamp = max(time.time_ns(), Camera._last_stamp + 10 * SECOND)

    def send(self, message: Any) -> int:
        """Publish one image a frame's time after the last; return its stamp."""
        self.stamp += PERIOD
        Camera._last_stamp = max(Camera._last_stamp, self.stamp)
        message.header.stamp = ns_to_stamp(self.stamp)
        message.header.frame_id = "camera"
        self._probe.spin(self._due - time.monotonic())
        # A hold-up is not made up for by a burst.
        self._due = max(self._due + self._step, time.monotonic() - 5 * self._step)
        self._publisher.publish(message)
        return self.stamp

    def play(
        self,
        images: Iterable[npt.NDArray[Any] | Image],
        encoding: str = "mono8",
        answers: Sequence[list[Any]] = (),
    ) -> list[int]:
        """Publish images; return their stamps.

        `answers` are topics with a message for each image. They are waited for, so that a busy
        machine never has more of them under way than their publisher keeps.
        """
        before = [len(topic) for topic in answers]
        stamps: list[int] = []
        for image in images:
            given = isinstance(image, Image)
            stamps.append(self.send(image if given else message_from_image(image, encoding, 0)))
            for topic, count in zip(answers, before, strict=True):
                self._probe.wait_for(
                    lambda topic=topic, count=count: (
                        len(topic) >= count + len(stamps) - _MAX_UNANSWERED
                    ),
                    "answers to keep up",
                )
        return stamps

    def close(self) -> None:
        """Stop publishing."""
        self._probe.withdraw(self._publisher)


def stamps_of(messages: Iterable[Any]) -> list[int]:
    """Return the messages' stamps in nanoseconds."""
    return [stamp_to_ns(message.header.stamp) for message in messages]


def figures(diagnostics: Sequence[DiagnosticArray]) -> dict[str, str]:
    """Return what the newest diagnostics show."""
    newest = diagnostics[-1].status[0].values if diagnostics else ()
    return defaultdict(str, {value.key: value.value for value in newest})


def quick_and_soak(quick: int, soak: int) -> list[Any]:
    """Return a test's length in `make test` and, where minutes do not matter, in `make soak`."""
    return [quick, pytest.param(soak, marks=pytest.mark.soak)]


def moving_square(
    frames: int, size: tuple[int, int] = (120, 160), speed: float = 2.0
) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield grey frames: a still texture and, before it, a brighter square that goes right."""
    rng = np.random.default_rng(1)
    height, width = size
    ground = texture(rng, (height, width), 40, 140)
    side = height // 4
    square = texture(rng, (side, side), 150, 250)
    for number in range(frames):
        image = ground.copy()
        left, top = 10 + round(speed * number) % (width - side - 20), (height - side) // 2
        image[top : top + side, left : left + side] = square
        yield image


def texture(
    rng: np.random.Generator, size: tuple[int, int], low: float, high: float
) -> npt.NDArray[np.uint8]:
    """Return smooth random grey with something to see everywhere."""
    noise = cv2.GaussianBlur(rng.random(size, np.float32), (0, 0), 1.5)
    return cv2.normalize(noise, None, low, high, cv2.NORM_MINMAX).astype(np.uint8)
