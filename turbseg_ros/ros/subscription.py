"""Subscribing to a topic as its publishers offer it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from turbseg_ros.parameters import ParameterError

_FORCED = {
    "reliable": ReliabilityPolicy.RELIABLE,
    "best_effort": ReliabilityPolicy.BEST_EFFORT,
}


def strictest_reliability(offered: Iterable[QoSProfile]) -> ReliabilityPolicy:
    """Give the strictest reliability that every publisher meets.

    A best-effort subscription hears everybody, but loses most of the large images that span
    hundreds of datagrams. A reliable one loses nothing, but hears no best-effort publisher.
    """
    if all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered):
        return ReliabilityPolicy.RELIABLE
    return ReliabilityPolicy.BEST_EFFORT


class MatchingSubscription:
    """A subscription whose reliability follows what the topic's publishers offer.

    `match` looks at them and, when they have changed, subscribes anew: call it regularly.
    `reliability` is `auto` to match, or `reliable` or `best_effort` to force. ROS' own QoS
    overrides (``qos_overrides.<topic>.subscription.*``) go before both. `on_lost` is told how
    many messages never came, where the middleware numbers them (Fast DDS does).

    :raises ParameterError: when ROS refuses the QoS overrides.
    """

    def __init__(
        self,
        node: Node,
        message_type: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        *,
        depth: int,
        reliability: str,
        on_lost: Callable[[int], None],
    ) -> None:
        self.topic = node.resolve_topic_name(topic)
        self._node = node
        self._message_type = message_type
        self._callback = callback
        self._depth = depth
        self._on_lost = on_lost
        self._numbers = SequenceNumbers()
        self._forced = _FORCED.get(reliability)
        self._overridden = node.has_parameter(
            f"qos_overrides.{self.topic}.subscription.reliability"
        )
        first = self._wanted_reliability(ReliabilityPolicy.RELIABLE)
        self._subscription = self._subscribe(first)

    @property
    def reliability(self) -> ReliabilityPolicy:
        """The reliability in force."""
        return self._subscription.qos_profile.reliability

    @property
    def publisher_count(self) -> int:
        """Publishers of the topic, heard or not."""
        return int(self._node.count_publishers(self.topic))

    def match(self) -> None:
        """Subscribe anew if the publishers offer another reliability than the one in force."""
        wanted = self._wanted_reliability(self.reliability)
        if wanted == self.reliability or self._overridden:
            return
        self._node.get_logger().info(
            f"subscribing to {self.topic} as {wanted.name.lower()}, as its publishers offer"
        )
        self.destroy()
        self._subscription = self._subscribe(wanted)

    def destroy(self) -> None:
        """Stop listening."""
        self._node.destroy_subscription(self._subscription)

    def _wanted_reliability(self, current: ReliabilityPolicy) -> ReliabilityPolicy:
        if self._forced is not None:
            return self._forced
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        if not publishers:
            # The next one will most likely be the last one, started anew.
            return current
        return strictest_reliability(publisher.qos_profile for publisher in publishers)

    def _subscribe(self, reliability: ReliabilityPolicy) -> Subscription:
        try:
            return self._node.create_subscription(
                self._message_type,
                self.topic,
                self._receive,
                QoSProfile(depth=self._depth, reliability=reliability),
                qos_overriding_options=self._overriding_options(),
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._warn_of_incompatible_qos
                ),
            )
        except (RuntimeError, AssertionError) as error:
            # What rclpy raises for an override that is no such policy or of the wrong type.
            reason = str(error) or "a value of the wrong type"
            raise ParameterError(
                f"parameters qos_overrides.{self.topic}.subscription.* are refused: {reason}"
            ) from error

    def _overriding_options(self) -> QoSOverridingOptions:
        if self._overridden:
            return QoSOverridingOptions.with_default_policies()
        # A parameter for the reliability would pin the first match for good.
        return QoSOverridingOptions((QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH))

    def _warn_of_incompatible_qos(self, _event: QoSRequestedIncompatibleQoSInfo) -> None:
        if self._forced is None and not self._overridden:
            # The next match mends it.
            return
        self._node.get_logger().warning(
            f"a publisher of {self.topic} offers less than {self.reliability.name.lower()}, so it "
            "is not heard; qos.reliability: auto takes what is offered"
        )

    def _receive(self, message: Any, info: Mapping[str, int | None]) -> None:
        missing = self._numbers.missing_before(info["publication_sequence_number"])
        # Each publisher counts for itself, so that two can't be told from one that lost some.
        if missing and self.publisher_count == 1:
            self._on_lost(missing)
        self._callback(message)


class SequenceNumbers:
    """The numbers of one publisher's messages as they arrive."""

    def __init__(self) -> None:
        self._last: int | None = None

    def missing_before(self, number: int | None) -> int:
        """Give how many were left out before this one; a smaller one is another publisher's.

        `number` is None where the middleware does not number messages.
        """
        last, self._last = self._last, number
        if number is None or last is None:
            return 0
        return max(number - last - 1, 0)
