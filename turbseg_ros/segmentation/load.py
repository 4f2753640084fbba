"""What is given up, and in which order, while frames wait to be segmented.

Frames wait in two places: in the window, for later ones, and before it. A stream's first frames
pile up in the window on purpose, and are worked off beside those that come; that some wait
before it meanwhile tells nothing of how fast the machine is.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from turbseg_ros.parameters import Parameters

# Frames segmented for each that comes while some have piled up in the window.
_CATCH_UP = 2
# Share of the frames that may wait before the window that may do so at no price while others have
# piled up in it; the rest is room in which shedding load keeps them from being dropped.
_PATIENCE = 1 / 3


class Step(enum.IntEnum):
    """The steps of a ladder: what is given up under load, each step with what those before it do.

    A frame is segmented at one of the first three; what is `DROPPING` gives up frames themselves,
    before they are segmented.
    """

    FULL = 0
    COASTING = 1
    SPARSE_MOTION = 2
    DROPPING = 3

    @property
    def label(self) -> str:
        """The name that is published."""
        return self.name.lower().replace("_", " ")

    @property
    def j(self) -> float | None:
        """Mean J over the evaluation's scenes, by default parameters, of frames all segmented so.

        None where frames have no masks. The commands are in docs/accuracy.md, "Load shedding".
        """
        return _J.get(self)


ANSWERED_STEPS = tuple(step for step in Step if step is not Step.DROPPING)
"""Those at which frames are segmented."""
_J = {Step.FULL: 0.793, Step.COASTING: 0.770, Step.SPARSE_MOTION: 0.722}


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

    @property
    def step(self) -> Step:
        """The furthest step that is taken."""
        if self.sparse_motion:
            return Step.SPARSE_MOTION
        return Step.COASTING if self.coasts else Step.FULL

    @classmethod
    def of(cls, waiting: int, parameters: Parameters, piled_up: int = 0) -> Load:
        """Return what is given up while so many frames wait.

        :param waiting: frames before the window.
        :param piled_up: frames in the window that could have been segmented earlier.
        """
        latency = parameters.latency
        excess = max(waiting - min(piled_up, int(_PATIENCE * parameters.queue_size)), 0)
        coasts, sparse = excess >= latency.coast_from, excess >= latency.sparse_from
        # What is outlined costs too much to catch up when one more that waits would shed load;
        # what coasts does not. Where none is ever shed, results depend on no frame's time.
        hurries = coasts and not sparse
        crowded = waiting >= max(latency.coast_from - 1, 1)
        return cls(coasts, sparse, 1 if crowded and not hurries else _CATCH_UP)
