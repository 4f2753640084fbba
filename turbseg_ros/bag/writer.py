"""Writing of rosbag2 bags stored as MCAP."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from mcap.writer import Writer
from rclpy.qos import LivelinessPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

from turbseg_ros.bag import qos as qos_format
from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.schema import message_definition, type_name_of
from turbseg_ros.messages.cdr import serialised_image

_METADATA_VERSION = 9  # of ROS 2 Jazzy
_ROS_DISTRO = "jazzy"
_RELIABLE = QoSProfile(depth=10, liveliness=LivelinessPolicy.AUTOMATIC)


@dataclass
class _Channel:
    id: int
    topic: str
    type_name: str
    qos: QoSProfile
    message_count: int = 0


class BagWriter:
    """A new rosbag2 bag: a directory with one MCAP file and its `metadata.yaml`.

    To be used in a `with` statement. The bag grows in a hidden directory beside `path` and takes
    its name only when the statement ends well; after an exception nothing of it stays.

    :raises BagError: when `path` exists or can't be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._partial = path.parent / f".{path.name}.{os.getpid()}.partial"
        self._file_name = f"{path.name}_0.mcap"
        self._channels: dict[str, _Channel] = {}
        self._schema_ids: dict[str, int] = {}
        self._first_stamp: int | None = None
        self._last_stamp = 0
        self._partial_reason = ""

    def __enter__(self) -> BagWriter:
        self._refuse_existing()
        with self._reporting_os_errors():
            self._partial.mkdir(parents=True)
            self._stream = (self._partial / self._file_name).open("xb")
        self._mcap = Writer(self._stream)
        self._mcap.start(profile="ros2", library="turbseg_ros")
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if exc_type is None:
                self._finish()
        finally:
            with contextlib.suppress(OSError):  # what it can't flush is thrown away anyway
                self._stream.close()
            shutil.rmtree(self._partial, ignore_errors=True)

    def has_topic(self, topic: str) -> bool:
        """Whether the bag has a topic already."""
        return topic in self._channels

    def add_topic(self, topic: str, type_name: str, qos: QoSProfile = _RELIABLE) -> None:
        """Announce a topic before its first message, to give it a QoS profile of its own.

        :raises BagError: when the message type isn't installed.
        :raises ValueError: when the bag has the topic already.
        """
        if topic in self._channels:
            raise ValueError(f"{topic} is in the bag already")
        definition = message_definition(type_name)
        with self._reporting_os_errors():
            if type_name not in self._schema_ids:
                self._schema_ids[type_name] = self._mcap.register_schema(
                    type_name, "ros2msg", definition.text.encode()
                )
            channel_id = self._mcap.register_channel(
                topic,
                "cdr",
                self._schema_ids[type_name],
                {
                    "offered_qos_profiles": qos_format.to_yaml([qos]),
                    "topic_type_hash": definition.type_hash,
                },
            )
        self._channels[topic] = _Channel(channel_id, topic, type_name, qos)

    def write(self, topic: str, message: object, stamp_ns: int) -> None:
        """Append a ROS message, recorded at `stamp_ns` (nanoseconds since the epoch)."""
        self.write_serialized(topic, type_name_of(message), serialised(message), stamp_ns)

    def mark_partial(self, reason: str) -> None:
        """Note in `metadata.yaml`, as custom data under `partial`, that something is missing."""
        self._partial_reason = reason

    def write_serialized(self, topic: str, type_name: str, cdr: bytes, stamp_ns: int) -> None:
        """Append a message that is serialized as CDR already, encapsulation header included.

        :raises BagError: when it can't be written or its type isn't installed.
        :raises ValueError: when the topic carries another type or the stamp is negative.
        """
        if stamp_ns < 0:
            raise ValueError(f"{topic}: time {stamp_ns} ns lies before the epoch")
        if topic not in self._channels:
            self.add_topic(topic, type_name)
        channel = self._channels[topic]
        if channel.type_name != type_name:
            raise ValueError(f"{topic} carries {channel.type_name}, not {type_name}")
        with self._reporting_os_errors():
            self._mcap.add_message(
                channel.id,
                log_time=stamp_ns,
                data=cdr,
                publish_time=stamp_ns,
                sequence=channel.message_count,
            )
        channel.message_count += 1
        first = stamp_ns if self._first_stamp is None else self._first_stamp
        self._first_stamp = min(first, stamp_ns)
        self._last_stamp = max(self._last_stamp, stamp_ns)

    def _finish(self) -> None:
        information = self._information()
        with self._reporting_os_errors():
            self._mcap.add_metadata(
                "rosbag2",
                {
                    "serialized_metadata": yaml.safe_dump(information, sort_keys=False),
                    "ROS_DISTRO": _ROS_DISTRO,
                },
            )
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            (self._partial / "metadata.yaml").write_text(
                yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
            )
            self._refuse_existing()
            self._partial.rename(self._path)

    def _information(self) -> dict[str, Any]:
        """Return what `metadata.yaml` says of the bag."""
        start = self._first_stamp or 0
        extent = {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": max(self._last_stamp - start, 0)},
            "message_count": sum(channel.message_count for channel in self._channels.values()),
        }
        return {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            **_copied(extent),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": channel.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [qos_format.to_metadata(channel.qos)],
                        "type_description_hash": message_definition(channel.type_name).type_hash,
                    },
                    "message_count": channel.message_count,
                }
                for channel in self._channels.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [{"path": self._file_name, **extent}],
            "custom_data": {"partial": self._partial_reason} if self._partial_reason else None,
            "ros_distro": _ROS_DISTRO,
        }

    def _refuse_existing(self) -> None:
        if self._path.exists():
            raise BagError(f"{self._path} exists already; remove it or choose another output")

    @contextlib.contextmanager
    def _reporting_os_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise BagError(f"cannot write {self._path}: {error.strerror or error}") from error


def serialised(message: object) -> bytes:
    """Return a ROS message as CDR, encapsulation header included; what is so already, as it is."""
    if isinstance(message, bytes):
        return message
    if isinstance(message, Image):
        return serialised_image(message)
    return bytes(serialize_message(message))


def _copied(extent: dict[str, Any]) -> dict[str, Any]:
    """Copy, so that YAML writes the values twice instead of an anchor and an alias."""
    return {
        key: dict(value) if isinstance(value, dict) else value for key, value in extent.items()
    }
