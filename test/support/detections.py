"""Detections that are drawn, for a tracker to follow."""

from __future__ import annotations

import numpy as np

from turbseg_ros.segmentation.cropped_mask import Box
from turbseg_ros.segmentation.track import Detection

STILL_CAMERA = np.eye(3)
# Nothing to tell objects apart by but their place.
PLAIN = np.full((480, 864, 1), 128, np.uint8)


def seen(
    x: float,
    y: float,
    velocity: tuple[float, float] = (0.0, 0.0),
    *,
    width: int = 20,
    height: int = 12,
    moving: bool = True,
) -> Detection:
    """A rectangle whose upper left pixel is (x, y)."""
    left, top = round(x), round(y)
    box = Box(left, top, left + width, top + height)
    return Detection(box, np.ones((height, width), bool), velocity, moving)
