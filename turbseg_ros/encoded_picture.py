"""Pictures in the formats that OpenCV reads, decoded within the memory that they are worth."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# A PNG is its signature and chunks: length, kind, so many bytes of data, checksum.
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK_FRAME = 12


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
