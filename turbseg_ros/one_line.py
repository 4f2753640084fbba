"""Texts of others in messages of ours: in one line, and nothing that a terminal would obey."""

from __future__ import annotations


def printable(text: str, longest: int) -> str:
    """Return a text as one line of so many characters at most, control characters written out."""
    line = " ".join(text.split())
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line[:longest])
    return shown + "..." * (len(line) > longest)
