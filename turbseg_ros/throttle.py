"""Logging of what may happen on every image."""

from __future__ import annotations

import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable
from typing import Any

_PERIOD = 5.0


class ThrottledLogger:
    """Logs each kind of thing at once and then at most `burst` times in `period` s, with a count.

    rclpy throttles each line of code instead, so that of two faults which one line reports the
    first would silence the second. Any thread may log.
    """

    def __init__(
        self,
        logger: Any,
        period: float = _PERIOD,
        clock: Callable[[], float] = time.monotonic,
        burst: int = 1,
    ) -> None:
        self._logger = logger
        self._period = period
        self._clock = clock
        self._lock = threading.Lock()
        # When each kind was logged in its running period, which begins with the first time.
        self._times: defaultdict[Hashable, list[float]] = defaultdict(list)
        self._burst = burst
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

    def catch_up(self, kind: Hashable, text: str) -> None:
        """Log at level INFO how many of a kind were left out, once it may be logged again."""
        with self._lock:
            if not self._unsaid[kind] or not self._may_log(kind):
                return
            unsaid = self._unsaid.pop(kind)
        self._logger.info(f"{text}: {unsaid}")

    def _due(self, kind: Hashable, text: str) -> str | None:
        with self._lock:
            if not self._may_log(kind):
                self._unsaid[kind] += 1
                return None
            unsaid = self._unsaid.pop(kind, 0)
        return f"{text} ({unsaid} more like it before)" if unsaid else text

    def _may_log(self, kind: Hashable) -> bool:
        """Whether something of a kind may be logged now, which it is then taken to be."""
        now, times = self._clock(), self._times[kind]
        if times and now - times[0] >= self._period:
            times.clear()
        if len(times) == self._burst:
            return False
        times.append(now)
        return True
