"""Worker processes: what comes back and in which order, and what the death of one costs."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from support.pool_tasks import interrupts_are_held_back, square, stay
from turbseg_ros.worker_pool import WorkerPool

# Processes start slowly on a busy machine.
pytestmark = pytest.mark.timeout(240)
TIMEOUT = 100.0
# Seconds after which an interruption that went unheard is repeated.
AGAIN = 5.0


def test_results_come_in_the_order_of_the_items() -> None:
    with WorkerPool(2) as pool:
        assert [future.result() for future in pool.run(square, range(6))] == [0, 1, 4, 9, 16, 25]
        assert [future.result() for future in pool.run(square, [7])] == [49]


def test_a_worker_that_dies_costs_its_task_only() -> None:
    with WorkerPool(2) as pool:
        futures = list(pool.run(square, [0, -1, 2, -3, 13, 5, 6]))
    errors = [type(future.exception()) for future in futures]
    fine = type(None)
    assert errors == [fine, BrokenProcessPool, fine, BrokenProcessPool, ValueError, fine, fine]
    assert [futures[number].result() for number in (0, 2, 5, 6)] == [0, 4, 25, 36]


def test_interrupts_from_the_terminal_do_not_reach_workers() -> None:
    with WorkerPool(1) as pool:
        assert [each.result() for each in pool.run(interrupts_are_held_back, [0])] == [True]


@pytest.mark.parametrize("answers", [True, False])
def test_an_exception_ends_workers_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: bool
) -> None:
    if not answers:
        # As on a busy machine, where workers are at work before their first answers are read.
        monkeypatch.setattr(Future, "set_result", lambda self, result: None)
    marks = [tmp_path / name for name in ("one", "two")]
    interrupted = threading.Event()
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    # What is started in the background of a shell ignores it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def wait_for_both() -> None:
        until = time.monotonic() + TIMEOUT
        while not all(mark.exists() for mark in marks) and time.monotonic() < until:
            time.sleep(0.01)
        # Again where the first came when Python lets none through: see cli.errors.
        while not interrupted.is_set():
            signal.pthread_kill(main_thread, signal.SIGINT)
            interrupted.wait(AGAIN)

    waiting = threading.Thread(target=wait_for_both)
    waiting.start()
    with pytest.raises(KeyboardInterrupt), WorkerPool(2) as pool:
        try:
            list(pool.run(stay, marks))
        finally:
            interrupted.set()
    waiting.join()
    for mark in marks:
        with pytest.raises(ProcessLookupError):
            os.kill(int(mark.read_text()), 0)
