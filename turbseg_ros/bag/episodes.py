"""Bags of what is worth keeping: from a while before something happens to a while after it."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

from rclpy.qos import DurabilityPolicy, QoSProfile

from turbseg_ros.bag.records import Record
from turbseg_ros.bag.writer import BagWriter

_SECOND = 10**9


class PreRoll:
    """The messages of the last seconds, in no more than so many bytes: the newest stay.

    `cut_to` is the shortest time, in seconds, that the bytes were enough for, None while they
    are enough.
    """

    def __init__(self, seconds: float, max_bytes: int) -> None:
        self._span = round(seconds * _SECOND)
        self._max_bytes = max_bytes
        self._messages: deque[Record] = deque()
        self._bytes = 0
        self.cut_to: float | None = None

    def add(self, message: Record) -> None:
        """Take the next message."""
        self._messages.append(message)
        self._bytes += len(message.data)
        while self._messages and message.stamp_ns - self._messages[0].stamp_ns > self._span:
            self._drop_oldest()
        if self._bytes <= self._max_bytes:
            return
        while self._bytes > self._max_bytes:
            self._drop_oldest()
        first = self._messages[0].stamp_ns if self._messages else message.stamp_ns
        held = (message.stamp_ns - first) / _SECOND
        self.cut_to = held if self.cut_to is None else min(self.cut_to, held)

    def take(self) -> list[Record]:
        """Return the messages, the oldest first, and forget them."""
        messages, self._bytes = list(self._messages), 0
        self._messages.clear()
        return messages

    def _drop_oldest(self) -> None:
        self._bytes -= len(self._messages.popleft().data)


class Episodes:
    """Writes a bag into a folder for each episode: while `happens` is called, and around it.

    Bags are named after the time (UTC) of their first message. What a topic latches goes into
    each. Whoever makes one calls `close` in the end.

    :param pre_roll: seconds that are kept from before an episode.
    :param post_roll: seconds without anything after which it ends.
    :param max_bytes: bytes that the pre-roll may take.
    :param max_seconds: seconds after which a long one goes on in another bag, None for never.
    :param on_begin: told the path of each bag when it is begun.
    :param on_end: told it, and how many messages it has, when it is complete.
    """

    def __init__(
        self,
        folder: Path,
        pre_roll: float,
        post_roll: float,
        max_bytes: int,
        max_seconds: float | None = None,
        on_begin: Callable[[Path], None] = lambda path: None,
        on_end: Callable[[Path, int], None] = lambda path, messages: None,
    ) -> None:
        self._folder = folder
        self.pre_roll = PreRoll(pre_roll, max_bytes)
        self._post_roll = round(post_roll * _SECOND)
        self._max_span = None if max_seconds is None else round(max_seconds * _SECOND)
        self._on_begin, self._on_end = on_begin, on_end
        self._qos: dict[str, QoSProfile] = {}
        self._latched: dict[str, Record] = {}
        self._bag: BagWriter | None = None
        self._path = folder
        self._open = contextlib.ExitStack()
        self._first = self._latest = self._count = 0

    @property
    def recording(self) -> bool:
        """Whether an episode is being written."""
        return self._bag is not None

    def add_topic(self, topic: str, qos: QoSProfile) -> None:
        """Say what a topic's publishers offer, which its bags tell."""
        self._qos[topic] = qos

    def write(self, message: Record) -> None:
        """Take the next message.

        :raises BagError: when it can't be written.
        """
        self.end_if_over(message.stamp_ns)
        if self._is_latched(message.topic):
            self._latched[message.topic] = message
        if self._bag is None:
            self.pre_roll.add(message)
            return
        if self._max_span is not None and message.stamp_ns - self._first > self._max_span:
            self._end()
            self._begin([message])
            return
        self._append(self._bag, message)

    def happens(self, stamp: int) -> None:
        """Say that something happens, at a time in nanoseconds: an episode begins, or goes on.

        :raises BagError: when its bag can't be written.
        """
        self._latest = max(stamp, self._latest)
        if self._bag is None:
            self._begin(self.pre_roll.take())

    def end_if_over(self, now: int) -> None:
        """End an episode in which nothing has happened for the post-roll.

        :raises BagError: when its bag can't be written.
        """
        if self._bag is not None and now - self._latest > self._post_roll:
            self._end()

    def close(self) -> None:
        """End the episode, if there is one.

        :raises BagError: when its bag can't be written.
        """
        if self._bag is not None:
            self._end()

    def _begin(self, messages: list[Record]) -> None:
        self._first = messages[0].stamp_ns if messages else self._latest
        self._path = _free_path(self._folder, self._first)
        self._bag = self._open.enter_context(BagWriter(self._path))
        self._count = 0
        self._on_begin(self._path)
        there = {message.topic for message in messages}
        for latched in self._latched.values():
            if latched.topic not in there:
                self._append(self._bag, replace(latched, stamp_ns=self._first))
        for message in messages:
            self._append(self._bag, message)

    def _append(self, bag: BagWriter, message: Record) -> None:
        if message.topic in self._qos and not bag.has_topic(message.topic):
            bag.add_topic(message.topic, message.type_name, self._qos[message.topic])
        bag.write_serialized(message.topic, message.type_name, message.data, message.stamp_ns)
        self._count += 1

    def _end(self) -> None:
        self._bag = None
        self._open.close()
        self._on_end(self._path, self._count)

    def _is_latched(self, topic: str) -> bool:
        qos: Mapping[str, QoSProfile] = self._qos
        return topic in qos and qos[topic].durability == DurabilityPolicy.TRANSIENT_LOCAL


def _free_path(folder: Path, stamp: int) -> Path:
    """Return a path that nothing has yet, named after a time."""
    when = datetime.fromtimestamp(stamp / _SECOND, timezone.utc)
    name = f"{when:%Y-%m-%dT%H-%M-%S}"
    path, number = folder / name, 2
    while path.exists():
        path, number = folder / f"{name}_{number}", number + 1
    return path
