"""Runs at work: one after another in this process, or side by side on a Dask cluster.

Dask is imported only when a cluster is asked for.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import signal
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2

from turbseg_ros.bag.errors import BagError
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation.evaluate import EvaluationError
from turbseg_ros.evaluation.run import Progress, Run, RunResult
from turbseg_ros.parameters import ParameterError

if TYPE_CHECKING:
    from distributed import Client, Future

_LOGGER = logging.getLogger(__name__)
_CONNECT_SECONDS = 10.0
# A worker gets one run at a time, for if it dies, all that it has got count as its murderers;
# and what killed two of them doesn't get a third.
_LOCAL_CONFIGURATION = {
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.allowed-failures": 1,
}


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


def run_on(client: Client, runs: Sequence[Run]) -> Iterator[Outcome]:
    """Run runs on a Dask cluster; bags must be found there under the same paths."""
    futures = deque(client.map(_run_as_worker, runs, pure=False, batch_size=1))
    for run in runs:
        # Once nobody holds a future, the cluster forgets its result, whose pictures are large.
        yield _fetched(run, futures.popleft())


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start worker processes on this machine, of one thread each, for as long as they are needed.

    :raises ClusterError: when Dask is not installed.
    """
    distributed = _distributed()
    with (
        importlib.import_module("dask").config.set(_LOCAL_CONFIGURATION),
        tempfile.TemporaryDirectory(prefix="turbseg_workers_") as scratch,
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            local_directory=scratch,
            silence_logs=logging.ERROR,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.run(_leave_interrupts_to_the_parent)
        yield client


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


def _leave_interrupts_to_the_parent() -> None:
    # A Ctrl-C goes to all processes at a terminal; the one that the user started ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_as_worker(run: Run) -> Outcome:
    # The processor's cores are shared out among the workers already.
    cv2.setNumThreads(1)
    return _outcome(run, iter)


def _outcome(run: Run, progress: Progress) -> Outcome:
    try:
        return run.run(progress)
    except (BagError, EvaluationError, ParameterError) as error:
        return Failure(str(error))
    except Exception as error:
        return _unforeseen(run, error)


def _fetched(run: Run, future: Future[Outcome]) -> Outcome:
    try:
        return future.result()
    except Exception as error:  # a worker that died, or could not even start on the run
        return _unforeseen(run, error)


def _unforeseen(run: Run, error: Exception) -> Failure:
    _LOGGER.error("%s could not be evaluated", run.title, exc_info=error)
    return Failure(f"{run.source.name}: {type(error).__name__}: {error}")
