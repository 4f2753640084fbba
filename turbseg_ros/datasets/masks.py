"""What the masks of data sets mean: which pixel belongs to which object."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from turbseg_ros.bag.errors import ClipError

Labels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

# More values than this are no labels but a picture.
_MAX_VALUES = 256
_WHITE = (255, 65535)
# The label of white, in masks that only tell foreground from background.
_FOREGROUND = 255
# What CDnet writes beside 255: shadow, which is background; outside of the region that is judged;
# and unknown, as blurred borders are.
_CDNET_SHADOW, _CDNET_IGNORED = 50, (85, 170)
# Set in the value of a colour, to tell it from a grey level.
_COLOUR = 1 << 24


@dataclass(frozen=True)
class MaskMeaning:
    """The object that each value of a clip's masks stands for.

    `values` are sorted: grey levels, or colours as 0x1RRGGBB, black being 0; `objects` has a label
    for each. `ignored` are those that say nothing: such pixels are neither right nor wrong.
    """

    values: npt.NDArray[np.int32]
    objects: Labels
    ignored: tuple[int, ...] = ()

    def ignored_in(self, mask: npt.NDArray[Any]) -> npt.NDArray[np.bool_] | None:
        """Return where a mask says nothing, HxW; None for clips that tell of every pixel."""
        return np.isin(_values(mask), self.ignored) if self.ignored else None

    def labels(self, mask: npt.NDArray[Any]) -> Labels:
        """Return a mask, HxW or HxWx3 (BGR), as labels, HxW: 0 background, k object.

        :raises ClipError: when it holds a value that the clip's masks did not.
        """
        values = _values(mask)
        places = np.minimum(np.searchsorted(self.values, values), self.values.size - 1)
        if not np.array_equal(self.values[places], values):
            raise ClipError("a mask changed while it was read")
        return self.objects[places]


def mask_meaning(masks: Iterable[npt.NDArray[Any]]) -> MaskMeaning:
    """Find what a clip's masks mean.

    A single value beside 0 is one object, label 1, whatever it is; but white alone is 255, the
    foreground, in which objects are not told apart. Several grey levels are labels, unless they
    are those of CDnet: 255 foreground, 50 shadow, 85 and 170 neither. Several colours are those of
    DAVIS-2017, whose palette gives the label.

    :raises ClipError: when the values can't be told to be either.
    """
    seen = {0}
    for mask in masks:
        seen.update(np.unique(_values(mask)).tolist())
    values = np.array(sorted(seen), np.int32)
    if _is_of_cdnet(seen):
        foreground = np.where(values == _FOREGROUND, _FOREGROUND, 0).astype(np.uint8)
        return MaskMeaning(values, foreground, _CDNET_IGNORED)
    return MaskMeaning(values, _narrowed(_objects(values)))


def _is_of_cdnet(seen: set[int]) -> bool:
    """Whether values are CDnet's; one alone beside 0 may be an object."""
    levels = {0, _CDNET_SHADOW, *_CDNET_IGNORED, _FOREGROUND}
    return seen <= levels and len(seen) > 2 and not seen.isdisjoint(_CDNET_IGNORED)


def _objects(values: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    if values.size <= 2:
        white = values[-1] in (*_WHITE, _COLOUR | 0xFFFFFF)
        return values.astype(bool) * np.int32(_FOREGROUND if white else 1)
    if values.size > _MAX_VALUES:
        raise ClipError(f"the masks hold {values.size} values: they are no labels but a picture")
    if values.max() < _COLOUR:
        return _grey_labels(values)
    blue, green, red = (values >> shift & 0xFF for shift in (0, 8, 16))
    if np.array_equal(red, green) and np.array_equal(green, blue):
        return _grey_labels(blue)
    return _palette_indices(values)


def _grey_labels(levels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    if levels.max() in _WHITE:
        raise ClipError(
            f"the masks hold {levels.max()} beside {', '.join(map(str, levels[1:-1][:5]))}: "
            "make them 0 and 255 for one object, or 0, 1, 2... for several"
        )
    return levels


def _narrowed(labels: npt.NDArray[np.int32]) -> Labels:
    return labels.astype(np.uint8) if labels.max() < 256 else labels.astype(np.uint16)


def _values(mask: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Return each pixel's grey level, or its colour as 0x1RRGGBB where the mask has colour."""
    if mask.ndim == 2 and mask.dtype in (np.uint8, np.uint16):
        return mask.astype(np.int32)
    if mask.ndim == 3 and mask.dtype == np.uint8:
        colours = mask.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        return np.where(colours == 0, 0, colours | _COLOUR)
    raise ClipError(f"the masks are {mask.dtype} of shape {mask.shape}; labels are whole numbers")


def _palette_indices(colours: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    palette = {_palette_colour(index): index for index in range(256)}
    named = (colours & ~_COLOUR).tolist()
    unknown = [f"#{colour:06x}" for colour in named if colour not in palette]
    if unknown:
        raise ClipError(
            f"the masks hold colours that are not of the DAVIS palette ({', '.join(unknown[:5])});"
            " make them grey: 0 background, 1, 2... objects"
        )
    return np.array([palette[colour] for colour in named], np.int32)


def _palette_colour(index: int) -> int:
    """Return a colour of the palette that PASCAL VOC began and DAVIS uses, as 0xRRGGBB.

    The index's bits go to red, green and blue in turn, the lowest to the highest of each.
    """
    red = green = blue = 0
    for bit in range(7, -1, -1):
        red |= (index & 1) << bit
        green |= (index >> 1 & 1) << bit
        blue |= (index >> 2 & 1) << bit
        index >>= 3
    return red << 16 | green << 8 | blue
