"""What cameras and video hardware publish beside the usual encodings, against independent ones."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sensor_msgs.msg import CompressedImage, Image

from turbseg_ros.messages.images import ImageConversionError, image_from_message

SUBSAMPLED = ("nv12", "nv21", "i420", "yuv420", "yuv420p", "iyuv", "yv12")
PLANAR = (*SUBSAMPLED, "nv24")
PADDING = 0xAA


def bgr_of(luma: np.ndarray, cb: np.ndarray, cr: np.ndarray) -> np.ndarray:
    """Return BGR by the formula of ITU-R BT.601 in video range, each plane HxW."""
    y, b, r = 1.164383 * (luma - 16.0), cb - 128.0, cr - 128.0
    bgr = np.dstack([y + 2.017232 * b, y - 0.391762 * b - 0.812968 * r, y + 1.596027 * r])
    # OpenCV clips luma below black first.
    return np.rint(bgr).clip(0, 255).astype(int)


def rows_of(plane: np.ndarray, step: int) -> bytes:
    return b"".join(row.tobytes().ljust(step, bytes([PADDING])) for row in plane)


def planar_message(
    encoding: str, luma: np.ndarray, cb: np.ndarray, cr: np.ndarray, padding: int = 0
) -> Image:
    """Lay planes out row by row; `padding` bytes (even) follow each row of luma."""
    height, width = luma.shape
    step = width + padding
    name = encoding.lower()
    data = rows_of(luma, step)
    if name in ("nv12", "nv21", "nv24"):
        pair = (cr, cb) if name == "nv21" else (cb, cr)
        chroma = np.dstack(pair).reshape(len(cb), -1)
        data += rows_of(chroma, 2 * step if name == "nv24" else step)
    else:
        first, second = (cr, cb) if name == "yv12" else (cb, cr)
        data += rows_of(first, step // 2) + rows_of(second, step // 2)
    message = Image(height=height, width=width, encoding=encoding, step=step)
    message.data.frombytes(data)
    return message


@st.composite
def pictures(draw: st.DrawFn, encodings: tuple[str, ...]) -> tuple:
    encoding = draw(st.sampled_from(encodings))
    factor = 1 if encoding.lower() == "nv24" else 2
    shape = (draw(st.integers(1, 6)), draw(st.integers(1, 6)))
    levels = st.integers(16, 235)
    luma = draw(hnp.arrays(np.uint8, (shape[0] * factor, shape[1] * factor), elements=levels))
    cb, cr = (draw(hnp.arrays(np.uint8, shape, elements=levels)) for _ in range(2))
    return encoding, luma, cb, cr, draw(st.sampled_from([0, 2, 6]))


@settings(max_examples=200)
@given(pictures((*PLANAR, "NV12", "NV21", "NV24", "I420", "YV12", "YUV420")))
def test_planes_give_the_colours_that_the_standard_gives_them(picture: tuple) -> None:
    encoding, luma, cb, cr, padding = picture
    result = image_from_message(planar_message(encoding, luma, cb, cr, padding))
    if encoding.lower() != "nv24":
        cb, cr = (plane.repeat(2, axis=0).repeat(2, axis=1) for plane in (cb, cr))
    assert result.dtype == np.uint8
    assert np.abs(result - bgr_of(luma, cb, cr)).max() <= 2


@pytest.mark.parametrize("encoding", PLANAR)
def test_the_last_row_may_lack_its_padding(encoding: str) -> None:
    random = np.random.default_rng(0)
    luma = random.integers(16, 235, (4, 6), np.uint8)
    shape = luma.shape if encoding == "nv24" else (2, 3)
    cb, cr = (random.integers(16, 235, shape, np.uint8) for _ in range(2))
    message = planar_message(encoding, luma, cb, cr, 4)
    whole = image_from_message(message)
    while message.data[-1] == PADDING:
        message.data.pop()
    np.testing.assert_array_equal(image_from_message(message), whole)
    message.data.pop()
    with pytest.raises(ImageConversionError, match="data is too short"):
        image_from_message(message)


def test_a_step_that_counts_chroma_in_does_no_harm() -> None:
    random = np.random.default_rng(0)
    luma = random.integers(16, 235, (4, 6), np.uint8)
    cb, cr = (random.integers(16, 235, (2, 3), np.uint8) for _ in range(2))
    message = planar_message("nv12", luma, cb, cr)
    plain = image_from_message(message)
    message.step = 9
    np.testing.assert_array_equal(image_from_message(message), plain)


@pytest.mark.parametrize("encoding", SUBSAMPLED)
@pytest.mark.parametrize("size", [(5, 4), (4, 5), (5, 5), (1, 1)])
def test_an_odd_size_is_refused_in_one_line(encoding: str, size: tuple[int, int]) -> None:
    message = Image(width=size[0], height=size[1], encoding=encoding, step=size[0])
    message.data.frombytes(bytes(200))
    complaint = f"image of {size[0]}x{size[1]} pixels can't be {encoding}"
    with pytest.raises(ImageConversionError, match=rf"{complaint}.*both must be even$"):
        image_from_message(message)


@pytest.mark.parametrize("encoding", PLANAR)
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"width": 0}, "is empty"),
        ({"height": 0}, "is empty"),
        ({"step": 5}, "step 5 is too short"),
        ({"step": 0}, "step 0 is too short"),
        ({"height": 2**31}, "data is too short"),
    ],
)
def test_impossible_planes_are_refused_in_one_line(
    encoding: str, changes: dict, complaint: str
) -> None:
    message = Image(width=6, height=4, encoding=encoding, step=6)
    message.data.frombytes(bytes(100))
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(ImageConversionError, match=complaint) as caught:
        image_from_message(message)
    assert "\n" not in str(caught.value)


NUMBERS = {"8SC1": "i1", "16SC1": "i2", "32SC1": "i4", "64FC1": "f8"}


@given(st.data())
def test_signed_and_double_numbers_become_float_whatever_the_padding_and_byte_order(
    data: st.DataObject,
) -> None:
    encoding = data.draw(st.sampled_from(sorted(NUMBERS)))
    dtype = np.dtype(NUMBERS[encoding])
    image = data.draw(hnp.arrays(dtype, (data.draw(st.integers(1, 5)), 4)))
    padding, big_endian = data.draw(st.integers(0, 5)), data.draw(st.booleans())
    stored = image.astype(dtype.newbyteorder(">" if big_endian else "<"))
    step = 4 * dtype.itemsize + padding
    message = Image(
        height=len(image), width=4, encoding=encoding, step=step, is_bigendian=int(big_endian)
    )
    message.data.frombytes(rows_of(stored, step))
    result = image_from_message(message)
    assert result.dtype == np.float32
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(result, image.astype(np.float32))


# Where the blue, green and red channels lie in a pixel: as OpenCV has them, which names no order.
OPENCV = {"8UC3": ("u1", 3), "8UC4": ("u1", 4), "16UC3": ("u2", 3), "16UC4": ("u2", 4)}


@given(st.data())
def test_opencvs_own_names_are_blue_green_and_red(data: st.DataObject) -> None:
    encoding = data.draw(st.sampled_from(sorted(OPENCV)))
    kind, channels = OPENCV[encoding]
    dtype = np.dtype(kind)
    image = data.draw(hnp.arrays(dtype, (data.draw(st.integers(1, 5)), 4, channels)))
    padding, big_endian = data.draw(st.integers(0, 5)), data.draw(st.booleans())
    stored = image.astype(dtype.newbyteorder(">" if big_endian else "<")).reshape(len(image), -1)
    step = 4 * channels * dtype.itemsize + padding
    message = Image(
        height=len(image), width=4, encoding=encoding, step=step, is_bigendian=int(big_endian)
    )
    message.data.frombytes(rows_of(stored, step))
    result = image_from_message(message)
    assert result.dtype == dtype
    np.testing.assert_array_equal(result, image[:, :, :3])


# --- Depth ---------------------------------------------------------------------------------------


def compressed(image_format: str, data: bytes) -> CompressedImage:
    message = CompressedImage(format=image_format)
    message.data.frombytes(data)
    return message


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


@pytest.mark.parametrize(
    "image_format", ["16UC1; compressedDepth png", "16UC1; compressedDepth", "mono16", ""]
)
def test_depth_in_a_png_is_read_behind_its_head(image_format: str) -> None:
    depth = np.arange(60, dtype=np.uint16).reshape(6, 10) * 900
    message = compressed(image_format, struct.pack("<iff", 0, 0, 0) + png(depth))
    np.testing.assert_array_equal(image_from_message(message), depth)


def test_depth_in_metres_is_brought_back() -> None:
    """As compressed_depth_image_transport quantises it: inverse depth in 16 bits, 0 for none."""
    depth = np.linspace(0.5, 40.0, 60, dtype=np.float32).reshape(6, 10)
    quantisation, offset = np.float32(2000.0), np.float32(1.0 - 2000.0 / 100.0)
    stored = np.rint(quantisation / depth + offset).astype(np.uint16)
    stored[0, 0] = 0
    head = struct.pack("<iff", 0, quantisation, offset)
    read = image_from_message(compressed("32FC1; compressedDepth png", head + png(stored)))
    assert read.dtype == np.float32
    assert np.isnan(read[0, 0])
    inverse = np.abs(1 / read - 1 / depth).ravel()[1:]
    assert inverse.max() <= 0.51 / quantisation


@pytest.mark.parametrize("content", [b"", b"\0" * 5, b"\0" * 12, b"\0" * 12 + b"rvl coded"])
def test_depth_that_is_no_png_names_what_to_do(content: bytes) -> None:
    with pytest.raises(ImageConversionError, match=r"image_transport republish.*compressedDepth"):
        image_from_message(compressed("16UC1; compressedDepth rvl", content))


@pytest.mark.parametrize(
    "image_format", ["h264", "H265", "hevc", "libx264;yuv420p;bgr8;bgr8", "av1", "theora"]
)
def test_video_where_pictures_should_be_names_what_to_do(image_format: str) -> None:
    with pytest.raises(ImageConversionError, match="image_transport republish") as caught:
        image_from_message(compressed(image_format, b"\0\0\0\1\x67"))
    assert re.escape("\n") not in str(caught.value)
