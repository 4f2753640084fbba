"""Images between ROS messages, arrays and frames; needs no running middleware."""

from __future__ import annotations

import math
import re
import reprlib
import struct
import sys
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from turbseg_ros.encoded_picture import PictureError, decoded_in_part, is_png
from turbseg_ros.messages.cdr import (
    CompressedImageView,
    ImageView,
    SerialisedDataError,
    compressed_image_view,
    image_view,
)
from turbseg_ros.messages.planar import PLANAR_LAYOUTS, PlanarLayout
from turbseg_ros.segmentation.frame import Frame

AnyImage: TypeAlias = Image | CompressedImage | ImageView | CompressedImageView

_NANOSECONDS = 1_000_000_000
# What compressed_depth_image_transport puts ahead of the picture: a format, and two numbers that
# make depth of what a picture of floats holds.
_DEPTH_HEAD = struct.Struct("<iff")
# Formats of compressed images that hold no pictures but packets of video.
_VIDEO = re.compile("264|265|hevc|av1|vp8|vp9|theora", re.IGNORECASE)


class ImageConversionError(ValueError):
    """Message and image that can't be made one another; the text is one line saying why."""


class UnknownEncodingError(ImageConversionError):
    """An encoding that is not in the table."""


class ImageSizeError(ImageConversionError):
    """A size that no image of the encoding has."""


class ImageDataError(ImageConversionError):
    """Data that do not hold what the message says."""


class StampError(ImageConversionError):
    """A stamp that is no time."""


@dataclass(frozen=True)
class _Layout:
    """How an encoding stores a pixel, and OpenCV's conversion of that to grey or BGR, if any.

    Every conversion needs at least `minimum` pixels each way, and a width that `columns` divides.
    Types that the method doesn't take become float32, which holds 24 bits of them.
    """

    dtype: type[np.generic]
    channels: int = 1
    conversion: int | None = None
    minimum: int = 1
    columns: int = 1


def _bayer(dtype: type[np.generic], conversion: int) -> _Layout:
    return _Layout(dtype, conversion=conversion, minimum=3)


_UYVY = _Layout(np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY, columns=2)
_YUYV = _Layout(np.uint8, 2, cv2.COLOR_YUV2BGR_YUY2, columns=2)

# By the names in sensor_msgs/image_encodings.hpp. OpenCV names a Bayer pattern by the two pixels
# in the middle of the second row, ROS by the first four: OpenCV's BG is rggb.
_LAYOUTS = {
    "mono8": _Layout(np.uint8),
    "8UC1": _Layout(np.uint8),
    "8SC1": _Layout(np.int8),
    "mono16": _Layout(np.uint16),
    "16UC1": _Layout(np.uint16),
    "16SC1": _Layout(np.int16),
    "32SC1": _Layout(np.int32),
    "32FC1": _Layout(np.float32),
    "64FC1": _Layout(np.float64),
    "8UC3": _Layout(np.uint8, 3),
    "8UC4": _Layout(np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "16UC3": _Layout(np.uint16, 3),
    "16UC4": _Layout(np.uint16, 4, cv2.COLOR_BGRA2BGR),
    "bgr8": _Layout(np.uint8, 3),
    "rgb8": _Layout(np.uint8, 3, cv2.COLOR_RGB2BGR),
    "bgra8": _Layout(np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Layout(np.uint8, 4, cv2.COLOR_RGBA2BGR),
    "bgr16": _Layout(np.uint16, 3),
    "rgb16": _Layout(np.uint16, 3, cv2.COLOR_RGB2BGR),
    "bgra16": _Layout(np.uint16, 4, cv2.COLOR_BGRA2BGR),
    "rgba16": _Layout(np.uint16, 4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": _bayer(np.uint8, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": _bayer(np.uint8, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": _bayer(np.uint8, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": _bayer(np.uint8, cv2.COLOR_BayerGB2BGR),
    "bayer_rggb16": _bayer(np.uint16, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr16": _bayer(np.uint16, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg16": _bayer(np.uint16, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg16": _bayer(np.uint16, cv2.COLOR_BayerGB2BGR),
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUYV,
    "yuyv": _YUYV,
}

# What the method takes.
_METHOD_TYPES = (np.uint8, np.uint16, np.float32)

# By type and channels, what needs no conversion.
_PLAIN = {
    ("uint8", 1): "mono8",
    ("uint16", 1): "mono16",
    ("float32", 1): "32FC1",
    ("uint8", 3): "bgr8",
    ("uint16", 3): "bgr16",
}


def frame_from_serialised(
    message: memoryview,
    kind: type[Image] | type[CompressedImage],
    enough: float | None = None,
) -> Frame:
    """Return the frame that a serialised message of a kind holds; see `frame_from_message`.

    :raises ImageConversionError: also when it is no message of that kind.
    """
    read = compressed_image_view if kind is CompressedImage else image_view
    try:
        return frame_from_message(read(message), enough)
    except SerialisedDataError as error:
        raise ImageDataError(f"image {error}") from error


def frame_from_message(message: AnyImage, enough: float | None = None) -> Frame:
    """Return the frame that a camera's message holds, as the method takes it.

    :param enough: how many pixels will do for an image that nobody wants to see: a JPEG of many
        more is decoded in part (`encoded_picture.decoded_in_part`). None where it is wanted.
    :raises ImageConversionError: as `image_from_message`, and for a stamp whose nanoseconds make
        a second or more, for the answers could not carry it.
    """
    stamp, frame_id = stamp_of(message.header), message.header.frame_id
    if enough is None:
        return Frame(stamp, image_from_message(message), frame_id)
    whole = None
    if isinstance(message, CompressedImage | CompressedImageView):
        image, whole = _decoded(message, enough)
    else:
        image = image_from_message(message)
    return Frame(stamp, image, frame_id, image_wanted=False, whole=whole)


def stamp_of(header: Header) -> int:
    """Return the time of an image's header, nanoseconds.

    :raises StampError: when its nanoseconds make a second or more.
    """
    if header.stamp.nanosec >= _NANOSECONDS:
        raise StampError(f"image stamp has {header.stamp.nanosec} ns, which is a second or more")
    return stamp_to_ns(header.stamp)


def image_from_message(message: AnyImage) -> npt.NDArray[Any]:
    """Return a message's image: HxW (grey) or HxWx3 (BGR), uint8, uint16 or float32.

    Where nothing needs converting, the array is a view of the message's own data, its rows apart
    by the message's `step`.

    :raises ImageConversionError: for an encoding that is not known, a size, step or length of data
        that can't be, or compressed data that can't be decoded.
    """
    if isinstance(message, CompressedImage | CompressedImageView):
        return _decoded(message)[0]
    layout = _LAYOUTS.get(message.encoding)
    if layout is None:
        planar = PLANAR_LAYOUTS.get(message.encoding.lower())
        if planar is not None:
            return _from_planes(message, planar)
        raise UnknownEncodingError(
            f"image encoding {reprlib.repr(message.encoding)} is not supported; "
            f"it takes {', '.join((*_LAYOUTS, *PLANAR_LAYOUTS))}"
        )
    stored = _native(_pixels(message, layout))
    if layout.conversion is None:
        return stored if layout.dtype in _METHOD_TYPES else _as_float(stored)
    converted: npt.NDArray[Any] = cv2.cvtColor(stored, layout.conversion)
    return converted


def encoding_of(image: npt.NDArray[Any]) -> str:
    """Return the encoding that stores `image`, HxW (grey) or HxWx3 (BGR), as it is.

    :raises ImageConversionError: when none does.
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    encoding = _PLAIN.get((image.dtype.name, channels))
    if encoding is None:
        raise ImageConversionError(
            f"no encoding stores {image.dtype} images of {channels} channels"
        )
    return encoding


def message_from_image(
    image: npt.NDArray[Any], encoding: str, stamp_ns: int, frame_id: str = ""
) -> Image:
    """Return an image message that holds a copy of `image`, HxW or HxWxC.

    :raises ValueError: when the array isn't what `encoding` stores.
    """
    layout = _LAYOUTS[encoding]
    shape = image.shape if image.ndim == 3 else (*image.shape, 1)
    if len(shape) != 3 or shape[2] != layout.channels or image.dtype != layout.dtype:
        raise ValueError(f"{encoding} does not store {image.dtype} of shape {image.shape}")
    message = Image(
        height=shape[0],
        width=shape[1],
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=shape[1] * shape[2] * image.itemsize,
    )
    message.header.stamp = ns_to_stamp(stamp_ns)
    message.header.frame_id = frame_id
    # Assigning an array or bytes to `data` checks every byte in Python: a hundred times slower.
    message.data.frombytes(np.ascontiguousarray(image).data.cast("B"))
    return message


def stamp_to_ns(stamp: Time) -> int:
    """Return a message's time in nanoseconds."""
    return int(stamp.sec) * _NANOSECONDS + int(stamp.nanosec)


def ns_to_stamp(nanoseconds: int) -> Time:
    """Return a time in nanoseconds as messages carry it."""
    sec, nanosec = divmod(nanoseconds, _NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def _pixels(message: Image | ImageView, layout: _Layout) -> npt.NDArray[Any]:
    """View a message's data as HxW or HxWxC, in the byte order that it has."""
    height, width, step = message.height, message.width, message.step
    _check_size(message, layout)
    dtype = np.dtype(layout.dtype).newbyteorder(">" if message.is_bigendian else "<")
    row = width * layout.channels * dtype.itemsize
    if step < row:
        raise ImageDataError(
            f"image step {step} is too short: {width} pixels of {message.encoding} are {row} bytes"
        )
    needed = (height - 1) * step + row
    if len(message.data) < needed:
        raise ImageDataError(
            f"image data is too short: {width}x{height} {message.encoding} with step {step} "
            f"needs {needed} bytes, not {len(message.data)}"
        )
    shape = (height, width, layout.channels)
    strides = (step, layout.channels * dtype.itemsize, dtype.itemsize)
    pixels: npt.NDArray[Any] = np.ndarray(shape, dtype, memoryview(message.data), 0, strides)
    return pixels[:, :, 0] if layout.channels == 1 else pixels


def _from_planes(message: Image | ImageView, layout: PlanarLayout) -> npt.NDArray[np.uint8]:
    """Return an image of planes as BGR."""
    width, height, step = message.width, message.height, message.step
    if min(height, width) == 0:
        raise ImageSizeError(f"image of {width}x{height} pixels is empty")
    if layout.is_subsampled and (width % 2 or height % 2):
        raise ImageSizeError(
            f"image of {width}x{height} pixels can't be {message.encoding}: it has a colour for "
            "every two by two, so that both must be even"
        )
    if step < width:
        raise ImageDataError(
            f"image step {step} is too short: {width} pixels of {message.encoding} are {width} "
            "bytes of luma"
        )
    if len(message.data) == layout.size(width, height, width):
        step = width  # some count the chroma's bytes in
    needed = layout.size(width, height, step)
    if len(message.data) < needed:
        raise ImageDataError(
            f"image data is too short: {width}x{height} {message.encoding} with step {step} "
            f"needs {needed} bytes, not {len(message.data)}"
        )
    return layout.to_bgr(np.frombuffer(message.data, np.uint8), width, height, step)


def _as_float(image: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    with np.errstate(over="ignore"):  # infinite then, which the tone map takes
        return image.astype(np.float32)


def _check_size(message: Image | ImageView, layout: _Layout) -> None:
    size = f"image of {message.width}x{message.height} pixels"
    if min(message.height, message.width) == 0:
        raise ImageSizeError(f"{size} is empty")
    if min(message.height, message.width) < layout.minimum or message.width % layout.columns:
        raise ImageSizeError(f"{size} can't be {message.encoding}")


def _native(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the array in this machine's byte order, its rows where their type may lie."""
    whole_steps = pixels.strides[0] % pixels.itemsize == 0
    return pixels.astype(pixels.dtype.newbyteorder("="), copy=not whole_steps)


def _decoded(
    message: CompressedImage | CompressedImageView, enough: float = math.inf
) -> tuple[npt.NDArray[Any], tuple[int, int]]:
    """Return a compressed image, in part where that is enough, and the rows and columns it has."""
    data = np.frombuffer(memoryview(message.data), np.uint8)
    what = f"compressed image (format {reprlib.repr(message.format)}, {data.size} bytes)"
    if _VIDEO.search(message.format.partition(";")[0]):
        raise UnknownEncodingError(
            f"{what} is a packet of video; make images of it with 'ros2 run image_transport "
            "republish --ros-args -p in_transport:=... -p out_transport:=raw', or record it: "
            "turbseg_replay reads video"
        )
    if "compressedDepth" in message.format or is_png(data[_DEPTH_HEAD.size :]):
        depth = _depth(data, message.format, what)
        return depth, (depth.shape[0], depth.shape[1])
    return _picture(data, what, enough)


def _depth(data: npt.NDArray[np.uint8], image_format: str, what: str) -> npt.NDArray[Any]:
    """Decode what compressed_depth_image_transport publishes: 16 bits, or floats in metres."""
    content = data[_DEPTH_HEAD.size :]
    if not is_png(content):
        raise UnknownEncodingError(
            f"{what} is no PNG behind its head; make images of it with 'ros2 run image_transport "
            "republish --ros-args -p in_transport:=compressedDepth -p out_transport:=raw'"
        )
    stored, _ = _picture(content, what)
    if not image_format.startswith("32FC1"):
        return stored
    _, quantisation, offset = _DEPTH_HEAD.unpack(data[: _DEPTH_HEAD.size].tobytes())
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = np.float32(quantisation) / (stored.astype(np.float32) - np.float32(offset))
    return np.where(stored == 0, np.float32(np.nan), depth)


def _picture(
    data: npt.NDArray[np.uint8], what: str, enough: float = math.inf
) -> tuple[npt.NDArray[Any], tuple[int, int]]:
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image, shape = decoded_in_part(data, flags, enough)
    except PictureError as error:
        reason = f": {error}" if str(error) else ""
        raise ImageDataError(f"{what} can't be decoded{reason}") from error
    if image.ndim == 3 and image.shape[2] == 4:  # 16-bit PNG keeps its alpha
        image = cv2.cvtColor(image, cv2.COLOR_BGRA2BGR)
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise UnknownEncodingError(f"{what} holds {image.dtype}, which is not supported")
    return image, shape
