"""What `make` does, as it says beforehand."""

from __future__ import annotations

import os
import re
import shutil
import subprocess

import pytest

from support.paths import ROOT

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")

NEEDS_TORCH = re.compile(r'importorskip\(["\']torch')
MAKEFILE = (ROOT / "Makefile").read_text()


def make(*arguments: str) -> str:
    # By itself, also where another make runs the tests, of which it would talk in its output.
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    return subprocess.run(
        ["make", *arguments],
        cwd=ROOT,
        env=alone,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout


def test_tests_and_demonstration_need_no_torch():
    # As on a fresh clone: -B takes nothing for done.
    planned = make("-nB", "test", "demo")
    assert "pip install" in planned and "pytest" in planned
    assert "torch" not in planned and "learning" not in planned


def test_every_test_that_needs_torch_is_run_where_torch_is() -> None:
    files = (ROOT / "test").rglob("test_*.py")
    needing = {path for path in files if NEEDS_TORCH.search(path.read_text())}
    targets = re.findall(r"test/\S+", make("-nB", "test-learning").splitlines()[-1])
    covered = {path for name in targets for path in (ROOT / name, *(ROOT / name).rglob("*"))}
    assert needing
    assert needing <= covered


def test_what_is_large_is_announced_before_it_is_installed():
    planned = make("-nB", "test-learning")
    assert planned.index("GB are downloaded") < planned.index(".[learning]")
    assert planned.index(".[learning]") < planned.index("test/learning")
    elsewhere = make("-nB", "learning", "TORCH_INDEX=https://example.com/cpu")
    assert "--extra-index-url https://example.com/cpu" in elsewhere
    assert "GB are downloaded" not in elsewhere


def test_ci_runs_all_tests_and_the_demonstration():
    steps = re.findall(r"^make (\S+)$", (ROOT / ".ci" / "run").read_text(), re.M)
    assert steps == ["test", "test-learning", "demo"]


def test_help_tells_of_every_target():
    phony = re.search(r"^\.PHONY: (.*)$", MAKEFILE, re.M)
    assert phony is not None
    told = re.findall(r"^  ([a-z-]+): \w", make("help"), re.M)
    assert set(told) == set(phony[1].split())
    assert make() == make("help")
