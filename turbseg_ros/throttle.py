"""Logging of what may happen on every image."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Hashable
from typing import Any

_PERIOD = 5.0


class ThrottledLogger:
    """Logs each kind of thing at once and then at most every `period` seconds, with a count.

    rclpy throttles each line of code instead, so that of two faults which one line reports the
    first would silence the second. Any thread may log.
    """

    def __init__(
        self, logger: Any, period: float = _PERIOD, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._logger = logger
        self._period = period
        self._clock = clock
        self._lock = threading.Lock()
        self._last: dict[Hashable, float] = {}
        self._unsaid: Counter[Hashable] = Counter()

    def info(self, kind: Hashable, text: str) -> None:
        """Log at level INFO, unless this kind was logged a moment ago."""
        if (due := self._due(kind, text)) is not None:
            self._logger.info(due)

    def warning(self, kind: Hashable, text: str) -> None:
        """Log at level WARN, unless this kind was logged a moment ago."""
        if (due := self._due(kind, text)) is not None:
            self._logger.warning(due)

    def error(self, kind: Hashable, text: str) -> None:
        """Log at level ERROR, unless this kind was logged a moment ago."""
        if (due := self._due(kind, text)) is not None:
            self._logger.error(due)

    def _due(self, kind: Hashable, text: str) -> str | None:
        with self._lock:
            now = self._clock()
            last = self._last.get(kind)
            if last is not None and now - last < self._period:
                self._unsaid[kind] += 1
                return None
            self._last[kind] = now
            unsaid = self._unsaid.pop(kind, 0)
        return f"{text} ({unsaid} more like it before)" if unsaid else text
