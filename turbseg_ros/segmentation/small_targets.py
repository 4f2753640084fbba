"""Targets of a few pixels: what stands out from its surroundings, followed until it has moved.

Flow compares patches; a target smaller than they are, or slower than flow can tell, is lost in it.
But before sky or fog it is the strongest thing within its surroundings, in every single frame. So
it is linked from frame to frame first and judged afterwards, by its displacement against
what else stands out near it: that is not misled by a camera whose motion is known badly, nor by
one that follows the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.clutter import CELL
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.target_motion import FollowedTargets, have_moved, parts_of
from turbseg_ros.segmentation.track import Detection

Points = npt.NDArray[np.float64]
Levels = npt.NDArray[np.uint16]
Numbers = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

# A target stands out from all of a ring round it: radius of the ring, points on it and side of
# the mean that is compared, in pixels. What is larger is for flow to find.
_RING, _RING_POINTS, _SMALL = 5, 8, 3
# By so many times what pixels differ from their neighbours nearby, and so many of them a frame.
_STANDS_OUT, _MOST = 2.5, 24
# Side in pixels of the cells that what is usual is told for, and of the square of cells nearby.
_CELL, _NEARBY = 4, 5
# What lies within such a square is one target.
_APART = np.ones((9, 9), np.uint8)
# Grey values that a picture is taken to differ by at least.
_ROUNDING = 0.5
# Parts of a grey value that are told apart.
_FRACTIONS = 16
# Pixels from the border of the picture within which there is no ring.
_MARGIN = 6
# Pixels within which a target's middle is told.
_REACH = 4
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
# Every so many frames paths are judged.
_EVERY = 4
# Square, in detail pixels, in which an outline is drawn, and its share of the contrast.
_CROP, _EDGE = 14, 0.4
# Area in detail pixels below which an outline is widened by a pixel.
_TINY = 12
# An outline more than so many times as large as a target shows another thing.
_MUCH_LARGER = 25


@dataclass(frozen=True)
class Blobs:
    """What stands out in a frame: `points`, Nx2 (x, y) at processing resolution.

    `contrast`, N, is by how many grey values, negative where darker, `strength`, N, by how many
    times what pixels nearby differ from their neighbours.
    """

    points: Points
    contrast: Numbers
    strength: Numbers


NO_BLOBS = Blobs(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class SmallTarget:
    """A target that has moved significantly, in one frame.

    Place (x, y) and velocity, against the scene, are in pixels (a frame) at processing resolution;
    `number` is the same in all its frames.
    """

    place: tuple[float, float]
    velocity: tuple[float, float]
    contrast: float
    number: int


def blobs_in(grey: ByteImage) -> Blobs:
    """Return what stands out from all its surroundings, the strongest first.

    :param grey: HxW at processing resolution.
    """
    # Grey values in sixteenths, for means of small squares are no whole numbers.
    values = cv2.multiply(grey, float(_FRACTIONS), dtype=cv2.CV_16U)
    mean = cv2.blur(values, (_SMALL, _SMALL))
    size = _standing_out(mean, _AROUND)
    least = _STANDS_OUT * _ROUNDING * _FRACTIONS
    peaks = cv2.compare(size, cv2.dilate(size, _APART), cv2.CMP_GE)
    peaks &= cv2.compare(size, least, cv2.CMP_GT)
    inner = np.ascontiguousarray(peaks[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])
    found = cv2.findNonZero(inner)
    if found is None:
        return NO_BLOBS
    x, y = (found.reshape(-1, 2).astype(np.intp) + _MARGIN).T
    # How much pixels differ from their neighbours is told for coarse cells.
    differ = cv2.absdiff(values, mean)
    differ = cv2.resize(differ, None, fx=1 / _CELL, fy=1 / _CELL, interpolation=cv2.INTER_AREA)
    usual = cv2.blur(differ, (_NEARBY, _NEARBY))
    last_row, last_column = usual.shape[0] - 1, usual.shape[1] - 1
    rows, columns = np.minimum(y // _CELL, last_row), np.minimum(x // _CELL, last_column)
    strength = size[y, x] / (usual[rows, columns] + _ROUNDING * _FRACTIONS)
    order = np.argsort(-strength)[:_MOST]
    order = order[strength[order] > _STANDS_OUT]
    if not len(order):
        return NO_BLOBS
    y, x = y[order], x[order]
    around = _windows(mean, x, y, _RING)
    brighter = mean[y, x] > np.median(around.reshape(len(x), -1), axis=1)
    contrast = np.where(brighter, 1.0, -1.0) * size[y, x]
    return Blobs(_middles(mean, x, y, contrast), contrast / _FRACTIONS, strength[order])


def _ring(radius: int, points: int) -> npt.NDArray[np.uint8]:
    angles = 2.0 * np.pi * np.arange(points) / points
    ring = np.zeros((2 * radius + 1, 2 * radius + 1), np.uint8)
    rows, columns = np.rint(radius * np.sin(angles)), np.rint(radius * np.cos(angles))
    ring[radius + rows.astype(int), radius + columns.astype(int)] = 1
    return ring


_AROUND = _ring(_RING, _RING_POINTS)


def _standing_out(values: Levels, ring: npt.NDArray[np.uint8]) -> Levels:
    """Return by how much each pixel lies above or below all of a ring round it, 0 if within."""
    above = cv2.subtract(values, cv2.dilate(values, ring))
    below = cv2.subtract(cv2.erode(values, ring), values)
    return np.asarray(cv2.max(above, below))


def _windows(
    values: Levels, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], reach: int
) -> Levels:
    """Return the values around pixels that lie further than that from the border, Nxnxn."""
    around = np.arange(-reach, reach + 1)
    return values[y[:, None, None] + around[:, None], x[:, None, None] + around]


def _middles(
    mean: Levels, x: npt.NDArray[np.intp], y: npt.NDArray[np.intp], contrast: Numbers
) -> Points:
    """Return the middles (x, y) of what stands out around pixels, Nx2."""
    around = np.arange(-_REACH, _REACH + 1)
    sign, size = np.sign(contrast)[:, None, None], np.abs(contrast)[:, None, None]
    excess = _windows(mean, x, y, _REACH) - mean[y, x].astype(np.float64)[:, None, None]
    weight = np.maximum(excess * sign + size / 2, 0.0)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-6)
    across = (weight.sum(axis=1) * around).sum(axis=1) / total
    down = (weight.sum(axis=2) * around).sum(axis=1) / total
    return np.stack([x + across, y + down], axis=1)


class TargetTracks:
    """Follows what stands out, and tells what of it has moved significantly."""

    def __init__(self) -> None:
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
        self._moves: Mask = np.zeros(0, bool)
        self._numbers: Counts = np.zeros(0, np.int64)
        self._begun = 0
        self._count = 0
        # Frames since the camera's motion was not known.
        self._since_lost = 0

    def take(
        self,
        blobs: Blobs,
        ego_motion: Matrix,
        state: CameraState = CameraState.STILL,
        overlay: Mask | None = None,
    ) -> None:
        """Take what stands out in the next frame.

        :param ego_motion: takes processing pixels of the frame before to this one's.
        :param state: what the camera does in it.
        :param overlay: hxw cells that are no scene; None where none are known.
        """
        self._count += 1
        self._since_lost = 0 if state is CameraState.LOST else self._since_lost + 1
        self._propagate(ego_motion)
        blobs = _in_scene(blobs, overlay)
        taken = self._match(blobs)
        self._estimate()
        max_misses = np.choose(np.digitize(self._hits, (_FEW, _RECENT)), (0, *_MAX_MISSES))
        kept = self._misses <= max_misses
        if not kept.all():
            self._keep(kept)
        self._begin(blobs, ~taken)
        if self._count % _EVERY == 0 and state is not CameraState.SLEWING:
            self._judge()

    def moving_at(self, age: int) -> list[SmallTarget]:
        """Return the targets that have moved, as seen so many frames before the newest."""
        if age >= _MEMORY:
            return []
        places = self._raw[:, _MEMORY - 1 - age]
        seen = self._moves & ~np.isnan(places[:, 0])
        return [
            SmallTarget(
                (float(places[k, 0]), float(places[k, 1])),
                (float(self._velocities[k, 0]), float(self._velocities[k, 1])),
                float(self._contrasts[k]),
                int(self._numbers[k]),
            )
            for k in np.nonzero(seen)[0]
        ]

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

    def _keep(self, kept: Mask) -> None:
        self._paths, self._raw = self._paths[kept], self._raw[kept]
        self._places, self._velocities = self._places[kept], self._velocities[kept]
        self._contrasts, self._strengths = self._contrasts[kept], self._strengths[kept]
        self._moves, self._numbers = self._moves[kept], self._numbers[kept]
        self._hits, self._misses = self._hits[kept], self._misses[kept]

    def _begin(self, blobs: Blobs, free: Mask) -> None:
        """Begin tracks with blobs that are free and lie beside no track."""
        if len(self._places) and len(free):
            distance = np.linalg.norm(self._places[:, None] - blobs.points, axis=2)
            free = free & (distance.min(axis=0) > _SMALL)
        points = blobs.points[free]
        count = len(points)
        if not count:
            return
        path = np.full((count, _MEMORY, 2), np.nan)
        path[:, -1] = points
        numbers = np.arange(self._begun + 1, self._begun + count + 1)
        self._begun += count
        self._paths = np.concatenate([self._paths, path])
        self._raw = np.concatenate([self._raw, path])
        self._places = np.concatenate([self._places, points])
        self._velocities = np.concatenate([self._velocities, np.zeros((count, 2))])
        self._contrasts = np.concatenate([self._contrasts, blobs.contrast[free]])
        self._strengths = np.concatenate([self._strengths, blobs.strength[free]])
        self._hits = np.concatenate([self._hits, np.ones(count, np.int64)])
        self._misses = np.concatenate([self._misses, np.zeros(count, np.int64)])
        self._moves = np.concatenate([self._moves, np.zeros(count, bool)])
        self._numbers = np.concatenate([self._numbers, numbers])

    def _judge(self) -> None:
        """Tell which tracks have moved significantly."""
        known = np.nonzero(self._hits >= _SURE)[0]
        followed = FollowedTargets(
            self._paths[known],
            self._raw[known],
            self._places[known],
            self._strengths[known],
            self._moves[known],
        )
        moved = have_moved(followed, _EVERY, _MOST, self._since_lost)
        # Where most of what stands out moves, it is the scene, and the camera is known badly.
        places = followed.places
        if moved.any() and parts_of(places[moved]) > max(parts_of(places[~moved]), 1):
            moved[:] = False
        self._moves = np.zeros(len(self._hits), bool)
        self._moves[known] = moved


def _in_scene(blobs: Blobs, overlay: Mask | None) -> Blobs:
    if overlay is None or not overlay.any():
        return blobs
    near = cv2.dilate(overlay.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    column, row = (blobs.points.T // CELL).astype(int)
    rows, columns = near.shape
    scene = ~near[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    return Blobs(blobs.points[scene], blobs.contrast[scene], blobs.strength[scene])


def with_targets(
    detections: Sequence[Detection],
    targets: Sequence[SmallTarget],
    image: ByteImage,
    resolution: Resolution,
) -> list[Detection]:
    """Return detections, those that show a moving target, and the other moving targets.

    :param image: HxWxC at detail resolution.
    """
    result = list(detections)
    for target in targets:
        found = _detection(target, image, resolution)
        if found is None:
            continue
        around = found.outline.dilated(2, resolution.detail_shape)
        there = [
            n
            for n, each in enumerate(result)
            if not each.hidden and around.shares_pixels(each.outline)
        ]
        if not there:
            result.append(found)
            continue
        for n in there:
            if result[n].area < _MUCH_LARGER * found.area:
                targets_there = result[n].targets | found.targets
                result[n] = replace(result[n], moving=True, targets=targets_there)
    return result


def _detection(target: SmallTarget, image: ByteImage, resolution: Resolution) -> Detection | None:
    """Outline a target in its surroundings; None where nothing stands out there."""
    scale_x, scale_y = resolution.detail_from_processing
    x, y = (target.place[0] + 0.5) * scale_x - 0.5, (target.place[1] + 0.5) * scale_y - 0.5
    shape = resolution.detail_shape
    middle = Box(round(x), round(y), round(x) + 1, round(y) + 1)
    box = middle.padded(_CROP, shape)
    if min(box.shape) < 2 * _SMALL:
        return None
    crop = image[box.slices].astype(np.float32).mean(axis=2) * np.sign(target.contrast)
    rim = np.concatenate([crop[0], crop[-1], crop[:, 0], crop[:, -1]])
    difference = crop - np.median(rim)
    core = middle.padded(2, shape).moved(-box.x0, -box.y0).slices
    peak = float(difference[core].max())
    if peak <= 0.0:
        return None
    _, parts = cv2.connectedComponents((difference > _EDGE * peak).astype(np.uint8))
    row, column = np.unravel_index(int(difference[core].argmax()), difference[core].shape)
    mask = parts == parts[core][row, column]
    if np.count_nonzero(mask) < _TINY:
        mask = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    outline = CroppedMask.of(mask, box.x0, box.y0)
    return Detection(
        box=outline.box,
        mask=outline.mask,
        velocity=(target.velocity[0] * scale_x, target.velocity[1] * scale_y),
        moving=True,
        targets=frozenset([target.number]),
    )
