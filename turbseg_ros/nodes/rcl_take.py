"""Taking messages from the middleware while Python's other threads go on.

rclpy holds Python's lock while it takes a message and copies it, twice. For a 1080p image in
colour that is time enough to segment a good part of a frame. ctypes lets the lock go, so rcl, ROS'
interface for client libraries in C, is called by it, in the copy of it that rclpy has loaded. The
structures below are those of ROS 2 Jazzy; `MessageTaker` tries them out before it uses them, and
goes rclpy's own way where they don't hold.

This file can go once rclpy itself releases the lock in `Subscription.take_message`, which
https://github.com/ros2/rclpy/issues/1025 asks for: `subscription.handle.take_message(type, True)`
then does all that is wanted here.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from turbseg_ros.nodes.receiving_node import ReceivedElsewhere, left_to_reception

# Of rcl/types.h: RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED.
_OK, _NOTHING_THERE = 0, 401
# Of rmw/types.h, RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED: the middleware numbers no messages.
_UNNUMBERED = 2**64 - 1

_TRIAL_TOPIC = "~/_trial_of_taking"
# Two messages of the trial, so that what the first leaves behind shows in the second. Bytes.
_TRIAL_SIZES = (1_000, 70_000)
# Seconds that the trial may last, and of rest between two looks.
_TRIAL_LIMIT = 3.0
_TRIAL_POLL = 0.002


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _Bytes(ctypes.Structure):
    """rcutils_uint8_array_t, which holds a serialised message."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t, of which the first fields are read; with room for it to grow."""

    _fields_ = [
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("others", ctypes.c_uint8 * 256),
    ]


class _ErrorString(ctypes.Structure):
    """rcutils_error_string_t."""

    _fields_ = [("text", ctypes.c_char * 1024)]


# Name, arguments and result of each function that is called.
_FUNCTIONS = (
    (
        "rcl_take_serialized_message",
        (
            ctypes.c_void_p,  # rcl_subscription_t
            ctypes.POINTER(_Bytes),
            ctypes.POINTER(_MessageInfo),
            ctypes.c_void_p,  # rmw_subscription_allocation_t, which may be missing
        ),
        ctypes.c_int,
    ),
    ("rcutils_get_zero_initialized_uint8_array", (), _Bytes),
    ("rcutils_get_default_allocator", (), _Allocator),
    ("rcutils_uint8_array_fini", (ctypes.POINTER(_Bytes),), ctypes.c_int),
    ("rcutils_get_error_string", (), _ErrorString),
    ("rcutils_reset_error", (), None),
)


class TakingError(RuntimeError):
    """rcl could not be called, or could not give a message."""


@dataclass(frozen=True)
class Taken:
    """A message as the middleware carries it.

    `data` is its CDR, whose memory is the message's own for as long as anything views it;
    `number` is its publisher's count, None where the middleware does not number messages.
    """

    data: memoryview
    number: int | None


class MessageTaker:
    """Takes messages by rcl where that can be trusted, and rclpy's own way elsewhere.

    rcl is tried out when one is made: two messages on a private topic must come by it as they
    come by rclpy. After its first failure, then or later, rclpy's own way is used for good. The
    log says once which one is in use, and again if that changes.

    :param node: the node that the trial's topic belongs to, and that logs.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._uses_rcl = False
        try:
            _compare_with_rclpy(node)
        except Exception as error:
            # Whatever it is, rclpy can do without.
            self._say_why_not(error)
        else:
            self._uses_rcl = True
            self._logger.info("images are taken by rcl, which lets other threads go on")

    @property
    def uses_rcl(self) -> bool:
        """Whether messages are taken by rcl, not rclpy's own way."""
        return self._uses_rcl

    def take(self, subscription: Subscription) -> Taken | None:
        """Return the message that waits longest at a subscription, None when none does.

        The caller holds the subscription's handle meanwhile, so that nobody destroys it.

        :raises RuntimeError: when rclpy can't take a message either.
        """
        if self._uses_rcl:
            try:
                return take_by_rcl(subscription)
            except Exception as error:
                self._uses_rcl = False
                self._say_why_not(error)
        return take_by_rclpy(subscription)

    def _say_why_not(self, error: Exception) -> None:
        self._logger.warning(
            f"images are taken by rclpy, which holds up other threads meanwhile: {error}"
        )


def take_by_rcl(subscription: Subscription) -> Taken | None:
    """Return the message that waits longest at a subscription, None when none does.

    Python's other threads go on meanwhile.

    :raises TakingError: when rcl can't be called, or fails.
    """
    rcl = _rcl()
    owner = _OwnedBytes(rcl)
    info = _MessageInfo()
    status = rcl.rcl_take_serialized_message(
        subscription.handle.pointer, ctypes.byref(owner.content), ctypes.byref(info), None
    )
    if status == _NOTHING_THERE:
        return None
    if status != _OK:
        reason = rcl.rcutils_get_error_string().text.decode(errors="replace")
        rcl.rcutils_reset_error()
        raise TakingError(f"rcl_take_serialized_message returned {status}: {reason}")
    return Taken(owner.view(), _number(info.publication_sequence_number))


def take_by_rclpy(subscription: Subscription) -> Taken | None:
    """Return what `take_by_rcl` does, by rclpy's own means: all other threads wait meanwhile.

    :raises RuntimeError: when rclpy can't take a message.
    """
    taken = subscription.handle.take_message(subscription.msg_type, True)
    if taken is None:
        return None
    data, info = taken
    return Taken(memoryview(data), _number(info["publication_sequence_number"]))


def _number(publication_sequence_number: int) -> int | None:
    return None if publication_sequence_number == _UNNUMBERED else publication_sequence_number


class _OwnedBytes:
    """Memory that the middleware fills, and that goes with the last view of it."""

    def __init__(self, rcl: ctypes.CDLL) -> None:
        self._free = rcl.rcutils_uint8_array_fini
        self.content = rcl.rcutils_get_zero_initialized_uint8_array()
        self.content.allocator = rcl.rcutils_get_default_allocator()

    def __del__(self) -> None:
        self._free(ctypes.byref(self.content))

    def view(self) -> memoryview:
        content = self.content
        if not content.length:
            return memoryview(b"")
        array = (ctypes.c_uint8 * content.length).from_address(content.buffer)
        array.owner = self  # type: ignore[attr-defined]
        return memoryview(array).cast("B").toreadonly()


@functools.cache
def _rcl() -> ctypes.CDLL:
    """Return the library whose functions are those of rcl, as rclpy has loaded it.

    :raises TakingError: when it lacks one.
    """
    try:
        library = ctypes.CDLL(rclpy_implementation.__file__)
        for name, arguments, result in _FUNCTIONS:
            function = getattr(library, name)
            function.argtypes, function.restype = arguments, result
    except (OSError, AttributeError) as error:
        raise TakingError(f"rcl can't be called: {error}") from error
    return library


def _compare_with_rclpy(node: Node) -> None:
    """Send messages to two subscriptions, of which rcl takes one's and rclpy the other's.

    :raises TakingError: when rcl fails, a message does not come in time, or two differ.
    """
    qos = QoSProfile(depth=len(_TRIAL_SIZES), durability=DurabilityPolicy.TRANSIENT_LOCAL)
    until = time.monotonic() + _TRIAL_LIMIT
    with contextlib.ExitStack() as stack:
        subscriptions = []
        for _ in range(2):
            subscription = node.create_subscription(
                Image, _TRIAL_TOPIC, left_to_reception, qos, callback_group=ReceivedElsewhere()
            )
            stack.callback(node.destroy_subscription, subscription)
            stack.enter_context(subscription.handle)
            subscriptions.append(subscription)
        publisher = node.create_publisher(Image, _TRIAL_TOPIC, qos)
        stack.callback(node.destroy_publisher, publisher)
        for number, size in enumerate(_TRIAL_SIZES, start=1):
            message = Image(height=1, width=size, step=size, encoding="mono8")
            message.data.frombytes(bytes([number]) * size)
            publisher.publish(message)
        for _ in _TRIAL_SIZES:
            by_rcl = _awaited(take_by_rcl, subscriptions[0], until)
            by_rclpy = _awaited(take_by_rclpy, subscriptions[1], until)
            if by_rcl != by_rclpy:
                raise TakingError("rcl does not give what rclpy gives")


def _awaited(
    take: Callable[[Subscription], Taken | None], subscription: Subscription, until: float
) -> Taken:
    while (taken := take(subscription)) is None:
        if time.monotonic() > until:
            raise TakingError(f"no message came within {_TRIAL_LIMIT:g} s to try rcl with")
        time.sleep(_TRIAL_POLL)
    return taken
