"""How the frames that a result may wait for are spent: on motion first, then on being sure."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from turbseg_ros.parameters import Parameters

WHOLE_CLIP = sys.maxsize
"""So many frames must follow where objects are told from one another at the end only."""

# Frames for which one is prepared beside the segmentation of those before.
_PREPARATION = 1


@dataclass(frozen=True)
class LookAhead:
    """Frames that follow one before the stages turn to it.

    Motion is measured in a frame once `neighbours` others follow, and may be under way while
    `measuring` frames are segmented. A frame is segmented once `segmentation` others follow; its
    result waits until `confirmation` more are, so that what moves in it may be known to be an
    object by then. `preparation` frames are made ready beside all that. A stream begins with
    `warm_up` frames that all wait, and it takes `to_confirm` frames to confirm an object.
    """

    neighbours: int
    measuring: int
    segmentation: int
    confirmation: int
    preparation: int = _PREPARATION
    warm_up: int = 0
    to_confirm: int = 0

    @property
    def lag(self) -> int:
        """Frames by which what is measured comes late, and is propagated."""
        return max(self.neighbours + self.measuring - self.segmentation, 0)

    @property
    def frames(self) -> int:
        """Frames that follow one before its result is given."""
        return self.preparation + self.segmentation + self.confirmation

    def results_kept(self, segmented: int) -> int:
        """Return how many results wait, so many frames of a stream being segmented.

        The first ones are late anyway, and wait as long as it takes to confirm an object, while
        the warm-up is worked off: two frames for each that comes, if there is time for it.
        """
        piled_up = self.warm_up - segmented // 2 - self.segmentation - 1
        longer = min(piled_up, self.to_confirm - self.confirmation)
        return self.confirmation + max(longer, 0)

    @classmethod
    def of(cls, parameters: Parameters, intervals: Sequence[int], to_confirm: int) -> LookAhead:
        """Spend as many frames as the parameters let a result wait for.

        :param intervals: those that motion is measured over; where one alone lies ahead, half of
            it will do, see `FrameWindow.neighbours`.
        :param to_confirm: frames until what is seen in each of them is confirmed.
        """
        every = parameters.flow.every
        measuring = (every + 1) // 2
        if parameters.is_causal:
            return cls(0, measuring, 0, 0, preparation=0)
        ahead = [k for k in intervals if k > 0]
        neighbours = widest = max(ahead, default=0)
        if len(ahead) == 1:
            neighbours = (widest + 1) // 2
        left = parameters.latency.look_ahead - _PREPARATION
        if to_confirm >= WHOLE_CLIP:
            left += WHOLE_CLIP
        segmentation = min(neighbours + measuring, left)
        left -= segmentation
        # Flow over the whole interval is better, but nothing is if all objects come late.
        if left > widest - neighbours:
            segmentation += widest - neighbours
            left -= widest - neighbours
            neighbours = widest
        # All that remains confirms objects, but for what spares slow machines from waiting.
        if left >= every - measuring + to_confirm:
            segmentation += every - measuring
            left -= every - measuring
            measuring = every
        return cls(
            neighbours,
            measuring,
            segmentation,
            confirmation=left,
            warm_up=parameters.latency.warm_up,
            to_confirm=to_confirm,
        )
