"""The velocity of the scene's places, averaged over measurements: for what is too slow for one.

What comes closer, or is far away, moves by less in half a second than turbulence makes it seem to.
But it goes on, while turbulence is another in each measurement.
"""

from __future__ import annotations

import functools
from collections import deque
from dataclasses import replace

import cv2
import numpy as np

from turbseg_ros.arrays import Flow, Map, Matrix
from turbseg_ros.segmentation.geometry import corner_displacement, lengths, resampled
from turbseg_ros.segmentation.motion import MotionEstimate, noise_deviation

# Share of the newest measurement in the average.
_NEWEST = 0.2
# Measurements that a pixel needs before its average tells more than the newest one.
_FEWEST = 4
# A measurement counts for no more than so many times its noise: what passes leaves no trail.
_MOST = 6.0
# What is averaged must still move: the newest velocity has so much of it along the average.
_STILL_MOVES = 0.3
# Flow's errors at rest don't average out below this, in pixels a frame.
_MIN_NOISE = 0.006
# How much of its clutter a place keeps in an average.
_CLUTTER = 0.35
# Pixels by which the camera may have moved the picture's corners, and the measurements in which:
# what it passes, near and far, would be averaged as well.
_NEARLY_STANDS, _LOOKED_BACK = 5.0, 6
# Pixels by which it may move them for the average to be taken as it is.
_STAYS = 0.5


class VelocityMemory:
    """A running average of the velocity of each pixel of the scene, weighted towards the newest.

    Averaged over the camera's path it makes an estimate of motion with less noise, while the
    camera nearly stands.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start anew: another scene, or a camera whose motion isn't known."""
        self._velocity: Flow = np.zeros((0, 0, 2), np.float32)
        self._count: Map = np.zeros((0, 0), np.float32)
        # From the frame that these are of to the newest; from each measurement to the next.
        self._transform: Matrix = np.eye(3)
        self._ways: deque[Matrix] = deque(maxlen=_LOOKED_BACK)

    def propagate(self, ego_motion: Matrix | None) -> None:
        """Follow the camera to another frame; to another scene if None.

        :param ego_motion: takes processing pixels of the frame before to those of the next.
        """
        if ego_motion is None:
            self.forget()
            return
        self._ways.append(ego_motion)
        self._transform = ego_motion @ self._transform
        size = self._count.shape[1], self._count.shape[0]
        if self._count.size and corner_displacement(self._transform, size) > _STAYS:
            self._velocity = resampled(self._velocity, self._transform)
            self._count = resampled(self._count, self._transform)
            self._transform = np.eye(3)

    def take(self, motion: MotionEstimate) -> MotionEstimate | None:
        """Take in what was measured in the frame followed to; return the motion on average.

        :param motion: with what is known of clutter.
        :return: None while the camera doesn't stand, or too little was measured yet.
        """
        if self._count.shape != motion.noise.shape:
            self._velocity = np.zeros_like(motion.velocity)
            self._count = np.zeros_like(motion.noise)
        self._learn(motion)
        way = functools.reduce(lambda before, after: after @ before, self._ways, np.eye(3))
        known = motion.visible & (self._count >= _FEWEST)
        if corner_displacement(way, known.shape[::-1]) > _NEARLY_STANDS or not known.any():
            return None
        x, y = cv2.split(self._velocity)
        newest_x, newest_y = cv2.split(motion.velocity)
        speed = lengths(x, y)
        unit = np.float32(noise_deviation(speed, motion.noise, known))
        along = x * newest_x + y * newest_y
        clutter = motion.clutter
        return replace(
            motion,
            velocity=self._velocity,
            motion_map=speed,
            noise=np.maximum(unit * motion.noise, np.float32(_MIN_NOISE)),
            visible=known & (along > np.float32(_STILL_MOVES) * speed * speed),
            clutter=None if clutter is None else clutter * np.float32(_CLUTTER),
        )

    def _learn(self, motion: MotionEstimate) -> None:
        self._count += 1.0
        self._count *= motion.visible
        most = np.float32(_MOST) * motion.noise
        share = most / np.maximum(motion.motion_map, most)
        weight = np.maximum(np.float32(_NEWEST), 1.0 / np.maximum(self._count, 1.0))
        # NumPy takes five times as long for a map and a flow.
        change = cv2.multiply(motion.velocity, cv2.merge([share, share]))
        cv2.subtract(change, self._velocity, dst=change)
        change = cv2.multiply(change, cv2.merge([weight, weight]))
        # Estimates made of the average before keep it.
        self._velocity = cv2.add(self._velocity, change)
