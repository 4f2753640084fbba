"""Label images in bags: truth, and predictions that were recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

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
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult


@dataclass(frozen=True)
class StampedLabels:
    """A label image and the stamp, in nanoseconds, of the frame that it belongs to."""

    stamp: int
    labels: Labels


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
        yield StampedLabels(stamp_to_ns(message.header.stamp), labels)


class LabelsByStamp:
    """Label images by the stamp of their frame.

    They are held compressed, for those of a long high-resolution bag don't fit into memory.
    """

    def __init__(self, items: Iterable[StampedLabels] = ()) -> None:
        self._compressed: dict[int, npt.NDArray[np.uint8]] = {}
        for item in items:
            self.add(item)

    def __len__(self) -> int:
        return len(self._compressed)

    def add(self, item: StampedLabels) -> None:
        """Take one more label image; of two with the same stamp the later counts."""
        self._compressed[item.stamp] = _compressed(item.labels)

    def at(self, stamp: int) -> Labels | None:
        """Return the labels of the frame with this stamp, None when there are none."""
        compressed = self._compressed.get(stamp)
        if compressed is None:
            return None
        return np.asarray(cv2.imdecode(compressed, cv2.IMREAD_UNCHANGED))


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


def _compressed(labels: Labels) -> npt.NDArray[np.uint8]:
    _, compressed = cv2.imencode(".png", labels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return compressed
