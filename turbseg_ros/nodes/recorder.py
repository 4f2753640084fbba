"""Recording of topics into a bag."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Mapping

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.writer import BagWriter

# Deep, so that a pause of the recorder's process loses nothing.
_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


class Recorder(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """Writes what is published on topics into a bag, as it came and when it came.

    `topics` gives the name of each topic's message type. It subscribes reliably, as fits the
    node's outputs.
    """

    def __init__(self, bag: BagWriter, topics: Mapping[str, str]) -> None:
        super().__init__("recorder")
        self._bag = bag
        for topic, type_name in topics.items():
            bag.add_topic(topic, type_name, _QOS)
        self._received: Counter[str] = Counter()
        self._recorded_subscriptions = [
            self.create_subscription(
                message_class(type_name),
                topic,
                functools.partial(self._record, topic, type_name),
                _QOS,
                raw=True,
            )
            for topic, type_name in topics.items()
        ]
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)

    @property
    def matched(self) -> bool:
        """Whether every topic has a publisher that this recorder hears."""
        return all(
            subscription.get_publisher_count() > 0 for subscription in self._recorded_subscriptions
        )

    def spin_once(self, timeout: float) -> None:
        """Wait for a message, `timeout` seconds at most, and record it."""
        self._spinner.spin_once(timeout_sec=timeout)

    def received(self, topic: str) -> int:
        """Return the number of messages recorded of a topic."""
        return self._received[topic]

    def _record(self, topic: str, type_name: str, cdr: bytes) -> None:
        self._bag.write_serialized(topic, type_name, cdr, time.time_ns())
        self._received[topic] += 1
