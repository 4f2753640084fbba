"""Times in serialised messages, replaced without knowing what else the messages hold."""

from __future__ import annotations

import functools
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from turbseg_ros.bag.schema import message_class

_HEADER, _TIME = "std_msgs/Header", "builtin_interfaces/Time"
# Plain CDR begins with two bytes that tell the byte order, and two of no meaning.
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_STAMP_BEGIN, _STAMP_END = 4, 12
_NANOSECONDS = 1_000_000_000
_SECONDS = range(-(2**31), 2**31)
# The message type that a field's description names: alone, or as an array's or sequence's.
_MESSAGE_TYPE = re.compile(r"(?:sequence<)?(?P<package>\w+)/(?P<name>\w+)")


def header_stamp(cdr: bytes, kind: type[Any]) -> int | None:
    """Return the stamp of a serialised message's header in nanoseconds.

    None where messages of that class don't begin with a header, or the data are none.
    """
    form = _stamp_format(cdr) if _begins_with_header(kind) else None
    if form is None:
        return None
    sec, nanosec = form.unpack_from(cdr, _STAMP_BEGIN)
    return _nanoseconds(sec, nanosec)


def restamped(cdr: bytes, kind: type[Any], change: Callable[[int], int]) -> bytes:
    """Return a serialised message with all its times changed, in headers and elsewhere.

    A time of 0 says "not set" and stays, but for that of the header at the beginning. So does one
    that would leave the range of messages. Data that are no such message are returned as they are.

    :param kind: the message's class.
    :param change: takes one time to another, both in nanoseconds.
    """
    if not _timed_fields(kind):
        return cdr
    if _begins_with_header(kind):
        cdr = _with_header_stamp(cdr, change)
        if len(_timed_fields(kind)) == 1:
            return cdr
    try:
        message = deserialize_message(cdr, kind)
    except Exception:  # rclpy raises a bare RMWError or RuntimeError
        return cdr
    for field in _timed_fields(kind)[int(_begins_with_header(kind)) :]:
        _change_field(message, field, change)
    return bytes(serialize_message(message))


@dataclass(frozen=True)
class _TimedField:
    """A field that is, or holds, a time, or an array of such; `kind` is the class of its parts."""

    name: str
    is_time: bool
    is_array: bool
    kind: type[Any]


def _timed_fields(kind: type[Any]) -> tuple[_TimedField, ...]:
    return _timed_fields_of(f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}")


@functools.cache
def _timed_fields_of(type_name: str) -> tuple[_TimedField, ...]:
    fields = []
    kind = message_class(type_name)
    for name, description in kind.get_fields_and_field_types().items():
        match = _MESSAGE_TYPE.match(description)
        if match is None:
            continue
        part = message_class(f"{match['package']}/msg/{match['name']}")
        is_time = f"{match['package']}/{match['name']}" == _TIME
        if is_time or _timed_fields(part):
            is_array = match[0] != description
            fields.append(_TimedField(name, is_time, is_array, part))
    return tuple(fields)


def _begins_with_header(kind: type[Any]) -> bool:
    return bool(next(iter(kind.get_fields_and_field_types().values()), "") == _HEADER)


def _stamp_format(cdr: bytes) -> struct.Struct | None:
    order = _BYTE_ORDERS.get(bytes(cdr[:2]))
    return struct.Struct(f"{order}iI") if order and len(cdr) >= _STAMP_END else None


def _with_header_stamp(cdr: bytes, change: Callable[[int], int]) -> bytes:
    form = _stamp_format(cdr)
    if form is None:
        return cdr
    sec, nanosec = form.unpack_from(cdr, _STAMP_BEGIN)
    stamp = form.pack(*_changed(sec, nanosec, change))
    return b"".join((cdr[:_STAMP_BEGIN], stamp, memoryview(cdr)[_STAMP_END:]))


def _change_field(message: Any, field: _TimedField, change: Callable[[int], int]) -> None:
    value = getattr(message, field.name)
    for part in value if field.is_array else (value,):
        if not field.is_time:
            for inner in _timed_fields(field.kind):
                _change_field(part, inner, change)
        elif part.sec or part.nanosec:
            part.sec, part.nanosec = _changed(part.sec, part.nanosec, change)


def _changed(sec: int, nanosec: int, change: Callable[[int], int]) -> tuple[int, int]:
    new_sec, new_nanosec = divmod(change(_nanoseconds(sec, nanosec)), _NANOSECONDS)
    return (new_sec, new_nanosec) if new_sec in _SECONDS else (sec, nanosec)


def _nanoseconds(sec: int, nanosec: int) -> int:
    return sec * _NANOSECONDS + nanosec
