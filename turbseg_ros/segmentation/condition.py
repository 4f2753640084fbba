"""What a frame was like, as far as that decides what is done with it."""

from __future__ import annotations

import enum


class Condition(enum.Enum):
    """What a frame was like; its value completes "a frame that is ..."."""

    SOUND = "sound"
    DAMAGED = "damaged"
    """A part of it doesn't show the scene: grey, smeared, torn, or as it was a frame before."""
    BLIND = "blind"
    """Nothing of it shows the scene: black, white, noise, a shutter."""
    REPEATED = "repeated"
    """It is the frame before once more, to the last bit."""
    CUT = "of another scene"
    """It is the first frame of a scene that has nothing in common with the one before."""

    @property
    def is_passed_over(self) -> bool:
        """Whether such a frame is answered from what is known, and tells nothing to others."""
        return self in (Condition.DAMAGED, Condition.BLIND, Condition.REPEATED)
