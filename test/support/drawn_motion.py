"""Estimates of motion that are drawn, not measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from turbseg_ros.segmentation.motion import MotionEstimate


def drawn_motion(velocity: np.ndarray, noise: float = 0.1, **known: Any) -> MotionEstimate:
    """Return an estimate with a velocity, HxWx2, and one noise all over, visible everywhere.

    :param known: what else differs from that, by the names of `MotionEstimate`.
    """
    velocity = velocity.astype(np.float32)
    shape = velocity.shape[:2]
    told = {
        "velocity": velocity,
        "motion_map": np.hypot(velocity[..., 0], velocity[..., 1]),
        "noise": np.full(shape, noise, np.float32),
        "tilt": 0.1,
        "visible": np.ones(shape, bool),
        "ego_motion_model": "affine",
    }
    return MotionEstimate(**{**told, **known})
