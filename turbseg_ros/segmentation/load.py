"""What is given up, and in which order, while frames wait to be segmented."""

from __future__ import annotations

from dataclasses import dataclass

from turbseg_ros.parameters import LatencyParameters

# Frames segmented for each that comes while some have piled up in the window.
_CATCH_UP = 2


@dataclass(frozen=True)
class Load:
    """How a frame is segmented under the load of its moment.

    `coasts`: between measurements of motion, objects are propagated instead of outlined;
    `sparse_motion`: motion is measured half as often; `frames_at_once`: how many frames that
    have piled up in the window are segmented for each that comes.
    """

    coasts: bool = False
    sparse_motion: bool = False
    frames_at_once: int = _CATCH_UP

    @classmethod
    def of(cls, waiting: int, latency: LatencyParameters) -> Load:
        """Return what is given up while so many frames wait."""
        coasts = waiting >= latency.coast_from
        return cls(
            coasts=coasts,
            sparse_motion=waiting >= latency.sparse_from,
            frames_at_once=1 if coasts and waiting else _CATCH_UP,
        )
