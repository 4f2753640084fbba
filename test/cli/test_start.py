"""How executables start: by name, and deaf to nobody's Ctrl-C while their modules load."""

from __future__ import annotations

import re
import signal
import subprocess
import sys

import pytest

TIME_LIMIT = 30

# Runs an executable that gets a SIGINT at the very moment when it begins to load a module.
INTERRUPTED_START = """
import os, signal, sys
from turbseg_ros.cli import __main__ as executables

name, moment = sys.argv[1:]
sys.argv[1:] = []

def interrupt(event, details):
    if event == "import" and details[0] == moment:
        os.kill(os.getpid(), signal.SIGINT)

sys.addaudithook(interrupt)
sys.exit(getattr(executables, name)())
"""


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        check=False,
    )


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("replay", "turbseg_ros.parameters"),
        ("replay", "numpy"),
        ("replay", "cv2"),
        ("replay", "rclpy"),
        ("replay", "turbseg_ros.segmentation.pipeline"),
        ("evaluate", "numpy"),
        ("simulate", "numpy"),
        ("import_", "numpy"),
        ("demo", "numpy"),
        ("play", "rclpy"),
    ],
)
def test_an_interrupt_while_modules_load_ends_the_process_in_silence(name, moment):
    process = run("-c", INTERRUPTED_START, name, moment)
    assert (process.stdout, process.stderr) == ("", "")
    assert process.returncode == -signal.SIGINT


@pytest.mark.parametrize(
    "name",
    [
        "node",
        "play",
        "replay",
        "evaluate",
        "simulate",
        "import",
        "benchmark",
        "demo",
        "view",
        "record",
    ],
)
def test_every_executable_starts_by_its_name(name):
    process = run("-m", "turbseg_ros.cli", name, "--help")
    assert process.returncode == 0, process.stderr
    assert process.stdout.startswith("usage: ")
    assert name in process.stdout.splitlines()[0]


@pytest.mark.parametrize("name", ["replay", "evaluate", "simulate", "benchmark", "train"])
def test_help_tells_of_all_options_before_it_lists_the_parameters(name: str) -> None:
    told = run("-m", "turbseg_ros.cli", name, "--help").stdout
    options, _, parameters = told.partition("\nparameter names:\n")
    assert "flow.interval" not in options
    if parameters:
        assert not re.search(r"^  -", parameters, re.M)
    assert re.search(r"^  -", options, re.M)


@pytest.mark.parametrize("arguments", [[], ["nonsense"]])
def test_an_unknown_name_is_answered_with_those_there_are(arguments):
    process = run("-m", "turbseg_ros.cli", *arguments)
    assert process.returncode == 2
    assert process.stderr.count("\n") == 1
    assert "{node,play,replay," in process.stderr
