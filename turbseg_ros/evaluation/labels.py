"""Label images in bags: truth, and predictions that were recorded."""

from __future__ import annotations

import bisect
import itertools
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.messages.images import (
    ImageConversionError,
    image_from_message,
    stamp_to_ns,
)
from turbseg_ros.messages.stream_monitor import stamps_tell
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

T = TypeVar("T")
_Compressed = npt.NDArray[np.uint8]

# Stamps that lie so far from others are of another clock. Nanoseconds.
_CLOCK_DIFFERENCE = 60 * 10**9
# What was recorded so far apart does not belong together, though frames be rare. Nanoseconds.
_MAX_TOLERANCE = 20 * 10**6


@dataclass(frozen=True)
class StampedLabels:
    """A label image, the stamp of the frame that it belongs to, and when it was recorded.

    Both times are in nanoseconds; the second is None where it was not recorded.
    """

    stamp: int
    labels: Labels
    recorded: int | None = None


def read_labels(reader: BagReader, topic: str) -> Iterator[StampedLabels]:
    """Return the label images (mono8 or mono16) of a topic, in the order they were recorded.

    :raises BagError: when the bag has no such topic, or it holds anything but label images.
    """
    if topic not in reader.topics:
        raise BagError(
            f"{reader.path} has no {topic}; its topics: {', '.join(reader.topics) or 'none'}"
        )
    if reader.topics[topic].type_name != "sensor_msgs/msg/Image":
        raise BagError(f"{reader.path}: {topic} holds {reader.topics[topic].type_name}, no labels")
    for record in reader.messages([topic]):
        message = record.message()
        try:
            labels = image_from_message(message)
        except ImageConversionError as error:
            raise BagError(f"{reader.path}: {topic}: {error}") from error
        if labels.ndim != 2 or not np.issubdtype(labels.dtype, np.integer):
            raise BagError(f"{reader.path}: {topic} holds {message.encoding} images, no labels")
        yield StampedLabels(stamp_to_ns(message.header.stamp), labels, record.stamp_ns)


class ByStamp(Generic[T]):
    """What belongs to frames, by their stamps, or by its own time where stamps are unusable."""

    def __init__(self) -> None:
        self._by_stamp: dict[int, T] = {}
        self._by_time: dict[int, T] = {}
        self._stamps: list[int] = []
        self._times: list[int] = []

    def __len__(self) -> int:
        return len(self._by_stamp) if self.stamps_tell else len(self._by_time)

    @property
    def stamps_tell(self) -> bool:
        """Whether stamps tell them apart, or nothing else does."""
        return stamps_tell(self._stamps) or not self._by_time

    def insert(self, item: T, stamp: int, recorded: int | None) -> None:
        """Take one more, of a frame with this stamp; of two with the same time the later counts.

        :param recorded: when it was recorded; both times are in nanoseconds.
        """
        self._by_stamp[stamp] = item
        self._stamps.append(stamp)
        if recorded is not None:
            self._by_time[recorded] = item
            bisect.insort(self._times, recorded)

    def find(
        self,
        stamp: int,
        recorded: int | None = None,
        period: float | None = None,
        same_recording: bool = True,
    ) -> T | None:
        """Return what belongs to the frame with this stamp, None when there is nothing.

        Where stamps are unusable, or are of different clocks, it is what was recorded with the
        frame.

        :param recorded: when the frame was recorded, in nanoseconds.
        :param period: seconds from one frame to the next.
        :param same_recording: whether it was recorded with the frame, or with what was made of
            that later; then a stamp may be the time at which the frame was recorded.
        """
        found = self._by_stamp.get(stamp) if self.stamps_tell else None
        if found is None and self._times and recorded is not None:
            found = self._recorded_with(stamp, recorded, period, same_recording)
        return found

    def ordered(self) -> Iterator[T]:
        """Yield all in the order in which they were recorded."""
        items = self._by_stamp if self.stamps_tell else self._by_time
        yield from (items[time] for time in sorted(items))

    def _recorded_with(
        self, stamp: int, recorded: int, period: float | None, same_recording: bool
    ) -> T | None:
        if not self.stamps_tell:
            times = (recorded,) if same_recording else (stamp, recorded)
        elif (same_recording and recorded in self._by_time) or not self._same_clock(stamp):
            times = (recorded,)
        else:
            # A frame without any.
            return None
        near = (self._nearest(time, period) for time in times)
        return next((found for found in near if found is not None), None)

    def _same_clock(self, stamp: int) -> bool:
        first, last = min(self._stamps), max(self._stamps)
        return first - _CLOCK_DIFFERENCE <= stamp <= last + _CLOCK_DIFFERENCE

    def _nearest(self, time: int, period: float | None) -> T | None:
        """Return what was recorded at a time, give or take half a period."""
        index = bisect.bisect(self._times, time)
        neighbours = self._times[max(index - 1, 0) : index + 1]
        nearest = min(neighbours, key=lambda each: abs(each - time))
        if abs(nearest - time) > (0.5 * period * 1e9 if period else self._tolerance):
            return None
        return self._by_time[nearest]

    @property
    def _tolerance(self) -> float:
        steps = [later - earlier for earlier, later in itertools.pairwise(self._times)]
        return min(0.5 * statistics.median(steps or [0]), _MAX_TOLERANCE)


class LabelsByStamp:
    """Label images by the stamp of their frame, or by their own time where stamps are unusable.

    They are held compressed, for those of a long high-resolution bag don't fit into memory.
    """

    def __init__(self, items: Iterable[StampedLabels] = ()) -> None:
        self._compressed = ByStamp[_Compressed]()
        for item in items:
            self.add(item)

    def __len__(self) -> int:
        return len(self._compressed)

    @property
    def stamps_tell(self) -> bool:
        """Whether stamps tell them apart, or nothing else does."""
        return self._compressed.stamps_tell

    def add(self, item: StampedLabels) -> None:
        """Take one more label image; of two with the same time the later counts."""
        self._compressed.insert(_compressed(item.labels), item.stamp, item.recorded)

    def at(
        self,
        stamp: int,
        recorded: int | None = None,
        period: float | None = None,
        same_recording: bool = True,
    ) -> Labels | None:
        """Return the labels of a frame, None when there are none; see `ByStamp.find`."""
        found = self._compressed.find(stamp, recorded, period, same_recording)
        return None if found is None else _uncompressed(found)

    def in_order(self) -> Iterator[Labels]:
        """Yield the labels in the order in which they were recorded."""
        yield from map(_uncompressed, self._compressed.ordered())


def result_from_labels(frame: Frame, labels: Labels) -> SegmentationResult:
    """Return the result that labels alone tell of: objects without velocity, slot and trail."""
    return replace(
        SegmentationResult.empty(frame),
        labels=labels.astype(np.uint16, copy=False),
        objects=tuple(
            MovingObject.from_mask(labels == value, int(value))
            for value in np.unique(labels)
            if value
        ),
    )


def _compressed(labels: Labels) -> _Compressed:
    _, compressed = cv2.imencode(".png", labels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return compressed


def _uncompressed(compressed: _Compressed) -> Labels:
    return np.asarray(cv2.imdecode(compressed, cv2.IMREAD_UNCHANGED))
