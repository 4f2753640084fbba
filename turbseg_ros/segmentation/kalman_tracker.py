"""Which object of this frame is which of the frames before, live: ids that stay."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from turbseg_ros.arrays import ByteImage, Matrix, Point
from turbseg_ros.segmentation.companions import Companions
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, CroppedMask
from turbseg_ros.segmentation.geometry import transformed_point
from turbseg_ros.segmentation.occlusion import AppearanceModel, DepthOrder, divided_among
from turbseg_ros.segmentation.significance import chance_per_test, jitter, significant_displacement
from turbseg_ros.segmentation.track import (
    SHAPE_SPAN,
    Detection,
    Observation,
    Track,
    Tracker,
    joined,
)

_UNMATCHABLE = 1e6
# Cost of a detection that shows what the track is known to: less than any other.
_SAME_TARGET = -10.0
# Area in detail pixels below which an outline that noise may make is told from an object by its
# shape only.
_SMALL = 200
# How far a centroid may stray from its prediction, in diagonals of the object.
_REACH = 0.6
# Share of a detection that must lie where an object is expected for it to be a part of it.
_PART = 0.5
# Share of an object's expected mask, or of the detection if that is smaller, that both must have
# in common for the object to have a claim to the detection's pixels.
_CLAIM = 0.1
# Displacement over the path length that its flow adds up to, from which a track may be an object:
# the middle of what enters the picture comes half of it.
_CONFIRMED_RATIO = 0.35
# Least IoU of a mask with the one before, propagated, on average over the frames of confirmation
# and, for an object, over a longer span: leaves and waves change their shape all the time.
_MIN_SHAPE_IOU = 0.4
# Times by which the area of what isn't known to be an object, nor told by flow, may change.
_OTHER_SIZE = 3.0
# Share of the tilt that a centroid jitters by: over an object's pixels it cancels in part.
_SHARED_TILT = 0.35
# Times what is usual by which a track's place jitters when it flickers, the least tilt in pixels
# that counts there, and times as often that it must be seen then to become an object.
_FLICKER, _MIN_TILT, _FLICKER_HITS = 2.0, 0.2, 2
# Jitter of the middle of an outline that flow shows to move, in roots of its area: it is never
# drawn twice alike.
_REDRAWN = 0.02
# Share of its size that an object must have travelled to be certainly no clutter.
_TRAVELLED = 0.5
# Least displacement of what no flow shows to move, and of what begins where something got nowhere,
# in roots of its area and, besides, in tilts, and over its path length.
_CLEAR, _SHIMMER, _STRAIGHT = 1.0, 3.0, 0.75
# Frames more in which it must be seen: what flickers may leap straight on for some.
_UNTOLD_HITS = 1
# Frames without an object after which it is out of sight, pixels a frame from which it then goes
# on, and the share of its speed by which what moves otherwise is none of it.
_LOST, _PASSING, _OTHER_SPEED = 2, 0.5, 0.5
# Times by which the area of what moves elsewhere may differ from that of an object out of sight,
# and the area in detail pixels up to which all are alike.
_OTHER_AREA, _FEW_PIXELS = 4.0, 50
# Standard deviations that a lost object may be off its expected place, and by what its area, at
# most times as large, and its colour, in grey values, may differ when it is found again.
_SURE, _SIZES, _COLOURS = 3.0, 3.0, 40.0
# Share of its path length that what the border cuts off must have travelled: its jitter isn't
# known.
_WANDERS = 0.25
# Frames for which the place of one that got nowhere is remembered.
_CLUTTER_SPAN = 300


@dataclass(frozen=True)
class _ClutterSite:
    """A place where something moved and got nowhere: its middle (x, y) and its radius."""

    middle: Point
    radius: float
    age: int = 0

    def holds(self, point: Point) -> bool:
        return float(np.linalg.norm(point - self.middle)) < self.radius

    def propagated(self, ego_motion: Matrix) -> _ClutterSite:
        middle = transformed_point(ego_motion, self.middle)
        return _ClutterSite(middle, self.radius, self.age + 1)


class KalmanTracker:
    """Constant-velocity Kalman filters, matched to detections by the Hungarian method.

    A track becomes an object once it was seen often enough and has travelled: what shimmers or
    sways on the spot does not. Nor does what goes with the scene while the camera slews, for that
    may be all it is. It keeps its id and slot until it has been lost for `max_age` frames. Ids
    count up and are never used again.
    """

    def __init__(
        self,
        min_hits: int,
        false_alarms_per_hour: float,
        max_age: int,
        slots: int,
        every: int = 1,
    ) -> None:
        """Set up a tracker without tracks.

        :param min_hits: frames in which a track must be seen to become an object.
        :param false_alarms_per_hour: how often what only shimmers may become an object.
        :param max_age: frames that an object may be lost, or stand still, before it ends.
        :param slots: number of output slots.
        :param every: every how many frames motion is measured; only then it may become an object.
        """
        self._every = every
        self._min_hits = min_hits
        self._false_alarms_per_hour = false_alarms_per_hour
        self._max_age = max_age
        self._free_slots = list(range(slots))
        self._tracks: list[Track] = []
        # Objects that ended and may be found again.
        self._ended: list[Track] = []
        self._clutter_sites: list[_ClutterSite] = []
        self._depth_order: DepthOrder[Track] = DepthOrder()
        self._companions = Companions()
        self._next_id = 1
        # Whether the camera slewed in the last frame.
        self._slewing = False

    @property
    def delay(self) -> int:
        """Frames until a track that is seen in each of them is confirmed."""
        return self._min_hits - 1 + self._every - 1

    @property
    def next_id(self) -> int:
        """The id that the next object will get."""
        return self._next_id

    def continue_ids(self, other: Tracker) -> None:
        """Go on counting where another one stands."""
        self._next_id = other.next_id

    def settle(self) -> None:
        """Leave what isn't confirmed unconfirmed."""

    def reset(self) -> None:
        """End all tracks; ids go on."""
        for track in self._tracks:
            self._end(track)
        self._tracks, self._ended = [], []
        self._clutter_sites = []
        self._depth_order = DepthOrder()
        self._companions = Companions()

    def expected_objects(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Detection]:
        """Return each object as it should be in the coming frame of some shape.

        :param ego_motion: takes the last frame's pixels to the coming one's.
        """
        return [track.expected(ego_motion, shape) for track in self._tracks if track.confirmed]

    def travelled_outlines(
        self, ego_motion: Matrix, shape: tuple[int, int], frames: int
    ) -> list[CroppedMask]:
        """Return where each object that has travelled half its size should be so many frames on.

        :param ego_motion: takes the last frame's pixels to that one's, which is of some shape.
        """
        return [
            track.expected(ego_motion, shape, frames).outline
            for track in self._tracks
            if _has_travelled(track)
        ]

    def update(
        self,
        detections: Sequence[Detection],
        ego_motion: Matrix,
        tilt: float,
        image: ByteImage,
        slewing: bool = False,
    ) -> list[Observation]:
        """Match a frame's detections to the tracks, and start tracks for the others.

        :param ego_motion: takes the last frame's pixels to this one's.
        :param tilt: rms turbulent motion an axis in pixels.
        :param image: HxWxC, this frame.
        :param slewing: whether the camera is turned so fast that the scene may seem to move.
        :return: an observation for each track seen in this frame.
        """
        for track in self._tracks:
            track.propagate(ego_motion)
            track.follow(image, ego_motion)
        self._propagate_places(ego_motion)
        self._note_slew(slewing)
        hidden = self._hidden(detections)
        detections = [detection for detection in detections if not detection.hidden]
        divided, detections, shared = self._divided(detections, tilt, image)
        detections = self._reunited(detections, divided)
        observations = self._seen_beside_others(divided)
        matched = self._match(detections, tilt, [*divided, *hidden])
        for index, detection in enumerate(detections):
            known = matched.get(index)
            if known is None and detection.stands:
                # That object has ended.
                continue
            if known is None:
                track = Track.started(detection, tilt)
                self._tracks.append(track)
            else:
                track = known
                track.correct(detection)
            self._confirm(track, tilt)
            if track.confirmed:
                track.appearance = AppearanceModel.of(detection.outline, image, track.seen_at)
            observations.append(track.observed(track.detection))
        seen = {observation.track for observation in observations}
        for track in self._tracks:
            track.misses = 0 if track in seen else track.misses + 1
            track.remember_picture(image)
        for track in [track for track in self._tracks if track.confirmed and not track.id]:
            self._number(track, tilt)
        self._companions.observe([track for track in self._tracks if track in seen], shared)
        self._drop_lost()
        return observations

    def coast(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Observation]:
        """Propagate all tracks to a frame of some shape in which nothing is looked for.

        :param ego_motion: takes the last frame's pixels to this one's.
        :return: an observation for each track that was seen when last looked for.
        """
        # Where two overlap, the first one's is what is seen.
        coasted = [
            (track, track.coast(ego_motion, shape))
            for track in self._depth_order.front_to_back(self._tracks)
        ]
        self._propagate_places(ego_motion)
        return [
            track.observed(detection)
            for track, detection in coasted
            if track.misses == 0 and detection.area
        ]

    def _note_slew(self, slewing: bool) -> None:
        """Note whether the camera slews; after a slew, forget what may have been the scene."""
        if self._slewing and not slewing:
            self._tracks = [
                track for track in self._tracks if track.confirmed or not track.goes_with_scene()
            ]
        self._slewing = slewing

    def _propagate_places(self, ego_motion: Matrix) -> None:
        """Take what is known of places without a track into the next frame."""
        self._ended = [track for track in self._ended if track.misses < self._max_age]
        for track in self._ended:
            track.propagate(ego_motion)
            track.misses += 1
        self._clutter_sites = [
            place.propagated(ego_motion)
            for place in self._clutter_sites
            if place.age < _CLUTTER_SPAN
        ]

    def _hidden(self, detections: Sequence[Detection]) -> list[Track]:
        """Return the tracks that are said to be hidden, and aren't followed as small targets."""
        ids = {detection.stands for detection in detections if detection.hidden}
        seen = [detection.targets for detection in detections if not detection.hidden]
        followed = frozenset[int]().union(*seen)
        return [
            track for track in self._tracks if track.id in ids and not track.targets & followed
        ]

    def _divided(
        self, detections: Sequence[Detection], tilt: float, image: ByteImage
    ) -> tuple[dict[Track, list[Detection]], list[Detection], list[Collection[Track]]]:
        """Divide detections that hold several objects, say one that passes before another.

        :return: each such object's parts, the detections that hold one object at most, and the
            objects of each of the others.
        """
        appearances = {
            track: track.appearance.at(track.position)
            for track in self._tracks
            # What stands is told from others before.
            if track.appearance is not None and not track.stood
        }
        divided: dict[Track, list[Detection]] = {}
        whole = []
        shared: list[Collection[Track]] = []
        for detection in detections:
            claiming = {
                track: appearance
                for track, appearance in appearances.items()
                if _has_claim(appearance.outline, detection)
            }
            if len(claiming) < 2 or detection.stands:
                whole.append(detection)
                continue
            shared.append(claiming)
            parts = divided_among(detection.outline, claiming, image, tilt, self._depth_order)
            for track, part in parts.items():
                seen = replace(detection, box=part.box, mask=part.mask, velocity=track.velocity)
                divided.setdefault(track, []).append(seen)
        return divided, whole, shared

    def _reunited(
        self, detections: Sequence[Detection], divided: dict[Track, list[Detection]]
    ) -> list[Detection]:
        """Join detections that are parts of one object, say on both sides of a pole.

        A part lies mostly where one object is expected, and on no other more. Those of an object
        that is among the divided ones are added there.
        """
        objects = [track for track in self._tracks if track.confirmed and not track.stood]
        parts: dict[Track, list[Detection]] = {}
        result = []
        for detection in detections:
            shares = [track.intersection_area(detection) / detection.area for track in objects]
            if shares and not detection.stands and max(shares) > _PART:
                track = objects[int(np.argmax(shares))]
                (divided if track in divided else parts).setdefault(track, []).append(detection)
            else:
                result.append(detection)
        return result + [joined(members) for members in parts.values()]

    def _seen_beside_others(self, divided: Mapping[Track, list[Detection]]) -> list[Observation]:
        """Take what is seen of objects that touch or hide one another."""
        seen = {track: joined(parts) for track, parts in divided.items()}
        observations = []
        for track, detection in seen.items():
            others = [other for there, other in seen.items() if there is not track]
            hiding = joined(others).outline if others else EMPTY_MASK
            assert track.appearance is not None
            track.correct_beside(detection, track.appearance.at(track.position), hiding)
            observations.append(track.observed(detection))
        return observations

    def _match(
        self, detections: Sequence[Detection], tilt: float, taken: Collection[Track]
    ) -> dict[int, Track]:
        """Return each detection's track by the detection's number; objects choose first.

        Else what an object was split into for a frame would take its place.
        """
        matched: dict[int, Track] = {}
        for confirmed in (True, False):
            tracks = [
                track
                for track in self._tracks
                if track.confirmed == confirmed and track not in taken
            ]
            left = [number for number in range(len(detections)) if number not in matched]
            if not tracks or not left:
                continue
            cost = np.array(
                [[_cost(track, detections[number], tilt) for number in left] for track in tracks]
            )
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < _UNMATCHABLE:
                    matched[left[column]] = tracks[row]
        return matched

    def _confirm(self, track: Track, tilt: float) -> None:
        if track.confirmed or track.hits < self._min_hits or not track.detection.moving:
            return
        if self._slewing and track.goes_with_scene():
            return
        if track.detection.moves_significantly or self._behaves_like_object(track, tilt):
            track.confirmed = True

    def _number(self, track: Track, tilt: float) -> None:
        """Give an object its id and slot: those of one that was lost, if it is that one again."""
        before = self._lost_before(track, tilt)
        if before is not None:
            if before in self._tracks:
                self._end(before)
            self._tracks = [other for other in self._tracks if other is not before]
            self._ended = [other for other in self._ended if other is not before]
            track.id = before.id
        else:
            track.id = self._next_id
            self._next_id += 1
        if before is not None and before.slot in self._free_slots:
            self._free_slots.remove(before.slot)
            track.slot = before.slot
        elif self._free_slots:
            track.slot = self._free_slots.pop(0)

    def _lost_before(self, track: Track, tilt: float) -> Track | None:
        """Return the lost object that was to be where one appeared and looks like it, if any.

        It was last seen before that one was seen first.
        """
        lost = {
            other: distance
            for other in [*self._tracks, *self._ended]
            if other.id and other.misses > track.age and _looks_like(track, other)
            if (distance := float(np.linalg.norm(track.position - other.position)))
            < _reach(track.size, other.size, tilt) + _SURE * other.deviation
        }
        return min(lost, key=lambda other: lost[other], default=None)

    def _behaves_like_object(self, track: Track, tilt: float) -> bool:
        """Whether it keeps its shape and has travelled further than chance would take it."""
        if not track.keeps_shape(max(self._min_hits - 1, 1), _MIN_SHAPE_IOU):
            return False
        if track.hits < _FLICKER_HITS * self._min_hits and _flickers(track, tilt):
            return False
        if _opposes_flow(track):
            return False
        suspect = any(site.holds(track.start) for site in self._clutter_sites)
        if not track.detection.flow_known and track.hits < self._min_hits + _UNTOLD_HITS:
            return False
        if (suspect or not track.detection.flow_known) and not _gets_clear(track, tilt):
            return False
        least = self._significant_displacement(track, tilt)
        wanted = max(least, _CONFIRMED_RATIO * sum(track.flow_speeds))
        if track.detection.truncated:
            if _comes_straight(track, least):
                return True
            wanted = max(wanted, _WANDERS * track.walked)
        return track.travelled >= wanted

    def _significant_displacement(self, track: Track, tilt: float) -> float:
        """Return the displacement wanted of a track: chance exceeds it seldom enough."""
        tests = sum(not other.confirmed for other in self._tracks)
        usual = jitter([], _SHARED_TILT * tilt)
        own = usual if track.detection.truncated else jitter(track.sightings, usual)
        return significant_displacement(
            # An outline that is mended jumps, too.
            jitter=min(own, _FLICKER * usual),
            clutter=float(np.sqrt(np.mean(np.square(track.clutter)))),
            frames=track.hits,
            steady=self._every,
            chance=chance_per_test(self._false_alarms_per_hour, self._every, tests),
        )

    def _drop_lost(self) -> None:
        parts = self._companions.parts()
        stuck = [track for track in self._tracks if track.gets_nowhere() and not track.stands]
        self._clutter_sites += [
            _ClutterSite(track.position, track.size)
            for track in stuck
            if not _has_travelled(track)
        ]
        lost = [
            track
            for track in self._tracks
            if track.misses > (self._max_age if track.confirmed else 1)
            or track.still > self._max_age
            or track in stuck
            or (
                not track.stands
                and not track.keeps_shape(SHAPE_SPAN, _MIN_SHAPE_IOU, known=SHAPE_SPAN)
            )
            or track.is_absorbed
            or track in parts
        ]
        for track in lost:
            self._end(track)
        self._ended += [
            track for track in lost if track.id and not track.is_absorbed and track not in parts
        ]
        self._tracks = [track for track in self._tracks if track not in lost]
        self._depth_order.keep(self._tracks)
        self._companions.keep(self._tracks)

    def _end(self, track: Track) -> None:
        if track.slot >= 0:
            self._free_slots = sorted([*self._free_slots, track.slot])


def _has_travelled(track: Track) -> bool:
    """Whether an object has travelled so far that it is certainly no clutter."""
    return track.confirmed and track.travelled > _TRAVELLED * track.size


def _flickers(track: Track, tilt: float) -> bool:
    """Whether a track's place jumps by more than the air makes it.

    What enters or leaves the picture changes its middle without that.
    """
    if track.detection.truncated:
        return False
    usual = max(tilt, _MIN_TILT)
    if track.detection.flow_known:
        usual = max(usual, _REDRAWN * float(np.sqrt(track.detection.area)))
    return jitter(track.sightings, tilt) > _FLICKER * usual


def _opposes_flow(track: Track) -> bool:
    """Whether its outline has come, and goes, the other way than flow tells, as a flag's does.

    That of two cars which are drawn as one may have come the other way, but goes with them.
    """
    if not track.detection.flow_known:
        return False
    came = track.front.displacement
    if not came.any():
        came = track.position - track.start
    ways = np.array([came, track.velocity])
    return bool((ways @ np.array(track.detection.velocity) < 0.0).all())


def _comes_straight(track: Track, least: float) -> bool:
    """Whether the front end of what enters or leaves has come straight on, as far as flow says.

    :param least: the least displacement wanted of it, in pixels.
    """
    front = track.front
    by_flow = _CONFIRMED_RATIO * sum(track.flow_speeds[-len(front.places) :])
    return front.distance >= max(least, by_flow, _STRAIGHT * front.length)


def _gets_clear(track: Track, tilt: float) -> bool:
    """Whether a track has gone straight on, further than it is wide and than tilt takes it.

    The middle of its outline, its front end or its picture may tell.
    """
    clear = _CLEAR * float(np.sqrt(track.detection.area)) + _SHIMMER * tilt
    ways = [(track.travelled, track.walked), (track.front.distance, track.front.length)]
    if (stepped := track.stepped) is not None:
        ways.append(stepped)
    return any(travelled >= max(clear, _STRAIGHT * walked) for travelled, walked in ways)


def _may_be_noise(track: Track, detection: Detection) -> bool:
    """Whether an outline where a small target should be shows nothing of what that is known by."""
    if not track.targets or detection.targets or detection.moving or track.detection.area > _SMALL:
        return False
    return track.shape_iou(detection) < _MIN_SHAPE_IOU


def _passes_on(track: Track, detection: Detection) -> bool:
    """Whether an object that was lost from sight goes on, and an outline on its way rests.

    What hides it is looked at where it should be, and may stand out from what was seen there.
    """
    if track.misses < _LOST or detection.moving or not detection.flow_known:
        return False
    speed = float(np.hypot(*track.velocity))
    change = float(np.hypot(*np.subtract(detection.velocity, track.velocity)))
    return speed > _PASSING and change > _OTHER_SPEED * speed


def _is_of_other_size(track: Track, detection: Detection) -> bool:
    """Whether what moves beside where an object out of sight should be is too large or small.

    What flow doesn't show may be outlined in part.
    """
    if track.misses < _LOST or not detection.flow_known or track.intersection_area(detection):
        return False
    areas = track.detection.area, detection.area
    return max(areas) > _OTHER_AREA * max(min(areas), _FEW_PIXELS)


def _hides(track: Track, detection: Detection) -> bool:
    """Whether a detection where an object stood is another one, which may be before it."""
    return track.stood and track.shape_iou(detection) < _MIN_SHAPE_IOU


def _reach(size: float, other_size: float, tilt: float) -> float:
    """Return how far an object may be seen from where it is expected."""
    return _REACH * max(size, other_size) + 3.0 * tilt + 2.0


def _looks_like(track: Track, other: Track) -> bool:
    """Whether two objects are about as large and of about one colour."""
    one, two = track.appearance, other.appearance
    if one is None or two is None:
        return False
    areas = one.outline.area, two.outline.area
    if max(areas) > _SIZES * min(areas):
        return False
    colours = [each.picture[each.outline.mask].mean(axis=0) for each in (one, two)]
    return bool(np.abs(colours[0] - colours[1]).max() < _COLOURS)


def _has_claim(expected: CroppedMask, detection: Detection) -> bool:
    common = expected.common_area(detection.outline)
    return common > _CLAIM * min(expected.area, detection.area)


def _cost(track: Track, detection: Detection, tilt: float) -> float:
    if detection.stands:
        return _SAME_TARGET if detection.stands == track.id else _UNMATCHABLE
    if track.targets & detection.targets:
        return _SAME_TARGET
    if (
        _may_be_noise(track, detection)
        or _passes_on(track, detection)
        or _is_of_other_size(track, detection)
        or _hides(track, detection)
    ):
        return _UNMATCHABLE
    height, width = track.detection.box.shape
    other_height, other_width = detection.box.shape
    diagonal = max(float(np.hypot(height, width)), float(np.hypot(other_height, other_width)))
    reach = _reach(diagonal, diagonal, tilt)
    distance = float(np.linalg.norm(detection.centroid - track.position))
    if distance > reach:
        return _UNMATCHABLE
    size = track.detection.area, detection.area
    by_flow = track.detection.flow_known and detection.flow_known
    if not (track.confirmed or by_flow) and max(size) > _OTHER_SIZE * min(size):
        return _UNMATCHABLE
    change_of_size = float(np.log(max(size) / max(min(size), 1)))
    change_of_velocity = float(np.hypot(*np.subtract(detection.velocity, track.velocity)))
    speed = max(float(np.hypot(*detection.velocity)), float(np.hypot(*track.velocity)), 0.5)
    return distance / reach + 0.25 * change_of_size + 0.25 * min(change_of_velocity / speed, 2.0)
