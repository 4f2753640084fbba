"""Runs at work: one after another in this process, side by side in others, or on a Dask cluster.

Dask is imported only when its scheduler is asked for.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2

from turbseg_ros.bag.errors import BagError
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation.evaluate import EvaluationError
from turbseg_ros.evaluation.run import Progress, Run, RunResult
from turbseg_ros.parameters import ParameterError
from turbseg_ros.worker_pool import WorkerPool

if TYPE_CHECKING:
    from concurrent.futures import Future as PoolFuture

    from distributed import Client, Future

_LOGGER = logging.getLogger(__name__)
_CONNECT_SECONDS = 10.0


class ClusterError(Exception):
    """A cluster that can't be had; the text says why and what to do."""


@dataclass(frozen=True)
class Failure:
    """A run that came to nothing; `reason` is one line, for people."""

    reason: str


Outcome = RunResult | Failure
Runner = Callable[[Sequence[Run]], Iterator[Outcome]]
"""Runs runs and gives what came of each, in their order."""


def run_here(runs: Sequence[Run], progress: Callable[[Run], Progress]) -> Iterator[Outcome]:
    """Run runs one after another; `progress` gives what follows the frames of each."""
    for run in runs:
        yield _outcome(run, progress(run))


def run_beside(pool: WorkerPool, runs: Sequence[Run]) -> Iterator[Outcome]:
    """Run runs in the processes of a pool; one that dies costs the run that it had."""
    for run, future in zip(runs, pool.run(_run_as_worker, runs), strict=True):
        yield _fetched(run, future)


def run_on(client: Client, runs: Sequence[Run]) -> Iterator[Outcome]:
    """Run runs on a Dask cluster; bags must be found there under the same paths."""
    futures = deque(client.map(_run_as_worker, runs, pure=False, batch_size=1))
    for run in runs:
        # Once nobody holds a future, the cluster forgets its result, whose pictures are large.
        yield _fetched(run, futures.popleft())


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


def _run_as_worker(run: Run) -> Outcome:
    # Its other cores have workers of their own.
    cv2.setNumThreads(1)
    return _outcome(run, iter)


def _outcome(run: Run, progress: Progress) -> Outcome:
    try:
        return run.run(progress)
    except (BagError, EvaluationError, ParameterError) as error:
        return Failure(str(error))
    except Exception as error:
        return _unforeseen(run, error)


def _fetched(run: Run, future: Future[Outcome] | PoolFuture[Outcome]) -> Outcome:
    try:
        return future.result()
    except BrokenProcessPool:
        reason = "the process that ran it died, as for want of memory"
        return Failure(f"{run.source.name}: {run.method.name}: {reason}")
    except Exception as error:  # a worker that died, or could not even start on the run
        return _unforeseen(run, error)


def _unforeseen(run: Run, error: Exception) -> Failure:
    _LOGGER.error("%s could not be evaluated", run.title, exc_info=error)
    return Failure(f"{run.source.name}: {type(error).__name__}: {error}")
