"""Publishing of a bag's messages in their own time."""

from __future__ import annotations

import itertools
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.records import Record, Topic
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.stamps import header_stamp, restamped
from turbseg_ros.one_line import printable

_CLOCK_TOPIC = "/clock"
_CLOCK_PERIOD = 0.01  # seconds
# Messages kept for a subscriber that is slow to acknowledge them.
_DEPTH = 50
_DAY = 86400 * 10**9  # nanoseconds
# A message at time 0, which is "not set", lies decades before the others.
_MAX_GAP = _DAY
# Python answers signals between waits, so none is longer, in seconds.
_MAX_WAIT = 0.1
# Time from the end of a bag to its next round when no topic's messages tell any, in nanoseconds.
_DEFAULT_GAP = 1_000_000_000
# A camera's stamps may run by so much longer than what was recorded; by more, they have jumped.
_MAX_STAMP_EXCESS = 1_000_000_000
# Stamps given lately: messages that were taken at one time get the same new one.
_STAMPS_KEPT = 1000


class Timeline:
    """The bag's time: it runs with a steady clock, `rate` times as fast, unless paused."""

    def __init__(
        self,
        rate: float = 1.0,
        *,
        paused: bool = False,
        steady_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._rate = rate
        self._paused = paused
        self._steady_ns = steady_ns
        self.set(0)

    def set(self, stamp_ns: int) -> None:
        """Let it be `stamp_ns` now."""
        self._stamp_then = stamp_ns
        self._steady_then = self._steady_ns()

    def pause(self, paused: bool) -> None:
        """Stop time, or let it go on."""
        self.set(self.stamp_ns())
        self._paused = paused

    def stamp_ns(self) -> int:
        """Return the bag's time now, in nanoseconds."""
        if self._paused:
            return self._stamp_then
        passed = self._steady_ns() - self._steady_then
        return self._stamp_then + round(passed * self._rate)

    def seconds_until(self, stamp_ns: int) -> float:
        """Return how long it still takes, below 0 when it is past; infinite while paused."""
        if self._paused:
            return float("inf")
        return (stamp_ns - self.stamp_ns()) / self._rate * 1e-9


class _ClockSource:
    """Publishes the bag's time on /clock, from the bag's first message on."""

    def __init__(self, node: Node, timeline: Timeline) -> None:
        self._timeline = timeline
        self._publisher = node.create_publisher(Clock, _CLOCK_TOPIC, 1)
        self._timer = node.create_timer(
            _CLOCK_PERIOD,
            self.publish,
            clock=SteadyClock(clock_type=ClockType.STEADY_TIME),
            autostart=False,
        )

    def start(self) -> None:
        self._timer.reset()

    def publish(self) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self._timeline.stamp_ns(), 10**9)
        self._publisher.publish(message)


@dataclass(frozen=True)
class PlayedMessages:
    """How a bag was played: messages published, and by how many seconds the latest was late."""

    count: int
    lateness: float


class Player(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """Publishes the messages of a bag as they were recorded, byte by byte, but for their times.

    Played again, a bag goes on in time: all times in messages, and /clock, are later by the bag's
    length and the usual step from one image to the next. `~/pause` (std_srvs/SetBool) stops time
    and lets it go on.

    :param topics: those to publish, by default all whose message type is installed.
    :param clock: publish the bag's time on /clock.
    :param stamp_now: replace the times in messages by that of publishing; messages that have the
        same stamp, as an image and its camera_info do, get the same again. A recorded /clock, of
        another time, is not played then.
    :param qos: gives what is offered on a topic: `lossless_qos` or `recorded_qos`.
    :raises BagError: when `topics` names one that is not in the bag, or nothing is left to play.
    """

    def __init__(
        self,
        reader: BagReader,
        timeline: Timeline,
        *,
        topics: Collection[str] | None = None,
        clock: bool = False,
        stamp_now: bool = False,
        qos: Callable[[Topic], QoSProfile] | None = None,
    ) -> None:
        super().__init__("turbseg_play")
        self._reader = reader
        self._timeline = timeline
        replaced = {_CLOCK_TOPIC} if clock or stamp_now else set()
        self._topics = self._playable(topics, skipped=replaced)
        self._kinds = {topic.name: message_class(topic.type_name) for topic in self._topics}
        self._publishers_of = {
            topic.name: self.create_publisher(
                self._kinds[topic.name], topic.name, (qos or lossless_qos)(topic)
            )
            for topic in self._topics
        }
        self._stamp_now = stamp_now
        self._new_stamps: dict[int, int] = {}
        # By how much this round's times are later than the bag's, and what a round adds to it.
        self._shift = 0
        self._period: int | None = None
        self._clock_source = _ClockSource(self, timeline) if clock else None
        self.create_service(SetBool, "~/pause", self._on_pause)
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)

    def wait_for_subscribers(self, count: int, timeout: float) -> list[str]:
        """Wait until each topic of images has `count` subscribers, `timeout` seconds at most.

        Ground truth needs none. Return the topics that still have fewer.
        """
        deadline = time.monotonic() + timeout
        images = [topic.name for topic in self._topics if topic.has_images and not topic.is_truth]
        while True:
            missing = [
                name
                for name in images
                if self._publishers_of[name].get_subscription_count() < count
            ]
            left = deadline - time.monotonic()
            if not missing or left <= 0:
                return missing
            self._spin(left)

    def play(self) -> PlayedMessages:
        """Publish the bag once, each message when its time has come; called again, once more.

        :raises BagError: when the bag turns out to be damaged.
        """
        count, lateness = 0, 0.0
        extent = Extent() if self._period is None else None
        for record in self._reader.messages(self._publishers_of):
            if extent is not None:
                if not count:
                    self._start_time(record.stamp_ns)
                extent.add(record, self._kinds[record.topic])
            self._skip_gap(record.stamp_ns + self._shift)
            lateness = max(lateness, self._spin_until(record.stamp_ns + self._shift))
            self._publish(record)
            count += 1
        if extent is not None:
            self._period = extent.period({topic.name for topic in self._topics if _leads(topic)})
        self._shift += self._period or 0
        return PlayedMessages(count, lateness)

    def wait_until_received(self, timeout: float) -> bool:
        """Wait until all subscribers have acknowledged everything; False when time runs out."""
        deadline = time.monotonic() + timeout
        pending = list(self._publishers_of.values())
        while pending and time.monotonic() < deadline:
            if pending[-1].wait_for_all_acked(Duration(seconds=_MAX_WAIT)):
                pending.pop()
        return not pending

    def destroy_node(self) -> None:
        """Leave the graph."""
        self._spinner.shutdown()
        super().destroy_node()

    def _playable(self, asked: Collection[str] | None, skipped: Collection[str]) -> list[Topic]:
        known = self._reader.topics
        unknown = [name for name in asked or () if name not in known]
        if unknown:
            raise BagError(
                f"{self._reader.path} has no {', '.join(unknown)}; its topics: {', '.join(known)}"
            )
        names = [name for name in asked or known if name not in skipped]
        topics = [known[name] for name in names if self._can_play(known[name], bool(asked))]
        if not topics:
            raise BagError(f"{self._reader.path} has nothing to play")
        return topics

    def _can_play(self, topic: Topic, asked: bool) -> bool:
        try:
            message_class(topic.type_name)
            _check_name(topic.name)
        except BagError as error:
            if asked:
                raise
            self.get_logger().warning(f"{printable(topic.name, 100)} is not played: {error}")
            return False
        return True

    def _start_time(self, stamp_ns: int) -> None:
        self._timeline.set(stamp_ns)
        if self._clock_source is not None:
            self._clock_source.start()

    def _skip_gap(self, stamp_ns: int) -> None:
        """Go on at once where nothing is recorded for longer than anybody waits."""
        gap = stamp_ns - self._timeline.stamp_ns()
        if gap > _MAX_GAP:
            self.get_logger().warning(
                f"nothing is recorded for {gap / _DAY:.1f} days; the time between is left out"
            )
            self._timeline.set(stamp_ns)

    def _spin_until(self, stamp_ns: int) -> float:
        """Wait for a time of the bag; return by how many seconds it has passed."""
        while (left := self._timeline.seconds_until(stamp_ns)) > 0:
            self._spin(left)
        return -left

    def _spin(self, seconds: float) -> None:
        self._spinner.spin_once(timeout_sec=min(seconds, _MAX_WAIT))

    def _publish(self, record: Record) -> None:
        if self._clock_source is not None:
            self._clock_source.publish()
        data = record.data
        if self._shift or self._stamp_now:
            data = restamped(data, self._kinds[record.topic], self._new_stamp)
        self._publishers_of[record.topic].publish(data)

    def _new_stamp(self, stamp: int) -> int:
        if not self._stamp_now:
            # 0 says that there is no stamp.
            return stamp + self._shift if stamp else 0
        key = stamp + self._shift
        # Without a stamp nothing tells that two messages belong together.
        if not stamp or key not in self._new_stamps:
            self._new_stamps[key] = self.get_clock().now().nanoseconds
            if len(self._new_stamps) > _STAMPS_KEPT:
                del self._new_stamps[next(iter(self._new_stamps))]
        return self._new_stamps[key]

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._timeline.pause(request.data)
        response.success = True
        return response


class Extent:
    """The times of a bag's messages, as they were recorded and as their headers say."""

    def __init__(self) -> None:
        self._recorded: defaultdict[str, list[int]] = defaultdict(list)
        self._stamped: defaultdict[str, list[int]] = defaultdict(list)

    def add(self, record: Record, kind: type[Any]) -> None:
        """Take note of a message of that class."""
        self._recorded[record.topic].append(record.stamp_ns)
        if stamp := header_stamp(record.data, kind):
            self._stamped[record.topic].append(stamp)

    def period(self, leading: Collection[str]) -> int:
        """Return the time from a message to the same one when the bag is played once more.

        :param leading: topics whose usual step is kept across the end; all where none was played.
        :return: nanoseconds, above 0.
        """
        if not self._recorded:
            return _DEFAULT_GAP
        leaders = [topic for topic in self._recorded if topic in leading] or [
            max(self._recorded, key=lambda topic: len(self._recorded[topic]))
        ]
        recorded = max(_length_with_step(self._recorded[topic]) for topic in leaders)
        everything = list(itertools.chain.from_iterable(self._recorded.values()))
        recorded = max(recorded, max(everything) - min(everything)) or _DEFAULT_GAP
        # The last image may have been stamped later, relative to when it came, than the first.
        stamped = [_length_with_step(self._stamped[topic]) for topic in leaders]
        credible = [length for length in stamped if length <= recorded + _MAX_STAMP_EXCESS]
        return max([recorded, *credible])


def _length_with_step(times: list[int]) -> int:
    """Return how long a series of times is, with the usual step after its last."""
    if len(times) < 2:
        return 0
    steps = [later - earlier for earlier, later in itertools.pairwise(times)]
    return max(times) - min(times) + max(round(statistics.median(steps)), 0)


def _leads(topic: Topic) -> bool:
    """Whether a topic tells how a bag goes on: whether it has a camera's images."""
    return topic.has_images and not topic.is_truth


def _check_name(name: str) -> None:
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException as error:
        raise BagError(f"the bag names no ROS topic: {error}") from error


def lossless_qos(topic: Topic) -> QoSProfile:
    """Return a QoS that suits any subscriber and loses nothing: reliable, latched as recorded."""
    recorded = recorded_qos(topic)
    latched = recorded.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        # Late subscribers get as many as the recorded publishers would have given them.
        depth=recorded.depth if latched else _DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=recorded.durability,
    )


def recorded_qos(topic: Topic) -> QoSProfile:
    """Return the QoS that was recorded; of several publishers, what all of them offered."""
    offered = topic.qos or (QoSProfile(depth=_DEPTH),)
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        depth=max(1, *(profile.depth for profile in offered)),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
