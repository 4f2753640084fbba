"""Images read in place agree with what rclpy makes of the same bytes."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from turbseg_ros.messages.cdr import (
    SerialisedDataError,
    compressed_image_view,
    image_view,
    serialised_image,
)
from turbseg_ros.messages.images import (
    ImageConversionError,
    frame_from_message,
    frame_from_serialised,
    message_from_image,
)

# The first message loads a library.
untimed = settings(deadline=None)
NUMBERS = st.integers(0, 2**32 - 1)
# A zero ends a string.
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
HEADERS = st.builds(
    Header,
    stamp=st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=NUMBERS),
    frame_id=TEXTS,
)
IMAGES = st.builds(
    Image,
    header=HEADERS,
    height=NUMBERS,
    width=NUMBERS,
    encoding=TEXTS,
    is_bigendian=st.integers(0, 255),
    step=NUMBERS,
    data=st.binary(max_size=40),
)


@untimed
@given(IMAGES)
def test_an_image_is_read_as_it_was_written(message):
    view = image_view(memoryview(serialize_message(message)))
    fields = [name for name in message.get_fields_and_field_types() if name != "data"]
    assert [getattr(view, name) for name in fields] == [getattr(message, name) for name in fields]
    assert bytes(view.data) == bytes(message.data)


@untimed
@given(IMAGES)
def test_an_image_is_serialised_as_by_rclpy(message):
    serialised = serialised_image(message)
    assert deserialize_message(serialised, Image) == message
    # What rclpy leaves between fields is by chance.
    assert len(serialised) == len(serialize_message(message))


@untimed
@given(st.builds(CompressedImage, header=HEADERS, format=TEXTS, data=st.binary(max_size=40)))
def test_a_compressed_image_is_read_as_it_was_written(message):
    view = compressed_image_view(memoryview(serialize_message(message)))
    assert (view.header, view.format) == (message.header, message.format)
    assert bytes(view.data) == bytes(message.data)


def test_big_endian_messages_are_read():
    text = struct.pack(">I", 7) + b"camera\0"
    numbers = struct.pack(">iI", -3, 5) + text + b"\0" + struct.pack(">II", 1, 2)
    rest = struct.pack(">I", 6) + b"mono8\0" + b"\1\0" + struct.pack(">II", 2, 2) + b"ab"
    view = image_view(memoryview(b"\0\0\0\0" + numbers + rest))
    assert (view.header.stamp.sec, view.header.frame_id) == (-3, "camera")
    assert (view.height, view.width, view.encoding, view.step) == (1, 2, "mono8", 2)
    assert (view.is_bigendian, bytes(view.data)) == (1, b"ab")


@untimed
@given(IMAGES, st.data())
def test_a_message_that_ends_early_is_refused(message, data):
    serialised = serialize_message(message)
    end = serialised.index(bytes(message.data), len(serialised) - len(message.data) - 3)
    cut = serialised[: data.draw(st.integers(0, end + len(message.data) - 1))]
    with pytest.raises(SerialisedDataError):
        image_view(memoryview(cut))


@untimed
@given(st.binary(max_size=200), st.sampled_from([Image, CompressedImage]))
def test_any_bytes_give_a_frame_or_a_refusal(data, kind):
    try:
        frame_from_serialised(memoryview(b"\0\1\0\0" + data), kind)
    except ImageConversionError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\2" + bytes(100), b"\xff" * 100])
def test_a_format_that_is_not_known_is_refused(data):
    with pytest.raises(ImageConversionError, match=r"not known|message is empty"):
        frame_from_serialised(memoryview(data), Image)


def test_a_frame_is_a_view_of_the_message_and_as_rclpy_reads_it():
    picture = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
    serialised = bytearray(serialize_message(message_from_image(picture, "bgr8", 5, "camera")))
    frame = frame_from_serialised(memoryview(serialised), Image)
    expected = frame_from_message(deserialize_message(bytes(serialised), Image))
    assert (frame.stamp, frame.frame_id) == (expected.stamp, expected.frame_id)
    np.testing.assert_array_equal(frame.image, expected.image)
    assert np.shares_memory(frame.image, np.frombuffer(serialised, np.uint8))
