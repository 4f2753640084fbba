"""What the refining network sees: an object window as physical quantities, of one size.

Grey values are relative to the window's own, deviations in standard deviations of the background,
motion in units of its noise, so that nothing depends on the camera.
"""

from __future__ import annotations

from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.background import background_in, deviation_from, difference_from
from turbseg_ros.segmentation.silhouette import ObjectWindow, guided_filter

Map = npt.NDArray[np.float32]
_Value = TypeVar("_Value", np.uint8, np.float32)

SIDE = 96
"""Rows and columns that every window is brought to."""
CHANNELS = (
    "grey",
    "change",
    "deviation",
    "difference",
    "known",
    "motion",
    "share",
    "moving",
    "core",
    "width",
    "height",
)
"""What the network's input holds, in order."""

# Edges that probability is brought to: within so many pixels, and where the variance of the grey
# values (0 to 1) is larger.
_EDGE_REACH = 2
_EDGE_VARIANCE = 1e-3
# Grey values that a plain window is taken to vary by.
_LEAST_CONTRAST = 6.0
# Where deviation and motion, in units of their noise, come to half of their range.
_HALF_DEVIATION = 3.0
_HALF_MOTION = 5.0
# What is usual on an object is what this percentage of its pixels doesn't exceed.
_USUAL = 85


def window_input(window: ObjectWindow) -> Map:
    """Give the network's input, float32 CHANNELSxSIDExSIDE, each about -1 to 1."""
    # A large window is looked at no closer than the network sees it.
    shape = min(window.box.shape[0], SIDE), min(window.box.shape[1], SIDE)
    image = resized(window.image, shape).reshape(*shape, -1)
    background = background_in(window.box, window.views, shape)
    known = background.known
    moving, core, motion = (
        resized(np.asarray(values, np.float32), shape)
        for values in (window.area.mask, window.area.core, window.motion)
    )
    grey = _grey(image)
    middle, contrast = float(grey.mean()), max(float(grey.std()), _LEAST_CONTRAST)
    change = np.where(known, grey - _grey(background.median), 0.0)
    deviation = np.where(known, deviation_from(background, image, window.tilt), 0.0)
    difference = np.where(known, difference_from(background, image), 0.0)
    height, width = window.box.shape
    maps = (
        np.clip((grey - middle) / (2.0 * contrast), -1.5, 1.5),
        np.clip(change / (2.0 * contrast), -1.5, 1.5),
        deviation / (deviation + _HALF_DEVIATION),
        np.minimum(difference / _usual(difference, (moving > 0.5) & known, 1.0), 1.5),
        known,
        motion / (motion + _HALF_MOTION),
        np.minimum(motion / _usual(motion, moving > 0.5, 0.1), 1.5),
        moving,
        core,
        np.full_like(grey, np.log2(width / SIDE) / 3.0),
        np.full_like(grey, np.log2(height / SIDE) / 3.0),
    )
    return np.stack([resized(np.asarray(values, np.float32), (SIDE, SIDE)) for values in maps])


def at_window_size(probability: Map, window: ObjectWindow) -> Map:
    """Bring a network's output, SIDExSIDE, to the window's size, hxw.

    In a larger window its edges are then brought to those of the picture.
    """
    at_size = resized(probability, window.box.shape)
    if min(window.box.shape) <= SIDE:
        return at_size
    grey = _grey(window.image) / 255.0
    return guided_filter(grey, at_size, _EDGE_REACH, _EDGE_VARIANCE)


def _usual(values: Map, where: npt.NDArray[np.bool_], least: float) -> float:
    inside = values[where]
    return max(float(np.percentile(inside, _USUAL)), least) if inside.size else least


def _grey(picture: npt.NDArray[Any]) -> Map:
    """Give the mean of the channels, hxw."""
    channels = picture.shape[2]
    shares = np.full((1, channels), 1 / channels)
    grey: Map = cv2.transform(picture.astype(np.float32), shares).reshape(picture.shape[:2])
    return grey


def resized(values: npt.NDArray[_Value], shape: tuple[int, int]) -> npt.NDArray[_Value]:
    """Bring a map or picture to another number of rows and columns."""
    shrinks = values.shape[0] * values.shape[1] > shape[0] * shape[1]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    resized: npt.NDArray[_Value] = cv2.resize(values, shape[::-1], interpolation=interpolation)
    return resized
