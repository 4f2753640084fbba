"""How sure it is that an object is one, by how alike its masks stay from frame to frame.

What shimmers, a fragment, or a shadow that comes and goes changes its shape at times; how often an
object was seen and how far it travelled says no more than its confirmation did. A logistic
regression, fitted to objects of rendered scenes, true and false; docs/accuracy.md has how, and how
it holds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

# Log odds of an object one of whose masks has nothing in common with that before, and what they
# grow by for one whose masks are all the same.
_BASE, _ALIKE = 2.0, 4.8


def certainty(shape_ious: Sequence[float]) -> float:
    """Return the probability, 0 to 1, that an object is true.

    :param shape_ious: IoU of its latest masks, each with that of the frame before, propagated.
    """
    return 1.0 / (1.0 + math.exp(-(_BASE + _ALIKE * min(shape_ious, default=0.0))))
