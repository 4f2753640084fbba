"""Taking messages from the middleware while Python's other threads go on.

rclpy holds Python's lock while it copies a message, twice. For a 1080p image in colour that is
time enough to segment a good part of a frame. ctypes lets the lock go, so rcl, ROS' interface for
client libraries in C, is called by it, in the copy of it that rclpy has loaded.
"""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

# Of rcl/types.h.
_OK, _NOTHING_THERE = 0, 401
# Of rmw/types.h: what a middleware that numbers no messages gives.
_NO_NUMBER = 2**64 - 1


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
    """rmw_message_info_t, of which the first fields are read."""

    _fields_ = [
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("others", ctypes.c_uint8 * 256),
    ]


class _ErrorString(ctypes.Structure):
    """rcutils_error_string_t."""

    _fields_ = [("text", ctypes.c_char * 1024)]


class TakingError(RuntimeError):
    """The middleware could not give a message."""


@dataclass(frozen=True)
class Taken:
    """A message as the middleware carries it.

    `data` is its CDR, whose memory is the message's own for as long as anything views it;
    `number` is its publisher's count, None where the middleware does not number messages.
    """

    data: memoryview
    number: int | None


def take(subscription: Any) -> Taken | None:
    """Return the message that waits longest at a subscription, None when none does.

    :param subscription: an rclpy handle, which the caller holds meanwhile.
    :raises TakingError: when the middleware fails.
    """
    owner = _OwnedBytes()
    info = _MessageInfo()
    status = _rcl().rcl_take_serialized_message(
        ctypes.c_void_p(subscription.pointer),
        ctypes.byref(owner.content),
        ctypes.byref(info),
        None,
    )
    if status == _NOTHING_THERE:
        return None
    if status != _OK:
        raise TakingError(f"taking a message failed ({status}): {_taken_error()}")
    number = info.publication_sequence_number
    return Taken(owner.view(), None if number == _NO_NUMBER else number)


class _OwnedBytes:
    """Memory that the middleware fills, and that goes with the last view of it."""

    def __init__(self) -> None:
        self.content = _rcl().rcutils_get_zero_initialized_uint8_array()
        self.content.allocator = _rcl().rcutils_get_default_allocator()

    def __del__(self) -> None:
        _rcl().rcutils_uint8_array_fini(ctypes.byref(self.content))

    def view(self) -> memoryview:
        content = self.content
        if not content.length:
            return memoryview(b"")
        array = (ctypes.c_uint8 * content.length).from_address(content.buffer)
        array.owner = self  # type: ignore[attr-defined]
        return memoryview(array).cast("B").toreadonly()


def _taken_error() -> str:
    text = _rcl().rcutils_get_error_string().text.decode(errors="replace")
    _rcl().rcutils_reset_error()
    return str(text)


@functools.cache
def _rcl() -> Any:
    library = ctypes.CDLL(rclpy_implementation.__file__)
    library.rcutils_get_zero_initialized_uint8_array.restype = _Bytes
    library.rcutils_get_default_allocator.restype = _Allocator
    library.rcutils_get_error_string.restype = _ErrorString
    return library
