"""What is said where a network was chosen that can't be had."""

from __future__ import annotations

import importlib.util

from turbseg_ros.dependencies import how_to_install
from turbseg_ros.parameters import ParameterError


class NetworkError(ParameterError):
    """A network that was chosen and can't be had; the text is one line: what, and how to mend."""


def require_torch(what: str) -> None:
    """Do nothing if torch is installed.

    :param what: what was chosen, as its user would call it.
    :raises NetworkError: when it is not.
    """
    if importlib.util.find_spec("torch") is None:
        raise NetworkError(f"{what} needs torch: {how_to_install('torch')}")
