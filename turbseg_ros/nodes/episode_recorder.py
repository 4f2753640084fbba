"""Recording only while something moves: the topics of a node, and what it listens to."""

from __future__ import annotations

import functools
import time
from collections.abc import Collection

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from visualization_msgs.msg import Marker, MarkerArray

from turbseg_ros.bag.episodes import Episodes
from turbseg_ros.bag.records import Record
from turbseg_ros.bag.schema import is_installed, message_class
from turbseg_ros.nodes.subscription import strictest_reliability
from turbseg_ros.throttle import ThrottledLogger

# Seconds from one look at what is published to the next.
_LOOK_PERIOD = 0.2
# Messages that may wait in the middleware.
_DEPTH = 100
# What is recorded of a node unless topics are named: what it says in few bytes, and its input.
_SMALL_RESULTS = ("centroids", "annotations", "image_annotations", "events", "detections")
_INPUT_TYPES = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
)
_DIAGNOSTICS = "/diagnostics"


class EpisodeRecorder(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """Hands what is published to `episodes`, and tells it when the node shows an object.

    Topics may appear at any time. Each is subscribed to as its publishers offer it.

    :param node: full name of the node that segments, as /turbseg.
    :param topics: those to be recorded; None for what the node listens to, and what it publishes
        in few bytes.
    """

    def __init__(self, episodes: Episodes, node: str, topics: Collection[str] | None) -> None:
        super().__init__("turbseg_record")
        self._episodes = episodes
        namespace, _, name = node.rpartition("/")
        self._watched = name, namespace or "/"
        self._results = node
        self._topics = None if topics is None else {*map(self.resolve_topic_name, topics)}
        self._heard: dict[str, Subscription] = {}
        self._throttled = ThrottledLogger(self.get_logger(), period=60.0)
        self.create_subscription(
            MarkerArray,
            f"{node}/centroids",
            self._watch,
            QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE),
        )
        self.create_timer(_LOOK_PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)
        self._look()

    def spin_once(self, timeout: float) -> None:
        """Wait for a message, `timeout` seconds at most, and take it.

        :raises BagError: when it can't be written.
        """
        self._spinner.spin_once(timeout_sec=timeout)

    def _watch(self, markers: MarkerArray) -> None:
        if any(marker.action == Marker.ADD for marker in markers.markers):
            self._episodes.happens(time.time_ns())

    def _look(self) -> None:
        self._episodes.end_if_over(time.time_ns())
        for topic in sorted(self._wanted() - self._heard.keys()):
            publishers = self.get_publishers_info_by_topic(topic)
            types = {each.topic_type for each in publishers}
            if len(types) == 1 and is_installed(next(iter(types))):
                self._subscribe(topic, next(iter(types)), publishers)
        if (held := self._episodes.pre_roll.cut_to) is not None:
            self._throttled.warning(
                "memory",
                f"the pre-roll's memory is enough for {held:.1f} s only; --memory gives it more",
            )

    def _wanted(self) -> set[str]:
        if self._topics is not None:
            return self._topics
        wanted = {f"{self._results}/{name}" for name in _SMALL_RESULTS} | {_DIAGNOSTICS}
        if self._watched in self.get_node_names_and_namespaces():
            heard = self.get_subscriber_names_and_types_by_node(*self._watched)
            wanted |= {topic for topic, types in heard if {*types} & {*_INPUT_TYPES}}
        return wanted

    def _subscribe(
        self, topic: str, type_name: str, publishers: Collection[TopicEndpointInfo]
    ) -> None:
        offered = [each.qos_profile for each in publishers]
        latches = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
        qos = QoSProfile(
            depth=_DEPTH,
            reliability=strictest_reliability(offered),
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if latches else DurabilityPolicy.VOLATILE
            ),
        )
        self._episodes.add_topic(topic, qos)
        self._heard[topic] = self.create_subscription(
            message_class(type_name),
            topic,
            functools.partial(self._record, topic, type_name),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self.get_logger().info(f"recording {topic} ({type_name})")

    def _record(self, topic: str, type_name: str, cdr: bytes) -> None:
        self._episodes.write(Record(topic, type_name, time.time_ns(), cdr))
