"""Reading of recorded bags: rosbag2's, single files, and what else `rosbags` can read."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import logging
import math
import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mcap.writer import MCAP0_MAGIC
from rclpy.qos import QoSProfile

from turbseg_ros.bag import qos as qos_format
from turbseg_ros.bag.compression import is_compressed, unpack, unpacked_message
from turbseg_ros.bag.errors import BagError, reading
from turbseg_ros.bag.layout import find_layout, shortened
from turbseg_ros.bag.mcap_file import open_mcap
from turbseg_ros.bag.records import IMAGE_TYPES, BagFile, Record, Stream, Topic
from turbseg_ros.bag.rosbags_file import (
    ROS1_MAGIC,
    SQLITE_MAGIC,
    open_with_rosbags,
    ros1_converter,
)
from turbseg_ros.bag.section import WHOLE, Section
from turbseg_ros.bag.topics import is_result
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.one_line import printable

_LOGGER = logging.getLogger(__name__)

# Pictures that a camera publishes once more, for other transports.
_TRANSPORTS = ("compressed", "compressedDepth", "theora", "ffmpeg", "foxglove", "zstd")


class BagReader:
    """A recorded bag: a rosbag2 directory, or a single file.

    Only the index is read at first; messages are read chunk by chunk when asked for. A file that
    was cut, or whose index is damaged, is gone through instead: what its whole chunks hold is
    read. What is lost, missing, or no ROS message is left out, and a warning is logged. Files that
    are compressed as a whole are unpacked into the folder of temporary files.

    :param section: the part of it that is read. How many messages each topic has there is not
        counted: `topics` have about as many as even rates would give.
    :raises BagError: when there is no such bag, or it isn't one, or nothing of it can be saved,
        or it ends before the section begins.
    """

    def __init__(self, path: Path, section: Section = WHOLE) -> None:
        self.path = path
        self.section = section
        with reading(path):
            layout = find_layout(path)
            self._files, faults = _opened(layout.files)
        self._packed_messages = layout.packed_messages
        self._left_out = [name for file in self._files for name in file.left_out]
        self._types = _chosen_types(path, self._files, self._left_out)
        self._topics = _merged_topics(self._files, self._types)
        if self._left_out:
            _LOGGER.warning(
                "%s: left out, for it can't be read as ROS messages: %s",
                *(path, printable(shortened(list(dict.fromkeys(self._left_out))), 500)),
            )
        for fault in faults:
            _LOGGER.warning("left out: %s", fault)
        if layout.missing:
            _LOGGER.warning(
                "%s lacks %d of its files (%s); the others are read",
                *(path, len(layout.missing), printable(shortened(layout.missing), 500)),
            )
        self._report_damage(layout.stated, bool(faults or layout.missing))
        if section != WHOLE:
            self._narrow(section)

    def _narrow(self, section: Section) -> None:
        """Leave out what lies outside the section."""
        start, end = self._span
        first, last = section.bounds(start, end)
        if last < first:
            raise BagError(
                f"{self.path} is {(end - start) * 1e-9:.1f} s long and has nothing from "
                f"{section.start:g} s on"
            )
        share = (last - first + 1) / (end - start + 1)
        for name, topic in self._topics.items():
            count = math.ceil(share * topic.message_count)
            self._topics[name] = replace(topic, message_count=count)

    def _report_damage(self, stated: Mapping[str, int], incomplete: bool) -> None:
        """Warn of damaged files; take what metadata.yaml states for what was recorded."""
        damaged = [file for file in self._files if file.damage is not None]
        for file in damaged:
            _LOGGER.warning("%s %s", file.path, file.damage)
        if not (incomplete or any(file.lossy for file in damaged)):
            return
        for name, topic in self._topics.items():
            count = max(topic.message_count, stated.get(name, 0))
            self._topics[name] = replace(topic, message_count=count)
        written, left = sum(stated.values()), sum(file.message_count for file in self._files)
        if written >= left:
            _LOGGER.warning("%s: %d messages of %d are lost", self.path, written - left, written)
        else:
            _LOGGER.warning("%s: how many messages are lost is not recorded", self.path)

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topics by name, in the order they were first recorded."""
        return self._topics

    @property
    def duration_ns(self) -> int:
        """Nanoseconds from the first message to the last."""
        first, last = self.section.bounds(*self._span)
        return last - first

    @property
    def _span(self) -> tuple[int, int]:
        """When the first and the last message were recorded, nanoseconds."""
        filled = [file for file in self._files if file.message_count]
        start = min((file.start_ns for file in filled), default=0)
        return start, max((file.end_ns for file in filled), default=0)

    def find_image_topic(self, requested: str | None = None) -> str:
        """Return the topic whose images are to be segmented.

        That is `requested`, or else the only one with images that are neither ground truth nor
        results of this package's node. Of a camera's transports it is the raw one.

        :raises BagError: when there is none, or several to choose from, or `requested` isn't one.
        """
        images = [name for name, topic in self.topics.items() if topic.has_images]
        if requested is not None:
            if requested in images:
                return requested
            raise BagError(
                f"{self.path} has no images on {requested}; it has images on "
                f"{_listed(images)} and other messages on "
                f"{_listed([name for name in self.topics if name not in images])}"
            )
        types = {name: topic.type_name for name, topic in self.topics.items()}
        inputs = [
            name for name in images if not (self.topics[name].is_truth or is_result(name, types))
        ]
        inputs = [name for name in inputs if not _is_other_transport(name, inputs)]
        if not inputs:
            empty = [
                name
                for name, kind in types.items()
                if kind in IMAGE_TYPES and not self.topics[name].message_count
            ]
            unheard = (
                f"; nothing was recorded of {_listed(empty)}: a recorder that asks for more "
                "reliability than is offered hears nothing"
            )
            raise BagError(
                f"{self.path} has no image topic to segment; its topics: "
                f"{_listed([f'{name} ({kind})' for name, kind in types.items()])}"
                + (unheard if empty else "")
                + (f"; left out: {_listed(self._left_out)}" if self._left_out else "")
            )
        if len(inputs) > 1:
            raise BagError(
                f"{self.path} has several image topics; choose one with --image-topic: "
                f"{_listed(inputs)}"
            )
        return inputs[0]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Return the messages of `topics`, of all by default, in the order they were recorded.

        Memory holds no more than the chunks that overlap in time. Chunks that turn out to be
        damaged are left out, with a warning.

        :raises BagError: when a file can't be read any more; what came before is sound.
        """
        first, last = self.section.bounds(*self._span)
        streams = [self._read(file, topics, first) for file in self._files]
        records = heapq.merge(*streams, key=lambda record: record.stamp_ns)
        if self.section.duration is None:
            return records
        return itertools.takewhile(lambda record: record.stamp_ns <= last, records)

    def _read(self, file: BagFile, topics: Collection[str] | None, first: int) -> Iterator[Record]:
        wanted = {
            number: stream
            for number, stream in file.streams.items()
            if self._types.get(stream.topic) == stream.type_name
            and (topics is None or stream.topic in topics)
        }
        damaged = 0
        with reading(file.path):
            for number, stamp, data in file.read(wanted, first):
                stream = wanted[number]
                content = unpacked_message(data) if self._packed_messages else data
                content = _as_cdr(stream, content)
                if content is None:
                    damaged += 1
                else:
                    yield Record(stream.topic, stream.type_name, stamp, content)
        if damaged:
            _LOGGER.warning("%s: %d damaged messages are left out", file.path, damaged)


def _opened(paths: Sequence[Path]) -> tuple[list[BagFile], list[str]]:
    """Open the files of a bag; return those that can be read, and what is wrong with the others.

    :raises BagError: when none can be.
    """
    files: list[BagFile] = []
    faults: list[BagError] = []
    for path in paths:
        with _collected(faults):
            files.append(_open_file(path))
    if not files:
        raise faults[0]
    return files, [str(fault) for fault in faults]


@contextlib.contextmanager
def _collected(faults: list[BagError]) -> Iterator[None]:
    try:
        yield
    except BagError as error:
        faults.append(error)


def _open_file(path: Path) -> BagFile:
    """Open one file, by what it begins with.

    :raises BagError: when it is none of those that can be read, or nothing of it can be saved.
    :raises OSError: when it can't be read.
    """
    if not is_compressed(_beginning(path)):
        return _open_content(path, path)
    folder = Path(tempfile.mkdtemp(prefix="turbseg_bag_"))
    try:
        file = _open_content(path, unpack(path, folder))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(file, shutil.rmtree, folder, ignore_errors=True)
    return file


def _open_content(path: Path, content: Path) -> BagFile:
    beginning = _beginning(content)
    if beginning.startswith(MCAP0_MAGIC):
        return open_mcap(path, content)
    if beginning.startswith((SQLITE_MAGIC, ROS1_MAGIC)):
        return open_with_rosbags(path, content)
    raise BagError(f"{path} is not a bag: it is neither an MCAP file nor a rosbag2 directory")


def _beginning(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(16)


def _chosen_types(path: Path, files: Iterable[BagFile], left_out: list[str]) -> dict[str, str]:
    """Return the type by which each topic is read: images, or what it has most messages of.

    What else is recorded under its name is left out, and so is what ROS 1 recorded of types that
    ROS 2 doesn't have.
    """
    counts: dict[str, Counter[str]] = {}
    for file in files:
        for stream in file.streams.values():
            if _is_readable(file.path, stream):
                counted = counts.setdefault(stream.topic, Counter())
                counted[stream.type_name] += stream.message_count
            else:
                left_out.append(f"{stream.topic} ({stream.type_name} of ROS 1)")
    chosen = {}
    for topic, counted in counts.items():
        chosen[topic] = max(
            counted, key=lambda kind: (kind in IMAGE_TYPES and counted[kind] > 0, counted[kind])
        )
        for kind, count in counted.items():
            if kind != chosen[topic]:
                _LOGGER.warning(
                    "%s: %s carries two types: it is read as %s, %d messages of %s are left out",
                    *(path, printable(topic, 100), chosen[topic], count, printable(kind, 100)),
                )
    return chosen


def _is_readable(path: Path, stream: Stream) -> bool:
    if stream.ros1_definition is None:
        return True
    try:
        return ros1_converter(stream.type_name, stream.ros1_definition) is not None
    except ImportError as error:
        raise BagError(
            f"{path} was recorded by ROS 1; '{how_to_install('rosbags')}' to read it as it is"
        ) from error


def _as_cdr(stream: Stream, data: bytes | None) -> bytes | None:
    """Return a message's CDR, None when it is damaged."""
    if data is None or stream.ros1_definition is None:
        return data
    convert = ros1_converter(stream.type_name, stream.ros1_definition)
    assert convert is not None  # or its topic would have been left out
    try:
        return convert(data)
    except Exception:  # a foreign library on damaged content
        return None


def _merged_topics(files: Iterable[BagFile], types: Mapping[str, str]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for file in files:
        for stream in file.streams.values():
            if types.get(stream.topic) != stream.type_name:
                continue
            known = topics.get(stream.topic)
            topics[stream.topic] = Topic(
                name=stream.topic,
                type_name=stream.type_name,
                message_count=stream.message_count + (known.message_count if known else 0),
                qos=known.qos if known else _recorded_qos(file, stream),
            )
    return topics


def _recorded_qos(file: BagFile, stream: Stream) -> tuple[QoSProfile, ...]:
    try:
        return qos_format.from_yaml(stream.qos)
    except ValueError as error:
        _LOGGER.warning("%s: %s has %s", file.path, printable(stream.topic, 100), error)
        return ()


def _is_other_transport(name: str, names: Collection[str]) -> bool:
    """Whether its pictures are those of a topic beside it, as `image_raw/compressed`."""
    base, _, transport = name.rpartition("/")
    return transport in _TRANSPORTS and base in names


def _listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"
