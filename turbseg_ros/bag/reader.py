"""Reading of rosbag2 bags stored as MCAP."""

from __future__ import annotations

import heapq
import logging
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Channel
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from turbseg_ros.bag import qos as qos_format
from turbseg_ros.bag.errors import BagError, printable, reading
from turbseg_ros.bag.mcap_file import MAX_MESSAGES, McapFile, open_mcap
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.topics import TRUTH_NAMESPACE

_LOGGER = logging.getLogger(__name__)

_IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# How rosbag2 names the files that it splits a recording into.
_SPLIT_NAME = re.compile(r"(?P<stem>.+)_(?P<number>\d+)\.mcap")
# A metadata.yaml of a thousand topics is smaller than this, in bytes.
_MAX_METADATA = 2**24


@dataclass(frozen=True)
class Topic:
    """A recorded topic; `qos` are the profiles that its publishers offered, if recorded.

    `message_count` is what the bag states; where it is damaged, fewer can be read.
    """

    name: str
    type_name: str
    message_count: int
    qos: tuple[QoSProfile, ...]

    @property
    def has_images(self) -> bool:
        """Whether images were recorded, compressed or not."""
        return self.type_name in _IMAGE_TYPES and self.message_count > 0

    @property
    def is_truth(self) -> bool:
        """Whether it is ground truth to score against, not input."""
        return TRUTH_NAMESPACE in self.name.split("/")


@dataclass(frozen=True, slots=True)
class Record:
    """A recorded message: `data` is its CDR, `stamp_ns` when it was recorded, nanoseconds."""

    topic: str
    type_name: str
    stamp_ns: int
    data: bytes

    def message(self) -> Any:
        """Return the ROS message.

        :raises BagError: when the data is damaged or its message type isn't installed.
        """
        kind = message_class(self.type_name)
        try:
            return deserialize_message(self.data, kind)
        except Exception as error:  # rclpy raises a bare RMWError or RuntimeError
            raise BagError(f"{self.topic}: damaged {self.type_name} ({error})") from error


class BagReader:
    """A recorded bag: a rosbag2 directory, or a single MCAP file.

    Only the index is read at first; messages are read chunk by chunk when asked for. A file that
    was cut, or whose index is damaged, is gone through instead: what its whole chunks hold is
    read, and a warning is logged.

    :raises BagError: when there is no such bag, or it isn't one, or nothing of it can be saved.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path):
            information = _information(path)
            self._files = [open_mcap(file) for file in _storage_files(path, information)]
        self._topics = _merged_topics(self._files)
        self._report_damage(_stated_counts(information))

    def _report_damage(self, stated: Mapping[str, int]) -> None:
        """Warn of damaged files; take what metadata.yaml states for what was recorded."""
        damaged = [file for file in self._files if file.damage is not None]
        for file in damaged:
            _LOGGER.warning("%s %s", file.path, file.damage)
        if not any(file.lossy for file in damaged):
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
        filled = [file for file in self._files if file.message_count]
        start = min((file.start_ns for file in filled), default=0)
        return max((file.end_ns for file in filled), default=0) - start

    def find_image_topic(self, requested: str | None = None) -> str:
        """Return the topic whose images are to be segmented.

        That is `requested`, or else the only one with images that are not ground truth.

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
        inputs = [name for name in images if not self.topics[name].is_truth]
        if not inputs:
            raise BagError(
                f"{self.path} has no image topic to segment; its topics: {_listed(self.topics)}"
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
        streams = [_read(file, topics) for file in self._files]
        return heapq.merge(*streams, key=lambda record: record.stamp_ns)


def _information(path: Path) -> Mapping[str, Any] | None:
    """Return what a bag's metadata.yaml says, None when it has none."""
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        return None
    try:
        if metadata.stat().st_size > _MAX_METADATA:
            raise BagError(f"{metadata} is too large: {metadata.stat().st_size} bytes")
        information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise BagError(
            f"{metadata} is damaged; remove it or rebuild it with 'ros2 bag reindex'"
        ) from error
    if not isinstance(information, dict):
        raise BagError(f"{metadata} holds no rosbag2_bagfile_information")
    return information


def _storage_files(path: Path, information: Mapping[str, Any] | None) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.exists():
        raise BagError(f"no such bag: {path}")
    if information is not None:
        return _listed_files(path, information)
    names = [entry.name for entry in path.iterdir()]
    found = sorted(name for name in names if name.endswith(".mcap"))
    if len(found) == 1:
        return [path / found[0]]
    parts = _parts_of_one_recording(found)
    if parts:
        return [path / name for name in parts]
    if any(name.endswith(".db3") for name in names):
        raise _sqlite_error(path)
    raise BagError(
        f"{path} is not a bag: it has no metadata.yaml and {len(found) or 'no'} .mcap files"
    )


def _parts_of_one_recording(names: Iterable[str]) -> list[str]:
    """Order the files of a recording that was split and not ended; none when they aren't that."""
    numbered = {}
    stems = set()
    for name in names:
        match = _SPLIT_NAME.fullmatch(name)
        if match is None:
            return []
        stems.add(match["stem"])
        numbered[int(match["number"])] = name
    if len(stems) != 1 or sorted(numbered) != list(range(len(numbered))):
        return []
    return [numbered[number] for number in sorted(numbered)]


def _listed_files(directory: Path, information: Mapping[str, Any]) -> list[Path]:
    storage = information.get("storage_identifier")
    if storage == "sqlite3":
        raise _sqlite_error(directory)
    if storage != "mcap":
        kind = storage if isinstance(storage, str) else "something unnamed"
        raise BagError(f"{directory} is stored as {kind}; only mcap can be read")
    if information.get("compression_mode"):
        raise BagError(
            f"{directory} is compressed by rosbag2 (its compression_mode is set); "
            "convert it with 'ros2 bag convert' to plain mcap, which compresses by itself"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        names = []
    # Early rosbag2 wrote names that begin with the directory's own; nothing else lies outside.
    files = [directory / Path(name).name for name in names]
    if not files:
        raise BagError(f"{directory / 'metadata.yaml'} names no .mcap file")
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise BagError(f"{directory} lacks {_listed(missing)}, which its metadata.yaml names")
    return files


def _stated_counts(information: Mapping[str, Any] | None) -> dict[str, int]:
    """Return the messages of each topic that metadata.yaml states; nothing when it is damaged."""
    try:
        counts = {
            str(entry["topic_metadata"]["name"]): int(entry["message_count"])
            for entry in (information or {})["topics_with_message_count"]
        }
    except (KeyError, TypeError, ValueError, OverflowError):
        return {}
    return counts if all(0 <= count <= MAX_MESSAGES for count in counts.values()) else {}


def _sqlite_error(path: Path) -> BagError:
    return BagError(
        f"{path} is stored as sqlite3; only mcap can be read: "
        "convert it with 'ros2 bag convert' (storage_id: mcap)"
    )


def _merged_topics(files: Iterable[McapFile]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for file in files:
        for channel in file.channels.values():
            topic = _topic(file, channel)
            known = topics.get(topic.name)
            if known is None:
                topics[topic.name] = topic
            elif known.type_name != topic.type_name:
                raise BagError(
                    f"{file.path}: {topic.name} carries two types, "
                    f"{known.type_name} and {topic.type_name}"
                )
            else:
                count = known.message_count + topic.message_count
                topics[topic.name] = replace(known, message_count=count)
    return topics


def _topic(file: McapFile, channel: Channel) -> Topic:
    schema = file.schemas.get(channel.schema_id)
    if schema is None or channel.message_encoding != "cdr":
        raise BagError(
            f"{file.path}: {channel.topic} is no ROS 2 topic "
            f"(encoded as {channel.message_encoding})"
        )
    return Topic(
        name=channel.topic,
        type_name=schema.name,
        message_count=file.counts.get(channel.id, 0),
        qos=_recorded_qos(file, channel),
    )


def _recorded_qos(file: McapFile, channel: Channel) -> tuple[QoSProfile, ...]:
    try:
        return qos_format.from_yaml(channel.metadata.get("offered_qos_profiles", ""))
    except ValueError as error:
        _LOGGER.warning("%s: %s has %s", file.path, printable(channel.topic, 100), error)
        return ()


def _read(file: McapFile, topics: Collection[str] | None) -> Iterator[Record]:
    with reading(file.path):
        for channel, message in file.messages(topics):
            type_name = file.schemas[channel.schema_id].name
            yield Record(channel.topic, type_name, message.log_time, message.data)


def _listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"
