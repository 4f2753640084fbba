"""Which of the targets that were followed have moved, each against the others.

What stands still is displaced as far as registration errs, and so is its neighbour: a target is
told by its displacement against others near it that stand. A large thing that moves has many
parts, of which one has a say.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Mask
from turbseg_ros.segmentation.blobs import Numbers, Points
from turbseg_ros.segmentation.significance import chance_per_test, jitter, significant_displacement

Counts = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]

# Frames of a path that its ends are means of, at most.
_END = 4
# Least displacement in pixels; and, where nothing else is there to compare with, the least
# displacement, how much of a pixel a frame registration may drift, and the fewest frames and least
# strength believed then.
_MIN_DISPLACEMENT, _MIN_DISPLACEMENT_ALONE, _DRIFT = 2.0, 3.0, 0.015
_LONG, _STRONG = 24, 15.0
# The same of what is larger: the middle of many pixels wanders less, and is seldom noise.
_LARGE_LONG, _LARGE_STRONG = 12, 4.0
CHANGED_STRONG = 5.0
"""The least strength of what is told by what has changed: the scene isn't seen there at all."""
# The fewest frames of it. Pixels a frame that it must go at least, over so many frames: what is
# faster than that isn't parallax.
_CHANGED_LONG = 12
_CREEP, _CREEP_SPAN = 0.125, 24
# Pixels over its strength by which the place of what is faint wanders with what lies behind it.
_WIDTH = 3.5
# Others that a displacement is compared with, the nearest, the fewest that tell something, and the
# share of them that it must be significant against.
_OTHERS, _FEWEST, _SHARE = 8, 3, 0.75
# Pixels in so many frames that what is large rests below: whether it stays is told by its picture.
_RESTS, _LATELY = 0.5, 6
# Share of the scene's way in the picture up to which what is large lies nearer than the scene, or
# further away.
_PARALLAX = 0.6
# Share of the frames that it must be seen in, and side in pixels of the parts of the picture that
# have a say each.
_SEEN, _PART = 0.6, 72
# Pixels over which what stands still must be spread to be the scene.
_SPREAD = 80
# Least displacement over path length, in steps of so many frames.
_STRAIGHT, _STEP = 0.4, 4
# Pixels a frame by which a camera that follows something turns at least.
_TURNS = 0.4
# Least deviation in the picture as it came, in pixels: less is burnt in, or stands still; and the
# displacement against the scene from which it is burnt in.
_JITTERS, _BURNT_IN = 0.25, 1.0
# Once it moves, a target does until its displacement falls below this share of what was wanted.
_STILL_MOVES = 0.7
# False alarms an hour that are let pass.
_FALSE_ALARMS_PER_HOUR = 1.0


@dataclass(frozen=True)
class FollowedTargets:
    """What was followed for long enough to tell whether it moves.

    `paths` are the places (x, y) of N targets in T frames, NxTx2, in coordinates of the newest
    frame, from the one where each was first seen and NaN before; `sightings` the same as they
    came, NaN where not seen. `places`, Nx2, are where they are now, `strengths` how clearly they
    stand out; `moved`, N, which were found to move before. Pixels are those of a picture `scale`
    times smaller than at processing resolution.
    """

    paths: Points
    sightings: Points
    places: Points
    strengths: Numbers
    moved: Mask
    scale: int = 1

    @functools.cached_property
    def tracked(self) -> _Paths:
        """Their paths, to be measured."""
        return _Paths(self.paths)

    @functools.cached_property
    def common(self) -> Points:
        """The displacement (x, y) that most of them share, 0 where there are none."""
        if not len(self.paths):
            return np.zeros(2)
        return np.asarray(np.median(self.tracked.displacements, axis=0))

    @functools.cached_property
    def jitters(self) -> Mask:
        """Which of them aren't fixed to the picture, N."""
        return np.asarray(_deviations(self.sightings).max(axis=1) > _JITTERS)

    @functools.cached_property
    def lengths(self) -> Numbers:
        """How far each has come, N."""
        return np.linalg.norm(self.tracked.displacements, axis=1)

    @functools.cached_property
    def stands(self) -> Mask:
        """Which of them the others may be held against, N."""
        return ~self.moved & (self.jitters | (self.lengths < _BURNT_IN))

    @functools.cached_property
    def drift(self) -> float:
        """By how much registration displaces what stands, in pixels."""
        return _scatter(self.tracked.displacements[~self.moved])


@dataclass(frozen=True)
class _Standard:
    """What is asked of a kind of target before it is believed to move.

    :param frames: those that it must have been followed for, where little else speaks for it;
        `strength` is the least then.
    :param always: whether that is asked where others stand near, too.
    :param exclusions: tell whether a target's way is rather that of something else than an object.
    """

    frames: int
    strength: float
    always: bool = False
    exclusions: tuple[Callable[[_Way], bool], ...] = ()


@dataclass(frozen=True)
class _Way:
    """The way of one target: its `path` and `sightings`, Tx2, see `FollowedTargets`.

    `wanted` is the displacement that would be significant, in pixels.
    """

    path: Points
    sightings: Points
    wanted: float

    @functools.cached_property
    def seen(self) -> Indices:
        """The frames that show it, at most T."""
        return np.nonzero(~np.isnan(self.sightings[:, 0]))[0]

    def displacements(self, end: int) -> tuple[Points, Points]:
        """Return those against the scene and in the picture, (x, y), between means of its ends.

        :param end: sightings that each is the mean of.
        """
        against, within = (
            way[self.seen[-end:]].mean(axis=0) - way[self.seen[:end]].mean(axis=0)
            for way in (self.path, self.sightings)
        )
        return against, within


def have_moved(targets: FollowedTargets, every: int, tests: int, camera_known: int) -> Mask:
    """Return which targets have travelled further than chance and the scene would take them, N.

    :param every: frames from one time that this is asked to the next.
    :param tests: targets that are looked at in each frame.
    :param camera_known: frames for which the camera's motion has been known without a gap.
    """
    count = len(targets.paths)
    if not count:
        return np.zeros(0, bool)
    apart = _apart(targets, targets)
    still = targets.scale * targets.places[apart < 2.0 * _MIN_DISPLACEMENT]
    if count > _FEWEST and not (len(still) and np.ptp(still, axis=0).max() > _SPREAD):
        # Registration may hang on one thing, and the scene be what moves.
        return np.zeros(count, bool)
    standard = _SMALL if targets.scale == 1 else _LARGE
    return _significant(targets, targets, standard, every, tests, camera_known)


def have_come(
    changes: FollowedTargets,
    standing: FollowedTargets,
    every: int,
    tests: int,
    camera_known: int,
) -> Mask:
    """Return which of the targets told by what has changed have travelled significantly, N.

    See `have_moved`; they are held against what stands in the picture itself.

    :param standing: what stands out in the picture, at the same scale.
    """
    return _significant(changes, standing, _CHANGED, every, tests, camera_known)


def _apart(targets: FollowedTargets, others: FollowedTargets) -> Numbers:
    """Return how far targets have come, less what is common to others, N."""
    return np.linalg.norm(targets.tracked.displacements - others.common, axis=1)


def _significant(
    targets: FollowedTargets,
    others: FollowedTargets,
    standard: _Standard,
    every: int,
    tests: int,
    camera_known: int,
) -> Mask:
    """Return which targets have travelled significantly against others near them that stand, N.

    See `have_moved`; the others may be the same.
    """
    chance = chance_per_test(_FALSE_ALARMS_PER_HOUR, every, tests)
    moved = np.zeros(len(targets.paths), bool)
    paths, lengths = targets.tracked, targets.lengths
    # Most stand still, and those need no closer look.
    far = np.maximum(_apart(targets, others), lengths) > _MIN_DISPLACEMENT / 2.0
    for number in np.nonzero(targets.jitters & far)[0].tolist():
        frames = int(paths.frames[number])
        seen = ~np.isnan(targets.sightings[number, :, 0])
        if np.count_nonzero(seen) < _SEEN * frames or not paths.is_straight(number):
            continue
        there = others.stands & (others.tracked.frames >= 0.5 * frames)
        if others is targets:
            there[number] = False
        place = targets.scale * targets.places[number]
        near = _nearest(others.scale * others.places, place, np.nonzero(there)[0])
        alone = len(near) < _FEWEST
        relative = lengths[[number]] if alone else paths.relative(number, others.tracked, near)
        least = _MIN_DISPLACEMENT_ALONE if alone else _MIN_DISPLACEMENT
        factor = _STILL_MOVES if targets.moved[number] else 1.0
        if np.mean(relative > factor * least) < _SHARE:
            continue
        believed = (
            standard.frames <= frames <= camera_known
            and targets.strengths[number] > standard.strength
        )
        if (alone or standard.always) and not believed:
            continue
        # Ends are means of a few places; drift is that of a displacement, which has two.
        drifted = _DRIFT * frames if alone else others.drift
        shakes = jitter(list(targets.paths[number][seen]), 0.0) / 2.0
        faint = _WIDTH / targets.strengths[number]
        own = float(np.linalg.norm([shakes, drifted / np.sqrt(2.0), faint]))
        wanted = max(significant_displacement(own, 0.0, frames, every, chance), least)
        way = _Way(targets.paths[number], targets.sightings[number], wanted)
        if any(is_other(way) for is_other in standard.exclusions):
            continue
        moved[number] = np.mean(relative > factor * wanted) >= _SHARE
    return moved


def _stands_in_picture(way: _Way) -> bool:
    """Whether a target stands in the picture of a camera that nearly stands.

    Then it is registration that drifts. What a camera follows has it turn faster.
    """
    own, in_picture = way.displacements(min(_END, max(len(way.seen) // 3, 1)))
    turned = np.hypot(*(in_picture - own)) / np.ptp(way.seen)
    return bool(np.hypot(*in_picture) < way.wanted and turned < _TURNS)


def _creeps(way: _Way) -> bool:
    """Whether a target's path has led so slowly lately that it may be parallax."""
    recent = way.path[way.seen][-_CREEP_SPAN:]
    return bool(np.hypot(*(recent[-1] - recent[0])) < _CREEP * len(recent))


def _rests(way: _Way) -> bool:
    """Whether a target's path has led nowhere lately."""
    return bool(np.hypot(*(way.path[-1] - way.path[-1 - _LATELY])) < _RESTS)


def _passes_with_scene(way: _Way) -> bool:
    """Whether a target's own way is so short beside the scene's that it may be parallax.

    What the camera follows has gone as far as the scene has, against it.
    """
    own, in_picture = way.displacements(1)
    return bool(np.hypot(*own) < _PARALLAX * np.hypot(*(in_picture - own)))


_SMALL = _Standard(_LONG, _STRONG, exclusions=(_stands_in_picture,))
_LARGE = _Standard(_LARGE_LONG, _LARGE_STRONG, exclusions=(_rests, _passes_with_scene))
_CHANGED = _Standard(
    _CHANGED_LONG, CHANGED_STRONG, always=True, exclusions=(_creeps, _stands_in_picture)
)


def parts_of(places: Points) -> int:
    """Count the parts of the picture that places, Nx2, are in: a large thing is in one."""
    return len(np.unique(places // _PART, axis=0))


class _Paths:
    """Paths of N targets in T frames, NxTx2, NaN before each was seen first."""

    def __init__(self, paths: Points) -> None:
        self._paths = paths
        self._last = paths.shape[1]
        there = ~np.isnan(paths[..., 0])
        self.frames = there.sum(axis=1)
        sums = np.cumsum(np.where(there[..., None], paths, 0.0), axis=1)
        # The sum of the places before each frame, and of all.
        self._sums = np.concatenate([np.zeros((len(paths), 1, 2)), sums], axis=1)
        self.displacements = self._displacements(np.arange(len(paths)), self.frames)

    def _displacements(self, which: Indices, frames: Counts) -> Points:
        """Return the displacements of some over so many frames, (x, y)."""
        end = np.clip(frames // 3, 1, _END)
        first = self._last - frames
        sums, last = self._sums, np.full_like(frames, self._last)
        here = sums[which, last] - sums[which, last - end]
        there = sums[which, first + end] - sums[which, first]
        return np.asarray((here - there) / end[:, None])

    def relative(self, number: int, others: _Paths, which: Indices) -> Numbers:
        """Return how far one has moved from each of some others, since both were seen.

        :param others: may be these; `which` are theirs.
        """
        frames = np.minimum(self.frames[number], others.frames[which])
        own = self._displacements(np.full_like(which, number), frames)
        return np.linalg.norm(own - others._displacements(which, frames), axis=1)

    def is_straight(self, number: int) -> bool:
        """Whether one's displacement is a good part of its path length."""
        path = self._paths[number, self._last - self.frames[number] :: _STEP]
        path_length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        net = float(np.hypot(*self.displacements[number]))
        return net < _MIN_DISPLACEMENT or net > _STRAIGHT * float(path_length)


def _nearest(places: Points, place: Points, which: Indices) -> Indices:
    """Return the nearest to a place of some others, Nx2, each in another part of the picture."""
    nearest = which[np.argsort(np.linalg.norm(places[which] - place, axis=1))]
    first: dict[tuple[float, ...], int] = {}
    for part, other in zip((places[nearest] // _PART).tolist(), nearest.tolist(), strict=True):
        first.setdefault(tuple(part), other)
    return np.array(list(first.values())[:_OTHERS], np.intp)


def _deviations(sightings: Points) -> Points:
    """Return the standard deviations of places, NxTx2, of which some are NaN, along T, Nx2."""
    seen = ~np.isnan(sightings)
    count = np.maximum(seen.sum(axis=1), 1)
    mean = np.where(seen, sightings, 0.0).sum(axis=1) / count
    from_mean = np.where(seen, sightings - mean[:, None], 0.0)
    return np.asarray(np.sqrt(np.square(from_mean).sum(axis=1) / count))


def _scatter(displacements: Points) -> float:
    """Return the standard deviation an axis of displacements that should be alike."""
    if not len(displacements):
        return 0.0
    lengths = np.linalg.norm(displacements - np.median(displacements, axis=0), axis=1)
    return float(np.median(lengths)) / 1.1774
