from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
import weakref
from collections.abc import Sequence

import pytest

from turbseg_ros.bag.errors import BagError
from turbseg_ros.cli.errors import Interrupted, UsageError, executable
from turbseg_ros.parameters import ParameterError

TIME_LIMIT = 20


def failing(error: BaseException):
    @executable("turbseg_test")
    def main(arguments=None) -> int:
        raise error

    return main


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (BagError("no such bag: x"), "turbseg_test: no such bag: x\n"),
        (ParameterError("unknown parameter y"), "turbseg_test: unknown parameter y\n"),
        (UsageError("first\n  second"), "turbseg_test: first second\n"),
        (PermissionError(13, "Permission denied", "z"), "turbseg_test: z: Permission denied\n"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_2(capsys, error, line):
    assert failing(error)([]) == 2
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError("no file behind it")])
def test_a_programmers_mistake_stays_an_exception(error):
    with pytest.raises(type(error)):
        failing(error)([])


def test_arguments_and_status_pass_through():
    @executable("turbseg_test")
    def main(arguments=None) -> int:
        return len(arguments)

    assert main(["a", "b", "c"]) == 3


def test_signals_are_handled_only_meanwhile():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    failing(BagError("x"))([])
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def start(body: str) -> subprocess.Popen[str]:
    program = textwrap.dedent(
        """
        import sys, time
        from turbseg_ros.cli.errors import executable

        @executable("turbseg_test")
        def main(arguments=None):
        """
    ) + textwrap.indent(textwrap.dedent(body) + "\nreturn 0", "    ")
    return subprocess.Popen(
        [sys.executable, "-c", program + "\nsys.exit(main())"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_lets_the_program_clean_up_undisturbed(number):
    process = start(
        """
        try:
            print("started", flush=True)
            time.sleep(30)
        finally:
            print("cleaning", flush=True)
            time.sleep(0.5)
            print("clean", flush=True)
        """
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "started\n"
        process.send_signal(number)
        assert process.stdout.readline() == "cleaning\n"
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=TIME_LIMIT)
    finally:
        process.kill()
    assert (output, errors, process.returncode) == ("clean\n", "", 128 + number)


def test_a_reader_that_goes_away_is_no_traceback():
    process = start('for i in range(10**6): print("line", i)')
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        process.stdout.readline()
        process.stdout.close()
        errors = process.stderr.read()
        status = process.wait(timeout=TIME_LIMIT)
    finally:
        process.kill()
    assert (errors, status) == ("", 128 + signal.SIGPIPE)


@pytest.mark.parametrize("seconds", [0.0, 0.01])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_that_python_lost_comes_again(
    number: signal.Signals, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # At once means on a busy machine: while it is being looked at that it was lost.
    monkeypatch.setattr("turbseg_ros.cli.errors._REPEAT_SECONDS", seconds)

    class Thing:
        pass

    @executable("turbseg_test")
    def main(arguments: Sequence[str] | None = None) -> int:
        thing = Thing()
        # An exception in here reaches nobody.
        watched = weakref.ref(thing, lambda _: signal.raise_signal(number))
        del thing
        until = time.monotonic() + 20
        while time.monotonic() < until:
            time.sleep(0.01)
        return 0 if watched() is None else 1

    with pytest.raises(Interrupted) as ended:
        main([])
    assert ended.value.code == 128 + number
