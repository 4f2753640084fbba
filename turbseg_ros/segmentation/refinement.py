"""Outlines by a network's judgement of each pixel, in place of the rules of `foreground`.

The network itself is handed in: this room knows neither files nor how it is run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from turbseg_ros.arrays import Map, Mask
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.foreground import ObjectCrop, Surroundings, opened, separated

# A crop's rim, as a share of its side, in which an outline is cut if it takes up so many pixels of
# the border and that share of it.
_RIM, _FEWEST_CUT, _SHARE_CUT = 0.04, 3, 0.1
# Room that a crop which cuts an outline gets on that side: a share of its own side, and the least.
_ROOM, _LEAST_ROOM = 0.5, 8


class Refiner(Protocol):
    """Tells objects from background within crops."""

    def refine(self, crops: Sequence[ObjectCrop]) -> list[Map]:
        """Return for each crop, hxw, the probability from 0 to 1 that a pixel is an object's."""


def whole_crops(
    surroundings: Surroundings, refiner: Refiner
) -> tuple[list[ObjectCrop], list[Map]]:
    """Return crops and the probabilities in them; where one cuts an object, a wider one.

    Flow may show a part of an object only, say the lower half of what comes closer; with room
    around it the network draws the whole.
    """
    whole = list(surroundings.crops)
    probabilities = refiner.refine(whole)
    cut = {
        number: box
        for number, (crop, probability) in enumerate(zip(whole, probabilities, strict=True))
        if (box := _roomy_box(crop, probability, surroundings.shape)) != crop.box
    }
    wider = [surroundings.wider(whole[number], box) for number, box in cut.items()]
    seen = zip(cut, wider, refiner.refine(wider) if wider else [], strict=True)
    for number, crop, probability in seen:
        whole[number], probabilities[number] = crop, probability
    return whole, probabilities


def refined_masks(crops: Sequence[ObjectCrop], probabilities: Sequence[Map]) -> list[CroppedMask]:
    """Cut out what is rather object than background; in a crop, it is split by its gaps.

    Of what several crops show, each keeps what lies nearest to its own area: else one would cut
    pieces out of the other's objects.

    :param probabilities: one map a crop, hxw, as a `Refiner` gives them.
    """
    found = []
    for crop, probability in zip(crops, probabilities, strict=True):
        parts = separated(_object_mask(crop, probability))
        found += [CroppedMask.of(part, crop.box.x0, crop.box.y0) for part in parts]
    return found


def _object_mask(crop: ObjectCrop, probability: Map) -> Mask:
    """Return what of a crop is rather object than background, hxw."""
    mask = opened(probability > 0.5) & crop.area.nearest
    if not crop.area.probable.any():
        # Nothing was found to move: without this the outline would creep away over the scene.
        mask &= crop.area.search_mask
    return mask


def _roomy_box(crop: ObjectCrop, probability: Map, shape: tuple[int, int]) -> Box:
    """Return the crop's box, wider on the sides that cut what is outlined there.

    :param shape: the frame's.
    """
    mask, box = _object_mask(crop, probability), crop.box
    (height, width), (rows, columns) = box.shape, shape
    # The network is less sure at a crop's border.
    across, down = (max(1, round(_RIM * side)) for side in (width, height))
    more_x, more_y = (max(_LEAST_ROOM, int(_ROOM * side)) for side in (width, height))
    left, right = _is_cut(mask[:, :across]), _is_cut(mask[:, -across:])
    top, bottom = _is_cut(mask[:down].T), _is_cut(mask[-down:].T)
    return Box(
        max(box.x0 - more_x * left, 0),
        max(box.y0 - more_y * top, 0),
        min(box.x1 + more_x * right, columns),
        min(box.y1 + more_y * bottom, rows),
    )


def _is_cut(rim: Mask) -> bool:
    """Whether an outline goes on beyond a crop's rim, nxd with the border along n."""
    touching = np.count_nonzero(rim.any(axis=1))
    return bool(touching >= max(_FEWEST_CUT, _SHARE_CUT * len(rim)))
