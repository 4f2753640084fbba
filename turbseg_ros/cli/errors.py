"""How the executables end: what their user did wrong is one line, never a traceback.

This module imports nothing that starts threads: the node has to block signals before.
"""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import CodeType, FrameType
from typing import NoReturn, Protocol, TypeVar

from turbseg_ros.bag.errors import BagError
from turbseg_ros.dependencies import what_is_missing
from turbseg_ros.parameters import ParameterError

_REFUSED = 2  # as argparse ends
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_REPEAT_SECONDS = 0.01

T = TypeVar("T")

SignalHandler = Callable[[int, FrameType | None], object]


class Main(Protocol):
    """What an executable runs."""

    def __call__(self, arguments: Sequence[str] | None = None) -> int:
        """Take arguments, by default the process's own; return the exit status."""


class UsageError(Exception):
    """Something asked for that can't be done; the text is one line: what, and how to mend it."""


class Interrupted(SystemExit):
    """SIGINT or SIGTERM arrived; unless caught, the exit status says which, as a shell's does."""


@contextlib.contextmanager
def signals_answered_by(handler: SignalHandler, numbers: Iterable[int]) -> Iterator[None]:
    """Let `handler` answer some signals for the time of a `with` statement.

    Those that it gave another handler itself keep that one.
    """
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            if signal.getsignal(number) is handler:
                signal.signal(number, earlier)


class StopRequest:
    """Whether SIGINT or SIGTERM asked a long job to end with what it has done so far.

    The job takes its work from `until_stopped`, and tells by `cut` whether some of it is missing.
    """

    def __init__(self) -> None:
        self._received: int | None = None
        self.cut = False

    @property
    def received(self) -> bool:
        """Whether a signal came."""
        return self._received is not None

    @property
    def status(self) -> int:
        """The exit status of a job that was cut, as a shell's; 0 of one that was not."""
        return 128 + self._received if self.cut and self._received is not None else 0

    def note(self, number: int, frame: FrameType | None) -> None:
        """Take note of a signal, as its handler; a second one interrupts what goes on.

        :raises Interrupted: the second time.
        """
        if self._received is not None:
            _interrupt(number, frame)
        self._received = number

    def until_stopped(self, items: Iterable[T]) -> Iterator[T]:
        """Hand items on until a signal comes."""
        for item in items:
            if self._received is not None:
                self.cut = True
                return
            yield item

    def check(self) -> None:
        """Go on unless a signal came: for work of which a part is worth nothing.

        :raises Interrupted: when one came.
        """
        if self._received is not None:
            raise Interrupted(128 + self._received)


@contextlib.contextmanager
def stopping_at_signals(name: str) -> Iterator[StopRequest]:
    """Let the first SIGINT or SIGTERM end a job early, for the time of a `with` statement.

    When it is interrupted all the same, so that nothing of it is kept, the executable `name` says
    so.
    """
    request = StopRequest()
    with signals_answered_by(request.note, _STOP_SIGNALS):
        try:
            yield request
        except Interrupted:
            print(f"{name}: interrupted; nothing of it is kept", file=sys.stderr)
            raise


def interrupted_after(done: int, total: int | None, unit: str = "frames") -> str:
    """Return what marks something partial: how much was done, of how much where that is known."""
    of = "" if total is None else f" of {total}"
    return f"interrupted after {done}{of} {unit}"


def executable(name: str) -> Callable[[Main], Main]:
    """Decorate `main(arguments) -> exit status` of the executable `name`.

    A user's mistake, such as a package that is not installed, becomes one line on standard error
    and exit status 2; SIGINT and SIGTERM unwind the program once, so that `with` and `finally`
    clean up undisturbed.
    """

    def decorate(main: Main) -> Main:
        @functools.wraps(main)
        def run(arguments: Sequence[str] | None = None) -> int:
            with signals_answered_by(_interrupt, _STOP_SIGNALS), _lost_interruptions_repeated():
                try:
                    status = main(arguments)
                    sys.stdout.flush()
                except BrokenPipeError:
                    return _leave_closed_pipe()
                except (BagError, ParameterError, UsageError) as error:
                    return _refuse(name, str(error))
                except ImportError as error:
                    return refuse_without(name, error)
                except OSError as error:
                    if error.filename is None:
                        raise
                    return _refuse(name, f"{error.filename}: {error.strerror}")
                return status

        return run

    return decorate


@contextlib.contextmanager
def _lost_interruptions_repeated() -> Iterator[None]:
    """Interrupt again when the exception was raised where Python lets none through.

    Such places are callbacks of weak references, which thread pools have, and `__del__`.
    """
    before = sys.unraisablehook
    repeats: list[_Repeat] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        # Here, too, the exception would be lost.
        if not _runs(look.__code__, frame):
            repeats[-1].answered = True
            _interrupt(number, frame)

    def look(lost: sys.UnraisableHookArgs) -> None:
        if not isinstance(lost.exc_value, Interrupted):
            before(lost)
            return
        repeats.append(_Repeat(int(lost.exc_value.code or 0) - 128))
        for stop in _STOP_SIGNALS:
            signal.signal(stop, interrupt)
        repeats[-1].start()

    sys.unraisablehook = look
    try:
        yield
    finally:
        sys.unraisablehook = before
        for repeat in repeats:
            repeat.answered = True
            repeat.join()


class _Repeat(threading.Thread):
    """Sends a signal to the process again and again until it was `answered`.

    No lock guards that: the handler that answers may itself be interrupted.
    """

    def __init__(self, number: int) -> None:
        super().__init__(daemon=True)
        self.answered = False
        self._number = number

    def run(self) -> None:
        """Send it, each time a moment later."""
        while not self.answered:
            time.sleep(_REPEAT_SECONDS)
            if not self.answered:
                os.kill(os.getpid(), self._number)


def _runs(code: CodeType, frame: FrameType | None) -> bool:
    """Whether a frame, or one that it was called from, runs a function's code."""
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None


def refuse_without(name: str, error: ImportError) -> int:
    """Say in one line what the executable `name` lacks; return its exit status.

    :raises ImportError: `error`, when it is about nothing that a user would install.
    """
    reason = what_is_missing(error)
    if reason is None:
        raise error
    return _refuse(name, reason)


def _refuse(name: str, reason: str) -> int:
    print(f"{name}: {' '.join(reason.split())}", file=sys.stderr)
    return _REFUSED


def _leave_closed_pipe() -> int:
    """Give up output whose reader has gone, such as `head`, without complaint at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    for stop in _STOP_SIGNALS:
        # A second one must not disturb the cleaning up, until the process has ended.
        signal.signal(stop, signal.SIG_IGN)
    raise Interrupted(128 + number)
