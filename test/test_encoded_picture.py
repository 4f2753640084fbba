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
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.datasets.images import image_folder
from turbseg_ros.encoded_picture import PictureError, decoded, decoded_in_part, jpeg_shape
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


FLAGS = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
SIDES = st.integers(1, 70)


def soft_picture(rows: int, columns: int, colour: bool) -> npt.NDArray[np.uint8]:
    shape = (rows, columns, 3) if colour else (rows, columns)
    noise = np.random.default_rng(rows).integers(0, 255, shape, np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, None, 4.0))


def encoded(picture: npt.NDArray[np.uint8], *options: int) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.imencode(".jpg", picture, options)[1]).ravel()


@settings(max_examples=60, deadline=None)
@given(SIDES, SIDES, st.booleans(), st.booleans(), st.integers(1, 100))
def test_a_jpeg_tells_its_size(
    rows: int, columns: int, colour: bool, progressive: bool, quality: int
) -> None:
    options = (
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_PROGRESSIVE,
        int(progressive),
        cv2.IMWRITE_JPEG_RST_INTERVAL,
        3,
    )
    data = encoded(soft_picture(rows, columns, colour), *options)
    assert jpeg_shape(data) == (rows, columns)
    filled = np.concatenate([data[:2], np.full(3, 0xFF, np.uint8), data[2:]])
    assert jpeg_shape(filled) == (rows, columns)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60), st.integers(0, 400))
def test_what_is_no_jpeg_or_a_damaged_one_never_fails_to_be_told(content: bytes, at: int) -> None:
    sound = encoded(soft_picture(40, 60, True)).tobytes()
    for data in (b"\xff\xd8" + content, sound[:at] + content + sound[at:], sound[:at]):
        shape = jpeg_shape(np.frombuffer(data, np.uint8))
        assert shape is None or min(shape) > 0


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize(
    ("enough", "part"), [(96 * 160, 1), (96 * 160 / 4, 2), (500.0, 4), (1.0, 8)]
)
def test_a_jpeg_is_decoded_in_the_smallest_part_that_is_enough(
    colour: bool, enough: float, part: int
) -> None:
    picture = soft_picture(96, 160, colour)
    found, shape = decoded_in_part(encoded(picture), FLAGS, enough)
    assert shape == (96, 160)
    assert found.ndim == picture.ndim
    expected = cv2.resize(picture, (160 // part, 96 // part), interpolation=cv2.INTER_AREA)
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < 4


def test_an_odd_size_is_rounded_up_as_the_decoder_does() -> None:
    found, shape = decoded_in_part(encoded(soft_picture(33, 51, True)), FLAGS, 17.0 * 26.0 / 2)
    assert (found.shape[:2], shape) == ((17, 26), (33, 51))


def test_what_is_no_jpeg_is_decoded_in_full() -> None:
    picture = soft_picture(33, 51, True)
    data = np.asarray(cv2.imencode(".png", picture)[1]).ravel()
    found, shape = decoded_in_part(data, FLAGS, 1.0)
    np.testing.assert_array_equal(found, picture)
    assert shape == (33, 51)


def test_a_jpeg_that_is_cut_to_its_head_is_refused_in_part_too() -> None:
    data = encoded(soft_picture(96, 160, True))[:200]
    with pytest.raises(PictureError):
        decoded_in_part(data, FLAGS, 1.0)
