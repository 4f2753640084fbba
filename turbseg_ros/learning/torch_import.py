"""Tells in one line that torch is missing, where something was chosen that needs it."""

from __future__ import annotations

import importlib.util

from turbseg_ros.learning.errors import NetworkError


def require_torch(what: str) -> None:
    """Do nothing if torch is installed.

    :param what: what was chosen, as its user would call it.
    :raises NetworkError: when it is not.
    """
    if importlib.util.find_spec("torch") is None:
        raise NetworkError(f"{what} needs torch: pip install 'turbseg_ros[learning]'")
