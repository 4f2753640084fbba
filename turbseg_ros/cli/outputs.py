"""Outputs that can't be written are refused before the work, not after it."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from turbseg_ros.cli.errors import UsageError
from turbseg_ros.overlay import PictureError, check_picture_name


def check_file(path: Path) -> None:
    """Make the folder of a file to be written, and see that it takes one.

    :raises UsageError: when the file could not be written.
    """
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file")
    check_folder(path.parent)


def check_picture(path: Path) -> None:
    """See that a picture can be written under a name, as `check_file` does.

    :raises UsageError: when it could not be, or its name tells no format.
    """
    try:
        check_picture_name(path)
    except PictureError as error:
        raise UsageError(str(error)) from error
    check_file(path)


def check_suffix(path: Path, suffixes: Sequence[str]) -> None:
    """See that a file can be written under a name that ends as one of its kind does.

    :raises UsageError: when it could not be, or ends otherwise.
    """
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: end the name in {' or '.join(suffixes)}")
    check_file(path)


def check_folder(path: Path) -> None:
    """Make a folder that files shall be written into, and see that it takes them.

    :raises UsageError: when they could not be written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path} can't be made: {error.strerror}") from error
    _check_writable(path)


def check_new(path: Path) -> None:
    """See that a bag or folder to be written is not there yet, and can be.

    :raises UsageError: when it exists or could not be written.
    """
    if path.exists() or path.is_symlink():
        raise UsageError(f"{path} exists already; remove it or choose another output")
    nearest = next(parent for parent in path.absolute().parents if parent.exists())
    if not nearest.is_dir():
        raise UsageError(f"{path} can't be made: {nearest} is no folder")
    _check_writable(nearest)


def _check_writable(folder: Path) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{folder} can't be written into: {error.strerror}") from error
