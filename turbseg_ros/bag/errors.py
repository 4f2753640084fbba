"""What a user of bags can meet."""

from __future__ import annotations


class BagError(Exception):
    """A bag that can't be read or written; the text is one line: which, why, what to do."""


class ClipError(BagError):
    """Video or images that can't be made a bag; the text is one line: which, why, what to do."""
