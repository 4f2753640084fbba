"""The frames of a bag, in the order they were recorded, without middleware."""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from collections.abc import Generator, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.section import WHOLE
from turbseg_ros.messages.images import ImageConversionError, frame_from_serialised
from turbseg_ros.messages.stream_monitor import Action, StreamMonitor
from turbseg_ros.messages.video import (
    VIDEO_TRANSPORTS,
    VideoDecoder,
    how_to_read_video,
    video_packet,
)
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.throttle import ThrottledLogger

T = TypeVar("T")

_LOGGER = logging.getLogger(__name__)
_END = object()


class BagFrames:
    """The frames of a bag's image topic, in the order they were recorded.

    As the node does with what arrives: where stamps are unusable, frames count as taken when they
    were recorded, and one after a jump in time or a long gap begins a new stream. Video packets
    are decoded where PyAV is installed. An image that can't be read as one, comes twice or late is
    warned about, throttled by kind, counted in `skipped` and left out; so are packets that give no
    frame. `lost` counts those that the bag states and that its damaged parts no longer give; of a
    section of a bag that isn't known, and 0.

    :raises BagError: when they are video packets and PyAV is missing; also when iterated over.
    """

    def __init__(self, reader: BagReader, image_topic: str) -> None:
        self._reader = reader
        self._topic = image_topic
        self._type = reader.topics[image_topic].type_name
        self._kind = None if self._type in VIDEO_TRANSPORTS else message_class(self._type)
        if self._kind is None:
            self._video_decoder()  # refused now rather than at the first image
        self.skipped = 0
        self.lost = 0
        self._throttled = ThrottledLogger(_LOGGER)

    def __len__(self) -> int:
        """Images that the bag states, unreadable and lost ones included; about, in a section."""
        return self._reader.topics[self._topic].message_count

    def __iter__(self) -> Iterator[Frame]:
        self.skipped = 0
        self.lost = len(self)
        whole = self._reader.section == WHOLE
        monitor = StreamMonitor()
        for number, recorded, frame in self._read():
            verdict = monitor.judge(frame, recorded)
            if verdict.notice:
                _LOGGER.warning("%s: %s", self._topic, verdict.notice)
            if verdict.action is Action.SKIP:
                self._warn(number, verdict.continuity, verdict.reason)
                continue
            if verdict.action is Action.RESTART:
                self._throttled.info(
                    verdict.continuity, f"image {number}: new window: {verdict.reason}"
                )
            self.skipped -= 1
            yield verdict.frame
        if not whole:
            self.lost = 0

    def _read(self) -> Iterator[tuple[int, int, Frame]]:
        """Yield each frame that can be read, its record's number, and when that was recorded.

        Every record counts as skipped until its frame is passed on.
        """
        decoder: VideoDecoder | None = None
        recorded = 0
        for number, record in enumerate(self._reader.messages([self._topic])):
            self.lost -= 1
            self.skipped += 1
            recorded = record.stamp_ns
            with self._told(number):
                packet = video_packet(memoryview(record.data), self._type)
                if packet is None:
                    assert self._kind is not None  # or all would be packets
                    image = memoryview(record.data)
                    yield number, recorded, frame_from_serialised(image, self._kind)
                    continue
                decoder = decoder or self._video_decoder()
                for frame in decoder.decode(packet):
                    yield number, recorded, frame
        if decoder is not None:
            with self._told(len(self)):
                for frame in decoder.flush():
                    yield len(self), recorded, frame

    def _video_decoder(self) -> VideoDecoder:
        try:
            return VideoDecoder()
        except ImportError as error:
            raise BagError(how_to_read_video(self._topic, self._type)) from error

    @contextlib.contextmanager
    def _told(self, number: int) -> Iterator[None]:
        """Warn of an image that can't be read."""
        try:
            yield
        except ImageConversionError as error:
            self._warn(number, type(error).__name__, str(error))

    def _warn(self, number: int, kind: Hashable, reason: str) -> None:
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
