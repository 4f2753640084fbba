"""One object through time: where it was seen, where it is expected, whether it behaves like one.

Positions and masks are in detail pixels. Before each frame a track is propagated by the
ego-motion, so that velocities are against the scene.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix, Point
from turbseg_ros.segmentation.certainty import certainty
from turbseg_ros.segmentation.cropped_mask import Box, CroppedMask
from turbseg_ros.segmentation.front import UNCUT, FrontPath, Sides
from turbseg_ros.segmentation.geometry import (
    transformed_point,
    transformed_points,
    translation,
)
from turbseg_ros.segmentation.occlusion import AppearanceModel
from turbseg_ros.segmentation.template import SAME, SURELY_SAME, Template

_TRAIL_LENGTH = 60
# Least displacement over the path length that its flow adds up to, or an object ends: flow bleeds
# past an object's edge, and what sways or ripples gets nowhere.
_MIN_DISPLACEMENT_RATIO = 0.25
# Frames over which an object's displacement is compared with its flow's.
_DISPLACEMENT_SPAN = 24
# Share of the scene's way in the picture from which on something goes with it.
_WITH_SCENE = 0.5
# Share of an object that must be seen beside others for its place to be told by that.
_MIN_VISIBLE = 0.2
# Frames in which what stands out, and no flow shows to move, covers its own size if it goes on.
_SOON = 48
# Sightings that tell how fast that is.
_RECENT = 5
_UNKNOWN_SPEED = 0.1
_SURPRISING = 2.0
# Standard deviation of a velocity that its picture tells, in pixels a frame.
_BY_PICTURE = 0.5
# Pixels a frame from which flow may lose it within its interval, from which it is worth looking
# whether it did, and the share of a step by which flow must err.
_TOO_FAST, _FAST, _OTHER_STEP = 8.0, 4.0, 0.5
# Steps by its picture from which its displacement is told.
_FEWEST_STEPS = 3
# A change of velocity by one pixel a frame, as the filter's uncertainty a frame later has it.
_ANY_VELOCITY = np.kron(np.ones((2, 2)), np.eye(2))
SHAPE_SPAN = 12
"""Frames over which an object's masks are compared with each other."""


@dataclass(frozen=True)
class Detection:
    """A mask that may be an object: hxw within its box, and how it moves.

    `velocity` is in pixels a frame against the scene; `moving` tells whether motion was found in
    this frame, or only an outline that stands out where an object is known to be. `clutter` is
    what its place is known to move by without anything being there, in pixels a frame;
    `cut_sides` are those on which it reaches the border of what can be seen, `flow_known` tells
    whether flow tells its velocity, which else is 0. `targets` are the numbers of the small
    targets that it shows, which were followed for long enough to know that it is an object.
    `stands` is the id of the object that is known to stand there, 0 for none, `hidden` whether
    something else is before that, and `absorbed` whether it stood there for so long that it is
    background from here on; see `stopped`.
    """

    box: Box
    mask: Mask
    velocity: tuple[float, float]
    moving: bool
    clutter: float = 0.0
    cut_sides: Sides = UNCUT
    flow_known: bool = True
    targets: frozenset[int] = frozenset()
    stands: int = 0
    hidden: bool = False
    absorbed: bool = False

    @property
    def moves_significantly(self) -> bool:
        """Whether it is known to be an object before it is tracked."""
        return bool(self.targets)

    @property
    def truncated(self) -> bool:
        """Whether the border of what can be seen cuts it off."""
        return any(self.cut_sides)

    @property
    def outline(self) -> CroppedMask:
        """Where it is."""
        return CroppedMask(self.box, self.mask)

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
    """One object through time.

    `detection` is what was seen of it last, when its centroid, hidden parts included, was at
    `seen_at`; `front` is how its front end has come where the border cuts it off; `appearance` is
    what it looked like when last seen whole, None until it is an object. `start` is where it was
    seen first, and `picture_start` where that was in the picture then, which doesn't move with the
    scene; `sightings` are its centroids, `clutter` what their places move by, the oldest first;
    `targets` the numbers of the small targets that it showed last. `template` is what it looked
    like in the frame before where flow doesn't tell how fast it is, `steps` are the displacements
    against the scene that its picture told, and `followed` tells whether it did in this frame.
    """

    detection: Detection
    kalman: cv2.KalmanFilter
    start: Point
    picture_start: Point
    seen_at: Point
    appearance: AppearanceModel | None = None
    id: int = 0
    slot: int = -1
    hits: int = 1
    misses: int = 0
    age: int = 0
    still: int = 0
    flow_speeds: list[float] = field(default_factory=list)
    shape_ious: list[float] = field(default_factory=list)
    confirmed: bool = False
    sightings: list[Point] = field(default_factory=list)
    clutter: list[float] = field(default_factory=list)
    trail: list[Point] = field(default_factory=list)
    targets: frozenset[int] = frozenset()
    template: Template | None = None
    steps: list[Point] = field(default_factory=list)
    followed: bool = False
    front: FrontPath = field(default_factory=FrontPath)

    @classmethod
    def started(cls, detection: Detection, tilt: float) -> Track:
        """Begin a track where a detection was seen.

        :param tilt: rms turbulent motion an axis in pixels.
        """
        centroid = detection.centroid
        return cls(
            detection,
            _kalman_at(detection, tilt),
            start=centroid,
            picture_start=centroid,
            seen_at=centroid,
            sightings=[centroid],
            clutter=[detection.clutter],
            targets=detection.targets,
            front=FrontPath().seen(detection.outline, detection.cut_sides),
        )

    @property
    def position(self) -> Point:
        """Estimated centroid (x, y)."""
        # A copy: OpenCV gives a view of what the next prediction overwrites.
        return np.array(self.kalman.statePost[:2, 0], dtype=np.float64)

    @property
    def size(self) -> float:
        """Diagonal of the box around it."""
        return float(np.hypot(*self.detection.box.shape))

    def keeps_shape(self, frames: int, least: float, known: int = 1) -> bool:
        """Whether its masks of the last frames were alike: at least so much IoU a frame.

        It does while fewer than `known` were compared.
        """
        recent = self.shape_ious[-frames:]
        return len(recent) < known or float(np.mean(recent)) >= least

    def goes_with_scene(self) -> bool:
        """Whether it has come with the scene in the picture since it was seen first.

        So does what is the scene, however wrong its registration is, but not what the camera
        turns to follow.
        """
        scene, came = self.start - self.picture_start, self.position - self.picture_start
        return float(came @ scene) > _WITH_SCENE * float(scene @ scene)

    def gets_nowhere(self) -> bool:
        """Whether its displacement has long been a small part of what its flow adds up to."""
        expected = sum(self.flow_speeds[-_DISPLACEMENT_SPAN:])
        if len(self.trail) < _DISPLACEMENT_SPAN or expected < 0.5 * self.size:
            return False
        displacement = float(np.linalg.norm(self.trail[-1] - self.trail[-_DISPLACEMENT_SPAN]))
        return displacement < _MIN_DISPLACEMENT_RATIO * expected

    @property
    def stands(self) -> bool:
        """Whether the picture showed it where it stands, when it was looked for last."""
        return self.misses == 0 and self.stood

    @property
    def stood(self) -> bool:
        """Whether it stood when it was seen last."""
        return self.detection.stands == self.id > 0

    @property
    def is_absorbed(self) -> bool:
        """Whether it stood for so long that it is background."""
        return self.stands and self.detection.absorbed

    @property
    def velocity(self) -> tuple[float, float]:
        """Estimated velocity in pixels a frame against the scene."""
        vx, vy = self.kalman.statePost[2:, 0]
        return float(vx), float(vy)

    @property
    def _expected_outline(self) -> CroppedMask:
        dx, dy = np.rint(self.position - self.seen_at).astype(int)
        return CroppedMask(self.detection.box.moved(int(dx), int(dy)), self.detection.mask)

    def propagate(self, ego_motion: Matrix) -> None:
        """Take its state into the next frame: by the ego-motion, then by its velocity."""
        self.age += 1
        linear = ego_motion[:2, :2]
        state = self.kalman.statePost
        state[:2, 0] = transformed_point(ego_motion, state[:2, 0])
        state[2:, 0] = linear @ state[2:, 0]
        self.kalman.statePost = state
        self.kalman.predict()
        self.start = transformed_point(ego_motion, self.start)
        self.trail = transformed_points(ego_motion, self.trail)
        self.sightings = transformed_points(ego_motion, self.sightings)
        self.steps = [linear @ step for step in self.steps]
        self.front = self.front.propagated(ego_motion)

    def follow(self, image: ByteImage, ego_motion: Matrix) -> None:
        """Put it where its picture is found in the frame that it was propagated to.

        :param image: HxWxC, that frame.
        :param ego_motion: takes the last frame's pixels to that one's.
        """
        step = self._step(image, ego_motion)
        self.followed = step is not None
        if step is None:
            return
        self.steps = [*self.steps, step][-_TRAIL_LENGTH:]
        place = transformed_point(ego_motion, self.seen_at) + step
        # It was there before, as surely as that is known, and goes on by what was told now.
        before = np.kron(np.diag([1.0, 0.0]), np.eye(2)) * self.kalman.measurementNoiseCov[0, 0]
        velocity = _ANY_VELOCITY * _BY_PICTURE**2
        self.kalman.statePre = np.array([*place, *step]).reshape(4, 1)
        self.kalman.statePost = self.kalman.statePre.copy()
        self.kalman.errorCovPre = before + velocity
        self.kalman.errorCovPost = self.kalman.errorCovPre.copy()

    def _step(self, image: ByteImage, ego_motion: Matrix) -> Point | None:
        """Return its displacement by its picture, None where that or flow tells better."""
        if self.template is None:
            return None
        flow_known = self.detection.flow_known
        alike = SURELY_SAME if flow_known else SAME
        step = self.template.displacement(image, ego_motion, alike)
        if step is None or not flow_known:
            return step
        length, error = np.linalg.norm(step), np.linalg.norm(step - self.velocity)
        return step if length >= _TOO_FAST and error >= _OTHER_STEP * length else None

    def remember_picture(self, image: ByteImage) -> None:
        """Remember what it looks like in this frame, HxWxC, if it must be followed by that.

        It must where it was seen, and no flow tells its velocity, or may have lost it.
        """
        self.template = None
        if self.misses or self.targets or self.stood:
            return
        if not self.detection.flow_known or self._outruns_flow():
            self.template = Template.of(self.detection.outline, image)

    def _outruns_flow(self) -> bool:
        """Whether the middle of its outline goes fast, and otherwise than flow says.

        Of what was seen only once, flow itself tells whether it goes fast.
        """
        if len(self.sightings) < 2:
            return float(np.hypot(*self.detection.velocity)) >= _FAST
        went = self.sightings[-1] - self.sightings[-2]
        way, error = np.linalg.norm(went), np.linalg.norm(went - self.detection.velocity)
        return bool(way >= _FAST and error >= _OTHER_STEP * way)

    def correct(self, detection: Detection) -> None:
        """Take the detection that stands for it in this frame."""
        # A pixel more or less is much of a target of a few, and says nothing.
        iou = 1.0 if detection.moves_significantly else self.shape_iou(detection)
        self.shape_ious = [*self.shape_ious, iou][-SHAPE_SPAN:]
        if not detection.flow_known and not self.followed:
            self._raise_velocity_variance(detection.centroid)
        self.kalman.correct(detection.centroid.reshape(2, 1))
        self._see(detection, detection.centroid)

    def _raise_velocity_variance(self, centroid: Point) -> None:
        """Raise the variance of the velocity where a place is surprising and no flow tells it."""
        uncertain = self.kalman.errorCovPre
        surprise = centroid - self.position
        usual = uncertain[:2, :2] + self.kalman.measurementNoiseCov
        if surprise @ np.linalg.solve(usual, surprise) > _SURPRISING**2:
            self.kalman.errorCovPre = uncertain + float(surprise @ surprise) * _ANY_VELOCITY

    def correct_beside(
        self, detection: Detection, whole: AppearanceModel, others: CroppedMask
    ) -> None:
        """Take what is seen of it where others touch or hide it.

        Its place follows from where what is seen lies against what should be, the less surely the
        less that is; its shape is taken to be what it was.

        :param whole: the object where it is expected, hidden parts included.
        :param others: the pixels of the others.
        """
        box = whole.outline.box
        visible = whole.outline.mask & ~others.within(box)
        share = np.count_nonzero(visible) / max(whole.outline.area, 1)
        centroid = self.position
        if share > _MIN_VISIBLE:
            centroid += detection.centroid - Detection(box, visible, (0.0, 0.0), False).centroid
            usual = np.array(self.kalman.measurementNoiseCov)
            self.kalman.measurementNoiseCov = usual / share**2
            self.kalman.correct(centroid.reshape(2, 1))
            self.kalman.measurementNoiseCov = usual
        self.shape_ious = [*self.shape_ious, *self.shape_ious[-1:]][-SHAPE_SPAN:]
        self._see(detection, centroid)

    def _see(self, detection: Detection, centroid: Point) -> None:
        self.detection, self.seen_at = detection, centroid
        self.front = self.front.seen(detection.outline, detection.cut_sides)
        self.targets = detection.targets or self.targets
        self.sightings = [*self.sightings, centroid][-_TRAIL_LENGTH:]
        self.clutter = [*self.clutter, detection.clutter][-_TRAIL_LENGTH:]
        self.hits += 1
        speed = float(np.hypot(*detection.velocity))
        self.flow_speeds = [*self.flow_speeds, speed][-_TRAIL_LENGTH:]
        goes = detection.moving and (detection.flow_known or self._covers_itself())
        self.still = 0 if goes or self.stands else self.still + 1

    def _covers_itself(self) -> bool:
        """Whether it goes so fast that it has soon left its place, or may have."""
        recent = self.sightings[-_RECENT:]
        way = float(np.linalg.norm(recent[-1] - recent[0]))
        return way * _SOON >= self.size * (len(recent) - 1)

    def coast(self, ego_motion: Matrix, shape: tuple[int, int]) -> Detection:
        """Take it into the next frame, where nobody looks for it; return where it is.

        If it was found when it was last looked for, its shape is taken to be as alike, and its
        flow as fast, as then.
        """
        expected = self.expected(ego_motion, shape)
        self.propagate(ego_motion)
        self.template = None
        self.still += 1
        if self.misses == 0:
            self.hits += 1
            self.shape_ious = [*self.shape_ious, *self.shape_ious[-1:]][-SHAPE_SPAN:]
            self.flow_speeds = [*self.flow_speeds, *self.flow_speeds[-1:]][-_TRAIL_LENGTH:]
        return expected

    def intersection_area(self, detection: Detection) -> int:
        """Count the detection's pixels that lie where its mask is expected now."""
        return self._expected_outline.common_area(detection.outline)

    def shape_iou(self, detection: Detection) -> float:
        """Return the IoU of a detection with its mask where that is expected now."""
        return self._expected_outline.iou(detection.outline)

    @property
    def deviation(self) -> float:
        """Standard deviation of its estimated centroid, in pixels."""
        variances = np.diag(self.kalman.errorCovPost)[:2]
        return float(np.sqrt(variances.max()))

    @property
    def certainty(self) -> float:
        """The probability, 0 to 1, that it is true."""
        return certainty(self.shape_ious)

    @property
    def travelled(self) -> float:
        """Distance from where it was seen first, in pixels."""
        return float(np.linalg.norm(self.position - self.start))

    @property
    def walked(self) -> float:
        """Path length over its sightings, in pixels."""
        return float(np.linalg.norm(np.diff(self.sightings, axis=0), axis=1).sum())

    @property
    def stepped(self) -> tuple[float, float] | None:
        """Displacement and path length by its picture, in pixels.

        The displacement is that of its median step: one wrong step tells nothing. None unless its
        picture was found in all frames but one since it was seen first.
        """
        if len(self.steps) < max(self.hits - 2, _FEWEST_STEPS):
            return None
        displacement = len(self.steps) * np.linalg.norm(np.median(self.steps, axis=0))
        return float(displacement), float(np.linalg.norm(self.steps, axis=1).sum())

    def expected(self, ego_motion: Matrix, shape: tuple[int, int], frames: int = 1) -> Detection:
        """Return it as it should be in a coming frame of some shape.

        :param ego_motion: takes the last frame's pixels to the coming one's.
        :param frames: how many frames later that is.
        """
        # The position has been propagated since the mask was last seen.
        x, y = self.position - self.seen_at + frames * np.asarray(self.velocity)
        motion = ego_motion @ translation(x, y)
        outline = self.detection.outline.resampled(motion, shape, cv2.INTER_NEAREST)
        return Detection(
            outline.box, outline.mask, self.velocity, moving=False, targets=self.targets
        )

    def observed(self, detection: Detection) -> Observation:
        """Remember where it is now; return what is known of it in this frame.

        :param detection: what stands for it there.
        """
        self.trail = [*self.trail, self.position][-_TRAIL_LENGTH:]
        return Observation(
            track=self,
            detection=detection,
            velocity=self.velocity,
            trail=tuple((float(x), float(y)) for x, y in self.trail),
        )


@dataclass(frozen=True)
class Observation:
    """A track seen in one frame; `track` may become confirmed only later."""

    track: Track
    detection: Detection
    velocity: tuple[float, float]
    trail: tuple[tuple[float, float], ...]


class Tracker(Protocol):
    """Assigns to the objects of one frame the identities they had in others."""

    @property
    def delay(self) -> int:
        """Frames that must follow before it is known which tracks are objects."""

    @property
    def next_id(self) -> int:
        """The id that the next object will get."""

    def continue_ids(self, other: Tracker) -> None:
        """Go on counting where another one stands."""

    def reset(self) -> None:
        """End all tracks; ids go on."""

    def expected_objects(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Detection]:
        """Return each object as it should be in the coming frame of some shape.

        :param ego_motion: takes the last frame's pixels to the coming one's.
        """

    def travelled_outlines(
        self, ego_motion: Matrix, shape: tuple[int, int], frames: int
    ) -> list[CroppedMask]:
        """Return where each object that has travelled half its size should be so many frames on.

        :param ego_motion: takes the last frame's pixels to that one's, which is of some shape.
        """

    def update(
        self,
        detections: Sequence[Detection],
        ego_motion: Matrix,
        tilt: float,
        image: ByteImage,
        slewing: bool = False,
    ) -> list[Observation]:
        """Return an observation for each detection that stands for a track.

        :param ego_motion: takes the last frame's pixels to this one's.
        :param tilt: rms turbulent motion an axis in pixels.
        :param image: HxWxC, this frame.
        :param slewing: whether the camera is turned so fast that the scene may seem to move.
        """

    def coast(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Observation]:
        """Propagate what was seen to a frame of some shape in which nothing is looked for.

        :param ego_motion: takes the last frame's pixels to this one's.
        """

    def settle(self) -> None:
        """Decide what is open: no frame follows."""


def joined(parts: Sequence[Detection]) -> Detection:
    """Make one detection of several; the largest one's velocity is the whole's."""
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
    return replace(
        largest,
        box=box,
        mask=mask,
        moving=any(part.moving for part in parts),
        cut_sides=functools.reduce(Sides.joined, (part.cut_sides for part in parts)),
        targets=frozenset[int]().union(*(part.targets for part in parts)),
        stands=max(part.stands for part in parts),
        absorbed=any(part.absorbed for part in parts),
    )


def _kalman_at(detection: Detection, tilt: float) -> cv2.KalmanFilter:
    kalman = cv2.KalmanFilter(4, 2, 0, cv2.CV_64F)
    kalman.transitionMatrix = np.eye(4) + np.diag([1.0, 1.0], 2)
    kalman.measurementMatrix = np.eye(2, 4)
    speed = float(np.hypot(*detection.velocity))
    # Objects change their velocity by about a tenth within a few frames.
    acceleration = (0.05 + 0.05 * speed) ** 2
    kalman.processNoiseCov = np.diag([0.0, 0.0, acceleration, acceleration])
    measurement_variance = (1.0 + tilt) ** 2
    kalman.measurementNoiseCov = np.diag([measurement_variance, measurement_variance])
    kalman.statePost = np.array([*detection.centroid, *detection.velocity]).reshape(4, 1)
    velocity_variance = (0.2 + 0.3 * speed) ** 2
    if not detection.flow_known:
        velocity_variance = (_UNKNOWN_SPEED * float(np.hypot(*detection.box.shape))) ** 2
    kalman.errorCovPost = np.diag(
        [measurement_variance, measurement_variance, velocity_variance, velocity_variance]
    )
    return kalman
