"""Whether anybody wants the node's results."""

from __future__ import annotations

import time
from collections.abc import Callable


class Demand:
    """Tells whether to work for listeners that come and go.

    The work goes on for a while after the last of them has left, for a viewer that is started
    anew, or a bag's recorder, should not find a window that has just been cleared.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last_wanted = clock()

    def renew(self) -> None:
        """Begin as if somebody had listened until now."""
        self._last_wanted = self._clock()

    def lasts(self, listened: bool, patience: float) -> bool:
        """Return whether there is something to work for.

        :param listened: whether somebody listens now.
        :param patience: seconds for which it lasts without a listener; 0: for ever.
        """
        now = self._clock()
        if listened:
            self._last_wanted = now
        return patience == 0.0 or now - self._last_wanted < patience
