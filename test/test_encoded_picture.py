"""Pictures that take no more memory than they are worth, wherever they come from."""

from __future__ import annotations

import resource
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.datasets.images import image_folder
from turbseg_ros.encoded_picture import PictureError, decoded
from turbseg_ros.parameters import ParameterError
from turbseg_ros.region_file import mask_picture

SOUND = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5


def png(width: int, height: int, stated: int | None = None) -> bytes:
    """Return a black PNG, which may state that its data are `stated` bytes."""

    def chunk(kind: bytes, data: bytes, length: int | None = None) -> bytes:
        length = len(data) if length is None else length
        return struct.pack(">I", length) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pixels = zlib.compress(bytes((width + 1) * height))
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", pixels, stated), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


BOMBS = {
    "chunk of 4 GB": png(8, 6, stated=2**32 - 1),
    "cut": bytes(cv2.imencode(".png", SOUND)[1])[:-20],
}


def bytes_taken() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_what_states_more_than_it_has_is_refused_everywhere(tmp_path: Path, bomb: bytes) -> None:
    before = bytes_taken()
    with pytest.raises(PictureError):
        decoded(np.frombuffer(bomb, np.uint8), cv2.IMREAD_GRAYSCALE)
    with pytest.raises(ParameterError, match=r"^m: not a picture .*polygons are named"):
        mask_picture(bomb, "m")
    (tmp_path / "0.png").write_bytes(bomb)
    with pytest.raises(ClipError, match=r"0\.png is not an image that can be read: "):
        list(image_folder(tmp_path))
    assert bytes_taken() - before < 2**29


def test_a_mask_of_more_pixels_than_images_may_have_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mask.png"
    file.write_bytes(png(2**14, 2**13 + 1))
    # In a process of its own: OpenCV learns the limit when it is loaded.
    program = (
        "import sys, pathlib; from turbseg_ros.region_file import mask_picture; "
        "mask_picture(pathlib.Path(sys.argv[1]).read_bytes(), 'm')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, file], capture_output=True, text=True, check=False
    )
    assert "m: not a picture (pixels" in done.stderr


def test_a_sound_picture_is_decoded() -> None:
    _, encoded = cv2.imencode(".png", SOUND)
    np.testing.assert_array_equal(decoded(encoded, cv2.IMREAD_UNCHANGED), SOUND)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"regions: []"])
def test_what_is_no_picture_is_refused(content: bytes) -> None:
    with pytest.raises(PictureError):
        decoded(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
