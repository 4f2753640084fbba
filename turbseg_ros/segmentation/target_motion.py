"""Which of the small targets that were followed have moved, by their ways against one another.

What stands still comes as far as registration errs, and so does its neighbour: a target is told
by the way that it has come against others near it that stand. A large thing that moves has many
parts, of which one has a say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Mask
from turbseg_ros.segmentation.significance import chance_per_test, jitter, significant_way

Points = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]

# Frames of a way that its ends are means of, at most.
_END = 4
# Least way in pixels; and, where nothing else is there to compare with, the least way, how much of
# a pixel a frame registration may drift, and the fewest frames and least strength believed then.
_LEAST_WAY, _LEAST_WAY_ALONE, _DRIFT = 2.0, 3.0, 0.015
_LONG, _STRONG = 24, 15.0
# Pixels over its strength by which the place of what is faint wanders with what lies behind it.
_WIDTH = 3.5
# Others that a way is compared with, the nearest, the fewest that tell something, and the share of
# them that it must be significant against.
_OTHERS, _FEWEST, _SHARE = 8, 3, 0.75
# Share of the frames that it must be seen in, and side in pixels of the parts of the picture that
# have a say each.
_SEEN, _PART = 0.6, 72
# Pixels over which what stands still must be spread to be the scene.
_SPREAD = 80
# Least way over the way walked, in steps of so many frames.
_STRAIGHT, _STEP = 0.4, 4
# Least deviation in the picture as it came, in pixels: less is burnt in, or stands still; and the
# way against the scene from which it is burnt in.
_TREMBLES, _BURNT_IN = 0.25, 1.0
# Once it moves, a target does until its way falls below this share of what was wanted.
_STILL_MOVES = 0.7
# False alarms an hour that are let pass.
_FALSE_ALARMS_PER_HOUR = 1.0


@dataclass(frozen=True)
class FollowedTargets:
    """What was followed for long enough to tell whether it moves.

    `ways` are the places (x, y) of N targets in T frames, NxTx2, in coordinates of the newest
    frame, from the one where each was first seen and NaN before; `sightings` the same as they
    came, NaN where not seen. `places`, Nx2, are where they are now, `strengths` how clearly they
    stand out; `moved`, N, which were found to move before.
    """

    ways: Points
    sightings: Points
    places: Points
    strengths: Numbers
    moved: Mask


def have_moved(targets: FollowedTargets, every: int, tests: int, camera_known: int) -> Mask:
    """Return which targets have come further than chance and the scene would take them, N.

    :param every: frames from one time that this is asked to the next.
    :param tests: targets that are looked at in each frame.
    :param camera_known: frames for which the camera's motion has been known without a gap.
    """
    count, moved = len(targets.ways), np.zeros(len(targets.ways), bool)
    if not count:
        return moved
    ways = _Ways(targets.ways)
    length = np.linalg.norm(ways.come, axis=1)
    apart = np.linalg.norm(ways.come - np.median(ways.come, axis=0), axis=1)
    still = targets.places[apart < 2.0 * _LEAST_WAY]
    if count > _FEWEST and not (len(still) and np.ptp(still, axis=0).max() > _SPREAD):
        # Registration may hang on one thing, and the scene be what moves.
        return moved
    trembles = _deviations(targets.sightings).max(axis=1) > _TREMBLES
    stands = ~targets.moved & (trembles | (length < _BURNT_IN))
    drift = _scatter(ways.come[~targets.moved])
    chance = chance_per_test(_FALSE_ALARMS_PER_HOUR, every, tests)
    # Most stand still, and those need no closer look.
    far = trembles & (np.maximum(apart, length) > _LEAST_WAY / 2.0)
    for number in np.nonzero(far)[0].tolist():
        frames = int(ways.frames[number])
        there = stands & (ways.frames >= 0.5 * frames)
        there[number] = False
        others = _nearest(targets.places, number, np.nonzero(there)[0])
        alone = len(others) < _FEWEST
        relative = length[[number]] if alone else ways.relative(number, others)
        least = _LEAST_WAY_ALONE if alone else _LEAST_WAY
        factor = _STILL_MOVES if targets.moved[number] else 1.0
        if np.mean(relative > factor * least) < _SHARE or not ways.is_straight(number):
            continue
        if alone and not (_LONG <= frames <= camera_known and targets.strengths[number] > _STRONG):
            continue
        seen = ~np.isnan(targets.sightings[number, :, 0])
        if np.count_nonzero(seen) < _SEEN * frames:
            continue
        # Ends are means of a few places; drift is that of a way, which has two.
        wander = _DRIFT * frames if alone else drift
        shakes = jitter(list(targets.ways[number][seen]), 0.0) / 2.0
        faint = _WIDTH / targets.strengths[number]
        own = float(np.linalg.norm([shakes, wander / np.sqrt(2.0), faint]))
        wanted = max(significant_way(own, 0.0, frames, every, chance), least)
        moved[number] = np.mean(relative > factor * wanted) >= _SHARE
    return moved


def parts_of(places: Points) -> int:
    """Count the parts of the picture that some places, Nx2, are in: a large thing is in one."""
    return len(np.unique(places // _PART, axis=0))


class _Ways:
    """Ways of N targets in T frames, NxTx2, NaN before each was seen first."""

    def __init__(self, ways: Points) -> None:
        self._ways = ways
        self._last = ways.shape[1]
        there = ~np.isnan(ways[..., 0])
        self.frames = there.sum(axis=1)
        sums = np.cumsum(np.where(there[..., None], ways, 0.0), axis=1)
        # The sum of the places before each frame, and of all.
        self._sums = np.concatenate([np.zeros((len(ways), 1, 2)), sums], axis=1)
        self.come = self._come(np.arange(len(ways)), self.frames)

    def _come(self, which: Indices, frames: Counts) -> Points:
        """Return how far some have come in so many frames, (x, y)."""
        end = np.clip(frames // 3, 1, _END)
        first = self._last - frames
        sums, last = self._sums, np.full_like(frames, self._last)
        here = sums[which, last] - sums[which, last - end]
        there = sums[which, first + end] - sums[which, first]
        return np.asarray((here - there) / end[:, None])

    def relative(self, number: int, others: Indices) -> Numbers:
        """Return how far one has come from each of some others, since both were seen."""
        frames = np.minimum(self.frames[number], self.frames[others])
        come = self._come(np.full_like(others, number), frames) - self._come(others, frames)
        return np.linalg.norm(come, axis=1)

    def is_straight(self, number: int) -> bool:
        """Whether one has come a good part of the way that it walked."""
        way = self._ways[number, self._last - self.frames[number] :: _STEP]
        steps = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
        net = float(np.hypot(*self.come[number]))
        return net < _LEAST_WAY or net > _STRAIGHT * float(steps)


def _nearest(places: Points, number: int, others: Indices) -> Indices:
    """Return the nearest others of one, each in another part of the picture."""
    nearest = np.argsort(np.linalg.norm(places[others] - places[number], axis=1))
    _, first = np.unique(places[others[nearest]] // _PART, axis=0, return_index=True)
    return np.asarray(others[nearest[np.sort(first)[:_OTHERS]]])


def _deviations(sightings: Points) -> Points:
    """Return the standard deviations of places, NxTx2, of which some are NaN, along T, Nx2."""
    seen = ~np.isnan(sightings)
    count = np.maximum(seen.sum(axis=1), 1)
    mean = np.where(seen, sightings, 0.0).sum(axis=1) / count
    from_mean = np.where(seen, sightings - mean[:, None], 0.0)
    return np.asarray(np.sqrt(np.square(from_mean).sum(axis=1) / count))


def _scatter(ways: Points) -> float:
    """Return the standard deviation an axis of ways that should be alike."""
    if not len(ways):
        return 0.0
    lengths = np.linalg.norm(ways - np.median(ways, axis=0), axis=1)
    return float(np.median(lengths)) / 1.1774
