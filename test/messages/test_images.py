from __future__ import annotations

import re
import resource

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sensor_msgs.msg import CompressedImage, Image

from turbseg_ros.messages.images import (
    ImageConversionError,
    encoding_of,
    frame_from_message,
    image_from_message,
    message_from_image,
    ns_to_stamp,
    stamp_to_ns,
)
from turbseg_ros.messages.planar import PLANAR_LAYOUTS

SIZES = st.integers(1, 12)
GREY = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
# Where the blue, green and red channels lie in a pixel.
COLOUR = {
    "bgr8": ("u1", 3, (0, 1, 2)),
    "rgb8": ("u1", 3, (2, 1, 0)),
    "bgra8": ("u1", 4, (0, 1, 2)),
    "rgba8": ("u1", 4, (2, 1, 0)),
    "bgr16": ("u2", 3, (0, 1, 2)),
    "rgb16": ("u2", 3, (2, 1, 0)),
    "bgra16": ("u2", 4, (0, 1, 2)),
    "rgba16": ("u2", 4, (2, 1, 0)),
}


def stored_message(
    image: np.ndarray, encoding: str, padding: int = 0, big_endian: bool = False
) -> Image:
    """Lay `image` (HxWxC) out byte by byte, independently of the code under test."""
    in_order = image.astype(image.dtype.newbyteorder(">" if big_endian else "<"))
    rows = [row.tobytes() + b"\xaa" * padding for row in in_order]
    message = Image(
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=len(rows[0]),
    )
    message.data.frombytes(b"".join(rows))
    return message


@st.composite
def stored_images(draw, encodings, dtype_and_channels):
    encoding = draw(st.sampled_from(sorted(encodings)))
    dtype, channels = dtype_and_channels(encoding)
    shape = (draw(SIZES), draw(SIZES), channels)
    image = draw(hnp.arrays(np.dtype(dtype), shape))
    return image, encoding, draw(st.integers(0, 5)), draw(st.booleans())


@given(stored_images(GREY, lambda encoding: (GREY[encoding], 1)))
def test_grey_is_read_whatever_the_padding_and_byte_order(stored):
    image, encoding, padding, big_endian = stored
    result = image_from_message(stored_message(image, encoding, padding, big_endian))
    assert result.dtype == image.dtype
    assert result.dtype.isnative
    np.testing.assert_array_equal(result, image[:, :, 0])


@given(stored_images(COLOUR, lambda encoding: COLOUR[encoding][:2]))
def test_colour_is_read_as_bgr_whatever_the_padding_and_byte_order(stored):
    image, encoding, padding, big_endian = stored
    result = image_from_message(stored_message(image, encoding, padding, big_endian))
    assert result.dtype == image.dtype
    np.testing.assert_array_equal(result, image[:, :, COLOUR[encoding][2]])


@given(
    st.sampled_from(["mono8", "mono16", "32FC1", "bgr8"]).flatmap(
        lambda encoding: st.tuples(
            st.just(encoding),
            hnp.arrays(
                np.dtype(GREY.get(encoding, "u1")),
                st.tuples(SIZES, SIZES, *([st.just(3)] if encoding == "bgr8" else [])),
            ),
        )
    ),
    st.integers(0, 2**31 * 10**9 - 1),
)
def test_an_image_survives_the_round_trip(encoded, stamp_ns):
    encoding, image = encoded
    message = message_from_image(image, encoding, stamp_ns, "camera")
    assert message.step * message.height == len(message.data)
    assert message.header.frame_id == "camera"
    assert stamp_to_ns(message.header.stamp) == stamp_ns
    np.testing.assert_array_equal(image_from_message(message), image)


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_a_stamp_survives_the_round_trip(nanoseconds):
    assert stamp_to_ns(ns_to_stamp(nanoseconds)) == nanoseconds


def test_a_view_of_an_image_is_stored_as_it_looks():
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)[::2, ::-1]
    message = message_from_image(image, "mono8", 0)
    np.testing.assert_array_equal(image_from_message(message), image)


@pytest.mark.parametrize("padding", [0, 8])
def test_nothing_is_copied_when_nothing_needs_converting(padding):
    message = stored_message(np.zeros((4, 6, 1), np.uint16), "mono16", padding)
    result = image_from_message(message)
    message.data[0] = 7
    assert result[0, 0] == 7


@pytest.mark.parametrize("depth", ["8", "16"])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_each_bayer_pattern_gives_the_colours_behind_it(pattern, depth):
    dtype = np.dtype(f"u{int(depth) // 8}")
    colour = {"b": 10, "g": 90, "r": 200}
    tile = np.array([colour[letter] for letter in pattern], dtype).reshape(2, 2, 1)
    message = stored_message(np.tile(tile, (4, 5, 1)), f"bayer_{pattern}{depth}")
    result = image_from_message(message)
    assert result.shape == (8, 10, 3)
    assert result.dtype == dtype
    assert np.all(result == [10, 90, 200])


def test_big_endian_bayer_is_read():
    tile = np.array([300, 1000, 1000, 5000], np.uint16).reshape(2, 2, 1)
    message = stored_message(np.tile(tile, (3, 3, 1)), "bayer_bggr16", big_endian=True)
    assert np.all(image_from_message(message) == [300, 1000, 5000])


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")],
)
def test_yuv422_gives_the_colours_behind_it(encoding, order):
    # ITU-R BT.601 in video range, as the formats are defined.
    yuv = {"y": 81, "u": 90, "v": 240}
    pair = np.array([yuv[letter] for letter in order], np.uint8).reshape(1, 2, 2)
    result = image_from_message(stored_message(np.tile(pair, (3, 2, 1)), encoding, padding=3))
    assert result.shape == (3, 4, 3)
    assert np.abs(result.astype(int) - [0, 0, 255]).max() <= 2


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4)])
def test_png_is_decoded_without_loss_and_without_alpha(shape, dtype):
    image = np.arange(np.prod(shape), dtype=dtype).reshape(shape) * dtype(3)
    result = image_from_message(compressed(cv2.imencode(".png", image)[1], "png"))
    assert result.dtype == dtype
    np.testing.assert_array_equal(result, image if image.ndim == 2 else image[:, :, :3])


def test_jpeg_is_decoded():
    noise = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    image = cv2.GaussianBlur(noise, None, 5.0)
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
    result = image_from_message(compressed(encoded, "bgr8; jpeg compressed bgr8"))
    assert result.shape == image.shape
    assert np.abs(result.astype(int) - image).max() < 12


def test_what_nobody_looks_at_is_decoded_in_part_and_keeps_its_size():
    noise = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    encoded = cv2.imencode(".jpg", cv2.GaussianBlur(noise, None, 5.0))[1]
    message = compressed(encoded, "jpeg")
    wanted = frame_from_message(message)
    assert wanted.image_wanted
    assert wanted.image.shape == (*wanted.shape, 3) == (40, 60, 3)
    unseen = frame_from_message(message, enough=600.0)
    assert not unseen.image_wanted
    assert unseen.image.shape == (20, 30, 3)
    assert unseen.shape == (40, 60)
    assert unseen.kept().image.shape == (40, 60, 3)
    plain = frame_from_message(message_from_image(noise, "bgr8", 5), enough=600.0)
    np.testing.assert_array_equal(plain.image, noise)
    assert not plain.image_wanted


def compressed(data: np.ndarray, image_format: str) -> CompressedImage:
    message = CompressedImage(format=image_format)
    message.data.frombytes(data.tobytes())
    return message


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"encoding": "mono12"}, "'mono12' is not supported"),
        ({"encoding": ""}, "'' is not supported"),
        ({"width": 0}, "0x4 pixels is empty"),
        ({"height": 0}, "6x0 pixels is empty"),
        ({"step": 11}, "step 11 is too short: 6 pixels of mono16 are 12 bytes"),
        ({"step": 0}, "step 0 is too short"),
        ({"height": 5}, "needs 60 bytes, not 48"),
        ({"height": 2**32 - 1, "step": 2**32 - 1}, "data is too short"),
        ({"encoding": "yuyv", "width": 5}, "5x4 pixels can't be yuyv"),
        ({"encoding": "bayer_rggb8", "height": 2}, "6x2 pixels can't be bayer_rggb8"),
    ],
)
def test_an_impossible_message_is_refused_in_one_line(changes, complaint):
    message = stored_message(np.zeros((4, 6, 1), np.uint16), "mono16")
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(ImageConversionError, match=re.escape(complaint)) as caught:
        image_from_message(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("length", [100, 2**31 - 1, 2**32 - 1])
def test_a_png_that_states_more_data_than_it_has_takes_no_memory_for_them(length):
    png = bytearray(cv2.imencode(".png", np.zeros((9, 9), np.uint8))[1].tobytes())
    data = png.index(b"IDAT")
    png[data - 4 : data] = length.to_bytes(4, "big")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImageConversionError, match="can't be decoded: it ends within a chunk"):
        image_from_message(compressed(np.frombuffer(bytes(png), np.uint8), "png"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_what_follows_the_end_of_a_png_is_left_alone():
    image = np.arange(81, dtype=np.uint8).reshape(9, 9)
    png = np.append(cv2.imencode(".png", image)[1], np.frombuffer(b"trailer", np.uint8))
    np.testing.assert_array_equal(image_from_message(compressed(png, "png")), image)


@pytest.mark.parametrize(
    "data", [b"", b"no picture", cv2.imencode(".png", np.zeros((9, 9)))[1][:50]]
)
def test_what_cannot_be_decoded_is_refused_in_one_line(data):
    with pytest.raises(ImageConversionError, match="can't be decoded") as caught:
        image_from_message(compressed(np.frombuffer(bytes(data), np.uint8), "png"))
    assert "\n" not in str(caught.value)


@settings(max_examples=500)
@given(
    encoding=st.sampled_from(
        [
            *(*GREY, *COLOUR, "bayer_gbrg16", "yuyv", "bayer_rggb8"),
            *(*PLANAR_LAYOUTS, "16SC1", "32SC1", "64FC1", "8UC4", "16UC3"),
        ]
    ),
    height=st.integers(0, 40),
    width=st.integers(0, 40),
    step=st.integers(0, 200),
    big_endian=st.booleans(),
    data=st.binary(max_size=4000),
)
def test_any_message_gives_an_image_of_its_size_or_a_refusal(
    encoding, height, width, step, big_endian, data
):
    message = Image(
        height=height, width=width, encoding=encoding, step=step, is_bigendian=int(big_endian)
    )
    message.data.frombytes(data)
    try:
        result = image_from_message(message)
    except ImageConversionError:
        return
    assert result.shape[:2] == (height, width)
    assert result.dtype in (np.uint8, np.uint16, np.float32)


@pytest.mark.parametrize(
    ("image", "encoding"),
    [
        (np.zeros((3, 4), np.uint16), "mono8"),
        (np.zeros((3, 4), np.uint8), "bgr8"),
        (np.zeros((3, 4, 3), np.uint8), "mono8"),
        (np.zeros(4, np.uint8), "mono8"),
    ],
)
def test_an_array_is_not_stored_under_an_encoding_it_does_not_have(image, encoding):
    with pytest.raises(ValueError, match="does not store"):
        message_from_image(image, encoding, 0)


def test_a_frame_has_its_message_stamp_frame_id_and_image():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    frame = frame_from_message(message_from_image(image, "mono8", -7, "camera"))
    assert (frame.stamp, frame.frame_id) == (-7, "camera")
    np.testing.assert_array_equal(frame.image, image)


@given(
    st.sampled_from([("uint8", 1), ("uint16", 1), ("float32", 1), ("uint8", 3), ("uint16", 3)]),
    SIZES,
    SIZES,
)
def test_an_image_is_stored_as_it_is(kind, height, width):
    dtype, channels = kind
    shape = (height, width) if channels == 1 else (height, width, channels)
    image = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    stored = image_from_message(message_from_image(image, encoding_of(image), 0))
    assert stored.dtype == image.dtype
    np.testing.assert_array_equal(stored, image)


@pytest.mark.parametrize(
    ("dtype", "shape"), [(np.float64, (2, 3)), (np.float32, (2, 3, 3)), (np.uint8, (2, 3, 2))]
)
def test_an_image_that_no_encoding_stores_is_refused(dtype, shape):
    with pytest.raises(ImageConversionError, match="no encoding stores"):
        encoding_of(np.zeros(shape, dtype))
