"""Serialised messages, field by field; images read where they lie, written with one copy.

The format is what DDS calls plain CDR (OMG DDSI-RTPS, section 10): four bytes about the format,
then the fields in turn, each number aligned to its own size, strings and sequences after their
length. Needs the message packages, no running middleware.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from sensor_msgs.msg import Image
from std_msgs.msg import Header

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_NATIVE_FORMAT = (b"\x00\x01" if sys.byteorder == "little" else b"\x00\x00") + b"\x00\x00"
_FORMAT_BYTES = len(_NATIVE_FORMAT)


class SerialisedDataError(ValueError):
    """Data that are no serialised message of the kind; the text is one line saying why."""


@dataclass(frozen=True)
class ImageView:
    """A `sensor_msgs/Image`, field by field; `data` is a view of the serialised message."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: memoryview


@dataclass(frozen=True)
class CompressedImageView:
    """A `sensor_msgs/CompressedImage`; `data` is a view of the serialised message."""

    header: Header
    format: str
    data: memoryview


def image_view(serialised: memoryview) -> ImageView:
    """Read a serialised `sensor_msgs/Image`.

    :raises SerialisedDataError: when it is none.
    """
    fields = FieldReader(serialised)
    return ImageView(
        header=fields.header(),
        height=fields.number("I"),
        width=fields.number("I"),
        encoding=fields.text(),
        is_bigendian=fields.number("B"),
        step=fields.number("I"),
        data=fields.sequence(),
    )


def compressed_image_view(serialised: memoryview) -> CompressedImageView:
    """Read a serialised `sensor_msgs/CompressedImage`.

    :raises SerialisedDataError: when it is none.
    """
    fields = FieldReader(serialised)
    return CompressedImageView(fields.header(), fields.text(), fields.sequence())


def ffmpeg_packet_view(serialised: memoryview) -> CompressedImageView:
    """Read a serialised `ffmpeg_image_transport_msgs/FFMPEGPacket`; `format` is its encoding.

    :raises SerialisedDataError: when it is none.
    """
    fields = FieldReader(serialised)
    header = fields.header()
    fields.number("i"), fields.number("i")  # width, height
    encoding = fields.text()
    fields.number("Q"), fields.number("B"), fields.number("B")  # pts, flags, is_bigendian
    return CompressedImageView(header, encoding, fields.sequence())


def compressed_video_view(serialised: memoryview) -> CompressedImageView:
    """Read a serialised `foxglove_msgs/CompressedVideo`.

    :raises SerialisedDataError: when it is none.
    """
    fields = FieldReader(serialised)
    header = fields.header()  # its timestamp and frame_id lie like those of one
    data = fields.sequence()
    return CompressedImageView(header, fields.text(), data)


def serialised_image(image: Image) -> bytes:
    """Return an image as rclpy would serialise it, in a fraction of the time."""
    fields = FieldWriter()
    fields.header(image.header)
    fields.number("I", image.height)
    fields.number("I", image.width)
    fields.text(image.encoding)
    fields.number("B", image.is_bigendian)
    fields.number("I", image.step)
    fields.number("I", len(image.data))
    return b"".join((fields.serialised(), memoryview(image.data)))


class FieldWriter:
    """Serialises the fields of a message, one after the other."""

    def __init__(self) -> None:
        self._fields = bytearray()

    def header(self, header: Header) -> None:
        """Append a `std_msgs/Header`."""
        self.number("i", header.stamp.sec)
        self.number("I", header.stamp.nanosec)
        self.text(header.frame_id)

    def number(self, kind: str, value: float) -> None:
        """Append a number; `kind` is struct's letter for it."""
        self._fields.extend(bytes(-len(self._fields) % struct.calcsize(kind)))
        self._fields.extend(struct.pack(f"={kind}", value))

    def text(self, value: str) -> None:
        """Append a string."""
        content = value.encode() + b"\0"
        self.number("I", len(content))
        self._fields.extend(content)

    def serialised(self) -> bytes:
        """Return what was appended, after the bytes about the format."""
        return _NATIVE_FORMAT + self._fields


class FieldReader:
    """The fields of a serialised message, one after the other."""

    def __init__(self, serialised: memoryview) -> None:
        if not serialised:
            raise SerialisedDataError("message is empty")
        kind = bytes(serialised[:2])
        if kind not in _BYTE_ORDERS:
            raise SerialisedDataError(f"message in a format that is not known ({kind.hex()})")
        self._order = _BYTE_ORDERS[kind]
        self._rest = serialised[_FORMAT_BYTES:]
        self._position = 0

    def header(self) -> Header:
        """Return the next field, a `std_msgs/Header`."""
        stamp = Time(sec=self.number("i"), nanosec=self.number("I"))
        return Header(stamp=stamp, frame_id=self.text())

    def number(self, kind: str) -> int:
        """Return the next whole number; `kind` is struct's letter for it."""
        return int(self._number(kind))

    def real(self) -> float:
        """Return the next number of double precision."""
        return float(self._number("d"))

    def _number(self, kind: str) -> float:
        size = struct.calcsize(kind)
        start = -(-self._position // size) * size
        value: float
        (value,) = struct.unpack(self._order + kind, self._bytes(start, size))
        return value

    def sequence(self) -> memoryview:
        """Return the bytes of the next sequence or string."""
        length = self.number("I")
        return self._bytes(self._position, length)

    def text(self) -> str:
        """Return the next string, without the zero that ends it."""
        return bytes(self.sequence()).removesuffix(b"\0").decode(errors="replace")

    def _bytes(self, start: int, length: int) -> memoryview:
        self._position = start + length
        if self._position > len(self._rest):
            raise SerialisedDataError(
                f"message ends after {len(self._rest)} bytes, {self._position} are needed"
            )
        return self._rest[start : self._position]
