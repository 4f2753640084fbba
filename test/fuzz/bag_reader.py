"""Fuzz the bag reader: whatever a bag holds, it is read, or refused by a `BagError`.

The first byte of an input says what the rest is: a file, the content of a chunk in an otherwise
sound file, a metadata.yaml beside a sound file, the CDR of an image, or QoS profiles.
"""

from __future__ import annotations

import itertools
import logging
import struct
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["turbseg_ros", "mcap"]):
    from turbseg_ros.bag import qos
    from turbseg_ros.bag.errors import BagError
    from turbseg_ros.bag.reader import BagReader
    from turbseg_ros.bag.records import Record
    from turbseg_ros.bag.schema import message_definition

from mcap.writer import CompressionType, Writer

# Enough to go through every branch; a flood of tiny messages is no finding.
MAX_MESSAGES = 1000
MAGIC = b"\x89MCAP0\r\n"
FOLDER = Path(tempfile.mkdtemp(prefix="fuzz_bag_"))


def sound_file() -> bytes:
    file = FOLDER / "sound.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2", library="")
        kind = "sensor_msgs/msg/Image"
        text = message_definition(kind).text.encode()[:100]
        channel = writer.register_channel(
            "/a", "cdr", writer.register_schema(kind, "ros2msg", text)
        )
        writer.add_message(channel, 1, b"\x00\x01\x00\x00" + bytes(40), 1)
        writer.finish()
    return file.read_bytes()


SOUND = sound_file()


def chunk_file(content: bytes) -> bytes:
    """Return a file that was cut behind a chunk with such content."""
    body = struct.pack("<QQQIIQ", 0, 1, len(content), 0, 0, len(content)) + content
    header = struct.pack("<BQ", 1, 12) + struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    return MAGIC + header + struct.pack("<BQ", 6, len(body)) + body


def read(path: Path) -> None:
    reader = BagReader(path)
    assert reader.duration_ns >= 0
    for record in itertools.islice(reader.messages(), MAX_MESSAGES):
        assert record.topic in reader.topics
        try:
            record.message()
        except BagError as error:
            assert str(error).isprintable()


def try_one(data: bytes) -> None:
    kind, rest = data[:1], data[1:]
    file, metadata = FOLDER / "bag_0.mcap", FOLDER / "metadata.yaml"
    metadata.unlink(missing_ok=True)
    try:
        if kind == b"F":
            file.write_bytes(rest)
            read(file)
        elif kind == b"C":
            file.write_bytes(chunk_file(rest))
            read(file)
        elif kind == b"M":
            file.write_bytes(SOUND[: len(SOUND) // 2] if rest[:1] == b"#" else SOUND)
            metadata.write_bytes(rest)
            read(FOLDER)
        elif kind == b"Q":
            qos.from_yaml(rest.decode("utf-8", "replace"))
        else:
            Record("/a", "sensor_msgs/msg/Image", 0, rest).message()
    except BagError as error:
        assert str(error).isprintable()
    except ValueError:
        if kind != b"Q":
            raise


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
