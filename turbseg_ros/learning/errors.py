"""What goes wrong when a network is asked for."""

from __future__ import annotations

from turbseg_ros.parameters import ParameterError


class NetworkError(ParameterError):
    """A network that was chosen and can't be had; the text is one line: what, and how to mend."""
