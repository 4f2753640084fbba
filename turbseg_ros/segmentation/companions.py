"""Objects that were never seen apart and go as one: they are parts of one object.

The tail of a helicopter may be found before its body is, and gets an id of its own; what holds
both is then divided between them for as long as they are in view. Two objects that touch, say one
that passes before another, were apart before, or don't go alike.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from turbseg_ros.arrays import Point
from turbseg_ros.segmentation.track import Track

# Gap from which two are apart, as a fraction of the larger one's size, and the share of the frames
# in which they may be seen in outlines of their own.
_APART, _MAX_OWN = 0.2, 0.2
# Frames in which two must be seen in one outline, by what share of the larger one's size one may
# move against the other meanwhile, and what share of it they must have travelled.
_FRAMES, _STEADY, _TRAVELLED = 12, 0.15, 0.5


@dataclass
class _Company:
    """How two were seen: frames in one outline, frames in two, whether they were ever apart.

    `offsets` are the last places of the younger one against the older one's in one outline.
    """

    together: int = 0
    beside: int = 0
    were_apart: bool = False
    offsets: tuple[Point, ...] = ()


class Companions:
    """How each track was seen with each other one."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self._companies: dict[tuple[Track, Track], _Company] = {}

    def observe(self, seen: Iterable[Track], shared: Iterable[Collection[Track]]) -> None:
        """Take what a frame shows.

        :param seen: all tracks that are seen in it, the oldest first.
        :param shared: the tracks of each outline that holds several.
        """
        together = {frozenset(pair) for tracks in shared for pair in combinations(tracks, 2)}
        for older, younger in combinations(seen, 2):
            company = self._companies.setdefault((older, younger), _Company())
            if company.were_apart:
                continue
            if {older, younger} in together:
                offset = younger.position - older.position
                company.together += 1
                company.offsets = (*company.offsets, offset)[-_FRAMES:]
            else:
                company.beside += 1
                gap = older.detection.box.gap(younger.detection.box)
                company.were_apart = gap > _APART * max(older.size, younger.size)

    def parts(self) -> set[Track]:
        """Return the tracks that are parts of older ones."""
        return {
            younger
            for (older, younger), company in self._companies.items()
            if _are_one(older, younger, company)
        }

    def keep(self, tracks: Collection[Track]) -> None:
        """Forget all others."""
        kept = set(tracks)
        self._companies = {
            pair: company for pair, company in self._companies.items() if kept.issuperset(pair)
        }


def _are_one(older: Track, younger: Track, company: _Company) -> bool:
    """Whether two have been seen, and have gone, as if they were one."""
    if company.were_apart or len(company.offsets) < _FRAMES:
        return False
    if company.beside > _MAX_OWN * (company.beside + company.together):
        return False
    size = max(older.size, younger.size)
    strayed = float(np.linalg.norm(np.ptp(company.offsets, axis=0)))
    return strayed < _STEADY * size and older.travelled > _TRAVELLED * size
