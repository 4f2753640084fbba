"""What the refining network sees: an object window as physical quantities, of one size.

Grey values are relative to the window's own, deviations in standard deviations of the background,
motion in units of its noise, so that nothing depends on the camera.
"""

from __future__ import annotations

import functools
import math
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Mask
from turbseg_ros.segmentation.background import (
    background_in,
    deviation_from,
    difference_from,
)
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
    "light",
    "colour",
    "likeness",
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
# Of the change of colour, likewise; grey values that darkness is lifted by first: it is all noise.
_HALF_COLOUR, _DARKNESS = 0.05, 8.0
# Levels that values are sorted into, of one channel, of each of three, in so many standard
# deviations; and how often each was seen before it is counted.
_LEVELS, _SPREADS, _UNSEEN = {1: 32, 3: 8}, 4.0, 0.5
# A colour that is seen so many times more often in one part is clearly its own.
_CLEARLY = 30.0
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
    behind = _grey(background.median)
    change = grey - behind
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
        light_ratio(grey, behind) * known,
        colour_change(image, background.median) * known,
        likeness(image, core > 0.5, ~inside),
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


def light_ratio(grey: Map, background: Map) -> Map:
    """Return how much brighter than the background each pixel is, in octaves, -1 to 1, hxw.

    A shadow takes away the same share of the light wherever it falls, whatever it falls on.
    """
    ratio: Map = np.log2((grey + np.float32(_DARKNESS)) / (background + np.float32(_DARKNESS)))
    return _within(ratio, 1.0)


def colour_change(image: ByteImage, background: Map) -> Map:
    """Return how much the shares of a pixel's channels differ from the background's, 0 to 1, hxw.

    Shadows hardly change them (Prati et al. 2003). It is 0 where there is one channel only.

    :param image: hxwxC; `background` is as large.
    """
    if image.shape[2] == 1:
        return np.zeros(image.shape[:2], np.float32)
    shares = zip(_shares(image), _shares(background), strict=True)
    change = functools.reduce(np.maximum, (np.abs(here - there) for here, there in shares))
    return change / (change + np.float32(_HALF_COLOUR))


def likeness(image: ByteImage, own: Mask, other: Mask) -> Map:
    """Return how much rather a pixel's colour is seen in one part than in another, -1 to 1, hxw.

    That is the logarithm of the ratio of the two histograms, as in GrabCut (Rother et al. 2004);
    0 where one of the parts is empty.

    :param image: hxwxC, one or three channels.
    :param own: hxw, of the object; `other`, of its surroundings.
    """
    if not (own.any() and other.any()):
        return np.zeros(image.shape[:2], np.float32)
    channels = image.shape[2]
    levels = _LEVELS[channels]
    colours = np.zeros(image.shape[:2], np.uint16)
    for values in cv2.split(image):
        mean, spread = (float(each[0, 0]) for each in cv2.meanStdDev(values))
        scale = levels / (_SPREADS * max(spread, 1.0))
        offset = levels / 2 - mean * scale
        place = np.arange(256, dtype=np.float32) * np.float32(scale) + np.float32(offset)
        level_of = np.clip(place, 0, levels - 1).astype(np.uint16)
        colours = colours * np.uint16(levels) + cv2.LUT(values, level_of)
    count = levels**channels
    logarithms = [
        np.log((np.bincount(colours[part], minlength=count) + _UNSEEN) / np.count_nonzero(part))
        for part in (own, other)
    ]
    ratio = (logarithms[0] - logarithms[1]) / math.log(_CLEARLY)
    return np.clip(ratio, -1.0, 1.0).astype(np.float32)[colours]


def _shares(picture: npt.NDArray[Any]) -> list[Map]:
    """Return the share that each channel has of a pixel's light, hxw each."""
    # Channel by channel: NumPy is slow along a last axis that is short.
    values = cv2.split(picture.astype(np.float32) + np.float32(_DARKNESS))
    total = functools.reduce(np.add, values)
    return [channel / total for channel in values]


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
