"""A node some of whose subscriptions no executor takes messages from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription


class ReceivedElsewhere(CallbackGroup):  # type: ignore[misc]  # rclpy is read as untyped
    """Marks subscriptions whose messages a thread of their own takes."""

    def can_execute(self, entity: Any) -> bool:
        """Whether an executor may take the messages: never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Whether an executor may begin with a callback: never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Take note of a callback's end, which never comes."""


class ReceivingNode(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """A node that keeps what is `ReceivedElsewhere` from executors, whichever spins it.

    Those that ask callback groups wait in vain for such messages, but do not take them. The
    events executor asks no group: it must not see the subscriptions at all.
    """

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor serves."""
        for subscription in super().subscriptions:
            if not isinstance(subscription.callback_group, ReceivedElsewhere):
                yield subscription


def left_to_reception(_message: Any) -> None:
    """Stand in for the callback of a subscription whose messages a thread takes."""
    raise AssertionError("an executor took a message that is received elsewhere")
