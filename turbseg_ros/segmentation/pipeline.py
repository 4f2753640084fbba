"""The whole method: frames in, one result for each out, in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import AlignedFrame, MaskedImage, with_objects_masked
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, CroppedMask, union_mask
from turbseg_ros.segmentation.exposure import AS_IT_IS, Exposure, exposure_between
from turbseg_ros.segmentation.flow import FlowBackend
from turbseg_ros.segmentation.foreground import foreground_masks, object_crops
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult, label_of
from turbseg_ros.segmentation.geometry import scaling, translation
from turbseg_ros.segmentation.kalman_tracker import KalmanTracker
from turbseg_ros.segmentation.kmeans_ids import KMeansIds
from turbseg_ros.segmentation.motion import (
    MotionEstimate,
    next_interval,
)
from turbseg_ros.segmentation.motion_worker import MotionJob, MotionWorker
from turbseg_ros.segmentation.moving import Moving, propagated
from turbseg_ros.segmentation.refinement import Refiner, refined_masks
from turbseg_ros.segmentation.tone import ToneMap
from turbseg_ros.segmentation.track import Detection, Observation, Tracker
from turbseg_ros.segmentation.window import FrameWindow, PreparedFrame, Resolution, prepare

Mask = npt.NDArray[np.bool_]
Matrix = npt.NDArray[np.float64]
ByteImage = npt.NDArray[np.uint8]

# Flow is also taken so many times B back, for what is slow.
_LONG = 3
# Smallest outline, in detail pixels.
_MIN_OUTLINE = 12
# Pixels by which objects are widened before what is left counts as background.
_GUARD = 2
# Frames segmented for each that comes while some have piled up.
_CATCH_UP = 2
# Periods of measuring motion from one time to the next while very many frames wait.
_SPARSE = 2
# A known object counts as resting when motion was found on less than this share of it.
_RESTING = 0.6


@dataclass(frozen=True)
class _Pending:
    """A segmented frame that waits until it is known which of its tracks are objects."""

    frame: Frame
    resolution: Resolution
    motion: MotionEstimate | None
    observations: Sequence[Observation]
    coasted: bool = False


@dataclass(frozen=True)
class _Outlook:
    """Other frames as one sees them, by index: scenes without what is headed there, exposures."""

    frame: int
    scenes: dict[int, MaskedImage] = field(default_factory=dict)
    exposures: dict[int, Exposure] = field(default_factory=dict)


class MotionSegmenter:
    """Segments what really moves, frame by frame.

    `push` takes frames in the order of time and gives the results that are ready; `flush` gives
    those of all frames that are left. Every frame gets exactly one result, in order. A frame of
    another size, kind or scene than those before starts a new window; ids go on.
    """

    def __init__(
        self,
        parameters: Parameters,
        refiner: Refiner | None = None,
        flow: FlowBackend | None = None,
    ) -> None:
        """Set up without frames; see `turbseg_ros.parameters` for what can be chosen.

        :param refiner: draws the outlines; without one, rules do.
        :param flow: computes the optical flow; without one, OpenCV's DIS does.
        """
        self._refiner = refiner
        self._motion_worker = MotionWorker(parameters.threads, flow)
        self._preparer = ThreadPoolExecutor(1, thread_name_prefix="preparation")
        self._tone = ToneMap()
        self.reconfigure(parameters)

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other parameters and a new window; frames not yet answered are forgotten."""
        identities = getattr(self, "_tracker", None)
        self._parameters = parameters
        self._tracker = _identity_keeper(parameters)
        if identities is not None:
            self._tracker.continue_ids(identities)
        self.reset()

    def reset(self) -> None:
        """Forget all frames and end all objects; ids go on."""
        p = self._parameters
        self._window = FrameWindow(
            # The frame in which motion was measured last is looked back to, too.
            reach=max(_LONG * p.flow.interval, _SPARSE * p.flow.every),
            look_ahead=self._look_ahead,
            warm_up=0 if self._is_causal else p.latency.warm_up,
            memory=p.outline.memory,
            key_step=p.outline.key_step,
        )
        self._tone.reset()
        self._tracker.reset()
        self._resolution: Resolution | None = None
        self._kind: tuple[object, ...] = ()
        self._coming: tuple[Frame, Future[PreparedFrame]] | None = None
        self._frames: dict[int, Frame] = {}
        self._pending: deque[_Pending] = deque()
        self._motion_worker.reset()
        self._moving: Moving | None = None
        self._outlook = _Outlook(0)
        self._in_haste = self._sparse = False
        self._due = 0
        self._interval = p.flow.interval

    @property
    def device(self) -> str:
        """Where optical flow is computed: cpu or cuda."""
        return self._motion_worker.device

    @property
    def look_ahead(self) -> int:
        """Frames that must follow a frame before its result is given."""
        if self._is_causal:
            return 0
        return self._look_ahead + self._tracker.delay + int(self._prepares_ahead)

    @property
    def _is_causal(self) -> bool:
        return self._parameters.latency.mode == "causal"

    @property
    def _prepares_ahead(self) -> bool:
        """Whether a frame is prepared beside all else, and joins the others with the next."""
        return not self._is_causal

    @property
    def _look_ahead(self) -> int:
        """Frames that must follow a frame before it is segmented.

        They are its own neighbours and those of the frame measured next, which is then worked on.
        """
        flow = self._parameters.flow
        return 0 if self._is_causal else flow.interval + flow.every

    def push(self, frame: Frame, waiting: int = 0) -> list[SegmentationResult]:
        """Take the next frame; return the results that are ready, of earlier frames mostly.

        Its image is still read until the next call.

        :param waiting: frames that wait to be pushed after it. Where there are as many as the
            parameters say, it is done sooner and less exactly: where motion isn't measured anew,
            objects are carried along instead of looked for, frames that have piled up are left
            for later, and with still more, motion is measured less often.
        """
        self._hurry(waiting)
        at_most = 1 if self._in_haste and waiting else _CATCH_UP
        results = []
        if self._kind and _kind_of(frame) != self._kind:
            results = self.flush()
            self.reset()
        results += self._take_in()
        self._prepare(frame)
        if not self._prepares_ahead:
            results += self._take_in()
        return results + self._advance(ended=False, at_most=at_most)

    def flush(self, waiting: Callable[[], int] | None = None) -> list[SegmentationResult]:
        """Return the results of all frames that have none yet.

        :param waiting: tells how many frames wait meanwhile to be pushed afterwards; asked before
            each frame, which is hurried with as in `push`; by default, as the last `push` said.
        """
        return self._take_in() + self._advance(ended=True, waiting=waiting)

    def _hurry(self, waiting: int) -> None:
        latency = self._parameters.latency
        self._in_haste = waiting >= latency.haste_from
        self._sparse = waiting >= latency.sparse_from

    def _prepare(self, frame: Frame) -> None:
        """Have a frame scaled and registered to the one before."""
        self._kind = _kind_of(frame)
        if self._resolution is None:
            sizes = self._parameters.resolution
            self._resolution = Resolution.of(frame.image.shape, sizes.processing, sizes.detail)
        picture, window = self._tone(frame.image), self._window
        self._coming = (
            frame,
            self._preparer.submit(prepare, picture, self._resolution, window.count, window.newest),
        )

    def _take_in(self) -> list[SegmentationResult]:
        """Let the frame that was prepared join the others; after a cut, give what was before."""
        if self._coming is None:
            return []
        (frame, preparation), self._coming = self._coming, None
        try:
            prepared = preparation.result()
        except Exception as error:
            raise RuntimeError(f"the frame of {frame.stamp} ns can't be prepared") from error
        if self._window.follows_cut(prepared):
            results = self._advance(ended=True)
            self.reset()
            self._prepare(frame)
            return results + self._take_in()
        self._window.append(prepared)
        self._frames[prepared.index] = frame.kept()
        return []

    def _advance(
        self, ended: bool, at_most: int = 1, waiting: Callable[[], int] | None = None
    ) -> list[SegmentationResult]:
        for centre in self._window.ready(ended, at_most):
            if waiting is not None:
                self._hurry(waiting())
            self._pending.append(self._segment(centre))
        if ended:
            self._tracker.settle()
        delay = 0 if ended or self._is_causal else self._tracker.delay
        results = []
        while len(self._pending) > delay:
            results.append(_result(self._pending.popleft()))
        return results

    def _segment(self, centre: int) -> _Pending:
        assert self._resolution is not None
        frame = self._frames.pop(centre)
        ego_motion = self._ego_motion(centre)
        moving = self._what_moves(centre)
        if moving is not None and moving.measured:
            widest = self._parameters.flow.interval
            self._interval = next_interval(self._interval, widest, moving.motion.tilt)
        self._moving = moving
        self._measure_ahead(centre)
        if moving is None:
            self._tracker.update([], ego_motion, 0.0)
            return _Pending(frame, self._resolution, None, [])
        coasted = self._in_haste and not moving.measured
        observations = (
            self._tracker.coast(ego_motion, self._detail_shape)
            if coasted
            else self._looked_for(centre, moving, ego_motion, frame.stamp)
        )
        shape = self._detail_shape
        widened = [seen.detection.outline.dilated(_GUARD, shape) for seen in observations]
        self._window.mark_objects(centre, widened)
        # Where nothing is cut out now, nothing will be until motion is measured again.
        self._moving = moving.where(union_mask(widened, shape))
        return _Pending(frame, self._resolution, moving.motion, observations, coasted)

    def _looked_for(
        self, centre: int, moving: Moving, ego_motion: Matrix, stamp: int
    ) -> list[Observation]:
        """Look for objects where something moves, and tell which of the known ones they are."""
        assert self._resolution is not None
        scale = self._resolution.detail_from_processing[0]
        tilt = 0.0 if np.isnan(moving.motion.tilt) else moving.motion.tilt * scale
        detections = self._outlines(centre, moving, ego_motion, tilt, stamp)
        return self._tracker.update(detections, ego_motion, tilt)

    @property
    def _detail_shape(self) -> tuple[int, int]:
        assert self._resolution is not None
        return self._resolution.detail[1], self._resolution.detail[0]

    def _ego_motion(self, centre: int) -> Matrix:
        """Return the transform of detail pixels from the frame before to this one."""
        assert self._resolution is not None
        if centre == 0:
            return np.eye(3)
        return self._resolution.to_detail(self._window[centre].from_previous)

    def _intervals(self) -> list[int]:
        p = self._parameters
        widest = p.flow.interval
        if p.flow.average == "slope" and p.motion.measure != "sampson":
            return [-_LONG * self._interval, -self._interval, self._interval]
        reach = range(1, widest + 1)
        if self._is_causal:
            return [-k for k in reach] + [-k - widest for k in reach]
        return [*(-k for k in reach), *reach]

    def _what_moves(self, centre: int) -> Moving | None:
        """Find what moves in a frame; None where there is nothing to compare it with."""
        measured = centre - self._lag
        if not self._window.shows_scene(centre):
            self._motion_worker.drop(measured)
            return None
        if self._is_due(centre) and centre not in self._motion_worker:
            self._order(centre)
        if measured in self._motion_worker:
            found = self._brought(self._motion_worker.take(measured), measured, centre)
            return None if found is None else replace(found, measured=True)
        return self._brought(self._moving, centre - 1, centre)

    @property
    def _lag(self) -> int:
        """Frames after which what moves in a frame is asked for, if none are waited for anyway.

        Meanwhile it is found beside what else is done.
        """
        return (self._parameters.flow.every + 1) // 2 if self._is_causal else 0

    def _is_due(self, centre: int) -> bool:
        """Whether motion is to be measured in a frame: in turn, or as none can be carried."""
        if centre == self._due:
            return True
        can_be_carried = self._moving is not None and self._window[centre].continues
        return not can_be_carried and not (self._lag and len(self._motion_worker))

    def _brought(self, moving: Moving | None, source: int, centre: int) -> Moving | None:
        """Bring what moves in one frame to a later one; None where the scene has changed."""
        if moving is None or not self._window.goes_on(source, centre):
            return None
        assert self._resolution is not None
        if source == centre:
            return moving
        ego_motion = self._window.transform(source, centre)
        return propagated(moving, ego_motion, self._resolution, centre - source)

    def _measure_ahead(self, centre: int) -> None:
        """Have motion measured in the next frame that is due, while outlines are drawn."""
        every = self._parameters.flow.every
        if centre >= self._due:
            self._due = (centre // every + (_SPARSE if self._sparse else 1)) * every
        is_at_hand = self._due < self._window.count and self._due <= centre + every
        if is_at_hand and self._due not in self._motion_worker:
            self._order(self._due)

    def _order(self, centre: int) -> None:
        """Have what moves in a frame found beside what else is done."""
        assert self._resolution is not None
        self._motion_worker.order(
            MotionJob(
                index=centre,
                surroundings=self._window.neighbourhood(centre, self._intervals()),
                near=2 * self._interval,
                parameters=self._parameters,
                size=self._resolution.detail,
            )
        )

    def _outlines(
        self,
        centre: int,
        moving: Moving,
        ego_motion: Matrix,
        tilt: float,
        stamp: int,
    ) -> list[Detection]:
        """Turn moving regions into outlines at detail resolution."""
        assert self._resolution is not None
        area = union_mask([area.search_mask for area in moving.areas], self._detail_shape)
        seen_to_move = area if moving.measured else np.zeros_like(area)
        if self._parameters.outline.method == "none":
            sizes = self._resolution.detail, self._resolution.processing
            outlines = [region.outline.resized(*sizes) for region in moving.regions]
        else:
            resting = self._resting_objects(area, ego_motion)
            windows = object_crops(
                self._window[centre].detail,
                [*moving.areas, *resting],
                self._views(centre, moving),
                moving.motion,
                tilt,
                stamp,
            )
            threshold = self._parameters.outline.threshold
            outlines = (
                foreground_masks(windows, threshold)
                if self._refiner is None
                else refined_masks(windows, self._refiner.refine(windows))
            )
        return [
            _detection(outline, seen_to_move, moving.motion, self._resolution)
            for outline in outlines
            if outline.area >= _MIN_OUTLINE
        ]

    def _resting_objects(self, moving: Mask, ego_motion: Matrix) -> list[MovingArea]:
        """Return where known objects should be that no motion was found for."""
        shape = self._detail_shape
        return [
            MovingArea(expected.dilated(_GUARD + 1, shape), EMPTY_MASK, EMPTY_MASK, (0.0, 0.0))
            for expected in self._tracker.expected_outlines(ego_motion, shape)
            if expected.intersection_area(moving) < _RESTING * expected.area
        ]

    def _views(self, centre: int, moving: Moving) -> list[AlignedFrame]:
        """Return the scene at other times; in frames to come, objects are where they are headed.

        Exposures, and what is yet to come, are as they were when motion was measured last.
        """
        assert self._resolution is not None
        if moving.measured:
            self._outlook = _Outlook(centre)
        window, outlook = self._window, self._outlook
        transforms = window.transforms_from(centre)
        since = self._exposure(outlook.frame, centre, transforms[outlook.frame])
        views = []
        for index in window.key_frames(centre):
            to_image = self._resolution.to_detail(transforms[index])
            if index not in outlook.exposures:
                way = transforms[index] @ np.linalg.inv(transforms[outlook.frame])
                outlook.exposures[index] = self._exposure(index, outlook.frame, way)
            scene = window[index].scene
            if not window[index].objects_known:
                if index not in outlook.scenes:
                    objects = self._headed(moving.areas, index - centre, to_image)
                    outlook.scenes[index] = with_objects_masked(scene, objects)
                scene = outlook.scenes[index]
            views.append(AlignedFrame(scene, to_image, outlook.exposures[index].then(since)))
        return views

    def _exposure(self, source: int, target: int, to_source: Matrix) -> Exposure:
        """Return what takes the grey values of one frame to those of another."""
        if source == target:
            return AS_IT_IS
        return exposure_between(self._window[source].grey, self._window[target].grey, to_source)

    def _headed(
        self, areas: Sequence[MovingArea], frames: int, to_image: Matrix
    ) -> list[CroppedMask]:
        """Return the cores of moving areas so many frames on, in that frame's pixels."""
        return [
            area.probable.resampled(
                to_image @ translation(area.velocity[0] * frames, area.velocity[1] * frames),
                self._detail_shape,
                cv2.INTER_NEAREST,
            )
            for area in areas
        ]


def _kind_of(frame: Frame) -> tuple[object, ...]:
    return frame.image.shape, frame.image.dtype


def _identity_keeper(parameters: Parameters) -> Tracker:
    tracking = parameters.tracking
    if tracking.mode == "kmeans":
        return KMeansIds(slots=parameters.max_objects)
    return KalmanTracker(
        confirmation=tracking.confirmation,
        travel=tracking.travel,
        patience=tracking.patience,
        slots=parameters.max_objects,
        every=parameters.flow.every,
    )


def _detection(
    outline: CroppedMask, moving: Mask, motion: MotionEstimate, resolution: Resolution
) -> Detection:
    """Describe an outline: its velocity is the median over its pixels."""
    y, x = np.nonzero(outline.mask)
    scale_x, scale_y = resolution.detail_from_processing
    height, width = motion.motion_map.shape
    column = np.minimum(((x + outline.box.x0) / scale_x).astype(int), width - 1)
    row = np.minimum(((y + outline.box.y0) / scale_y).astype(int), height - 1)
    vx, vy = np.median(motion.velocity[row, column], axis=0)
    return Detection(
        box=outline.box,
        mask=outline.mask,
        velocity=(float(vx) * scale_x, float(vy) * scale_y),
        moving=bool((outline.mask & moving[outline.box.slices]).any()),
    )


def _result(pending: _Pending) -> SegmentationResult:
    width, height = pending.resolution.input
    scale = width / pending.resolution.detail[0]
    labels = np.zeros((height, width), np.uint16)
    objects = []
    for observation in pending.observations:
        if not observation.track.confirmed:
            continue
        found = _at_input_resolution(observation.detection, pending.resolution)
        there = labels[found.box.slices]
        mask = found.mask & (there == 0)
        if mask.any():
            there[mask] = label_of(observation.track.id)
            objects.append(_moving_object(observation, CroppedMask(found.box, mask), scale))
    processing_scale = width / pending.resolution.processing[0]
    motion = pending.motion
    return SegmentationResult(
        frame=pending.frame,
        labels=labels,
        objects=tuple(sorted(objects, key=lambda found: found.id)),
        motion_map=(
            np.zeros(pending.resolution.processing[::-1], np.float32)
            if motion is None
            else motion.motion_map * np.float32(processing_scale)
        ),
        tilt=float("nan") if motion is None else motion.tilt * processing_scale,
        ego_motion_model="none" if motion is None else motion.ego_motion_model,
        coasted=pending.coasted,
    )


def _at_input_resolution(detection: Detection, resolution: Resolution) -> CroppedMask:
    outline = detection.outline
    if resolution.detail == resolution.input:
        return outline
    x, y = (there / here for there, here in zip(resolution.input, resolution.detail, strict=True))
    return outline.resampled(scaling(x, y), resolution.input[::-1], cv2.INTER_LINEAR)


def _moving_object(observation: Observation, outline: CroppedMask, scale: float) -> MovingObject:
    box = CroppedMask.of(outline.mask, outline.box.x0, outline.box.y0).box
    moments = cv2.moments(outline.mask.view(np.uint8), binaryImage=True)
    area = moments["m00"]
    vx, vy = observation.velocity
    return MovingObject(
        id=observation.track.id,
        slot=observation.track.slot,
        centroid=(
            moments["m10"] / area + outline.box.x0,
            moments["m01"] / area + outline.box.y0,
        ),
        velocity=(vx * scale, vy * scale),
        area=int(area),
        box=(box.x0, box.y0, box.x1 - box.x0, box.y1 - box.y0),
        trail=tuple((px * scale, py * scale) for px, py in observation.trail),
    )
