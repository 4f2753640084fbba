"""The one error that a user of bags meets."""

from __future__ import annotations


class BagError(Exception):
    """A bag that can't be read or written; the text is one line: which, why, what to do."""
