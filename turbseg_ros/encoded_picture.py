"""Pictures in the formats that OpenCV reads, decoded within the memory that they are worth."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# A PNG is its signature and chunks: length, kind, so many bytes of data, checksum.
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK_FRAME = 12
# A JPEG is segments, each with a marker and, in most, a length: that of a picture's frame holds
# its precision, rows and columns (ITU-T T.81, B.2.2).
_JPEG_START, _JPEG_SCAN = b"\xff\xd8", 0xDA
_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_JPEG_BARE = {0x01, *range(0xD0, 0xD9)}
_JPEG_FRAME = struct.Struct(">HH")
# OpenCV's flags by the part of a JPEG's sides that is decoded.
_REDUCED = {
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
}


class PictureError(ValueError):
    """Bytes that are no picture which can be decoded; the text is one line saying why, or empty.

    OpenCV doesn't always say.
    """


def decoded(data: npt.NDArray[np.uint8], flags: int) -> npt.NDArray[Any]:
    """Return the picture that a vector of bytes holds, HxW or HxWxC (BGR or BGRA).

    Pictures of more pixels than `OPENCV_IO_MAX_IMAGE_PIXELS` are refused before memory is taken
    for them, and so is a PNG that ends within a chunk.

    :param flags: OpenCV's of imdecode.
    :raises PictureError: when it is none.
    """
    if _is_cut_png(data):
        raise PictureError("it ends within a chunk")
    try:
        picture: npt.NDArray[Any] | None = cv2.imdecode(data, flags) if data.size else None
    except cv2.error as error:
        raise PictureError(" ".join(str(error.err).split())) from error
    if picture is None:
        raise PictureError("")
    return picture


def decoded_in_part(
    data: npt.NDArray[np.uint8], flags: int, enough: float
) -> tuple[npt.NDArray[Any], tuple[int, int]]:
    """Return the picture that a vector of bytes holds, and the rows and columns that it has.

    A JPEG of many more pixels than are `enough` is decoded at a half, a quarter or an eighth of
    its sides, which takes less time: coefficients of fine detail are left out.

    :param flags: OpenCV's of imdecode; none that asks for BGR from grey pictures.
    :raises PictureError: when it is none.
    """
    shape = jpeg_shape(data)
    if shape is not None:
        for part, flag in _REDUCED.items():
            reduced = (-(-shape[0] // part), -(-shape[1] // part))
            if shape[0] * shape[1] >= enough * part**2:
                picture = decoded(data, flags | flag)
                # A head that is damaged may say otherwise than what follows it.
                if picture.shape[:2] == reduced:
                    return picture, shape
                break
    picture = decoded(data, flags)
    return picture, (picture.shape[0], picture.shape[1])


def jpeg_shape(data: npt.NDArray[np.uint8]) -> tuple[int, int] | None:
    """Return the rows and columns that a JPEG's head tells, None where it is none that tells."""
    if data[:2].tobytes() != _JPEG_START:
        return None
    position = len(_JPEG_START)
    while position + 4 + _JPEG_FRAME.size < data.size:
        if data[position] != 0xFF:
            return None
        marker = int(data[position + 1])
        if marker == 0xFF:  # a fill byte
            position += 1
        elif marker in _JPEG_BARE:
            position += 2
        elif marker in _JPEG_FRAMES:
            rows, columns = _JPEG_FRAME.unpack_from(data.data, position + 5)
            return (rows, columns) if rows and columns else None
        elif marker == _JPEG_SCAN:
            return None
        else:
            position += 2 + max(int.from_bytes(data[position + 2 : position + 4], "big"), 2)
    return None


def is_png(data: npt.NDArray[np.uint8]) -> bool:
    """Whether bytes begin as a PNG does."""
    return data[: len(_PNG_SIGNATURE)].tobytes() == _PNG_SIGNATURE


def _is_cut_png(data: npt.NDArray[np.uint8]) -> bool:
    """Whether a PNG states more data than it has: OpenCV takes memory for all it states."""
    if not is_png(data):
        return False
    position = len(_PNG_SIGNATURE)
    while position < data.size:
        head = data[position : position + 8].tobytes()
        length, kind = head[:4], head[4:]
        position += _PNG_CHUNK_FRAME + int.from_bytes(length, "big")
        if kind == b"IEND":
            break
    return position > data.size
