"""What stops stays: objects that stand are there as long as the picture shows them.

Nothing moves where an object stands, and all that the window holds shows it after a while. So what
was there before is kept (see `place`) of each object that comes to rest, and as long as its place
still differs from that and looks like the object, it is reported there, for no longer than
`tracking.stopped` seconds: then it is background.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from turbseg_ros.arrays import ByteImage, Mask
from turbseg_ros.parameters import TrackingParameters
from turbseg_ros.segmentation.background import AlignedFrame
from turbseg_ros.segmentation.cropped_mask import CroppedMask, union_mask
from turbseg_ros.segmentation.place import Place, Sight
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Detection, Observation, Track, joined
from turbseg_ros.segmentation.window import FrameWindow

# Frames in which an object that comes to rest travels less than its own size, and sizes that it
# must have travelled before.
_COVERS, _TRAVELLED = 48, 0.5
# Frames in which no motion was found on an object, between which it is measured at times, from
# which on it stands.
_RESTS = 10
# Frames after which the picture of what stands is taken anew: the sooner, the more of what passes
# before it would be taken for a part of it.
_RENEWED = 30
# Share of an outline that must lie where an object stands, to be a part of it, and of a place from
# which on something else is before it.
_PART, _HIDDEN = 0.5, 0.5
# Least IoU of what is outlined with an object that stands for it to be that: where its place looks
# as it did, where it is hidden in part, and where it moves, and may change its shape.
_WHOLE, _SAME_SHAPE, _SAME_OBJECT = 0.75, 0.6, 0.5
# Share of its area that it has at least when it moves; else something comes before it.
_LEFT = 0.7
# Detail pixels between two objects within which they may be outlined as one.
_NEAR = 16
# Detail pixels around an object that stands which aren't told from it.
_RIM = 2


@dataclass(frozen=True)
class _Stopped:
    """An object's place, and the stamp in nanoseconds since which it rests there.

    `frames` counts those since motion was found on it, `unseen` those in which it was not seen;
    `rested` tells whether it ever stood there, or only may be about to.
    """

    place: Place
    since: int
    frames: int = 0
    unseen: int = 0
    rested: bool = False

    def seen_at_rest(self, rests: bool) -> _Stopped:
        """Return what is known a frame later, in which it rests or motion is found on it."""
        frames = self.frames + 1 if rests else 0
        return replace(self, frames=frames, rested=self.rested or frames >= _RESTS)


@dataclass(frozen=True)
class _RestOfFrame:
    """What else a frame shows; see `StoppedObjects.completed`."""

    detections: Sequence[Detection]
    known: Sequence[CroppedMask]
    moving: Mask
    image: ByteImage
    stamp: int

    def moves(self, detection: Detection) -> bool:
        """Whether any of a detection lies where something moves."""
        return detection.outline.intersection_area(self.moving) > 0

    def in_motion(self) -> list[Detection]:
        """Return the detections that move."""
        return [each for each in self.detections if self.moves(each)]

    def is_alone(self, outline: CroppedMask, others: Sequence[Detection]) -> bool:
        """Whether nothing else moves, nor is known, so near that the two may be outlined as one.

        :param others: the detections that are no part of it.
        """
        around = outline.dilated(_NEAR, (self.moving.shape[0], self.moving.shape[1]))
        near = [each for each in self.known if each.iou(outline) < _SAME_OBJECT]
        near += [each.outline for each in others if self.moves(each)]
        return not any(around.shares_pixels(each) for each in near)


class StoppedObjects:
    """Knows of one stream's objects that stand, or are about to, what was there before.

    What stands is background after `tracking.stopped` seconds; with 0 nothing is known.
    """

    def __init__(
        self, window: FrameWindow, resolution: Resolution, tracking: TrackingParameters
    ) -> None:
        self._window = window
        self._resolution = resolution
        self._limit, self._max_age = tracking.stopped, tracking.max_age
        self._stopped: dict[Track, _Stopped] = {}
        # What was there before at places that objects have just left, from the frame at hand.
        self._left: list[AlignedFrame] = []
        # The frame from which places are seen.
        self._index = 0

    def follow(self, index: int) -> None:
        """See all places from another frame; forget them where that shows another view."""
        self._left = []
        if self._stopped:
            motion = self._window.transform_if_continuous(self._index, index)
            if motion is None or not self._is_same_view(index):
                self._stopped = {}
            elif index != self._index:
                motion = self._resolution.to_detail(motion)
                self._stopped = {
                    track: replace(each, place=each.place.seen_from(motion))
                    for track, each in self._stopped.items()
                }
        self._index = index

    def views(self) -> list[AlignedFrame]:
        """Return what was at the places before, as the frame at hand sees it."""
        return [view for each in self._stopped.values() for view in each.place.aligned_views()]

    def completed(
        self,
        detections: Sequence[Detection],
        known: Sequence[CroppedMask],
        moving: Mask,
        image: ByteImage,
        tilt: float,
        stamp: int,
    ) -> list[Detection]:
        """Return detections, those that show an object that stands told so, with the others.

        :param known: where known objects should be.
        :param moving: HxW, where something moves, as measured or propagated.
        :param image: HxWxC, the frame at hand, at detail resolution.
        :param tilt: rms turbulent motion an axis in pixels.
        :param stamp: the frame's, in nanoseconds.
        """
        result = list(detections)
        for track, stopped in list(self._stopped.items()):
            sight, place = stopped.place.look(image, tilt)
            if sight is Sight.BEFORE:
                del self._stopped[track]
                continue
            rests = place.outline_in(self._resolution.detail_shape).intersection_area(moving) == 0
            stopped = replace(stopped, place=place).seen_at_rest(rests)
            if sight is Sight.WHOLE and stopped.frames % _RENEWED == _RENEWED - 1:
                stopped = replace(stopped, place=place.with_picture(image))
            self._stopped[track] = stopped
            if sight is not Sight.OTHER:
                around = _RestOfFrame(result, known, moving, image, stamp)
                result = self._with_standing(track, around, sight)
            elif stopped.rested:
                outline = place.outline_in(self._resolution.detail_shape)
                result.append(_standing(outline, track, hidden=True))
        return result

    def remember(
        self,
        observations: Sequence[Observation],
        image: ByteImage,
        stamp: int,
        views: Callable[[], Sequence[AlignedFrame]],
    ) -> None:
        """Keep what was there before where objects are about to stand; forget those that ended.

        :param views: returns earlier frames as the frame at hand sees them, the oldest first.
        """
        if not self._limit:
            return
        seen_tracks = {seen.track for seen in observations}
        self._stopped = {
            track: replace(each, unseen=0 if track in seen_tracks else each.unseen + 1)
            for track, each in self._stopped.items()
            if not _goes(track) and each.unseen < self._max_age
        }
        for seen in observations:
            track = seen.track
            if track in self._stopped or not _comes_to_rest(track):
                continue
            before = [*self.views(), *self._left, *views()]
            place = Place.of(seen.detection.outline, image, before)
            if place is not None:
                self._stopped[track] = _Stopped(place, stamp)

    def _is_same_view(self, index: int) -> bool:
        return self._window[index].camera.view == self._window[self._index].camera.view

    def _with_standing(self, track: Track, there: _RestOfFrame, sight: Sight) -> list[Detection]:
        """Return detections with the one of an object that its place shows."""
        shape, stopped = self._resolution.detail_shape, self._stopped[track]
        place, expected = stopped.place, stopped.place.outline_in(shape)
        parts, others = _parted(there.detections, expected)
        stands = track.id if stopped.rested else 0
        drawn = replace(joined(parts), stands=stands) if parts else None
        likeness = 0.0 if drawn is None else drawn.outline.iou(expected)
        absorbed = there.stamp - stopped.since >= self._limit * 1e9
        if drawn is not None and there.is_alone(expected, others):
            changed = there.moves(drawn) and sight is Sight.OBJECT
            if changed and likeness > _SAME_OBJECT and drawn.area > _LEFT * expected.area:
                self._move(track, drawn.outline, there)
                return [*others, drawn]
            if not changed and likeness > (_WHOLE if sight is Sight.WHOLE else _SAME_SHAPE):
                return [*others, replace(drawn, absorbed=absorbed and stopped.rested)]
        before = union_mask([each.outline for each in there.in_motion()], shape)
        told = _without(expected, before & place.hidden_in(shape).in_frame(shape))
        if not stopped.rested or told.area < _HIDDEN * expected.area:
            return list(there.detections)
        left = [
            replace(each, box=rest.box, mask=rest.mask)
            for each in [*others, *(part for part in parts if there.moves(part))]
            if (rest := self._beside(each.outline, told)).area
        ]
        return [*left, replace(_standing(told, track), absorbed=absorbed)]

    def _move(self, track: Track, outline: CroppedMask, there: _RestOfFrame) -> None:
        """Take an object to be where it is outlined, which its place may no longer hold."""
        shape = self._resolution.detail_shape
        place = self._stopped[track].place.with_outline(outline, shape)
        if place is None:
            self._left += self._stopped.pop(track).place.aligned_views()
        else:
            place = place.with_picture(there.image)
            self._stopped[track] = replace(self._stopped[track], place=place, since=there.stamp)

    def _beside(self, outline: CroppedMask, told: CroppedMask) -> CroppedMask:
        """Return what of an outline is not an object's that stands there, nor its rim."""
        shape = self._resolution.detail_shape
        if not outline.shares_pixels(told):
            return outline
        left = _without(outline, told.dilated(_RIM, shape).in_frame(shape))
        return left.eroded(1, shape).dilated(1, shape)


def _comes_to_rest(track: Track) -> bool:
    """Whether a track is well known to be an object, and is slow or stands."""
    return track.confirmed and track.travelled >= _TRAVELLED * track.size and not _goes(track)


def _goes(track: Track) -> bool:
    """Whether a track neither stands nor is slow, or is background."""
    is_fast = float(np.hypot(*track.velocity)) * _COVERS >= track.size
    return track.is_absorbed or (is_fast and not track.stood)


def _standing(outline: CroppedMask, track: Track, hidden: bool = False) -> Detection:
    return Detection(
        outline.box, outline.mask, (0.0, 0.0), moving=False, stands=track.id, hidden=hidden
    )


def _parted(
    detections: Sequence[Detection], place: CroppedMask
) -> tuple[list[Detection], list[Detection]]:
    """Return the detections that lie mostly in a place, and the others."""
    inside = [each.outline.common_area(place) > _PART * each.area for each in detections]
    parts = [each for each, here in zip(detections, inside, strict=True) if here]
    return parts, [each for each, here in zip(detections, inside, strict=True) if not here]


def _without(outline: CroppedMask, taken: Mask) -> CroppedMask:
    box = outline.box
    return CroppedMask.of(outline.mask & ~taken[box.slices], box.x0, box.y0)
