"""The method on one page: a frame's way through it, in the order of the paper (ECCV 2024).

    paper    stage                     the default; and as the paper has it
    eq. 1    stabilised flow           average.SlopeAverage; flow.mean_flow
    eq. 2    geometric consistency     motion.AffineMotion; geometry.sampson_distance
             seeds                     region_growing.seed_strength; evidence.PictureEvidence
    eq. 3    seeded region growing     region_growing.similar_velocity; similar_magnitude
             what comes closer         velocity_memory, expansion.expanded (not in the paper)
             targets                   target_pyramid.TargetPyramid (not in the paper)
             what stands out           standing_out.standing_areas (not in the paper)
    eq. 4    mask ids                  kalman_tracker.KalmanTracker; kmeans_ids.kmeans_ids
    eq. 5-9  refinement                outliner.RefinedDifference; learning.clip_refinement

What stands behind each name, and why it departs from the paper, is in docs/method.md.
"""

from __future__ import annotations

import functools
from concurrent.futures import Executor
from dataclasses import replace

from turbseg_ros.arrays import Mask
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.average import SHORT_BASELINE
from turbseg_ros.segmentation.clutter import cells_of_objects, with_clutter
from turbseg_ros.segmentation.cropped_mask import CroppedMask, union_mask
from turbseg_ros.segmentation.evidence import PictureEvidence
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.segmentation.load import Load
from turbseg_ros.segmentation.look_ahead import LookAhead
from turbseg_ros.segmentation.motion import BEYOND_TURBULENCE, MotionEstimate, measure_for
from turbseg_ros.segmentation.motion_schedule import MotionSchedule, frame_window
from turbseg_ros.segmentation.motion_worker import MotionJob, MotionWorker
from turbseg_ros.segmentation.moving import Moving, what_moves
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.outliner import GUARD, Outliner, overlay_masks
from turbseg_ros.segmentation.pending_result import PendingResult
from turbseg_ros.segmentation.preparation import PreparedFrame
from turbseg_ros.segmentation.region_growing import MIN_REGION, Region, grow_regions, seed_strength
from turbseg_ros.segmentation.registration import without_vote
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.scene_memory import SceneMemory
from turbseg_ros.segmentation.strategies import Strategies
from turbseg_ros.segmentation.target_pyramid import TargetPyramid


class Pipeline:
    """The method at work on one stream: made with its first frame, when the sizes are known.

    :param executor: one thread, in which motion is measured ahead.
    """

    def __init__(
        self,
        resolution: Resolution,
        parameters: Parameters,
        strategies: Strategies,
        look_ahead: LookAhead,
        executor: Executor,
        observer: StageObserver,
    ) -> None:
        self.resolution = resolution
        self.window = frame_window(parameters, strategies.measure, look_ahead)
        # Which cells of the picture stand still while the scene moves, hxw; None while unknown.
        self._overlay: Mask | None = None
        self._parameters = parameters
        self._strategies = strategies
        self._observer = observer
        self._worker = MotionWorker(self.measure_motion, executor)
        self._schedule = MotionSchedule(
            self.window,
            resolution,
            strategies.measure,
            self._worker,
            parameters.flow,
            look_ahead,
            observer,
            self._travelled_objects,
        )
        self._scene = SceneMemory(parameters.regions.static_overlays, parameters.motion.averaging)
        self._targets = TargetPyramid(resolution.processing_shape)
        self._regions = strategies.regions.fitted(resolution)
        self._tracked = -1  # The last frame's index.
        self._outliner = Outliner(
            self.window, resolution, strategies.outlines, observer, parameters
        )

    def append(self, frame: PreparedFrame) -> None:
        """Take the next frame into the window, and follow what stands out in it."""
        self.window.append(frame)
        with self._observer.stage("small targets"):
            self._targets.follow(self.window, self._travelled_objects(frame.index), self._overlay)

    def segment_frame(self, index: int, frame: Frame, load: Load) -> PendingResult:
        """Segment the next frame of the window."""
        resolution, tracker = self.resolution, self._strategies.tracker
        camera = self.window[index].camera
        ego_motion = resolution.to_detail(self.window[index].from_previous)

        # What moves here, measured (see `measure_motion`) or propagated: eq. 1 to 3.
        moving = self._schedule.what_moves(index, load)
        if moving is None:
            tracker.update([], ego_motion, 0.0, self.window[index].detail)
            self._tracked = index
            return PendingResult(frame, resolution, camera, regions=self._regions)
        self._overlay = moving.overlay
        self._observer.motion(frame.stamp, moving)
        shape = resolution.detail_shape
        overlays = overlay_masks(moving, shape)

        coasted = load.coasts and not moving.measured
        if coasted:
            observations = tracker.coast(ego_motion, shape)
        else:
            # Detections: objects cut out of the picture where something moves (eq. 5 to 9).
            tilt = resolution.tilt_in_detail(min(moving.motion.tilt, BEYOND_TURBULENCE))
            expected = tracker.expected_objects(ego_motion, shape)
            targets = self._targets.moving_at(self.window.count - 1 - index)
            detections = self._outliner.detections(
                index, moving, targets, expected, overlays, tilt, frame.stamp
            )
            image = self.window[index].detail
            detections = self._regions.looked_at(detections, expected)
            self._observer.detections(frame.stamp, detections, resolution)
            # Tracks: which object is which of those before (eq. 4).
            with self._observer.stage("tracking"):
                observations = tracker.update(detections, ego_motion, tilt, image, camera.slews)
            self._outliner.remember(index, moving, observations, frame.stamp)

        self._tracked = index
        # What is an object is no background, and only where one is does motion go on.
        masks = [seen.detection.outline.dilated(GUARD, shape) for seen in observations]
        self.window.mark_objects(index, [*masks, *overlays])
        self._schedule.keep_where(union_mask(masks, shape))
        self._schedule.watch_closely(any(not seen.track.confirmed for seen in observations))
        return PendingResult(
            frame, resolution, camera, moving.motion, observations, coasted, self._regions
        )

    def measure_motion(self, job: MotionJob) -> Moving | None:
        """Measure what moves in a frame; see `motion_worker.Measure`."""
        neighbourhood = job.neighbourhood
        self._scene.propagate(job.since_last, job.frames)
        if len(neighbourhood.neighbours) < 2:
            return None
        with self._observer.stage("optical flow"):
            aligned = neighbourhood.aligned()
            if self._scene.shows_nothing_new(job.unfollowed, neighbourhood.grey, aligned):
                return job.unfollowed
            flows = self._strategies.flow.flows_to(neighbourhood.grey, aligned)
        # Average (eq. 1) and distance from the camera's own motion (eq. 2), within the scene.
        with self._observer.stage("motion map"):
            overlay = self._scene.overlay(neighbourhood, aligned)
            valid = neighbourhood.valid(overlay)
            evidence = PictureEvidence(neighbourhood.grey, aligned, flows)
            near = evidence.of([k for k in aligned if abs(k) <= SHORT_BASELINE * job.interval])
            known = neighbourhood.camera_known
            seen = None if known else evidence.textured()
            measure = measure_for(self._strategies.measure, seen, near.followed)
            motions = measure.motions(flows, valid, job.interval)
        # Seeds that the pictures confirm, and the regions that grow from them (eq. 3).
        with self._observer.stage("region growing"):
            shape = self.resolution.processing_shape
            objects = cells_of_objects(job.objects, self.resolution.detail, shape)
            motions = self._scene.with_memory(motions, near.textured(), objects, known)
            grow = functools.partial(self._grow, evidence, objects)
            moving = what_moves(motions, grow, self.resolution.detail)
        return replace(moving, overlay=overlay)

    def voteless(self) -> Mask | None:
        """Return which cells of the newest frame have no vote in its registration, hxw."""
        objects = self._travelled_objects(self.window.count - 1)
        size, shape = self.resolution.detail, self.resolution.processing_shape
        return without_vote(self._overlay, cells_of_objects(objects, size, shape))

    def cancel(self) -> None:
        """Give up what is measured ahead."""
        self._worker.cancel()

    def _travelled_objects(self, index: int) -> list[CroppedMask]:
        """Return where objects that have travelled should be in a frame to come."""
        motion = self.window.transform_if_continuous(self._tracked, index)
        if motion is None:
            return []
        return self._strategies.tracker.travelled_outlines(
            self.resolution.to_detail(motion), self.resolution.detail_shape, index - self._tracked
        )

    def _grow(
        self, evidence: PictureEvidence, objects: Mask, motion: MotionEstimate, taken: Mask
    ) -> list[Region]:
        seed = self._parameters.seed
        noise = with_clutter(motion.noise, motion.clutter, seed.clutter)
        with_clutter_noise = replace(motion, noise=self._regions.without_seeds(noise, objects))
        strength = seed_strength(with_clutter_noise, seed.size, seed.delta1, seed.delta2)
        strength = evidence.of(motion.intervals).confirmed(strength, seed.size, seed.evidence)
        delta, similar = self._parameters.growing.delta, self._strategies.similarity
        regions = grow_regions(motion, strength, seed.size, delta, similar, MIN_REGION, taken)
        return self._strategies.expand(regions, motion, taken)
