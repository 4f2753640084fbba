"""Which of the targets that were followed have moved, each against the others.

What stands still is displaced as far as registration errs, and so is its neighbour: a target is
told by its displacement against others near it that stand. A large thing that moves has many
parts, of which one has a say.
"""

from __future__ import annotations

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
    times smaller than at processing resolution. `changed`, N, are those told by what has changed:
    they alone are judged then, against the others; None where all are judged by one another.
    """

    paths: Points
    sightings: Points
    places: Points
    strengths: Numbers
    moved: Mask
    scale: int = 1
    changed: Mask | None = None

    def held_against(self, standing: FollowedTargets) -> FollowedTargets:
        """Return both, these as what has changed; all have the same scale."""
        return FollowedTargets(
            paths=np.concatenate([self.paths, standing.paths]),
            sightings=np.concatenate([self.sightings, standing.sightings]),
            places=np.concatenate([self.places, standing.places]),
            strengths=np.concatenate([self.strengths, standing.strengths]),
            moved=np.concatenate([self.moved, standing.moved]),
            scale=self.scale,
            changed=np.arange(len(self.paths) + len(standing.paths)) < len(self.paths),
        )


def have_moved(targets: FollowedTargets, every: int, tests: int, camera_known: int) -> Mask:
    """Return which targets have travelled further than chance and the scene would take them, N.

    :param every: frames from one time that this is asked to the next.
    :param tests: targets that are looked at in each frame.
    :param camera_known: frames for which the camera's motion has been known without a gap.
    """
    count, moved = len(targets.paths), np.zeros(len(targets.paths), bool)
    if not count:
        return moved
    paths = _Paths(targets.paths)
    others = np.ones(count, bool) if targets.changed is None else ~targets.changed
    length = np.linalg.norm(paths.displacements, axis=1)
    common = np.median(paths.displacements[others], axis=0) if others.any() else np.zeros(2)
    apart = np.linalg.norm(paths.displacements - common, axis=1)
    still = targets.scale * targets.places[apart < 2.0 * _MIN_DISPLACEMENT]
    crowded = targets.changed is None and count > _FEWEST
    if crowded and not (len(still) and np.ptp(still, axis=0).max() > _SPREAD):
        # Registration may hang on one thing, and the scene be what moves.
        return moved
    jitters = _deviations(targets.sightings).max(axis=1) > _JITTERS
    stands = others & ~targets.moved & (jitters | (length < _BURNT_IN))
    drift = _scatter(paths.displacements[others & ~targets.moved])
    chance = chance_per_test(_FALSE_ALARMS_PER_HOUR, every, tests)
    long, strong = _enough(targets)
    # Most stand still, and those need no closer look.
    far = jitters & (np.maximum(apart, length) > _MIN_DISPLACEMENT / 2.0)
    if targets.changed is not None:
        far &= targets.changed
    for number in np.nonzero(far)[0].tolist():
        frames = int(paths.frames[number])
        seen = ~np.isnan(targets.sightings[number, :, 0])
        if np.count_nonzero(seen) < _SEEN * frames or not paths.is_straight(number):
            continue
        there = stands & (paths.frames >= 0.5 * frames)
        there[number] = False
        near = _nearest(targets.scale * targets.places, number, np.nonzero(there)[0])
        alone = len(near) < _FEWEST
        relative = length[[number]] if alone else paths.relative(number, near)
        least = _MIN_DISPLACEMENT_ALONE if alone else _MIN_DISPLACEMENT
        factor = _STILL_MOVES if targets.moved[number] else 1.0
        if np.mean(relative > factor * least) < _SHARE:
            continue
        by_itself = alone or targets.changed is not None
        if by_itself and not (
            long <= frames <= camera_known and targets.strengths[number] > strong
        ):
            continue
        if targets.changed is not None and _creeps(targets.paths[number][seen]):
            continue
        if targets.scale > 1 and (
            _rests(targets.paths[number]) or _passes_with_scene(targets, number, seen)
        ):
            continue
        # Ends are means of a few places; drift is that of a displacement, which has two.
        drifted = _DRIFT * frames if alone else drift
        shakes = jitter(list(targets.paths[number][seen]), 0.0) / 2.0
        faint = _WIDTH / targets.strengths[number]
        own = float(np.linalg.norm([shakes, drifted / np.sqrt(2.0), faint]))
        wanted = max(significant_displacement(own, 0.0, frames, every, chance), least)
        moved[number] = np.mean(relative > factor * wanted) >= _SHARE
    return moved


def _enough(targets: FollowedTargets) -> tuple[int, float]:
    """Return the fewest frames and the least strength of what little else speaks for."""
    if targets.changed is not None:
        return _CHANGED_LONG, CHANGED_STRONG
    return (_LONG, _STRONG) if targets.scale == 1 else (_LARGE_LONG, _LARGE_STRONG)


def _creeps(path: Points) -> bool:
    """Whether a target's path, Tx2, has led so slowly lately that it may be parallax."""
    recent = path[-_CREEP_SPAN:]
    return bool(np.hypot(*(recent[-1] - recent[0])) < _CREEP * len(recent))


def _rests(path: Points) -> bool:
    """Whether a target's path, Tx2, has led nowhere lately."""
    return bool(np.hypot(*(path[-1] - path[-1 - _LATELY])) < _RESTS)


def _passes_with_scene(targets: FollowedTargets, number: int, seen: Mask) -> bool:
    """Whether a target's own way is so short beside the scene's that it may be parallax.

    What the camera follows has gone as far as the scene has, against it.

    :param seen: the frames that show it, T.
    """
    first, last = np.nonzero(seen)[0][[0, -1]]
    own, in_picture = (
        way[number, last] - way[number, first] for way in (targets.paths, targets.sightings)
    )
    return bool(np.hypot(*own) < _PARALLAX * np.hypot(*(in_picture - own)))


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

    def relative(self, number: int, others: Indices) -> Numbers:
        """Return how far one has moved from each of some others, since both were seen."""
        frames = np.minimum(self.frames[number], self.frames[others])
        own = self._displacements(np.full_like(others, number), frames)
        return np.linalg.norm(own - self._displacements(others, frames), axis=1)

    def is_straight(self, number: int) -> bool:
        """Whether one's displacement is a good part of its path length."""
        path = self._paths[number, self._last - self.frames[number] :: _STEP]
        path_length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        net = float(np.hypot(*self.displacements[number]))
        return net < _MIN_DISPLACEMENT or net > _STRAIGHT * float(path_length)


def _nearest(places: Points, number: int, others: Indices) -> Indices:
    """Return the nearest others of one, each in another part of the picture."""
    nearest = others[np.argsort(np.linalg.norm(places[others] - places[number], axis=1))]
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
