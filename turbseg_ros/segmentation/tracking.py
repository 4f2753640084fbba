"""Which object of this frame is which of the frames before: ids that stay.

Positions and masks are in detail pixels. Before each frame every track is carried along by the
ego-motion, so that velocities are against the scene.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from turbseg_ros.segmentation.background import Box

Mask = npt.NDArray[np.bool_]
Matrix = npt.NDArray[np.float64]
Point = npt.NDArray[np.float64]

_UNMATCHABLE = 1e6
# How far a centroid may stray from its prediction, in diagonals of the object.
_REACH = 0.6
_TRAIL_LENGTH = 60
# Share of a candidate that must lie where an object is expected for it to be a part of it.
_PART = 0.5
# Share of an object's expected mask that must lie in a candidate for the candidate to hold it.
_HELD = 0.5
# Share of the way its flow claims that a track must really have come to become an object, and to
# stay one: flow bleeds past an object's edge, and what sways or ripples gets nowhere.
_HONESTY = 0.5
_LEAST_HONESTY = 0.25
# Least IoU of a mask with the one before, moved along, on average over the frames of confirmation
# and, for an object, over a longer span: leaves and waves change their shape all the time.
_LIKE = 0.4
_SHAPE_SPAN = 12
# Frames over which an object's way is compared with what it claims, and frames for which the
# place of one that got nowhere is remembered.
_HONESTY_SPAN = 24
_RESTLESS_SPAN = 300


@dataclass(frozen=True)
class Candidate:
    """A silhouette that may be an object: hxw mask within its box, and how it moves.

    `velocity` is in pixels a frame against the scene; `moving` tells whether motion was found in
    this frame, or only an outline that stands out where an object is known to be.
    """

    box: Box
    mask: Mask
    velocity: tuple[float, float]
    moving: bool

    @property
    def area(self) -> int:
        """Number of its pixels."""
        return int(np.count_nonzero(self.mask))

    @property
    def centroid(self) -> Point:
        """Mean (x, y) of its pixels."""
        moments = cv2.moments(self.mask.astype(np.uint8), binaryImage=True)
        area = max(moments["m00"], 1.0)
        return np.array([moments["m10"] / area + self.box.x0, moments["m01"] / area + self.box.y0])


@dataclass(eq=False)
class Track:
    """One object through time."""

    candidate: Candidate
    kalman: cv2.KalmanFilter
    birthplace: Point
    id: int = 0
    slot: int = -1
    hits: int = 1
    misses: int = 0
    still: int = 0
    claims: list[float] = field(default_factory=list)
    likeness: list[float] = field(default_factory=list)
    confirmed: bool = False
    trail: list[Point] = field(default_factory=list)

    @property
    def position(self) -> Point:
        """Estimated centroid (x, y)."""
        # A copy: OpenCV gives a view of what the next prediction overwrites.
        return np.array(self.kalman.statePost[:2, 0], dtype=np.float64)

    @property
    def size(self) -> float:
        """Diagonal of the box around it."""
        return float(np.hypot(*self.candidate.box.shape))

    def keeps_shape(self, frames: int, least: float) -> bool:
        """Tell whether its masks of the last frames were alike: at least so much IoU a frame."""
        recent = self.likeness[-frames:]
        return len(recent) < frames or float(np.mean(recent)) >= least

    def gets_nowhere(self) -> bool:
        """Tell whether, for a good while, it has come a small part of the way that it claims."""
        claimed = sum(self.claims[-_HONESTY_SPAN:])
        if len(self.trail) < _HONESTY_SPAN or claimed < 0.5 * self.size:
            return False
        come = float(np.linalg.norm(self.trail[-1] - self.trail[-_HONESTY_SPAN]))
        return come < _LEAST_HONESTY * claimed

    @property
    def velocity(self) -> tuple[float, float]:
        """Estimated velocity in pixels a frame against the scene."""
        vx, vy = self.kalman.statePost[2:, 0]
        return float(vx), float(vy)


@dataclass(frozen=True)
class _Place:
    """A place where something moved and got nowhere: its middle (x, y) and its radius."""

    middle: Point
    radius: float
    age: int = 0

    def holds(self, point: Point) -> bool:
        return float(np.linalg.norm(point - self.middle)) < self.radius

    def carried(self, ego_motion: Matrix) -> _Place:
        middle = ego_motion[:2, :2] @ self.middle + ego_motion[:2, 2]
        return _Place(middle, self.radius, self.age + 1)


@dataclass(frozen=True)
class Observation:
    """A track seen in one frame; `track` may become confirmed only later."""

    track: Track
    candidate: Candidate
    velocity: tuple[float, float]
    trail: tuple[tuple[float, float], ...]


class IdentityKeeper(Protocol):
    """Gives the objects of one frame the identities they had in others."""

    @property
    def delay(self) -> int:
        """Frames that must follow before it is known which tracks are objects."""

    @property
    def next_id(self) -> int:
        """The id that the next object will get."""

    def continue_ids(self, other: IdentityKeeper) -> None:
        """Go on counting where another one stands."""

    def reset(self) -> None:
        """End all tracks; ids go on."""

    def expected_masks(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Mask]:
        """Give where each object should be in the coming frame: HxW masks.

        :param ego_motion: takes the last frame's pixels to the coming one's.
        """

    def update(
        self, candidates: Sequence[Candidate], ego_motion: Matrix, tilt: float
    ) -> list[Observation]:
        """Give an observation for each candidate that stands for a track.

        :param ego_motion: takes the last frame's pixels to this one's.
        :param tilt: rms turbulent motion an axis in pixels.
        """

    def settle(self) -> None:
        """Decide what is open: no frame follows."""


class ObjectTracker:
    """Constant-velocity Kalman filters, matched to candidates by the Hungarian method.

    A track becomes an object once it was seen often enough and has travelled: what shimmers or
    sways on the spot does not. It keeps its id and slot until it has been lost for `patience`
    frames. Ids count up and are never used again.
    """

    def __init__(self, confirmation: int, travel: float, patience: int, slots: int) -> None:
        """Set up a tracker without tracks.

        :param confirmation: frames in which a track must be seen to become an object.
        :param travel: distance in pixels that it must have come, plus twice the tilt.
        :param patience: frames that an object may be lost, or stand still, before it ends.
        :param slots: number of output slots.
        """
        self._confirmation = confirmation
        self._travel = travel
        self._patience = patience
        self._free_slots = list(range(slots))
        self._tracks: list[Track] = []
        self._restless: list[_Place] = []
        self._next_id = 1

    @property
    def delay(self) -> int:
        """Frames until a track that is seen in each of them is confirmed."""
        return self._confirmation - 1

    @property
    def next_id(self) -> int:
        """The id that the next object will get."""
        return self._next_id

    def continue_ids(self, other: IdentityKeeper) -> None:
        """Go on counting where another one stands."""
        self._next_id = other.next_id

    def settle(self) -> None:
        """Leave what isn't confirmed unconfirmed."""

    def reset(self) -> None:
        """End all tracks; ids go on."""
        for track in self._tracks:
            self._end(track)
        self._tracks = []
        self._restless = []

    def expected_masks(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Mask]:
        """Give where each object should be in the coming frame: HxW masks.

        :param ego_motion: takes the last frame's pixels to the coming one's.
        """
        return [_moved_mask(track, ego_motion, shape) for track in self._tracks if track.confirmed]

    def update(
        self, candidates: Sequence[Candidate], ego_motion: Matrix, tilt: float
    ) -> list[Observation]:
        """Match a frame's candidates to the tracks, and start tracks for the others.

        :param ego_motion: takes the last frame's pixels to this one's.
        :param tilt: rms turbulent motion an axis in pixels.
        :return: an observation for each track seen in this frame.
        """
        for track in self._tracks:
            _carry(track, ego_motion)
        self._restless = [
            place.carried(ego_motion) for place in self._restless if place.age < _RESTLESS_SPAN
        ]
        candidates = self._reunited(self._divided(candidates))
        matched = self._match(candidates, tilt)
        observations = []
        for index, candidate in enumerate(candidates):
            known = matched.get(index)
            if known is None:
                track = Track(candidate, _kalman_at(candidate, tilt), candidate.centroid)
                self._tracks.append(track)
            else:
                track = known
                _correct(track, candidate)
            track.trail = [*track.trail, track.position][-_TRAIL_LENGTH:]
            self._confirm(track, tilt)
            observations.append(_observed(track))
        seen = {id(observation.track) for observation in observations}
        for track in self._tracks:
            track.misses = 0 if id(track) in seen else track.misses + 1
        self._drop_lost()
        return observations

    def _divided(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Split candidates that hold several objects, say one that passes before another.

        Each pixel goes to the object whose expected mask is nearest.
        """
        objects = [track for track in self._tracks if track.confirmed]
        result: list[Candidate] = []
        for candidate in candidates:
            held = [
                track
                for track in objects
                if _common_area(track, candidate) > _HELD * track.candidate.area
            ]
            result += [candidate] if len(held) < 2 else _split(candidate, held)
        return result

    def _reunited(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Join candidates that are parts of one object, say on both sides of a pole.

        A part lies mostly where one object is expected, and on no other more.
        """
        objects = [track for track in self._tracks if track.confirmed]
        parts: dict[int, list[Candidate]] = {}
        result = []
        for candidate in candidates:
            shares = [_common_area(track, candidate) / candidate.area for track in objects]
            if shares and max(shares) > _PART:
                parts.setdefault(int(np.argmax(shares)), []).append(candidate)
            else:
                result.append(candidate)
        return result + [_joined(members) for members in parts.values()]

    def _match(self, candidates: Sequence[Candidate], tilt: float) -> dict[int, Track]:
        if not candidates or not self._tracks:
            return {}
        cost = np.array(
            [[_cost(track, candidate, tilt) for candidate in candidates] for track in self._tracks]
        )
        rows, columns = linear_sum_assignment(cost)
        return {
            int(column): self._tracks[row]
            for row, column in zip(rows, columns, strict=True)
            if cost[row, column] < _UNMATCHABLE
        }

    def _confirm(self, track: Track, tilt: float) -> None:
        if track.confirmed or track.hits < self._confirmation:
            return
        if not track.keeps_shape(max(self._confirmation - 1, 1), _LIKE):
            return
        travelled = float(np.linalg.norm(track.position - track.birthplace))
        wanted = max(self._travel + 2.0 * tilt, _HONESTY * sum(track.claims))
        if any(place.holds(track.birthplace) for place in self._restless):
            wanted = max(wanted, track.size)
        if travelled < wanted:
            return
        track.confirmed = True
        track.id = self._next_id
        self._next_id += 1
        if self._free_slots:
            track.slot = self._free_slots.pop(0)

    def _drop_lost(self) -> None:
        restless = [track for track in self._tracks if track.gets_nowhere()]
        self._restless += [_Place(track.position, track.size) for track in restless]
        lost = [
            track
            for track in self._tracks
            if track.misses > (self._patience if track.confirmed else 1)
            or track.still > self._patience
            or track in restless
            or not track.keeps_shape(_SHAPE_SPAN, _LIKE)
        ]
        for track in lost:
            self._end(track)
        self._tracks = [track for track in self._tracks if track not in lost]

    def _end(self, track: Track) -> None:
        if track.slot >= 0:
            self._free_slots = sorted([*self._free_slots, track.slot])


def _kalman_at(candidate: Candidate, tilt: float) -> cv2.KalmanFilter:
    kalman = cv2.KalmanFilter(4, 2, 0, cv2.CV_64F)
    kalman.transitionMatrix = np.eye(4) + np.diag([1.0, 1.0], 2)
    kalman.measurementMatrix = np.eye(2, 4)
    speed = float(np.hypot(*candidate.velocity))
    # Objects change their velocity by about a tenth within a few frames.
    acceleration = (0.05 + 0.05 * speed) ** 2
    kalman.processNoiseCov = np.diag([0.0, 0.0, acceleration, acceleration])
    wander = (1.0 + tilt) ** 2
    kalman.measurementNoiseCov = np.diag([wander, wander])
    kalman.statePost = np.array([*candidate.centroid, *candidate.velocity]).reshape(4, 1)
    doubt = (0.2 + 0.3 * speed) ** 2
    kalman.errorCovPost = np.diag([wander, wander, doubt, doubt])
    return kalman


def _carry(track: Track, ego_motion: Matrix) -> None:
    """Take a track's state into the next frame: by the ego-motion, then by its velocity."""
    linear = ego_motion[:2, :2]
    state = track.kalman.statePost
    state[:2, 0] = linear @ state[:2, 0] + ego_motion[:2, 2]
    state[2:, 0] = linear @ state[2:, 0]
    track.kalman.statePost = state
    track.kalman.predict()
    track.birthplace = linear @ track.birthplace + ego_motion[:2, 2]
    track.trail = [linear @ point + ego_motion[:2, 2] for point in track.trail]


def _correct(track: Track, candidate: Candidate) -> None:
    common = _common_area(track, candidate)
    union = track.candidate.area + candidate.area - common
    track.likeness = [*track.likeness, common / max(union, 1)][-_SHAPE_SPAN:]
    track.kalman.correct(candidate.centroid.reshape(2, 1))
    track.candidate = candidate
    track.hits += 1
    track.claims = [*track.claims, float(np.hypot(*candidate.velocity))][-_TRAIL_LENGTH:]
    track.still = 0 if candidate.moving else track.still + 1


def _common_area(track: Track, candidate: Candidate) -> int:
    """Count the candidate's pixels that lie where the track's mask is expected now."""
    dx, dy = np.rint(track.position - track.candidate.centroid).astype(int)
    expected, found = track.candidate.box.moved(int(dx), int(dy)), candidate.box
    common = expected.common(found)
    if common is None:
        return 0
    there = track.candidate.mask[common.moved(-expected.x0, -expected.y0).slices]
    here = candidate.mask[common.moved(-found.x0, -found.y0).slices]
    return int(np.count_nonzero(there & here))


def _split(candidate: Candidate, tracks: Sequence[Track]) -> list[Candidate]:
    """Divide a candidate's pixels among the tracks that are expected in it, by distance."""
    away = np.stack([_distance_to_expected(track, candidate.box) for track in tracks])
    nearest = away.argmin(axis=0)
    parts = []
    for index, track in enumerate(tracks):
        mask = candidate.mask & (nearest == index)
        if mask.any():
            box = Box.around(mask)
            parts.append(
                Candidate(
                    box.moved(candidate.box.x0, candidate.box.y0),
                    mask[box.slices],
                    track.velocity,
                    candidate.moving,
                )
            )
    return parts


def _distance_to_expected(track: Track, box: Box) -> npt.NDArray[np.float32]:
    """Give the distance of each pixel in a box to where the track's mask is expected, hxw."""
    dx, dy = np.rint(track.position - track.candidate.centroid).astype(int)
    expected = track.candidate.box.moved(int(dx), int(dy))
    free = np.ones(box.shape, np.uint8)
    common = expected.common(box)
    if common is not None:
        there = track.candidate.mask[common.moved(-expected.x0, -expected.y0).slices]
        free[common.moved(-box.x0, -box.y0).slices] = ~there
    distance: npt.NDArray[np.float32] = cv2.distanceTransform(free, cv2.DIST_L2, 3)
    return distance


def _joined(parts: Sequence[Candidate]) -> Candidate:
    """Make one candidate of several; the largest one's velocity is the whole's."""
    if len(parts) == 1:
        return parts[0]
    box = Box(
        min(part.box.x0 for part in parts),
        min(part.box.y0 for part in parts),
        max(part.box.x1 for part in parts),
        max(part.box.y1 for part in parts),
    )
    mask = np.zeros(box.shape, bool)
    for part in parts:
        mask[part.box.moved(-box.x0, -box.y0).slices] |= part.mask
    largest = max(parts, key=lambda part: part.area)
    return Candidate(box, mask, largest.velocity, any(part.moving for part in parts))


def _cost(track: Track, candidate: Candidate, tilt: float) -> float:
    height, width = track.candidate.box.shape
    other_height, other_width = candidate.box.shape
    diagonal = max(float(np.hypot(height, width)), float(np.hypot(other_height, other_width)))
    reach = _REACH * diagonal + 3.0 * tilt + 2.0
    distance = float(np.linalg.norm(candidate.centroid - track.position))
    if distance > reach:
        return _UNMATCHABLE
    size = track.candidate.area, candidate.area
    change_of_size = float(np.log(max(size) / max(min(size), 1)))
    turn = float(np.hypot(*np.subtract(candidate.velocity, track.velocity)))
    speed = max(float(np.hypot(*candidate.velocity)), float(np.hypot(*track.velocity)), 0.5)
    return distance / reach + 0.25 * change_of_size + 0.25 * min(turn / speed, 2.0)


def _observed(track: Track) -> Observation:
    return Observation(
        track=track,
        candidate=track.candidate,
        velocity=track.velocity,
        trail=tuple((float(x), float(y)) for x, y in track.trail),
    )


def _moved_mask(track: Track, ego_motion: Matrix, shape: tuple[int, int]) -> Mask:
    box = track.candidate.box
    # The position has been carried along since the mask was last seen.
    way = track.position - track.candidate.centroid + np.asarray(track.velocity)
    place = np.array([[1.0, 0.0, box.x0 + way[0]], [0.0, 1.0, box.y0 + way[1]], [0, 0, 1.0]])
    moved: Mask = (
        cv2.warpAffine(
            track.candidate.mask.astype(np.uint8),
            (ego_motion @ place)[:2],
            (shape[1], shape[0]),
            flags=cv2.INTER_NEAREST,
        )
        > 0
    )
    return moved


class KMeansUnifier:
    """The paper's way: every mask is an object, ids come from K-means once the clip has ended.

    K is the number of masks that frames with any hold most often. Everything waits for the end of
    the clip.
    """

    def __init__(self, slots: int) -> None:
        """Set up without a clip; `slots` is the number of output slots."""
        self._slots = slots
        self._clip: list[list[Track]] = []
        self._next_id = 1

    @property
    def delay(self) -> int:
        """No result before the end of the clip."""
        return sys.maxsize

    @property
    def next_id(self) -> int:
        """The id that the next clip's first object will get."""
        return self._next_id

    def continue_ids(self, other: IdentityKeeper) -> None:
        """Go on counting where another one stands."""
        self._next_id = other.next_id

    def reset(self) -> None:
        """Forget the clip; ids go on."""
        self._clip = []

    def expected_masks(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Mask]:
        """Expect nothing: each frame stands for itself."""
        return []

    def update(
        self, candidates: Sequence[Candidate], ego_motion: Matrix, tilt: float
    ) -> list[Observation]:
        """Take every candidate for an object whose id is still open."""
        tracks = [
            Track(candidate, _kalman_at(candidate, tilt), candidate.centroid)
            for candidate in candidates
        ]
        self._clip.append(tracks)
        return [_observed(track) for track in tracks]

    def settle(self) -> None:
        """Give the clip's masks their ids."""
        counts = [len(tracks) for tracks in self._clip if tracks]
        if not counts:
            return
        clusters = int(np.bincount(counts).argmax())
        tracks = [track for frame in self._clip for track in frame]
        identities = unify_by_kmeans([track.candidate.centroid for track in tracks], clusters)
        for track, cluster in zip(tracks, identities, strict=True):
            track.id = self._next_id + int(cluster) - 1
            track.slot = int(cluster) - 1 if cluster <= self._slots else -1
            track.confirmed = True
        self._next_id += clusters
        self._clip = []


def unify_by_kmeans(centroids: Sequence[Point], count: int) -> npt.NDArray[np.int64]:
    """Give every mask of a clip an id from 1 to `count` by where its centroid lies.

    The paper's mask ID unification: K-means over the centroids of all frames. It needs the whole
    clip and its number of objects, and it splits an object that crosses the view.

    :param centroids: (x, y) of each mask of all frames.
    """
    if not centroids:
        return np.zeros(0, np.int64)
    points = np.asarray(centroids, np.float32).reshape(-1, 2)
    clusters = min(count, len(np.unique(points, axis=0)))
    if clusters == 1:
        return np.ones(len(points), np.int64)
    # OpenCV draws the first centres from its global generator.
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 0.01)
    _, assigned, _ = cv2.kmeans(points, clusters, None, criteria, 10, cv2.KMEANS_PP_CENTERS)
    return assigned.ravel().astype(np.int64) + 1
