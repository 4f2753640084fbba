"""Outlines by a network's judgement of each pixel, in place of the rules of `foreground`.

The network itself is handed in: this room knows neither files nor how it is run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from turbseg_ros.arrays import Map
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.foreground import ObjectCrop, opened, separated


class Refiner(Protocol):
    """Tells objects from background within crops."""

    def refine(self, crops: Sequence[ObjectCrop]) -> list[Map]:
        """Return for each crop, hxw, the probability from 0 to 1 that a pixel is an object's."""


def refined_masks(crops: Sequence[ObjectCrop], probabilities: Sequence[Map]) -> list[CroppedMask]:
    """Cut out what is rather object than background; in a crop, it is split by its gaps.

    Of what several crops show, each keeps what lies nearest to its own area: else one would cut
    pieces out of the other's objects.

    :param probabilities: one map a crop, hxw, as a `Refiner` gives them.
    """
    found = []
    for crop, probability in zip(crops, probabilities, strict=True):
        mask = opened(probability > 0.5) & crop.area.nearest
        if not crop.area.probable.any():
            # Nothing was found to move: without this the outline would creep away over the scene.
            mask &= crop.area.search_mask
        parts = separated(mask)
        found += [CroppedMask.of(part, crop.box.x0, crop.box.y0) for part in parts]
    return found
