"""The frames of a bag, in the order they were recorded, without middleware."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Generator, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

from turbseg_ros.bag.reader import BagReader, Record
from turbseg_ros.bag.schema import message_class
from turbseg_ros.messages.images import ImageConversionError, frame_from_serialised
from turbseg_ros.messages.stream_monitor import Action, StreamMonitor
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.throttle import ThrottledLogger

T = TypeVar("T")

_LOGGER = logging.getLogger(__name__)
_END = object()


class BagFrames:
    """The frames of a bag's image topic, in the order they were recorded.

    As the node does with what arrives: where stamps say nothing, frames count as taken when they
    were recorded, and one after a jump in time or a long gap begins a new stream. An image that
    can't be read as one, comes twice or late is warned about, throttled by kind, counted in
    `skipped` and left out; `lost` counts those that the bag states and that its damaged parts no
    longer give.
    """

    def __init__(self, reader: BagReader, image_topic: str) -> None:
        self._reader = reader
        self._topic = image_topic
        self._kind = message_class(reader.topics[image_topic].type_name)
        self.skipped = 0
        self.lost = 0
        self._throttled = ThrottledLogger(_LOGGER)

    def __len__(self) -> int:
        """Images that the bag states, those that turn out unreadable or lost included."""
        return self._reader.topics[self._topic].message_count

    def __iter__(self) -> Iterator[Frame]:
        self.skipped = 0
        self.lost = len(self)
        monitor = StreamMonitor()
        for number, record in enumerate(self._reader.messages([self._topic])):
            self.lost -= 1
            frame = self._frame(number, record, monitor)
            if frame is not None:
                yield frame

    def _frame(self, number: int, record: Record, monitor: StreamMonitor) -> Frame | None:
        try:
            frame = frame_from_serialised(memoryview(record.data), self._kind)
        except ImageConversionError as error:
            self._skip(number, type(error).__name__, str(error))
            return None
        verdict = monitor.judge(frame, record.stamp_ns)
        if verdict.notice:
            _LOGGER.warning("%s: %s", self._topic, verdict.notice)
        if verdict.action is Action.SKIP:
            self._skip(number, verdict.continuity, verdict.reason)
            return None
        if verdict.action is Action.RESTART:
            self._throttled.info(
                verdict.continuity, f"image {number}: new window: {verdict.reason}"
            )
        return verdict.frame

    def _skip(self, number: int, kind: Hashable, reason: str) -> None:
        self.skipped += 1
        self._throttled.warning(kind, f"image {number} of {self._topic} skipped: {reason}")


def ahead(items: Iterable[T], depth: int = 2) -> Generator[T, None, None]:
    """Return items as they are, made in a thread of its own, up to `depth` ahead of their use.

    What fails there is raised here, where the item would have come.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1) as worker:
        pending = deque(worker.submit(next, iterator, _END) for _ in range(depth))
        try:
            while (item := pending.popleft().result()) is not _END:
                pending.append(worker.submit(next, iterator, _END))
                yield cast(T, item)
        finally:
            for future in pending:
                future.cancel()
