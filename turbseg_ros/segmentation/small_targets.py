"""Targets of a few pixels: what stands out from its surroundings, followed until it has moved.

Flow compares patches; a target smaller than they are, or slower than flow can tell, is lost in it.
But before sky or fog it is the strongest thing within its surroundings, in every single frame. So
it is linked from frame to frame first and judged afterwards, by the way that it has come against
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
from turbseg_ros.segmentation.clutter import CELL
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.significance import chance_per_test, jitter, significant_way
from turbseg_ros.segmentation.track import Detection

Points = npt.NDArray[np.float64]
Levels = npt.NDArray[np.uint16]
Numbers = npt.NDArray[np.float64]

# A target stands out from all of a ring round it: radius of the ring, points on it and side of
# the mean that is compared, in pixels; of the larger ring at half of the resolution.
_RING, _RING_POINTS, _SMALL = 5, 8, 3
_COARSE_POINTS = 12
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
# Frames of a way that are remembered, and those at its end that tell a velocity.
_MEMORY, _RECENT = 96, 12
# Pixels from where a target is expected: when seen once, a few times, often; the last grows by
# that share of its speed.
_GATES, _GATE_OF_SPEED = (6.0, 4.0, 2.0), 0.3
_FEW, _SURE = 4, 8
# Frames that a target may be missed: when seen a few times, often.
_PATIENCE = (2, 6)
# Contrasts of one target differ by no more than this factor.
_ALIKE = 2.5
# Least way in pixels, the same where too little else is there to compare with, and then how much
# of a pixel a frame registration may drift.
_LEAST_WAY, _LEAST_WAY_ALONE, _DRIFT = 2.0, 3.0, 0.015
# Pixels over its strength by which the place of what is faint wanders with what lies behind it.
_WIDTH = 3.5
# Others that a way is compared with, the nearest, the fewest that tell something, and the share of
# them that it must be significant against.
_OTHERS, _FEWEST, _SHARE = 8, 3, 0.75
# Share of the frames that it must be seen in, and side of the parts of the picture that tell
# whether most of it moves.
_SEEN, _PART = 0.6, 72
# Pixels over which what stands still must be spread to be the scene.
_SPREAD = 80
# Least way over the way walked, and least jitter in the picture as it came: less is burnt in.
_STRAIGHT, _BURNT_IN = 0.4, 0.25
# Once it moves, a target does until its way falls below this share of what was wanted.
_STILL_MOVES = 0.7
# Every so many frames ways are judged; false alarms an hour that are let pass.
_EVERY, _FALSE_ALARMS_PER_HOUR = 4, 1.0
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
    """A target that has surely moved, in one frame.

    Place (x, y) and velocity, against the scene, are in pixels (a frame) at processing resolution.
    """

    place: tuple[float, float]
    velocity: tuple[float, float]
    contrast: float


def blobs_in(grey: ByteImage) -> Blobs:
    """Return what stands out from all its surroundings, the strongest first.

    :param grey: HxW at processing resolution.
    """
    # Grey values in sixteenths, for means of small squares are no whole numbers.
    values = cv2.multiply(grey, float(_FRACTIONS), dtype=cv2.CV_16U)
    mean = cv2.blur(values, (_SMALL, _SMALL))
    size = _standing_out(mean, _FINE_RING)
    half = cv2.resize(mean, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    coarse = _standing_out(half, _COARSE_RING)
    size = cv2.max(size, cv2.resize(coarse, grey.shape[::-1], interpolation=cv2.INTER_LINEAR))
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


_FINE_RING, _COARSE_RING = _ring(_RING, _RING_POINTS), _ring(_RING, _COARSE_POINTS)


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
    """Follows what stands out, and tells what of it has surely moved."""

    def __init__(self) -> None:
        # Places of N tracks in the newest frame's coordinates, and as they came; NaN: not seen.
        self._ways: Points = np.zeros((0, _MEMORY, 2))
        self._raw: Points = np.zeros((0, _MEMORY, 2))
        # Where each is expected in the newest frame, its velocity and its contrast.
        self._places: Points = np.zeros((0, 2))
        self._velocities: Points = np.zeros((0, 2))
        self._contrasts: Numbers = np.zeros(0)
        self._strengths: Numbers = np.zeros(0)
        self._hits: npt.NDArray[np.int64] = np.zeros(0, np.int64)
        self._misses: npt.NDArray[np.int64] = np.zeros(0, np.int64)
        self._moves: Mask = np.zeros(0, bool)
        self._count = 0

    def take(self, blobs: Blobs, ego_motion: Matrix, overlay: Mask | None = None) -> None:
        """Take what stands out in the next frame.

        :param ego_motion: takes processing pixels of the frame before to this one's.
        :param overlay: hxw cells that are no scene; None where none are known.
        """
        self._count += 1
        self._propagate(ego_motion)
        blobs = _in_scene(blobs, overlay)
        taken = self._match(blobs)
        self._estimate()
        patience = np.choose(np.digitize(self._hits, (_FEW, _RECENT)), (0, *_PATIENCE))
        kept = self._misses <= patience
        if not kept.all():
            self._keep(kept)
        self._begin(blobs, ~taken)
        if self._count % _EVERY == 0:
            self._judge()

    def moving_at(self, age: int) -> list[SmallTarget]:
        """Return the targets that have surely moved, as seen so many frames before the newest."""
        if age >= _MEMORY:
            return []
        places = self._raw[:, _MEMORY - 1 - age]
        seen = self._moves & ~np.isnan(places[:, 0])
        return [
            SmallTarget(
                (float(places[k, 0]), float(places[k, 1])),
                (float(self._velocities[k, 0]), float(self._velocities[k, 1])),
                float(self._contrasts[k]),
            )
            for k in np.nonzero(seen)[0]
        ]

    def _propagate(self, ego_motion: Matrix) -> None:
        linear, shift = ego_motion[:2, :2].T, ego_motion[:2, 2]
        unseen = np.full((len(self._ways), 1, 2), np.nan)
        self._ways = np.concatenate([self._ways[:, 1:] @ linear + shift, unseen], axis=1)
        self._raw = np.concatenate([self._raw[:, 1:], unseen], axis=1)
        self._velocities = self._velocities @ linear
        self._places = self._places @ linear + shift + self._velocities
        self._misses = self._misses + 1

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
        self._ways[tracks, -1] = self._raw[tracks, -1] = blobs.points[found]
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
        recent = self._ways[:, -_RECENT:]
        seen = ~np.isnan(recent[..., 0])
        count = np.maximum(seen.sum(axis=1), 1)
        age = np.arange(1 - _RECENT, 1)
        mean_age = (seen * age).sum(axis=1) / count
        distance = (age - mean_age[:, None]) * seen
        places = np.where(seen[..., None], recent, 0.0)
        # A short way tells little of a velocity: it is taken to be slower.
        spread = (distance**2).sum(axis=1) + 2.0
        velocity = (distance[..., None] * places).sum(axis=1) / spread[:, None]
        fitted = places.sum(axis=1) / count[:, None] - velocity * mean_age[:, None]
        just = (self._misses == 0) & (self._hits >= 2)
        self._velocities[just] = velocity[just]
        last = self._ways[:, -1]
        steady = just & (self._hits >= _RECENT // 2)
        self._places[just] = last[just]
        self._places[steady] = (last[steady] + fitted[steady]) / 2.0

    def _keep(self, kept: Mask) -> None:
        self._ways, self._raw = self._ways[kept], self._raw[kept]
        self._places, self._velocities = self._places[kept], self._velocities[kept]
        self._contrasts, self._strengths = self._contrasts[kept], self._strengths[kept]
        self._moves = self._moves[kept]
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
        way = np.full((count, _MEMORY, 2), np.nan)
        way[:, -1] = points
        self._ways = np.concatenate([self._ways, way])
        self._raw = np.concatenate([self._raw, way])
        self._places = np.concatenate([self._places, points])
        self._velocities = np.concatenate([self._velocities, np.zeros((count, 2))])
        self._contrasts = np.concatenate([self._contrasts, blobs.contrast[free]])
        self._strengths = np.concatenate([self._strengths, blobs.strength[free]])
        self._hits = np.concatenate([self._hits, np.ones(count, np.int64)])
        self._misses = np.concatenate([self._misses, np.zeros(count, np.int64)])
        self._moves = np.concatenate([self._moves, np.zeros(count, bool)])

    def _judge(self) -> None:
        """Tell which tracks have surely moved."""
        known = np.nonzero(self._hits >= _SURE)[0]
        if not len(known):
            return
        seen = ~np.isnan(self._ways[known, :, 0])
        first = seen.argmax(axis=1)
        come = self._places[known] - self._ways[known, first]
        drift = _scatter(come[~self._moves[known]])
        # Most stand still, and those need no closer look.
        apart = np.linalg.norm(come - np.median(come, axis=0), axis=1)
        far = (apart > _LEAST_WAY / 2.0) | (np.linalg.norm(come, axis=1) > _LEAST_WAY / 2.0)
        moves = np.zeros(len(self._hits), bool)
        still = self._places[known[apart < 2.0 * _LEAST_WAY]]
        if len(known) > _FEWEST and not (len(still) and np.ptp(still, axis=0).max() > _SPREAD):
            # Registration may hang on one thing, and the scene be what moves.
            far = np.zeros_like(far)
        for number in np.nonzero(far)[0].tolist():
            moves[known[number]] = self._has_moved(known, number, seen[number], first, drift)
        self._moves = moves
        # Where most of what stands out moves, it is the scene, and the camera is known badly.
        if moves.any() and self._places_of(moves) > max(self._places_of(_at(known, ~moves)), 1):
            self._moves = np.zeros_like(moves)

    def _places_of(self, which: Mask) -> int:
        """Count the parts of the picture that some tracks are in: a large thing is in one."""
        return len(np.unique(self._places[which] // _PART, axis=0))

    def _has_moved(
        self,
        known: npt.NDArray[np.intp],
        number: int,
        seen: Mask,
        first: npt.NDArray[np.intp],
        drift: float,
    ) -> bool:
        """Whether a track has come further than chance and what is near it would take it.

        :param known: tracks seen for long enough; `number` says which of them it is, `first` when
            each was seen first.
        :param seen: when it was seen.
        :param drift: standard deviation an axis of the ways of all that stand still.
        """
        k, frames = known[number], _MEMORY - int(first[number])
        way = self._ways[k][seen]
        if len(way) < _SEEN * frames or not self._trembles(k, seen) or not _straight(way):
            return False
        others = self._nearest(known, number, first, frames)
        alone = len(others) < _FEWEST
        # Ends are means of a few places; drift is that of a way, which has two.
        wander = _DRIFT * frames if alone else drift
        faint = _WIDTH / self._strengths[k]
        own = np.linalg.norm([jitter(list(way), 0.0) / 2.0, wander / np.sqrt(2.0), faint])
        chance = chance_per_test(_FALSE_ALARMS_PER_HOUR, _EVERY, _MOST)
        wanted = significant_way(float(own), 0.0, frames, _EVERY, chance)
        wanted = max(wanted, _LEAST_WAY_ALONE if alone else _LEAST_WAY)
        wanted *= _STILL_MOVES if self._moves[k] else 1.0
        if alone:
            return bool(np.hypot(*_net(way)) > wanted)
        relative = self._relative_ways(known, number, others, first)
        return bool(np.mean(relative > wanted) >= _SHARE)

    def _trembles(self, k: int, seen: Mask) -> bool:
        """Whether a track is not fixed to the picture itself, as what is burnt in."""
        return bool(self._raw[k][seen].std(axis=0).max() > _BURNT_IN)

    def _nearest(
        self, known: npt.NDArray[np.intp], number: int, first: npt.NDArray[np.intp], frames: int
    ) -> npt.NDArray[np.intp]:
        """Return the numbers of the nearest other tracks that were there for half as long."""
        there = (_MEMORY - first) >= 0.5 * frames
        there[number] = False
        others = np.nonzero(there)[0]
        distance = np.linalg.norm(
            self._places[known[others]] - self._places[known[number]], axis=1
        )
        return others[np.argsort(distance)[:_OTHERS]]

    def _relative_ways(
        self,
        known: npt.NDArray[np.intp],
        number: int,
        others: npt.NDArray[np.intp],
        first: npt.NDArray[np.intp],
    ) -> Numbers:
        """Return how far a track has come from each of some others, since both were seen."""
        ways = []
        for other in others:
            since = max(int(first[number]), int(first[other]))
            here, there = (_net(_seen(self._ways[known[n], since:])) for n in (number, other))
            ways.append(float(np.hypot(*(here - there))))
        return np.array(ways)


def _at(known: npt.NDArray[np.intp], which: Mask) -> Mask:
    """Return which tracks are known and among those of a mask."""
    chosen = np.zeros(len(which), bool)
    chosen[known] = which[known]
    return chosen


def _seen(way: Points) -> Points:
    return way[~np.isnan(way[:, 0])]


def _net(way: Points) -> Points:
    """Return the way from the first places to the last ones, (x, y)."""
    few = min(4, max(len(way) // 3, 1))
    return np.asarray(way[-few:].mean(axis=0) - way[:few].mean(axis=0))


def _straight(way: Points) -> bool:
    steps = np.linalg.norm(np.diff(way[::_EVERY], axis=0), axis=1).sum()
    net = float(np.hypot(*_net(way)))
    return net < _LEAST_WAY or net > _STRAIGHT * float(steps)


def _scatter(nets: Points) -> float:
    """Return the standard deviation an axis of ways that should be alike."""
    if not len(nets):
        return 0.0
    lengths = np.linalg.norm(nets - np.median(nets, axis=0), axis=1)
    return float(np.median(lengths)) / 1.1774


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
    """Return detections, those that show a target surely moving, and the other targets with them.

    :param image: HxWxC at detail resolution.
    """
    result = list(detections)
    for target in targets:
        found = _detection(target, image, resolution)
        if found is None:
            continue
        around = found.outline.dilated(2, resolution.detail_shape)
        there = [n for n, each in enumerate(result) if around.shares_pixels(each.outline)]
        if not there:
            result.append(found)
            continue
        for n in there:
            if result[n].area < _MUCH_LARGER * found.area:
                result[n] = replace(result[n], moving=True, surely_moves=True)
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
        surely_moves=True,
    )
