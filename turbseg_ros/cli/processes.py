"""Processes that a command starts and leaves none of behind."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from turbseg_ros.cli.errors import Interrupted, signals_answered_by

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Seconds that a process gets to end by itself.
_STOP_LIMIT = 10.0


class ProcessError(Exception):
    """A process that ended too early or badly; the text is one line with its last words."""


class SignalWatch:
    """Takes note of signals that ask to stop, so that they interrupt nothing halfway."""

    def __init__(self) -> None:
        self._received: int | None = None

    def note(self, number: int, frame: FrameType | None) -> None:
        """Take note of a signal, as its handler."""
        self._received = number

    def check(self) -> None:
        """Go on unless a signal came.

        :raises Interrupted: when one came.
        """
        if self._received is not None:
            raise Interrupted(128 + self._received)


@contextlib.contextmanager
def signals_watched() -> Iterator[SignalWatch]:
    """Hold signals back for the time of a `with` statement, in which `check` is called often."""
    progress = SignalWatch()
    with signals_answered_by(progress.note, _STOP_SIGNALS):
        yield progress


@dataclass(frozen=True)
class ChildProcess:
    """A process called `name`; what it prints goes to `log`."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def check(self) -> None:
        """Go on while the process runs or has ended well.

        :raises ProcessError: when it ended badly.
        """
        status = self.process.poll()
        if status:
            printed = self.log.read_text(errors="replace").splitlines()
            last = next((line for line in reversed(printed) if line.strip()), "it printed nothing")
            raise ProcessError(f"{self.name} ended with status {status}: {last}")


def executable_process(
    name: str, arguments: Sequence[str], log: Path
) -> contextlib.AbstractContextManager[ChildProcess]:
    """Run an executable of this package as `child_process`; `name` is without `turbseg_`."""
    command = [sys.executable, "-m", "turbseg_ros.cli", name, *arguments]
    return child_process(f"turbseg_{name}", command, log)


@contextlib.contextmanager
def child_process(name: str, command: Sequence[str], log: Path) -> Iterator[ChildProcess]:
    """Run a command for the time of a `with` statement.

    At its end the process gets SIGINT and, when that doesn't help, SIGKILL. It has a session of
    its own, so that a terminal's Ctrl-C reaches it by this way only. Progress signals meanwhile:
    an exception while the process is being started would leave it behind.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield ChildProcess(name, process, log)
    finally:
        for number in (signal.SIGINT, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_STOP_LIMIT)
