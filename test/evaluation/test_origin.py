"""Where figures come from."""

from __future__ import annotations

import datetime
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from turbseg_ros import __version__
from turbseg_ros.evaluation.origin import Origin, source_commit


def test_time_machine_and_versions_are_told() -> None:
    origin = Origin.here_and_now()
    made = datetime.datetime.fromisoformat(origin.date)
    assert made.tzinfo is not None
    assert abs(datetime.datetime.now(made.tzinfo) - made) < datetime.timedelta(minutes=5)
    assert origin.processor and origin.cores >= 1
    assert origin.versions["turbseg_ros"] == __version__
    assert origin.versions["NumPy"] == np.__version__
    assert {"Python", "OpenCV"} < set(origin.versions)


def test_a_commit_is_told_with_a_sign_where_files_were_changed(tmp_path: Path) -> None:
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    assert source_commit(tmp_path) is None

    def git(*words: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@example.com"]
        subprocess.run(["git", "-C", tmp_path, *identity, *words], check=True, timeout=60)

    git("init", "-q")
    assert source_commit(tmp_path) is None
    file = tmp_path / "file"
    file.write_text("one")
    git("add", "file")
    git("commit", "-q", "-m", "first", "--no-gpg-sign")
    commit = source_commit(tmp_path)
    assert commit is not None and commit.isalnum()
    file.write_text("two")
    assert source_commit(tmp_path) == f"{commit}+"
