"""Outlines by a network's judgement of each pixel, in place of the rules of `silhouette`.

The network itself is handed in: this room knows neither files nor how it is run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.outline import Outline
from turbseg_ros.segmentation.silhouette import ObjectWindow, opened, separated

Map = npt.NDArray[np.float32]


class Refiner(Protocol):
    """Tells objects from background within windows."""

    def refine(self, windows: Sequence[ObjectWindow]) -> list[Map]:
        """Give for each window, hxw, the probability from 0 to 1 that a pixel is an object's."""


def refined_silhouettes(
    windows: Sequence[ObjectWindow], probabilities: Sequence[Map]
) -> list[Outline]:
    """Cut out what is rather object than background; in a window, it is split by its gaps.

    :param probabilities: one map a window, hxw, as a `Refiner` gives them.
    """
    found = []
    for window, probability in zip(windows, probabilities, strict=True):
        mask = opened(probability > 0.5)
        if not window.area.core.any():
            # Nothing was found to move: without this the outline would creep away over the scene.
            mask &= window.area.mask
        parts = separated(mask)
        found += [Outline.of(part, window.box.x0, window.box.y0) for part in parts]
    return found
