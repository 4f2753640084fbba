"""Fixtures for what needs ROS running: a domain of one's own, node processes and a probe."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest
from rclpy.context import Context

# It logs for good to what is standard error at the moment: later, that of a single test.
with contextlib.suppress(ImportError):
    importlib.import_module("distributed")

# How long an example takes depends on what else the machine does.
hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")

# Localhost only, and a domain that another run on this machine hardly has too. Set before
# anything starts ROS, and inherited by every process that a test starts.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
# What tests start finds the helpers as they do.
os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, (str(Path(__file__).parent), os.environ.get("PYTHONPATH")))
)


@pytest.fixture(scope="session", autouse=True)
def ros_log_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Keep ROS' log files out of the home directory."""
    directory = tmp_path_factory.mktemp("ros_log")
    os.environ["ROS_LOG_DIR"] = str(directory)
    yield directory


@pytest.fixture(autouse=True)
def signals_answered_as_before() -> Iterator[None]:
    """Undo what a test does to the process' signals: an interrupted executable ignores them."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def context() -> Iterator[Context]:
    """Return a context for nodes within the test's own process."""
    context = Context()
    context.init()
    yield context
    context.try_shutdown()


@pytest.fixture(scope="module")
def one_torch_thread() -> Iterator[None]:
    """Let torch train in one thread.

    Networks and clips of tests are so small that a second one gains nothing. On a busy machine
    OpenMP's threads wait for each other, and training takes many times as long.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
