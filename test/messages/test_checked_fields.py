"""Messages once more, with rclpy's checks of every value that is given to a field.

Without them, as nodes run, a wrong type is taken for another one's memory and nothing is said.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from support.paths import ROOT

BUILDERS = [
    "test/messages/test_results.py",
    "test/messages/test_images.py",
    "test/messages/test_cdr.py",
    "test/nodes/test_diagnostics.py",
    "test/nodes/test_publishers.py",
    "test/nodes/test_player.py",
]


@pytest.mark.timeout(600)
@pytest.mark.parametrize("tests", BUILDERS)
def test_all_that_is_given_to_messages_is_of_the_fields_types(tests: str) -> None:
    quietly = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    # One that hangs is ended, and so told by its name, before all are.
    finished = subprocess.run(
        [sys.executable, "-m", "pytest", *quietly, "--timeout", "100", tests],
        cwd=ROOT,
        env={**os.environ, "ROS_PYTHON_CHECK_FIELDS": "1"},
        capture_output=True,
        text=True,
        timeout=580,
    )
    assert finished.returncode == 0, finished.stdout
