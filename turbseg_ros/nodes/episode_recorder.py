"""Recording only while something moves: the topics of a node, and what it listens to."""

from __future__ import annotations

import functools
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass

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
# Turns in which nothing waited after which nothing does: one may go to rclpy's own affairs.
_IDLE_TURNS = 3
# What is recorded of a node unless topics are named: what it says in few bytes, and its input.
_SMALL_RESULTS = {
    "centroids": "visualization_msgs/msg/MarkerArray",
    "annotations": "visualization_msgs/msg/ImageMarker",
    "image_annotations": "foxglove_msgs/msg/ImageAnnotations",
    "events": "diagnostic_msgs/msg/DiagnosticStatus",
    "detections": "vision_msgs/msg/Detection2DArray",
}
_INPUT_TYPES = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
)
_DIAGNOSTICS = "/diagnostics"
_DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True)
class _Offer:
    """What a topic is subscribed to as."""

    type_name: str
    reliability: ReliabilityPolicy
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE


def _offered(publishers: Sequence[TopicEndpointInfo]) -> _Offer | None:
    """Return what all of a topic's publishers offer, None where they are of several types."""
    if len({each.topic_type for each in publishers}) != 1:
        return None
    offered = [each.qos_profile for each in publishers]
    latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return _Offer(
        publishers[0].topic_type,
        strictest_reliability(offered),
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class EpisodeRecorder(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """Hands what is published to `episodes`, and tells it when the node shows an object.

    Topics may appear at any time. Each is subscribed to as its publishers offer it. What the node
    publishes or listens to is subscribed to before anybody publishes it, the latter as the node
    does: whoever subscribes only once a camera is there misses its first images.

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
        self._result_types = {f"{node}/{name}": kind for name, kind in _SMALL_RESULTS.items()}
        self._result_types[_DIAGNOSTICS] = _DIAGNOSTICS_TYPE
        self._heard: dict[str, tuple[_Offer, Subscription]] = {}
        self._published: set[str] = set()
        # How often anything was called, by which it shows whether anything waited.
        self._calls = 0
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

    def take_waiting(self) -> None:
        """Take all that has come by now, before it is the last.

        :raises BagError: when it can't be written.
        """
        idle = 0
        while idle < _IDLE_TURNS:
            before = self._calls
            self.spin_once(0.0)
            idle = idle + 1 if self._calls == before else 0

    def _watch(self, markers: MarkerArray) -> None:
        self._calls += 1
        if any(marker.action == Marker.ADD for marker in markers.markers):
            self._episodes.happens(time.time_ns())

    def _look(self) -> None:
        self._calls += 1
        self._episodes.end_if_over(time.time_ns())
        for topic in sorted(self._wanted()):
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers and topic in self._heard:
                continue  # once its publisher is gone, the next will most likely offer the same
            offer = _offered(publishers) if publishers else self._expected(topic)
            if offer is None or not is_installed(offer.type_name):
                continue
            self._hear(topic, offer)
            if publishers and topic not in self._published:
                self._published.add(topic)
                self.get_logger().info(f"recording {topic} ({offer.type_name})")
        if (held := self._episodes.pre_roll.cut_to) is not None:
            self._throttled.warning(
                "memory",
                f"the pre-roll's memory is enough for {held:.1f} s only; --memory gives it more",
            )

    def _wanted(self) -> set[str]:
        if self._topics is not None:
            return self._topics
        wanted = {*self._result_types}
        if self._watched in self.get_node_names_and_namespaces():
            heard = self.get_subscriber_names_and_types_by_node(*self._watched)
            wanted |= {topic for topic, types in heard if {*types} & {*_INPUT_TYPES}}
        return wanted

    def _expected(self, topic: str) -> _Offer | None:
        """Return what a topic that nobody publishes will most likely be, None where that is open.

        Its publishers will be such as the node hears, whose own topics are known.
        """
        if topic in self._result_types:
            return _Offer(self._result_types[topic], ReliabilityPolicy.RELIABLE)
        listening = [
            each
            for each in self.get_subscriptions_info_by_topic(topic)
            if (each.node_name, each.node_namespace) == self._watched
        ]
        if len({each.topic_type for each in listening}) != 1:
            return None
        asked = {each.qos_profile.reliability for each in listening}
        reliable = ReliabilityPolicy.RELIABLE in asked
        return _Offer(
            listening[0].topic_type,
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )

    def _hear(self, topic: str, offer: _Offer) -> None:
        """Subscribe to a topic, or anew where it is offered otherwise than before."""
        if topic in self._heard:
            before, subscription = self._heard[topic]
            if before == offer:
                return
            self.destroy_subscription(subscription)
        self._heard[topic] = offer, self._subscribe(topic, offer)

    def _subscribe(self, topic: str, offer: _Offer) -> Subscription:
        qos = QoSProfile(depth=_DEPTH, reliability=offer.reliability, durability=offer.durability)
        self._episodes.add_topic(topic, qos)
        return self.create_subscription(
            message_class(offer.type_name),
            topic,
            functools.partial(self._record, topic, offer.type_name),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def _record(self, topic: str, type_name: str, cdr: bytes) -> None:
        self._calls += 1
        self._episodes.write(Record(topic, type_name, time.time_ns(), cdr))
