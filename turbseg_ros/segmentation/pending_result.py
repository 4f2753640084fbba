"""What is known of a segmented frame, and the result made of it at the input's resolution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import Labels
from turbseg_ros.segmentation.camera_state import CameraTrack
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult, label_of
from turbseg_ros.segmentation.geometry import scaling
from turbseg_ros.segmentation.load import Step
from turbseg_ros.segmentation.marked_regions import FittedRegions
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Detection, Observation


@dataclass(frozen=True)
class PendingResult:
    """A segmented frame that waits until it is known which of its tracks are objects.

    `camera` is what is known of its motion up to the frame; `motion` is None where there was
    nothing to compare the frame with, `regions` where none are known to be marked.
    """

    frame: Frame
    resolution: Resolution
    camera: CameraTrack
    motion: MotionEstimate | None = None
    observations: Sequence[Observation] = ()
    coasted: bool = False
    regions: FittedRegions | None = None
    condition: Condition = Condition.SOUND
    step: Step = Step.FULL

    def result(self) -> SegmentationResult:
        """Return the result: objects are the tracks that are confirmed by now."""
        width, height = self.resolution.input
        labels = np.zeros((height, width), np.uint16)
        objects = self._draw_objects(labels)
        if self.motion is None:
            empty = SegmentationResult.empty(self.frame, self.resolution.processing_shape)
            return replace(
                empty,
                labels=labels,
                objects=objects,
                coasted=self.coasted,
                step=self.step,
                regions=self.regions,
                condition=self.condition,
                camera=self.camera.state,
            )
        scale, clutter = width / self.resolution.processing[0], self.motion.clutter
        return SegmentationResult(
            frame=self.frame,
            labels=labels,
            objects=objects,
            motion_map=self.motion.motion_map * np.float32(scale),
            tilt=self.motion.tilt * scale,
            ego_motion_model=self.camera.model_beside(self.motion.ego_motion_model),
            coasted=self.coasted,
            step=self.step,
            clutter=None if clutter is None else clutter * np.float32(scale),
            regions=self.regions,
            condition=self.condition,
            camera=self.camera.state,
        )

    def _draw_objects(self, labels: Labels) -> tuple[MovingObject, ...]:
        """Draw the objects into labels, HxW; return them in the order of their ids."""
        objects = []
        for observation in self.observations:
            if not observation.track.confirmed:
                continue
            found = self._reported(observation)
            if found is None:
                continue
            there = labels[found.box.slices]
            mask = found.mask & (there == 0)
            if mask.any():
                there[mask] = label_of(observation.track.id)
                objects.append(self._moving_object(observation, CroppedMask(found.box, mask)))
        return tuple(sorted(objects, key=lambda found: found.id))

    def _reported(self, observation: Observation) -> CroppedMask | None:
        """Return what of an object is reported, at the input's resolution; None for nothing."""
        found = _at_input_resolution(observation.detection, self.resolution)
        if self.regions is None:
            return found
        period = self.frame.period
        speed = float(np.hypot(*observation.velocity)) * self._scale
        return self.regions.reported(found, None if period is None else speed / period)

    @property
    def _scale(self) -> float:
        """How many input pixels a pixel at detail resolution is wide."""
        return self.resolution.input[0] / self.resolution.detail[0]

    def _moving_object(self, observation: Observation, found: CroppedMask) -> MovingObject:
        scale = self._scale
        vx, vy = observation.velocity
        return MovingObject.from_mask(
            found.mask,
            id=observation.track.id,
            slot=observation.track.slot,
            velocity=(vx * scale, vy * scale),
            trail=tuple((x * scale, y * scale) for x, y in observation.trail),
            origin=(found.box.x0, found.box.y0),
            period=self.frame.period,
            score=observation.track.certainty,
            absorbed=observation.detection.absorbed,
        )


def _at_input_resolution(detection: Detection, resolution: Resolution) -> CroppedMask:
    outline = detection.outline
    if resolution.detail == resolution.input:
        return outline
    x, y = (there / here for there, here in zip(resolution.input, resolution.detail, strict=True))
    return outline.resampled(scaling(x, y), resolution.input[::-1], cv2.INTER_LINEAR)
