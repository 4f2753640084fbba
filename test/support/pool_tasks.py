"""Tasks for worker processes, which find them by this module's name."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def square(number: int) -> int:
    """Return the square; of 0 late, and die at a negative number."""
    if number < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 0:
        time.sleep(0.5)
    if number == 13:
        raise ValueError("unlucky")
    return number * number


def interrupts_are_held_back(_: object) -> bool:
    """Whether the process keeps SIGINT from itself."""
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def stay(mark: Path) -> None:
    """Leave the process's id in a file, and never end."""
    mark.with_suffix(".part").write_text(str(os.getpid()))
    mark.with_suffix(".part").rename(mark)
    while True:
        time.sleep(1)
