"""What the border of the view cuts off: on which sides, and how far its front end has come.

Of what enters, more is seen in each frame: the middle of that goes half as far as the object, and
at first nowhere. The end that is away from the border goes as far as the whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from turbseg_ros.arrays import Matrix, Point
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import transformed_points

# Share of an outline's pixels, in per cent, that lie before its front end: single ones tell none.
_BEFORE = 5
# Frames of a path that are remembered: an outline that jumped once is soon forgotten.
_MEMORY = 8


class Sides(NamedTuple):
    """The sides of a box on which something is cut off."""

    left: bool = False
    top: bool = False
    right: bool = False
    bottom: bool = False

    @property
    def inward(self) -> tuple[int, int]:
        """Which way (x, y) leads away from them, -1, 0 or 1 each; 0 between two of them."""
        return int(self.left) - int(self.right), int(self.top) - int(self.bottom)

    def joined(self, other: Sides) -> Sides:
        """Return those of a box round two others."""
        return Sides(*(one or two for one, two in zip(self, other, strict=True)))


UNCUT = Sides()


@dataclass(frozen=True)
class FrontPath:
    """Where the front end of what is cut off was, the oldest first, while the sides stay the same.

    `places` are (x, y) in pixels of the newest frame; nothing is known with fewer than two.
    """

    inward: tuple[int, int] = (0, 0)
    places: tuple[Point, ...] = ()

    def seen(self, outline: CroppedMask, cut_sides: Sides) -> FrontPath:
        """Return the path with one frame more; another one, where other sides are cut off."""
        inward = cut_sides.inward
        if inward == (0, 0):
            return FrontPath()
        before = self.places if inward == self.inward else ()
        return FrontPath(inward, (*before, _front(outline, inward))[-_MEMORY:])

    def propagated(self, ego_motion: Matrix) -> FrontPath:
        """Return the path in the next frame's pixels."""
        return replace(self, places=tuple(transformed_points(ego_motion, self.places)))

    @property
    def displacement(self) -> Point:
        """How far it has come (x, y), in pixels along the ways that lead inward."""
        if len(self.places) < 2:
            return np.zeros(2)
        return np.asarray((self.places[-1] - self.places[0]) * np.abs(self.inward))

    @property
    def distance(self) -> float:
        """The length of its displacement in pixels."""
        return float(np.linalg.norm(self.displacement))

    @property
    def length(self) -> float:
        """Its path length in pixels, along the ways that lead inward."""
        if len(self.places) < 2:
            return 0.0
        steps = np.diff(self.places, axis=0) * np.abs(self.inward)
        return float(np.linalg.norm(steps, axis=1).sum())


def _front(outline: CroppedMask, inward: tuple[int, int]) -> Point:
    """Return the end (x, y) of an outline that lies furthest inward, its middle across that."""
    rows, columns = np.nonzero(outline.mask)
    corner = outline.box.x0, outline.box.y0
    place = [
        start + np.percentile(pixels, 50 + towards * (50 - _BEFORE))
        for start, pixels, towards in zip(corner, (columns, rows), inward, strict=True)
    ]
    return np.array(place)
