"""Bags in the formats of others, read through the library `rosbags` where it is installed.

SQLite is what rosbag2 wrote before Iron, `.bag` what ROS 1 wrote. Messages of ROS 1 become CDR.
"""

from __future__ import annotations

import functools
import importlib
import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.records import Stream
from turbseg_ros.bag.schema import canonical_type_name
from turbseg_ros.dependencies import how_to_install

_LOGGER = logging.getLogger(__name__)

SQLITE_MAGIC = b"SQLite format 3\0"
ROS1_MAGIC = b"#ROSBAG V"

_LATCHED = """\
- {history: 1, depth: 1, reliability: 1, durability: 1, liveliness: 1,
   deadline: {sec: 0, nsec: 0}, lifespan: {sec: 0, nsec: 0},
   liveliness_lease_duration: {sec: 0, nsec: 0}, avoid_ros_namespace_conventions: false}
"""

Converter = Callable[[bytes], bytes]


@dataclass(frozen=True)
class RosbagsFile:
    """A file that `rosbags` reads; `content` is where its bytes lie, unpacked."""

    path: Path
    content: Path
    streams: Mapping[int, Stream]
    left_out: Sequence[str]
    message_count: int
    start_ns: int
    end_ns: int
    damage: str | None = None
    lossy: bool = False

    def read(self, wanted: Collection[int], since_ns: int = 0) -> Iterator[tuple[int, int, bytes]]:
        """Return stream, time and data of messages; see `BagFile`.

        What lies behind damage is left out with a warning.
        """
        count = 0
        try:
            with _reader(self.content) as reader:
                chosen = [c for c in reader.connections if c.id in wanted]
                # None chosen would mean all.
                for connection, stamp, data in (
                    reader.messages(chosen, start=since_ns) if chosen else ()
                ):
                    yield connection.id, stamp, bytes(data)
                    count += 1
        except OSError:
            raise
        except Exception as error:  # a foreign library on damaged content
            _LOGGER.warning(
                "%s is damaged: %d messages before that are read (%s)",
                *(self.path, count, _reason(error)),
            )


def open_with_rosbags(path: Path, content: Path) -> RosbagsFile:
    """Find out what a file in SQLite or of ROS 1 holds.

    :raises BagError: when it is damaged, or `rosbags` isn't installed.
    """
    try:
        with _reader(content) as reader:
            connections = list(reader.connections)
            start, end = reader.start_time, reader.end_time
    except ImportError as error:
        raise BagError(_how_to_read(path, content)) from error
    except OSError:
        raise
    except Exception as error:  # a foreign library on damaged content
        raise BagError(
            f"{path} is damaged and can't be read ({_reason(error)}); where ROS' own tools still "
            f"read it, convert it with {_conversion(path, content)}"
        ) from error
    if _journal(path).exists():
        _LOGGER.warning(
            "%s was not closed: what is in %s is not read; 'sqlite3' merges it when it opens both",
            *(path, _journal(path).name),
        )
    of_cdr = [c for c in connections if _serialisation(c) in ("cdr", "ros1")]
    count = sum(connection.msgcount for connection in connections)
    return RosbagsFile(
        path=path,
        content=content,
        streams={connection.id: _stream(connection) for connection in of_cdr},
        left_out=[f"{c.topic} ({_serialisation(c)})" for c in connections if c not in of_cdr],
        message_count=count,
        start_ns=start if count else 0,
        end_ns=max(end - 1, start) if count else 0,
    )


@functools.cache
def ros1_converter(type_name: str, definition: str) -> Converter | None:
    """Return what makes CDR of a ROS 1 message, None when ROS 2 has no such type.

    :raises ImportError: when `rosbags` isn't installed.
    """
    typesys = importlib.import_module("rosbags.typesys")
    conversion = importlib.import_module("rosbags.convert.converter")
    theirs = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    ours = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    if definition.strip():
        theirs = typesys.get_typestore(typesys.Stores.EMPTY)
        try:
            theirs.register(typesys.get_types_from_msg(definition, type_name))
        except Exception:  # a foreign library on a definition from a bag
            return None
    if type_name not in ours.fielddefs or type_name not in theirs.fielddefs:
        return None
    if conversion.is_same_wireformat(theirs, ours, type_name, type_name):
        return lambda data: bytes(ours.ros1_to_cdr(data, type_name))
    migrate = functools.partial(conversion.migrate_bytes, theirs, ours, type_name, type_name, {})
    return lambda data: bytes(migrate(data, src_is2=False, dst_is2=True))


def _reader(content: Path) -> Any:
    if _is_ros1(content):
        return importlib.import_module("rosbags.rosbag1").Reader(content)
    # Not its class for any bag, which goes by a file's suffix.
    return importlib.import_module("rosbags.rosbag2").Reader(content)


def _is_ros1(content: Path) -> bool:
    with content.open("rb") as stream:
        return stream.read(len(ROS1_MAGIC)) == ROS1_MAGIC


def _journal(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _serialisation(connection: Any) -> str:
    return str(getattr(connection.ext, "serialization_format", "ros1"))


def _stream(connection: Any) -> Stream:
    ros1 = _serialisation(connection) == "ros1"
    return Stream(
        topic=connection.topic,
        type_name=canonical_type_name(connection.msgtype),
        message_count=connection.msgcount,
        qos=(_LATCHED if connection.ext.latching else "") if ros1 else _qos(connection),
        ros1_definition=connection.msgdef.data if ros1 else None,
    )


def _qos(connection: Any) -> str:
    """Return the profiles that a connection's publishers offered, as rosbag2 writes them."""
    return yaml.safe_dump(
        [
            {
                "history": int(profile.history.value),
                "depth": profile.depth,
                "reliability": int(profile.reliability.value),
                "durability": int(profile.durability.value),
                "liveliness": int(profile.liveliness.value),
                **{
                    name: {"sec": duration.sec, "nsec": duration.nsec}
                    for name, duration in (
                        ("deadline", profile.deadline),
                        ("lifespan", profile.lifespan),
                        ("liveliness_lease_duration", profile.liveliness_lease_duration),
                    )
                },
            }
            for profile in connection.ext.offered_qos_profiles
        ]
    )


def _how_to_read(path: Path, content: Path) -> str:
    what = "was recorded by ROS 1" if _is_ros1(content) else "is stored as sqlite3"
    return (
        f"{path} {what}: '{how_to_install('rosbags')}' to read it as it is, or convert it "
        f"with {_conversion(path, content)}"
    )


def _conversion(path: Path, content: Path) -> str:
    if _is_ros1(content):
        return f"'rosbags-convert --src {path} --dst {path.with_suffix('')}'"
    return (
        f"'ros2 bag convert -i {path} -o options.yaml', where options.yaml says "
        "'output_bags: [{uri: converted, storage_id: mcap, all_topics: true}]'"
    )


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
