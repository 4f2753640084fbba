"""Targets: what stands out from its surroundings, followed until it has moved.

Flow compares patches; a target smaller than they are, or slower than flow can tell, is lost in it,
and a boat among waves that move as much as it does. But before sky, fog or water it is the
strongest thing within its surroundings, in every single frame. So it is linked from frame to frame
first and judged afterwards, by its displacement against what else stands out near it: that is not
misled by a camera whose motion is known badly, nor by one that follows the target.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import Mask, Matrix
from turbseg_ros.segmentation.blobs import MOST, SMALL, Blobs, Numbers, Points
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.clutter import at_points
from turbseg_ros.segmentation.geometry import scaling
from turbseg_ros.segmentation.target_motion import (
    Counts,
    FollowedTargets,
    Indices,
    have_moved,
    parts_of,
)

# Frames of a path that are remembered, and those at its end that tell a velocity.
_MEMORY, _RECENT = 96, 12
# Pixels from where a target is expected: when seen once, a few times, often; the last grows by
# that share of its speed.
_GATES, _GATE_OF_SPEED = (6.0, 4.0, 2.0), 0.3
_FEW, _SURE = 4, 8
# Frames that a target may be missed: when seen a few times, often.
_MAX_MISSES = (2, 6)
# Contrasts of one target differ by no more than this factor.
_ALIKE = 2.5
EVERY = 4
"""Every so many frames paths are judged."""


@dataclass(frozen=True)
class Target:
    """A target that has moved significantly, in one frame.

    Place (x, y) and velocity, against the scene, are in pixels (a frame) at processing resolution;
    `number` is the same in all its frames. It was found in a picture `scale` times smaller, and
    has been known to move for so many `frames`; `by_change` tells whether it was found in what has
    changed.
    """

    place: tuple[float, float]
    velocity: tuple[float, float]
    contrast: float
    number: int
    scale: int = 1
    frames: int = 0
    by_change: bool = False

    @property
    def is_small(self) -> bool:
        """Whether it was found in the picture as it is."""
        return self.scale == 1


class TargetTracks:
    """Follows what stands out at one scale, and tells what of it has moved significantly."""

    _by_change = False

    def __init__(self, scale: int = 1, numbers: Iterator[int] | None = None) -> None:
        """Set up tracks of nothing.

        :param scale: by how many times the pictures are smaller than at processing resolution.
        :param numbers: those of the targets to come.
        """
        self._scale = scale
        self._new_numbers = itertools.count(1) if numbers is None else numbers
        # Take processing pixels to those of the smaller picture, and back.
        self._to_smaller = scaling(1.0 / scale, 1.0 / scale)
        self._from_smaller = scaling(scale, scale)
        # Places of N tracks in the newest frame's coordinates, from where each was first seen to
        # where it is, and before that NaN; and as they came, NaN where it was not seen.
        self._paths: Points = np.zeros((0, _MEMORY, 2))
        self._raw: Points = np.zeros((0, _MEMORY, 2))
        # Where each is expected in the newest frame, its velocity and its contrast.
        self._places: Points = np.zeros((0, 2))
        self._velocities: Points = np.zeros((0, 2))
        self._contrasts: Numbers = np.zeros(0)
        self._strengths: Numbers = np.zeros(0)
        self._hits: Counts = np.zeros(0, np.int64)
        self._misses: Counts = np.zeros(0, np.int64)
        # For how many frames each has been known to move, 0 where it isn't.
        self._moved_for: Counts = np.zeros(0, np.int64)
        self._numbers: Counts = np.zeros(0, np.int64)
        self._count = 0
        # Frames since the camera's motion was not known.
        self._since_lost = 0

    def take(
        self,
        blobs: Blobs,
        ego_motion: Matrix,
        state: CameraState = CameraState.STILL,
        overlay: Mask | None = None,
        known: Mask | None = None,
    ) -> None:
        """Take what stands out in the next frame.

        :param ego_motion: takes processing pixels of the frame before to this one's.
        :param state: what the camera does in it.
        :param overlay: hxw cells that are no scene; None where none are known.
        :param known: hxw cells of known objects, in which no new target is looked for.
        """
        self._count += 1
        self._moved_for[self._moved_for > 0] += 1
        self._since_lost = 0 if state is CameraState.LOST else self._since_lost + 1
        self._propagate(self._to_smaller @ ego_motion @ self._from_smaller)
        blobs = self._in_scene(blobs, overlay)
        taken = self._match(blobs)
        self._estimate()
        max_misses = np.choose(np.digitize(self._hits, (_FEW, _RECENT)), (0, *_MAX_MISSES))
        self._end(self._misses > max_misses)
        free = ~taken if known is None else ~taken & ~at_points(known, blobs.points)
        self._begin(blobs, free)
        if self._count % EVERY == 0 and state is not CameraState.SLEWING:
            self._judge()

    def moving_at(self, age: int) -> list[Target]:
        """Return the targets that have moved, as seen so many frames before the newest."""
        if age >= _MEMORY:
            return []
        # To pixels at processing resolution.
        places = self._scale * (self._raw[:, _MEMORY - 1 - age] + 0.5) - 0.5
        velocities = self._scale * self._velocities
        seen = (self._moved_for > 0) & ~np.isnan(places[:, 0])
        return [
            Target(
                (float(places[k, 0]), float(places[k, 1])),
                (float(velocities[k, 0]), float(velocities[k, 1])),
                float(self._contrasts[k]),
                int(self._numbers[k]),
                self._scale,
                int(self._moved_for[k]),
                self._by_change,
            )
            for k in np.nonzero(seen)[0]
        ]

    def _in_scene(self, blobs: Blobs, overlay: Mask | None) -> Blobs:
        """Return what lies in no cell that is no scene."""
        if overlay is None or not overlay.any():
            return blobs
        near = cv2.dilate(overlay.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
        return blobs.chosen(~at_points(near, self._scale * blobs.points))

    def _propagate(self, ego_motion: Matrix) -> None:
        linear, shift = ego_motion[:2, :2].T, ego_motion[:2, 2]
        self._velocities = self._velocities @ linear
        self._places = self._places @ linear + shift + self._velocities
        self._paths[:, :-1] = self._paths[:, 1:] @ linear + shift
        self._paths[:, -1] = self._places
        self._raw[:, :-1] = self._raw[:, 1:]
        self._raw[:, -1] = np.nan
        self._misses += 1

    def _match(self, blobs: Blobs) -> Mask:
        """Give tracks what is next to where they are expected; return which blobs were given."""
        taken = np.zeros(len(blobs.contrast), bool)
        if not (len(self._hits) and len(taken)):
            return taken
        distance = np.linalg.norm(self._places[:, None] - blobs.points, axis=2)
        change = blobs.contrast / self._contrasts[:, None]
        gate = np.choose(
            np.digitize(self._hits, (2, _FEW)),
            (*_GATES[:2], _GATES[2] + _GATE_OF_SPEED * np.linalg.norm(self._velocities, axis=1)),
        )
        near = distance < gate[:, None] + 0.5 * (self._misses[:, None] - 1)
        near &= (change > 1.0 / _ALIKE) & (change < _ALIKE)
        # What was just seen for the first time goes nowhere if it may go to several places.
        near &= (self._hits[:, None] >= _FEW) | (near.sum(axis=1)[:, None] == 1)
        cost = distance + 2.0 * np.abs(np.log(np.clip(change, 1e-3, 1e3)))
        cost = np.where(near, cost - 3.0 * (self._hits[:, None] >= _SURE), np.inf)
        best_blob, best_track = cost.argmin(axis=1), cost.argmin(axis=0)
        tracks = np.nonzero(near.any(axis=1) & (best_track[best_blob] == np.arange(len(cost))))[0]
        found = best_blob[tracks]
        taken[found] = True
        self._paths[tracks, -1] = self._raw[tracks, -1] = blobs.points[found]
        for mean, now in (
            (self._contrasts, blobs.contrast),
            (self._strengths, blobs.strength),
        ):
            mean[tracks] += 0.2 * (now[found] - mean[tracks])
        self._hits[tracks] += 1
        self._misses[tracks] = 0
        return taken

    def _estimate(self) -> None:
        """Fit a line to the recent places of those just seen: their velocity and place."""
        recent = self._paths[:, -_RECENT:]
        seen = ~np.isnan(self._raw[:, -_RECENT:, 0])
        count = np.maximum(seen.sum(axis=1), 1)
        age = np.arange(1 - _RECENT, 1)
        mean_age = (seen * age).sum(axis=1) / count
        distance = (age - mean_age[:, None]) * seen
        places = np.where(seen[..., None], recent, 0.0)
        # A short path tells little of a velocity: it is taken to be slower.
        spread = (distance**2).sum(axis=1) + 2.0
        velocity = (distance[..., None] * places).sum(axis=1) / spread[:, None]
        fitted = places.sum(axis=1) / count[:, None] - velocity * mean_age[:, None]
        just = (self._misses == 0) & (self._hits >= 2)
        self._velocities[just] = velocity[just]
        last = self._paths[:, -1]
        steady = just & (self._hits >= _RECENT // 2)
        self._places[just] = last[just]
        self._places[steady] = (last[steady] + fitted[steady]) / 2.0

    def _end(self, ended: Mask) -> None:
        """End some tracks, N."""
        if not ended.any():
            return
        kept = ~ended
        self._paths, self._raw = self._paths[kept], self._raw[kept]
        self._places, self._velocities = self._places[kept], self._velocities[kept]
        self._contrasts, self._strengths = self._contrasts[kept], self._strengths[kept]
        self._moved_for, self._numbers = self._moved_for[kept], self._numbers[kept]
        self._hits, self._misses = self._hits[kept], self._misses[kept]

    def _begin(self, blobs: Blobs, free: Mask) -> None:
        """Begin tracks with blobs that are free and lie beside no track."""
        if len(self._places) and len(free):
            distance = np.linalg.norm(self._places[:, None] - blobs.points, axis=2)
            free = free & (distance.min(axis=0) > SMALL)
        points = blobs.points[free]
        count = len(points)
        if not count:
            return
        path = np.full((count, _MEMORY, 2), np.nan)
        path[:, -1] = points
        numbers = np.fromiter(itertools.islice(self._new_numbers, count), np.int64)
        self._paths = np.concatenate([self._paths, path])
        self._raw = np.concatenate([self._raw, path])
        self._places = np.concatenate([self._places, points])
        self._velocities = np.concatenate([self._velocities, np.zeros((count, 2))])
        self._contrasts = np.concatenate([self._contrasts, blobs.contrast[free]])
        self._strengths = np.concatenate([self._strengths, blobs.strength[free]])
        self._hits = np.concatenate([self._hits, np.ones(count, np.int64)])
        self._misses = np.concatenate([self._misses, np.zeros(count, np.int64)])
        self._moved_for = np.concatenate([self._moved_for, np.zeros(count, np.int64)])
        self._numbers = np.concatenate([self._numbers, numbers])

    def _judge(self) -> None:
        """Tell which tracks have moved significantly."""
        known = self.seen_often
        moved = have_moved(self.followed(known), EVERY, MOST, self._since_lost)
        places = self._scale * self._places[known]
        if moved.any() and parts_of(places[moved]) > max(parts_of(places[~moved]), 1):
            # Where most of what stands out moves, it is the scene, and the camera is known badly.
            moved[:] = False
        self._remember_moved(known, moved)

    def _remember_moved(self, known: Indices, moved: Mask) -> None:
        """Remember which of the known tracks have moved; no other has."""
        for_frames = np.where(moved, np.maximum(self._moved_for[known], 1), 0)
        self._moved_for[:] = 0
        self._moved_for[known] = for_frames

    @property
    def seen_often(self) -> Indices:
        """The tracks that were seen often enough to be judged."""
        return np.nonzero(self._hits >= _SURE)[0]

    def followed(self, which: Indices) -> FollowedTargets:
        """Return some of them as they are judged."""
        return FollowedTargets(
            self._paths[which],
            self._raw[which],
            self._places[which],
            self._strengths[which],
            self._moved_for[which] > 0,
            self._scale,
        )
