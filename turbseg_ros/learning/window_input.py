"""What the refining network sees: an object window as physical quantities, of one size.

Grey values are relative to the window's own, deviations in standard deviations of the background,
motion in units of its noise, so that nothing depends on the camera.
"""

from __future__ import annotations

from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Map
from turbseg_ros.segmentation.background import background_in, deviation_from, difference_from
from turbseg_ros.segmentation.foreground import ObjectCrop, guided_filter

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
_MIN_CONTRAST = 6.0
# Where deviation and motion, in units of their noise, come to half of their range.
_HALF_DEVIATION = 3.0
_HALF_MOTION = 5.0
# What is usual on an object is what this percentage of its pixels doesn't exceed.
_USUAL = 85


def window_input(window: ObjectCrop) -> Map:
    """Return the network's input, float32 CHANNELSxSIDExSIDE, each about -1 to 1."""
    # A large window is looked at no closer than the network sees it.
    shape = min(window.box.shape[0], SIDE), min(window.box.shape[1], SIDE)
    image = resized(window.image, shape).reshape(*shape, -1)
    background = background_in(window.box, window.views, shape)
    known = background.known.astype(np.float32)
    moving, core, motion = (
        resized(np.asarray(values, np.float32), shape)
        for values in (window.area.search_mask, window.area.probable, window.motion)
    )
    grey = _grey(image)
    centred = grey - grey.mean()
    contrast = max(float(np.sqrt(np.mean(centred * centred))), _MIN_CONTRAST)
    change = grey - _grey(background.median)
    deviation = deviation_from(background, image, window.tilt)
    difference = difference_from(background, image) * known
    inside = moving > 0.5
    height, width = window.box.shape
    maps = (
        _within(centred / (2.0 * contrast), 1.5),
        _within(change / (2.0 * contrast), 1.5) * known,
        deviation / (deviation + _HALF_DEVIATION) * known,
        _within(difference / _usual(difference, inside & background.known, 1.0), 1.5),
        known,
        motion / (motion + _HALF_MOTION),
        _within(motion / _usual(motion, inside, 0.1), 1.5),
        moving,
        core,
    )
    seen = np.empty((len(CHANNELS), SIDE, SIDE), np.float32)
    for channel, values in zip(seen, maps, strict=False):
        cv2.resize(values, (SIDE, SIDE), dst=channel)
    seen[-2], seen[-1] = np.log2(width / SIDE) / 3.0, np.log2(height / SIDE) / 3.0
    return seen


def at_window_size(probability: Map, window: ObjectCrop) -> Map:
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
    if not inside.size:
        return least
    # NumPy's percentile, which interpolates, takes four times as long.
    rank = _USUAL * (inside.size - 1) // 100
    return max(float(np.partition(inside, rank)[rank]), least)


def _within(values: Map, most: float) -> Map:
    """Return values cut off at `most` and its negative."""
    return np.clip(values, -most, most, out=values)


def _grey(picture: npt.NDArray[Any]) -> Map:
    """Return the mean of the channels, hxw."""
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
