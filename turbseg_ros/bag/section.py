"""A part of a recording, as it is asked for on a command line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Section:
    """From `start` on, in seconds from the recording's first message, for `duration` seconds.

    Without a duration it goes on to the end.
    """

    start: float = 0.0
    duration: float | None = None

    def bounds(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return its first and its last nanosecond in a recording that has these.

        The last is before `start_ns` where the recording is over when the section begins.
        """
        first = start_ns + round(self.start * 1e9)
        if first > end_ns:
            return first, start_ns - 1
        if self.duration is None:
            return first, end_ns
        return first, min(end_ns, first + max(round(self.duration * 1e9) - 1, 0))


WHOLE = Section()
"""All of a recording."""
