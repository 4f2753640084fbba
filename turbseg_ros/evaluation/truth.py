"""What a bag holds of truth: labels or boxes, and where neither counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IGNORED_TOPIC, TRUTH_BOXES_TOPIC, TRUTH_TOPIC
from turbseg_ros.evaluation.labels import ByStamp, LabelsByStamp, StampedLabels, read_labels
from turbseg_ros.evaluation.metrics import Labels
from turbseg_ros.messages.cdr import SerialisedDataError
from turbseg_ros.messages.detections import TYPE_NAME, Detection, detections_from

Boxes = tuple[Detection, ...]


class BoxesByStamp(ByStamp[Boxes]):
    """The true boxes of each frame; frames that have an empty tuple are known to hold none."""

    def at(
        self,
        stamp: int,
        recorded: int | None = None,
        period: float | None = None,
        same_recording: bool = True,
    ) -> Boxes | None:
        """Return the boxes of a frame, None when nothing is known; see `ByStamp.find`."""
        return self.find(stamp, recorded, period, same_recording)

    def in_order(self) -> Iterator[Boxes]:
        """Yield the boxes in the order in which they were recorded."""
        return self.ordered()


Truth = LabelsByStamp | BoxesByStamp


class IgnoredRegions:
    """Where neither what is found nor what is missed counts: each image from its stamp on."""

    def __init__(self) -> None:
        self._changes = LabelsByStamp()
        self._stamps: list[int] = []
        self._newest: tuple[int, Labels] | None = None

    def add(self, item: StampedLabels) -> None:
        """Take one more image, non-zero in the region."""
        self._changes.add(replace(item, recorded=None))
        self._stamps.append(item.stamp)

    def at(self, stamp: int) -> Labels | None:
        """Return the region of the frame with this stamp, HxW, non-zero there; None without."""
        earlier = [each for each in self._stamps if each <= stamp] or self._stamps
        if not earlier:
            return None
        begun = max(earlier)
        if self._newest is None or self._newest[0] != begun:
            region = self._changes.at(begun)
            assert region is not None  # it was added
            self._newest = begun, region
        return self._newest[1]


def read_truth(reader: BagReader, topic: str) -> Truth:
    """Return the truth on a topic; in place of labels that are not there, boxes that are.

    :raises BagError: when the bag has no such topic, or it holds neither labels nor boxes.
    """
    if topic == TRUTH_TOPIC and topic not in reader.topics and TRUTH_BOXES_TOPIC in reader.topics:
        topic = TRUTH_BOXES_TOPIC
    if topic not in reader.topics or reader.topics[topic].type_name != TYPE_NAME:
        return LabelsByStamp(read_labels(reader, topic))
    boxes = BoxesByStamp()
    for record in reader.messages([topic]):
        try:
            stamp, found = detections_from(memoryview(record.data))
        except SerialisedDataError as error:
            raise BagError(f"{reader.path}: {topic}: {error}") from error
        boxes.insert(found, stamp, record.stamp_ns)
    return boxes


def read_ignored(reader: BagReader) -> IgnoredRegions:
    """Return where truth says nothing; nowhere in bags that don't tell.

    :raises BagError: when their topic holds anything but label images.
    """
    regions = IgnoredRegions()
    if IGNORED_TOPIC in reader.topics:
        for item in read_labels(reader, IGNORED_TOPIC):
            regions.add(item)
    return regions
