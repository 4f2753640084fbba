"""Recordings that are compressed as a whole, or message by message, as rosbag2 can do it."""

from __future__ import annotations

import bz2
import gzip
import importlib
import logging
import lzma
import shutil
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import zstandard

from turbseg_ros.bag.errors import BagError

_LOGGER = logging.getLogger(__name__)

# Disk space, in bytes, that unpacking leaves to others; and what is unpacked at a time.
_SPARED = 2**30
_PIECE = 2**22
# No message is longer; see `mcap_file`.
_MAX_MESSAGE = 2**30
_DAMAGE = (zstandard.ZstdError, OSError, EOFError, RuntimeError, zlib.error, lzma.LZMAError)


def _zstd(stream: BinaryIO) -> Any:
    return zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)


def _lz4(stream: BinaryIO) -> Any:
    return importlib.import_module("lz4.frame").open(stream)  # of the MCAP library's dependencies


# By what such a file begins with.
_READERS: dict[bytes, Callable[[BinaryIO], Any]] = {
    b"\x28\xb5\x2f\xfd": _zstd,
    b"\x04\x22\x4d\x18": _lz4,
    b"\x1f\x8b": lambda stream: gzip.GzipFile(fileobj=stream),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\0": lzma.LZMAFile,
}


def is_compressed(beginning: bytes) -> bool:
    """Whether a file that begins so is compressed as a whole."""
    return beginning.startswith(tuple(_READERS))


def unpack(path: Path, folder: Path) -> Path:
    """Unpack a compressed file into `folder`; return the file there.

    Of a file that was cut, or is damaged, what comes before is unpacked, with a warning.

    :raises BagError: when there is no room for it.
    :raises OSError: when the file can't be read.
    """
    unpacked = folder / path.stem
    with path.open("rb") as stream, unpacked.open("wb") as out:
        beginning = stream.read(16)
        stream.seek(0)
        source = next(
            reader(stream) for magic, reader in _READERS.items() if beginning.startswith(magic)
        )
        while True:
            if shutil.disk_usage(folder).free < _SPARED:
                raise BagError(
                    f"{path} needs more room than {tempfile.gettempdir()} has to be unpacked; "
                    "set TMPDIR to a folder with more, or unpack it yourself"
                )
            try:
                piece = source.read(_PIECE)
            except _DAMAGE as error:
                _LOGGER.warning("%s is damaged or cut, what comes before is read: %s", path, error)
                break
            if not piece:
                break
            out.write(piece)
    return unpacked


def unpacked_message(data: bytes) -> bytes | None:
    """Return a message that rosbag2 compressed by itself (zstd), None when it is damaged."""
    try:
        stated = zstandard.frame_content_size(data)
        if stated > _MAX_MESSAGE:
            return None
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=_MAX_MESSAGE)
    except (zstandard.ZstdError, MemoryError):
        return None
