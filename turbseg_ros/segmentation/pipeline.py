"""The whole method: frames in, one result for each out, in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation import region_growing
from turbseg_ros.segmentation.background import View, without_objects
from turbseg_ros.segmentation.flow import Flow, FlowBackend, dis_flow
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult, label_of
from turbseg_ros.segmentation.geometry import scaling
from turbseg_ros.segmentation.motion import (
    MotionEstimate,
    affine_motions,
    agree,
    mean_velocity,
    merged,
    next_interval,
    sampson_motion,
    slope_velocity,
    unchecked_motions,
)
from turbseg_ros.segmentation.refinement import Refiner, refined_silhouettes
from turbseg_ros.segmentation.region_growing import Region
from turbseg_ros.segmentation.silhouette import (
    SMEAR,
    MovingArea,
    Outline,
    convex_hull,
    enlarged,
    moving_areas,
    object_windows,
    resampled,
    silhouettes,
    union,
)
from turbseg_ros.segmentation.stabilization import align, visible
from turbseg_ros.segmentation.tone import ToneMap
from turbseg_ros.segmentation.track import Candidate, IdentityKeeper, Observation
from turbseg_ros.segmentation.tracking import ObjectTracker
from turbseg_ros.segmentation.unification import KMeansUnifier
from turbseg_ros.segmentation.window import FrameWindow, Resolution, prepare

Mask = npt.NDArray[np.bool_]
Matrix = npt.NDArray[np.float64]
ByteImage = npt.NDArray[np.uint8]

_FLOW_THREADS = 2
# Flow is also taken so many times B back, for what is slow.
_LONG = 3
# Flow within this many pixels of another frame's border follows the border, not the scene.
_BORDER = 4.0
# Smallest region, in pixels at processing resolution, and smallest outline, in detail pixels.
_SMALLEST_REGION = 12
_SMALLEST_OUTLINE = 12
# Pixels by which objects are widened before what is left counts as background.
_GUARD = 2
# A known object counts as resting when motion was found on less than this share of it.
_RESTING = 0.6


@dataclass(frozen=True)
class _Moving:
    """What moves in a frame: the motion measured, the regions grown, where objects may be."""

    motion: MotionEstimate
    regions: Sequence[Region]
    areas: Sequence[MovingArea]


@dataclass(frozen=True)
class _Pending:
    """A segmented frame that waits until it is known which of its tracks are objects."""

    frame: Frame
    resolution: Resolution
    motion: MotionEstimate | None
    observations: Sequence[Observation]


class MotionSegmenter:
    """Segments what really moves, frame by frame.

    `push` takes frames in the order of time and gives the results that are ready; `flush` gives
    those of all frames that are left. Every frame gets exactly one result, in order. A frame of
    another size or kind than the one before starts a new window; ids go on.
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
        self._flow = flow
        self._executor = ThreadPoolExecutor(_FLOW_THREADS, thread_name_prefix="flow")
        # Flows that are being computed, by frame and interval.
        self._ordered: dict[tuple[int, int], Future[Flow]] = {}
        self._tone = ToneMap()
        self.reconfigure(parameters)

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other parameters and a new window; frames not yet answered are forgotten."""
        identities = getattr(self, "_identities", None)
        self._parameters = parameters
        self._identities = _identity_keeper(parameters)
        if identities is not None:
            self._identities.continue_ids(identities)
        self.reset()

    def reset(self) -> None:
        """Forget all frames and end all objects; ids go on."""
        p = self._parameters
        self._window = FrameWindow(
            reach=_LONG * p.flow.interval,
            look_ahead=0 if p.latency.mode == "causal" else p.flow.interval,
            warm_up=0 if p.latency.mode == "causal" else p.latency.warm_up,
            memory=p.outline.memory,
            key_step=p.outline.key_step,
        )
        self._tone.reset()
        self._identities.reset()
        self._resolution: Resolution | None = None
        self._kind: tuple[object, ...] = ()
        self._frames: dict[int, Frame] = {}
        self._pending: deque[_Pending] = deque()
        for flow in self._ordered.values():
            flow.cancel()
        self._ordered = {}
        self._interval = p.flow.interval

    @property
    def device(self) -> str:
        """Where optical flow is computed: cpu or cuda."""
        return "cpu" if self._flow is None else self._flow.device

    @property
    def look_ahead(self) -> int:
        """Frames that must follow a frame before its result is given."""
        p = self._parameters
        if p.latency.mode == "causal":
            return 0
        return p.flow.interval + self._identities.delay

    def push(self, frame: Frame) -> list[SegmentationResult]:
        """Take the next frame; give the results that are ready, of earlier frames mostly."""
        results = []
        kind = (frame.image.shape, frame.image.dtype)
        if self._kind and kind != self._kind:
            results = self.flush()
            self.reset()
        self._kind = kind
        if self._resolution is None:
            sizes = self._parameters.resolution
            self._resolution = Resolution.of(frame.image.shape, sizes.processing, sizes.detail)
        index = self._window.count
        picture = self._tone(frame.image)
        self._window.append(
            prepare(picture, self._resolution, index, previous=self._window.newest)
        )
        self._frames[index] = frame
        return results + self._advance(ended=False)

    def flush(self) -> list[SegmentationResult]:
        """Give the results of all frames that have none yet."""
        return self._advance(ended=True)

    def _advance(self, ended: bool) -> list[SegmentationResult]:
        for centre in self._window.ready(ended):
            self._pending.append(self._segment(centre))
        if ended:
            self._identities.settle()
        causal = self._parameters.latency.mode == "causal"
        delay = 0 if ended or causal else self._identities.delay
        results = []
        while len(self._pending) > delay:
            results.append(_result(self._pending.popleft()))
        return results

    def _segment(self, centre: int) -> _Pending:
        assert self._resolution is not None
        frame = self._frames.pop(centre)
        ego_motion = self._ego_motion(centre)
        motions = self._motions(centre) if self._window.shows_scene(centre) else []
        if not motions:
            self._identities.update([], ego_motion, 0.0)
            return _Pending(frame, self._resolution, None, [])
        self._interval = next_interval(
            self._interval, self._parameters.flow.interval, motions[0].tilt
        )
        moving = self._what_moves(motions)
        scale = self._resolution.detail_from_processing[0]
        tilt = 0.0 if np.isnan(moving.motion.tilt) else moving.motion.tilt * scale
        candidates = self._outlines(centre, moving, ego_motion, tilt, frame.stamp)
        observations = self._identities.update(candidates, ego_motion, tilt)
        self._window.mark_objects(centre, _widened(candidates, self._detail_shape, _GUARD))
        return _Pending(frame, self._resolution, moving.motion, observations)

    @property
    def _detail_shape(self) -> tuple[int, int]:
        assert self._resolution is not None
        return self._resolution.detail[1], self._resolution.detail[0]

    def _ego_motion(self, centre: int) -> Matrix:
        """Give the transform of detail pixels from the frame before to this one."""
        assert self._resolution is not None
        if centre == 0:
            return np.eye(3)
        return self._resolution.to_detail(self._window.transform(centre - 1, centre))

    def _intervals(self) -> list[int]:
        p = self._parameters
        widest = p.flow.interval
        if p.flow.average == "slope" and p.motion.measure != "sampson":
            return [-_LONG * self._interval, -self._interval, self._interval]
        reach = range(1, widest + 1)
        if p.latency.mode == "causal":
            return [-k for k in reach] + [-k - widest for k in reach]
        return [*(-k for k in reach), *reach]

    def _motions(self, centre: int) -> list[MotionEstimate]:
        """Measure the motion in a frame, over a short and a long time.

        Nothing is given while there is nothing to compare it with.
        """
        intervals = self._window.neighbours(centre, self._intervals())
        if len(intervals) < 2:
            return []
        height, width = self._window[centre].grey.shape
        weights = {
            k: visible(
                (height, width), self._window.transform(centre, centre + k), _BORDER
            ).astype(np.float32)
            for k in intervals
        }
        flows = self._flows(centre, intervals)
        p = self._parameters
        if p.motion.measure == "sampson":
            return [sampson_motion(flows, weights, _interval_sets(p.flow.interval))]
        measure = affine_motions if p.motion.measure == "affine" else unchecked_motions
        if p.flow.average == "mean":
            return measure(flows, weights, [intervals], mean_velocity)
        near = [k for k in intervals if abs(k) <= 2 * self._interval]
        one = len(near) in (len(intervals), 0, 1)
        return measure(flows, weights, [intervals] if one else [near, intervals], slope_velocity)

    def _flows(self, centre: int, intervals: Sequence[int]) -> dict[int, Flow]:
        """Give the flows of a frame to its neighbours, which are aligned to it."""
        if self._flow is not None:
            aligned = {k: self._aligned(centre, k) for k in intervals}
            return self._flow.flows_to(self._window[centre].grey, aligned)
        self._order_flows(centre, intervals)
        # Those of the next frame for which all is there are computed while outlines are drawn.
        following = centre + 1
        if self._window.is_use(following):
            near = [k for k in self._intervals() if self._window.is_use(following + k)]
            self._order_flows(following, near)
        flows = {k: self._ordered[centre, k].result() for k in intervals}
        self._ordered = {pair: flow for pair, flow in self._ordered.items() if pair[0] > centre}
        return flows

    def _order_flows(self, centre: int, intervals: Sequence[int]) -> None:
        for k in intervals:
            if (centre, k) not in self._ordered:
                self._ordered[centre, k] = self._executor.submit(
                    dis_flow,
                    self._window[centre].grey,
                    self._aligned(centre, k),
                    self._parameters.flow.variational_iterations,
                )

    def _aligned(self, centre: int, interval: int) -> ByteImage:
        """Give the grey image of a frame's neighbour as the frame itself would show it."""
        neighbour = centre + interval
        return align(self._window[neighbour].grey, self._window.transform(centre, neighbour))

    def _what_moves(self, motions: Sequence[MotionEstimate]) -> _Moving:
        """Grow regions over a short time, and over a long one where what is slower moves."""
        assert self._resolution is not None
        short = motions[0]
        regions = self._regions(short, np.zeros(short.motion_map.shape, bool))
        moving = _Moving(short, regions, moving_areas(regions, short, self._resolution.detail))
        for motion in motions[1:]:
            taken = _dilated(
                union([convex_hull(region.mask) for region in regions], short.motion_map.shape),
                SMEAR,
            )
            regions = self._regions(motion, taken | ~agree(short, motion))
            slow = union([region.mask for region in regions], taken.shape)
            moving = _Moving(
                merged(moving.motion, motion, slow),
                [*moving.regions, *regions],
                [*moving.areas, *moving_areas(regions, motion, self._resolution.detail)],
            )
        return moving

    def _regions(self, motion: MotionEstimate, taken: Mask) -> list[Region]:
        seed, growing = self._parameters.seed, self._parameters.growing
        strength = region_growing.seed_strength(motion, seed.size, seed.delta1, seed.delta2)
        similarity = {
            "velocity": region_growing.similar_velocity,
            "magnitude": region_growing.similar_magnitude,
        }[growing.similarity]
        return region_growing.grow_regions(
            motion, strength, seed.size, growing.delta, similarity, _SMALLEST_REGION, taken
        )

    def _outlines(
        self,
        centre: int,
        moving: _Moving,
        ego_motion: Matrix,
        tilt: float,
        stamp: int,
    ) -> list[Candidate]:
        """Turn moving regions into outlines at detail resolution."""
        assert self._resolution is not None
        area = union([area.mask for area in moving.areas], self._detail_shape)
        if self._parameters.outline.method == "none":
            masks = [enlarged(region.mask, self._resolution.detail) for region in moving.regions]
            outlines = [Outline.of(mask) for mask in masks if mask.any()]
        else:
            resting = self._resting_objects(area, ego_motion)
            windows = object_windows(
                self._window[centre].detail,
                [*moving.areas, *resting],
                self._views(centre, moving.areas),
                moving.motion,
                tilt,
                stamp,
            )
            threshold = self._parameters.outline.threshold
            outlines = (
                silhouettes(windows, threshold)
                if self._refiner is None
                else refined_silhouettes(windows, self._refiner.refine(windows))
            )
        return [
            _candidate(outline, area, moving.motion, self._resolution)
            for outline in outlines
            if np.count_nonzero(outline.mask) >= _SMALLEST_OUTLINE
        ]

    def _resting_objects(self, moving: Mask, ego_motion: Matrix) -> list[MovingArea]:
        """Give where known objects should be that no motion was found for."""
        expected = self._identities.expected_masks(ego_motion, self._detail_shape)
        return [
            MovingArea(
                mask=_dilated(mask, _GUARD + 1),
                core=np.zeros_like(mask),
                heart=np.zeros_like(mask),
                velocity=(0.0, 0.0),
            )
            for mask in expected
            if np.count_nonzero(mask & moving) < _RESTING * np.count_nonzero(mask)
        ]

    def _views(self, centre: int, areas: Sequence[MovingArea]) -> list[View]:
        """Give the scene at other times; in frames to come, objects are where they are headed."""
        assert self._resolution is not None
        views = []
        for index in self._window.key_frames(centre):
            key = self._window[index]
            to_image = self._resolution.to_detail(self._window.transform(centre, index))
            scene = key.scene
            if scene is None:
                objects = self._headed(areas, index - centre, to_image)
                scene = without_objects(key.detail, objects)
            views.append(View(scene, to_image))
        return views

    def _headed(self, areas: Sequence[MovingArea], frames: int, to_image: Matrix) -> Mask:
        """Give the cores of moving areas so many frames on, HxW, in that frame's pixels."""
        objects = np.zeros(self._detail_shape, bool)
        for area in areas:
            if not area.core.any():
                continue
            core = Outline.of(area.core)
            vx, vy = area.velocity
            step = np.array([[1.0, 0.0, vx * frames], [0.0, 1.0, vy * frames], [0.0, 0.0, 1.0]])
            moved = resampled(core, to_image @ step, self._detail_shape, cv2.INTER_NEAREST)
            objects[moved.box.slices] |= moved.mask
        return objects


def _identity_keeper(parameters: Parameters) -> IdentityKeeper:
    tracking = parameters.tracking
    if tracking.mode == "kmeans":
        return KMeansUnifier(slots=parameters.max_objects)
    return ObjectTracker(
        confirmation=tracking.confirmation,
        travel=tracking.travel,
        patience=tracking.patience,
        slots=parameters.max_objects,
    )


def _interval_sets(widest: int) -> list[tuple[int, ...]]:
    """Give the symmetric sets K of eq. 1 that the authors' code uses, up to the widest interval.

    They are ±2, ±3, ±4, ±1 with ±2, and ±2 with ±3; for B = 1 only ±1 is left.
    """
    single: list[tuple[int, ...]] = [(k, -k) for k in range(2, widest + 1)]
    double: list[tuple[int, ...]] = [(k, -k, k + 1, -k - 1) for k in (1, 2) if k < widest]
    return (single + double) or [(1, -1)]


def _dilated(mask: Mask, radius: int) -> Mask:
    size = 2 * radius + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    dilated: Mask = cv2.dilate(mask.astype(np.uint8), kernel) > 0
    return dilated


def _widened(candidates: Sequence[Candidate], shape: tuple[int, int], radius: int) -> Mask:
    objects = np.zeros(shape, bool)
    for candidate in candidates:
        objects[candidate.box.slices] |= candidate.mask
    return _dilated(objects, radius)


def _candidate(
    outline: Outline, moving: Mask, motion: MotionEstimate, resolution: Resolution
) -> Candidate:
    """Describe an outline: its velocity is the median over its pixels."""
    y, x = np.nonzero(outline.mask)
    scale_x, scale_y = resolution.detail_from_processing
    height, width = motion.motion_map.shape
    column = np.minimum(((x + outline.box.x0) / scale_x).astype(int), width - 1)
    row = np.minimum(((y + outline.box.y0) / scale_y).astype(int), height - 1)
    vx, vy = np.median(motion.velocity[row, column], axis=0)
    return Candidate(
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
        found = _at_input_resolution(observation.candidate, pending.resolution)
        there = labels[found.box.slices]
        mask = found.mask & (there == 0)
        if mask.any():
            there[mask] = label_of(observation.track.id)
            objects.append(_moving_object(observation, Outline(found.box, mask), scale))
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
    )


def _at_input_resolution(candidate: Candidate, resolution: Resolution) -> Outline:
    outline = Outline(candidate.box, candidate.mask)
    if resolution.detail == resolution.input:
        return outline
    x, y = (there / here for there, here in zip(resolution.input, resolution.detail, strict=True))
    return resampled(outline, scaling(x, y), resolution.input[::-1], cv2.INTER_LINEAR)


def _moving_object(observation: Observation, outline: Outline, scale: float) -> MovingObject:
    box = Outline.of(outline.mask, outline.box.x0, outline.box.y0).box
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
