"""What a bag gives: topics, their messages, and the files that hold them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.topics import TRUTH_NAMESPACE
from turbseg_ros.messages.video import VIDEO_TRANSPORTS

IMAGE_TYPES = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    *VIDEO_TRANSPORTS,
)


@dataclass(frozen=True)
class Stream:
    """The messages of one topic and one type in a file.

    `qos` are the profiles that the publishers offered, as rosbag2 records them (YAML).
    `ros1_definition` is the definition of messages that ROS 1 serialised, None where they are CDR.
    """

    topic: str
    type_name: str
    message_count: int
    qos: str = ""
    ros1_definition: str | None = None


class BagFile(Protocol):
    """One file of a bag, whatever its format.

    `streams` are numbered as in the file; `left_out` names topics that hold no ROS messages.
    `damage` says what is wrong with it, None when nothing is, and `lossy` whether that may have
    cost messages.
    """

    @property
    def path(self) -> Path:
        """The file, as the user knows it."""

    @property
    def streams(self) -> Mapping[int, Stream]:
        """What can be read."""

    @property
    def left_out(self) -> Sequence[str]:
        """What can't, and how it is encoded."""

    @property
    def message_count(self) -> int:
        """Messages of all topics, those left out included."""

    @property
    def start_ns(self) -> int:
        """Time of the first message, nanoseconds."""

    @property
    def end_ns(self) -> int:
        """Time of the last message, nanoseconds."""

    @property
    def damage(self) -> str | None:
        """What is wrong with the file."""

    @property
    def lossy(self) -> bool:
        """Whether messages may be lost."""

    def read(self, wanted: Collection[int], since_ns: int = 0) -> Iterator[tuple[int, int, bytes]]:
        """Return stream, time (nanoseconds) and data of the wanted streams' messages, by time.

        :param since_ns: what was recorded before is left out.
        :raises OSError: when the file can't be read.
        """


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
        """Whether images were recorded, as they are, compressed, or as video."""
        return self.type_name in IMAGE_TYPES and self.message_count > 0

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
