"""Where things lie in the repository."""

from __future__ import annotations

from pathlib import Path

SUPPORT = Path(__file__).parent
ROOT = SUPPORT.parents[1]
BAGS = ROOT / "bags"
CONFIG = ROOT / "config"
