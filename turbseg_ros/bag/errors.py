"""What a user of bags can meet."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from turbseg_ros.one_line import printable

# What a name from a bag may take up of an error's text.
_MAX_LENGTH = 1000


class BagError(Exception):
    """A bag that can't be read or written; the text is one line: which, why, what to do.

    Names in it may come from the bag: what a terminal would obey is written out.
    """

    def __init__(self, text: str) -> None:
        super().__init__(printable(text, _MAX_LENGTH))


class ClipError(BagError):
    """Video or images that can't be made a bag; the text is one line: which, why, what to do."""


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Make what the operating system refuses a `BagError` that names the file, or else `path`."""
    try:
        yield
    except OSError as error:
        raise BagError(f"{error.filename or path}: {error.strerror or error}") from error
