"""Tasks side by side in processes, of which any may die without taking the others along."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


class WorkerPool:
    """So many worker processes, which start when they are needed; a context manager.

    Each worker has an executor of its own, and one task at a time. So it is known which task a
    worker died of; another one takes its place. Interrupts from the terminal don't reach workers.
    Leaving the context waits for them, but ends them at once where an exception is the reason.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._idle: list[_Worker] = []
        self._all: list[_Worker] = []

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error_type is not None:
            for worker in self._all:
                worker.terminate()
        for worker in self._all:
            worker.executor.shutdown(cancel_futures=True)

    def run(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Future[Result]]:
        """Call a function with each item; yield what came of each, done, in the items' order.

        Function and items must be picklable. The exception of a task whose worker died is
        `BrokenProcessPool`.
        """
        waiting = deque(enumerate(items))
        running: dict[Future[Result], tuple[int, _Worker]] = {}
        done: dict[int, Future[Result]] = {}
        try:
            for number in range(len(items)):
                while number not in done:
                    while waiting and (worker := self._free_worker()):
                        index, item = waiting.popleft()
                        running[worker.submit(function, item)] = index, worker
                    finished, _ = wait(running, return_when=FIRST_COMPLETED)
                    for future in finished:
                        index, worker = running.pop(future)
                        done[index] = future
                        self._release(worker, future)
                # Dropped here: results, and pictures in them, may be large.
                yield done.pop(number)
        finally:
            # Those that are busy, if nobody wants the rest, take what comes next afterwards.
            self._idle.extend(worker for _, worker in running.values())

    def _free_worker(self) -> _Worker | None:
        if self._idle:
            return self._idle.pop()
        if len(self._all) == self._workers:
            return None
        self._all.append(_Worker())
        return self._all[-1]

    def _release(self, worker: _Worker, future: Future[Result]) -> None:
        if isinstance(future.exception(), BrokenProcessPool):
            self._all.remove(worker)
            worker.executor.shutdown()
        else:
            self._idle.append(worker)


class _Worker:
    """One process."""

    def __init__(self) -> None:
        self.executor = ProcessPoolExecutor(
            1,
            mp_context=multiprocessing.get_context("spawn"),
            # The processor's cores are shared out among the workers already.
            initializer=cv2.setNumThreads,
            initargs=(1,),
        )
        with _interrupts_held_back():
            before = multiprocessing.active_children()
            # Starts the process, which keeps to itself what is held back here.
            self.executor.submit(os.getpid)
            children = multiprocessing.active_children()
            self._process = next((child for child in children if child not in before), None)

    def submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """Let the process call a function."""
        try:
            return self.executor.submit(function, item)
        except BrokenProcessPool as error:
            # It died while it had nothing to do, or could not even start.
            broken: Future[Result] = Future()
            broken.set_exception(error)
            return broken

    def terminate(self) -> None:
        """End the process, whatever it does, unless it has ended before."""
        if self._process is not None:
            self._process.terminate()


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
