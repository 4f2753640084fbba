"""Jobs at work: one after another in this process, side by side in others, or on a Dask cluster.

Dask is imported only when its scheduler is asked for.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import cv2

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.worker_pool import WorkerPool

if TYPE_CHECKING:
    from concurrent.futures import Future as PoolFuture

    from distributed import Client, Future

_LOGGER = logging.getLogger(__name__)
_CONNECT_SECONDS = 10.0

Progress = Callable[[BagFrames], Iterable[Frame]]
"""Hands the frames of a bag on while it follows, say with a progress bar, how many were taken."""

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class ClusterError(Exception):
    """A cluster that can't be had; the text says why and what to do."""


class Job(Protocol[Result_co]):
    """Work on one bag, which can be sent to another process.

    `foreseen` are the exceptions of a job that comes to nothing whose text is one line for people.
    """

    foreseen: ClassVar[tuple[type[Exception], ...]]

    @property
    def name(self) -> str:
        """The bag's name."""

    @property
    def title(self) -> str:
        """What a progress bar calls it."""

    @property
    def full_name(self) -> str:
        """What tells it from other jobs."""

    def run(self, progress: Progress = iter) -> Result_co:
        """Do the work; return what came of it."""


@dataclass(frozen=True)
class Failure:
    """A job that came to nothing; `reason` is one line, for people."""

    reason: str


Runner = Callable[[Sequence[Job[Result]]], Iterator[Result | Failure]]
"""Does jobs and gives what came of each, in their order."""


@contextlib.contextmanager
def job_runner(
    workers: int, scheduler: str | None, progress: Callable[[Job[Result]], Progress]
) -> Iterator[Runner[Result]]:
    """Return what does jobs: on the cluster of a scheduler, by so many workers, or here.

    :param progress: gives what follows the frames of each job that is done here.
    :raises ClusterError: when the cluster that was asked for can't be had.
    """
    if scheduler is not None:
        with remote_cluster(scheduler) as client:
            yield functools.partial(run_on, client)
    elif workers > 1:
        with WorkerPool(workers) as pool:
            yield functools.partial(run_beside, pool)
    else:
        yield functools.partial(run_here, progress=progress)


def usable_workers() -> int:
    """Return how many processes there is use for: as many as cores that this one may use."""
    return len(os.sched_getaffinity(0))


def run_here(
    jobs: Sequence[Job[Result]], progress: Callable[[Job[Result]], Progress]
) -> Iterator[Result | Failure]:
    """Do jobs one after another; `progress` gives what follows the frames of each."""
    for job in jobs:
        yield _outcome(job, progress(job))


def run_beside(pool: WorkerPool, jobs: Sequence[Job[Result]]) -> Iterator[Result | Failure]:
    """Do jobs in the processes of a pool; one that dies costs the job that it had."""
    work: Callable[[Job[Result]], Result | Failure] = _run_as_worker
    for job, future in zip(jobs, pool.run(work, jobs), strict=True):
        yield _fetched(job, future)


def run_on(client: Client, jobs: Sequence[Job[Result]]) -> Iterator[Result | Failure]:
    """Do jobs on a Dask cluster; bags must be found there under the same paths."""
    futures = deque(client.map(_run_as_worker, jobs, pure=False, batch_size=1))
    for job in jobs:
        # Once nobody holds a future, the cluster forgets its result, whose pictures are large.
        yield _fetched(job, futures.popleft())


@contextlib.contextmanager
def remote_cluster(address: str) -> Iterator[Client]:
    """Use the cluster of a Dask scheduler that runs already.

    :raises ClusterError: when Dask is not installed or nobody answers at the address.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address} ({error})") from error
    with client:
        yield client


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ClusterError(f"Dask is not installed: {how_to_install('distributed')}") from error


def _run_as_worker(job: Job[Result]) -> Result | Failure:
    # Its other cores have workers of their own.
    cv2.setNumThreads(1)
    return _outcome(job, iter)


def _outcome(job: Job[Result], progress: Progress) -> Result | Failure:
    try:
        return job.run(progress)
    except Exception as error:
        if isinstance(error, job.foreseen):
            return Failure(str(error))
        return _unforeseen(job, error)


def _fetched(
    job: Job[Result], future: Future[Result | Failure] | PoolFuture[Result | Failure]
) -> Result | Failure:
    try:
        return future.result()
    except BrokenProcessPool:
        return Failure(f"{job.full_name}: the process that ran it died, as for want of memory")
    except Exception as error:  # a worker that died, or could not even start on the job
        return _unforeseen(job, error)


def _unforeseen(job: Job[Result], error: Exception) -> Failure:
    _LOGGER.error("%s came to nothing", job.title, exc_info=error)
    return Failure(f"{job.name}: {type(error).__name__}: {error}")
