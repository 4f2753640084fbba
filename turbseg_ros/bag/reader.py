"""Reading of rosbag2 bags stored as MCAP."""

from __future__ import annotations

import contextlib
import heapq
import io
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema, Statistics
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from turbseg_ros.bag import qos as qos_format
from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.topics import TRUTH_NAMESPACE

_IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")

# What the MCAP library raises on damaged content.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    MemoryError,
)


@dataclass(frozen=True)
class Topic:
    """A recorded topic; `qos` are the profiles that its publishers offered, if recorded."""

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
        """Give the ROS message.

        :raises BagError: when the data is damaged or its message type isn't installed.
        """
        kind = message_class(self.type_name)
        try:
            return deserialize_message(self.data, kind)
        except Exception as error:  # rclpy raises a bare RMWError or RuntimeError
            raise BagError(f"{self.topic}: damaged {self.type_name} ({error})") from error


@dataclass(frozen=True)
class _McapFile:
    """One file of a bag, with the summary at its end."""

    path: Path
    summary: Summary
    statistics: Statistics


class BagReader:
    """A recorded bag: a rosbag2 directory, or a single MCAP file.

    Only the summary is read at first; messages are read chunk by chunk when asked for.

    :raises BagError: when there is no such bag, or it isn't one, or it is cut or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._files = [_open(file) for file in _storage_files(path)]
        self._topics = _merged_topics(self._files)

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topics by name, in the order they were first recorded."""
        return self._topics

    @property
    def duration_ns(self) -> int:
        """Nanoseconds from the first message to the last."""
        filled = [file.statistics for file in self._files if file.statistics.message_count]
        start = min((statistics.message_start_time for statistics in filled), default=0)
        return max((statistics.message_end_time for statistics in filled), default=0) - start

    def find_image_topic(self, requested: str | None = None) -> str:
        """Give the topic whose images are to be segmented.

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
        """Give the messages of `topics`, of all by default, in the order they were recorded.

        Memory holds no more than the chunks that overlap in time.

        :raises BagError: when the bag turns out to be damaged; what came before is sound.
        """
        streams = [_read(file, topics) for file in self._files]
        return heapq.merge(*streams, key=lambda record: record.stamp_ns)


def _storage_files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.exists():
        raise BagError(f"no such bag: {path}")
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        return _listed_files(path, _information(metadata))
    found = sorted(path.glob("*.mcap"))
    if len(found) == 1:
        return found
    if any(path.glob("*.db3")):
        raise _sqlite_error(path)
    raise BagError(
        f"{path} is not a bag: it has no metadata.yaml and {len(found) or 'no'} .mcap files"
    )


def _information(metadata: Path) -> Mapping[str, Any]:
    try:
        information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
    except OSError as error:
        raise BagError(f"{metadata}: {error.strerror or error}") from error
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise BagError(
            f"{metadata} is damaged; remove it or rebuild it with 'ros2 bag reindex'"
        ) from error
    if not isinstance(information, dict):
        raise BagError(f"{metadata} holds no rosbag2_bagfile_information")
    return information


def _listed_files(directory: Path, information: Mapping[str, Any]) -> list[Path]:
    storage = information.get("storage_identifier")
    if storage == "sqlite3":
        raise _sqlite_error(directory)
    if storage != "mcap":
        raise BagError(f"{directory} is stored as {storage}; only mcap can be read")
    if information.get("compression_mode"):
        raise BagError(
            f"{directory} is compressed by rosbag2 (mode {information['compression_mode']}); "
            "convert it with 'ros2 bag convert' to plain mcap, which compresses by itself"
        )
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise BagError(f"{directory / 'metadata.yaml'} names no .mcap file")
    # Early rosbag2 wrote names that begin with the directory's own.
    files = [directory / Path(str(name)).name for name in names]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise BagError(f"{directory} lacks {_listed(missing)}, which its metadata.yaml names")
    return files


def _sqlite_error(path: Path) -> BagError:
    return BagError(
        f"{path} is stored as sqlite3; only mcap can be read: "
        "convert it with 'ros2 bag convert' (storage_id: mcap)"
    )


def _open(path: Path) -> _McapFile:
    with _reporting_damage(path), path.open("rb") as stream:
        _check_ends(path, stream)
        reader = SeekingReader(stream)
        profile = reader.get_header().profile
        summary = reader.get_summary()
    if profile == "ros1":
        raise BagError(f"{path} was recorded by ROS 1; convert it with 'rosbags-convert'")
    if summary is None or summary.statistics is None:
        raise BagError(f"{path} has no summary; rebuild it with 'mcap recover'")
    return _McapFile(path, summary, summary.statistics)


def _check_ends(path: Path, stream: io.BufferedReader) -> None:
    if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise BagError(f"{path} is not a bag: it is neither an MCAP file nor a rosbag2 directory")
    stream.seek(0, io.SEEK_END)
    stream.seek(max(stream.tell() - len(MCAP0_MAGIC), len(MCAP0_MAGIC)))
    if stream.read() != MCAP0_MAGIC:
        raise BagError(
            f"{path} is truncated: it ends before its index; save what it has by 'mcap recover'"
        )
    stream.seek(0)


def _merged_topics(files: Iterable[_McapFile]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for file in files:
        for channel in file.summary.channels.values():
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


def _topic(file: _McapFile, channel: Channel) -> Topic:
    schema: Schema | None = file.summary.schemas.get(channel.schema_id)
    if schema is None or channel.message_encoding != "cdr":
        raise BagError(
            f"{file.path}: {channel.topic} is no ROS 2 topic "
            f"(encoded as {channel.message_encoding})"
        )
    with _reporting_damage(file.path):
        return Topic(
            name=channel.topic,
            type_name=schema.name,
            message_count=file.statistics.channel_message_counts.get(channel.id, 0),
            qos=qos_format.from_yaml(channel.metadata.get("offered_qos_profiles", "")),
        )


def _read(file: _McapFile, topics: Collection[str] | None) -> Iterator[Record]:
    # Without an index the library would sort the whole file in memory: take its own order then.
    indexed = bool(file.summary.chunk_indexes)
    with _reporting_damage(file.path), file.path.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(topics, log_time_order=indexed):
            assert schema is not None  # checked when the topics were listed
            yield Record(channel.topic, schema.name, message.log_time, message.data)


@contextlib.contextmanager
def _reporting_damage(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from error
    except _DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path} is damaged ({reason})") from error


def _listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"
