"""Where figures come from: when they were made, on which machine, by which code."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from turbseg_ros import __version__

_CPU_INFO = Path("/proc/cpuinfo")
_SOURCE = Path(__file__).parents[2]
_GIT_SECONDS = 10.0


@dataclass(frozen=True)
class Origin:
    """When and where something was made.

    `date` has minutes and the offset from UTC; `cores` are those that this process may use;
    `versions` are those of what takes part, by names; `commit` is that of the source tree, with a
    plus sign where files in it were changed since, None for an installed package.
    """

    date: str
    processor: str
    cores: int
    system: str
    versions: dict[str, str]
    commit: str | None

    @classmethod
    def here_and_now(cls) -> Origin:
        """Return what this process has to say."""
        return cls(
            date=datetime.datetime.now().astimezone().isoformat(" ", "minutes"),
            processor=_processor(),
            cores=len(os.sched_getaffinity(0)),
            system=f"{platform.system()} {platform.machine()}",
            versions={
                "turbseg_ros": __version__,
                "Python": platform.python_version(),
                "OpenCV": cv2.__version__,
                "NumPy": np.__version__,
            },
            commit=source_commit(_SOURCE),
        )


def source_commit(folder: Path) -> str | None:
    """Return the short name of the commit that a folder is the work tree of, None for others."""
    if not (folder / ".git").exists():
        return None
    commit = _git(folder, "rev-parse", "--short=12", "HEAD")
    if not commit:
        return None
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return f"{commit}+" if changed else commit


def _git(folder: Path, *words: str) -> str:
    try:
        run = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True,
            text=True,
            timeout=_GIT_SECONDS,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return run.stdout.strip()


def _processor() -> str:
    """Return the processor's name as Linux has it."""
    try:
        lines = _CPU_INFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()
