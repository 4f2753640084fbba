"""Subscribing to a topic as its publishers offer it, and receiving beside all else."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import (
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from turbseg_ros.nodes.operator_log import incompatible_text
from turbseg_ros.nodes.rcl_take import MessageTaker, Taken
from turbseg_ros.nodes.receiving_node import ReceivedElsewhere, ReceivingNode, left_to_reception
from turbseg_ros.parameters import ParameterError

_FORCED = {
    "reliable": ReliabilityPolicy.RELIABLE,
    "best_effort": ReliabilityPolicy.BEST_EFFORT,
}

# Seconds between errors that are logged, and of rest after each.
_ERROR_PERIOD = 5.0
_RESPITE = 0.1


def strictest_reliability(offered: Iterable[QoSProfile]) -> ReliabilityPolicy:
    """Return the strictest reliability that every publisher meets.

    A best-effort subscription hears everybody, but loses most of the large images that span
    hundreds of datagrams. A reliable one loses nothing, but hears no best-effort publisher.
    """
    if all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered):
        return ReliabilityPolicy.RELIABLE
    return ReliabilityPolicy.BEST_EFFORT


class MatchingSubscription:
    """A subscription whose reliability follows what the topic's publishers offer.

    Messages are received in a thread of its own, which hands them to `callback` serialised, as
    they came. `match` looks at the publishers and, when they have changed, subscribes anew: call
    it regularly. `reliability` is `auto` to match, or `reliable` or `best_effort` to force. ROS'
    own QoS overrides (``qos_overrides.<topic>.subscription.*``) go before both. `on_lost` is told
    how many messages never came, where the middleware numbers them (Fast DDS does).

    :raises ParameterError: when ROS refuses the QoS overrides.
    """

    def __init__(
        self,
        node: ReceivingNode,
        message_type: type[Any],
        topic: str,
        callback: Callable[[memoryview], None],
        *,
        taker: MessageTaker,
        depth: int,
        reliability: str,
        on_lost: Callable[[int], None],
    ) -> None:
        self.topic = node.resolve_topic_name(topic)
        self.type_name = f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"
        self._node = node
        self._message_type = message_type
        self._callback = callback
        self._taker = taker
        self._depth = depth
        self._on_lost = on_lost
        self._numbers = SequenceNumbers()
        self._forced = _FORCED.get(reliability)
        self._overridden = node.has_parameter(
            f"qos_overrides.{self.topic}.subscription.reliability"
        )
        self._unheard: set[bytes] = set()
        first = self._wanted_reliability(ReliabilityPolicy.RELIABLE)
        self._subscription = self._subscribe(first)
        self._reception = self._receive_in_a_thread()

    @property
    def reliability(self) -> ReliabilityPolicy:
        """The reliability in force."""
        return self._subscription.qos_profile.reliability

    @property
    def qos(self) -> str:
        """What is asked of the publishers, for people."""
        profile = self._subscription.qos_profile
        matching = self._forced is None and not self._overridden
        follows = ", or less where publishers offer less" if matching else ""
        return f"QoS {profile.reliability.name.lower()}{follows}, depth {profile.depth}"

    @property
    def publisher_count(self) -> int:
        """Publishers of the topic, heard or not; those of other message types don't count."""
        return self.published_types.count(self.type_name)

    @property
    def published_types(self) -> list[str]:
        """The message type of each of the topic's publishers."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        return [publisher.topic_type for publisher in publishers]

    @property
    def incompatibility(self) -> str:
        """What is asked for that no publisher offers, and what to set; "" where one is heard."""
        offered = [
            publisher.qos_profile
            for publisher in self._node.get_publishers_info_by_topic(self.topic)
            if publisher.topic_type == self.type_name
        ]
        asked = self._subscription.qos_profile
        return incompatible_text(self.topic, asked, offered, self._forced is not None)

    def match(self) -> None:
        """Subscribe anew if the publishers offer another reliability than the one in force.

        Where that is forced, those who offer less are warned about, each once.
        """
        if self._forced is not None or self._overridden:
            self._warn_of_unheard()
            return
        wanted = self._wanted_reliability(self.reliability)
        if wanted == self.reliability:
            return
        self._node.get_logger().info(
            f"subscribing to {self.topic} as {wanted.name.lower()}, as its publishers offer"
        )
        self.destroy()
        self._subscription = self._subscribe(wanted)
        self._reception = self._receive_in_a_thread()

    def destroy(self) -> None:
        """Stop listening; no message is handed on after that."""
        self._reception.stop()
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
                left_to_reception,
                QoSProfile(depth=self._depth, reliability=reliability),
                callback_group=ReceivedElsewhere(),
                qos_overriding_options=self._overriding_options(),
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
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

    def _warn_of_unheard(self) -> None:
        # Asked for here: a subscription's events would wake the executor for every message.
        unheard = {
            bytes(publisher.endpoint_gid)
            for publisher in self._node.get_publishers_info_by_topic(self.topic)
            if not self._hears(publisher.qos_profile)
        }
        if unheard - self._unheard:
            self._node.get_logger().warning(
                f"a publisher of {self.topic} offers less than {self.reliability.name.lower()}, "
                "so it is not heard; qos.reliability: auto takes what is offered"
            )
        self._unheard = unheard

    def _hears(self, offered: QoSProfile) -> bool:
        compatibility, _ = qos_check_compatible(offered, self._subscription.qos_profile)
        return bool(compatibility != QoSCompatibility.ERROR)

    def _receive_in_a_thread(self) -> _Reception:
        return _Reception(self._node, self._subscription, self._taker, self._receive)

    def _receive(self, taken: Taken) -> None:
        missing = self._numbers.missing_before(taken.number)
        # Each publisher counts for itself, so that two can't be told from one that lost some.
        if missing and self.publisher_count == 1:
            self._on_lost(missing)
        self._callback(taken.data)


class _Reception:
    """A thread that takes a subscription's messages as they come."""

    def __init__(
        self,
        node: ReceivingNode,
        subscription: Subscription,
        taker: MessageTaker,
        receive: Callable[[Taken], None],
    ) -> None:
        self._node = node
        self._subscription = subscription
        self._taker = taker
        self._receive = receive
        self._stopping = threading.Event()
        self._wake = GuardCondition(None, None, context=node.context)
        self._thread = threading.Thread(target=self._run, name="reception", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread, unless it has ended already."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._wake.trigger()
        self._thread.join()
        self._wake.destroy()

    def _run(self) -> None:
        context, handle = self._node.context, self._subscription.handle
        with context.handle, handle, self._wake.handle:
            # As rclpy.wait_for_message does; in public, rclpy waits for whole nodes only.
            wait_set = rclpy_implementation.WaitSet(1, 1, 0, 0, 0, 0, context.handle)
            with wait_set:
                while not self._stopping.is_set() and context.ok():
                    self._take_next(wait_set, handle)

    def _take_next(self, wait_set: Any, handle: Any) -> None:
        try:
            wait_set.clear_entities()
            wait_set.add_subscription(handle)
            wait_set.add_guard_condition(self._wake.handle)
            wait_set.wait(-1)
            taken = self._taker.take(self._subscription)
            if taken is not None:
                self._receive(taken)
        except Exception:
            # Whatever it is, the next message may be sound.
            self._node.get_logger().error(
                f"receiving from {self._subscription.topic_name} failed: {traceback.format_exc()}",
                throttle_duration_sec=_ERROR_PERIOD,
            )
            self._stopping.wait(_RESPITE)


class SequenceNumbers:
    """The numbers of one publisher's messages as they arrive."""

    def __init__(self) -> None:
        self._last: int | None = None

    def missing_before(self, number: int | None) -> int:
        """Return how many were left out before this one; a smaller one is another publisher's.

        `number` is None where the middleware does not number messages.
        """
        last, self._last = self._last, number
        if number is None or last is None:
            return 0
        return max(number - last - 1, 0)
