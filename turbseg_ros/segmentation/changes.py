"""What stands out in the change of a picture from its past: where something small may move.

Far away over ground, what moves is neither the strongest thing in the picture, nor large enough
for flow. But it wasn't there a second ago: in the difference of a frame from the median of three
earlier ones, aligned by the camera's motion, the scene cancels, and it stands out alone (the
median of frames in time is the background of Cucchiara et al. 2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.blobs import NO_BLOBS, RING, SMALL, Blobs, Numbers, blobs_in
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.clutter import cells_of, cells_of_objects, in_cells
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import corner_displacement
from turbseg_ros.segmentation.preparation import PreparedFrame
from turbseg_ros.segmentation.registration import align
from turbseg_ros.segmentation.window import FrameWindow

# Frames before, of which the latest and its thirds are looked at, and the fewest that tell
# something. What covers a place for longer than a third is background.
_SPAN, _SHORTEST = 36, 12
# Widths of the picture by which an earlier frame may lie aside.
_NEAR = 0.1
# Pixels by which it may lie aside and is taken as it is.
_SAME = 0.1
# Frames after which the past is looked at anew.
_RENEWED = 4
# Every so many pixels at detail resolution it is asked whether a known object is there.
_EVERY = 4
# By so many times what changes nearby a blob stands out.
_STANDS_OUT = 3.5
# Share of its change that the picture itself must show: what has left isn't there.
_SHOWN = 0.5
# The grey value of what hasn't changed.
_UNCHANGED = 128


@dataclass(frozen=True)
class Changes:
    """What stands out in the change of a frame.

    `known`, hxw, are the cells in which known objects are, or were in the frames that it is
    compared with; None where nothing is compared.
    """

    blobs: Blobs = NO_BLOBS
    known: Mask | None = None


NO_CHANGES = Changes()


@dataclass(frozen=True)
class _Past:
    """What the scene looked like before, as the frame of an index sees it.

    `median` is HxW at processing resolution, `known` the cells of known objects then, hxw.
    """

    index: int
    median: ByteImage
    known: Mask


class SceneChanges:
    """Tells what stands out in the change of each frame from the scene's past."""

    def __init__(self) -> None:
        self._past: _Past | None = None

    def newest(self, window: FrameWindow, objects: Sequence[CroppedMask]) -> Changes:
        """Return what stands out in the change of a window's newest frame, if that is looked for.

        :param objects: known objects as they should be in it, at detail resolution.
        """
        frame = window.newest
        if frame is None or not frame.blobs:
            return NO_CHANGES
        if frame.camera.state in (CameraState.SLEWING, CameraState.LOST):
            return NO_CHANGES
        lately = window.earlier(frame.index, _RENEWED - 1)
        if self._past is None or self._past.index not in lately:
            self._past = _past_of(window, frame.index)
        past = self._past
        if past is None:
            return NO_CHANGES
        to_past = window.transform(frame.index, past.index)
        size = frame.detail.shape[1], frame.detail.shape[0]
        known = cells_of_objects(objects, size, frame.grey.shape)
        known |= align(past.known.view(np.uint8), in_cells(to_past)) > 0
        median = _aligned(past.median, to_past)
        return Changes(changed_blobs(frame.grey, median), known)


def _past_of(window: FrameWindow, index: int) -> _Past | None:
    """Return what the scene looked like before a frame; None where too little is known."""
    earlier = _earlier(window, index)
    if not earlier:
        return None
    transforms = window.transforms_from(index)
    height, width = window[index].grey.shape
    aside = (corner_displacement(transforms[k], (width, height)) for k in earlier)
    if max(aside) > _NEAR * width:
        return None
    first, second, third = (_aligned(window[k].grey, transforms[k]) for k in earlier)
    median = cv2.max(cv2.min(first, second), cv2.min(cv2.max(first, second), third))
    hidden = [_hidden(window[k], transforms[k]) for k in earlier]
    return _Past(index, np.asarray(median), np.logical_or.reduce(hidden))


def _hidden(frame: PreparedFrame, to_frame: Matrix) -> Mask:
    """Return the cells in which an earlier frame showed known objects, hxw.

    :param to_frame: takes processing pixels to that frame's.
    """
    rows, columns = cells_of(frame.grey.shape)
    # Each is wider than that, and to look at all pixels takes long.
    hidden = frame.scene.image[::_EVERY, ::_EVERY, -1]
    if not frame.objects_known or not hidden.any():
        return np.zeros((rows, columns), bool)
    held = cv2.resize(hidden, (columns, rows), interpolation=cv2.INTER_AREA)
    held = cv2.dilate(align(held, in_cells(to_frame)), np.ones((3, 3), np.uint8))
    return np.asarray(held > 0)


def _aligned(grey: ByteImage, to_image: Matrix) -> ByteImage:
    """Return an earlier picture as a frame would show it, whose pixels are taken to its."""
    height, width = grey.shape
    return (
        grey if corner_displacement(to_image, (width, height)) < _SAME else align(grey, to_image)
    )


def _earlier(window: FrameWindow, index: int) -> list[int]:
    """Return three frames of a frame's view, evenly spread over the time before it, or none."""
    there = window.earlier(index, _SPAN)
    span = index - there[0] if there else 0
    if span < _SHORTEST:
        return []
    wanted = [index - span, index - span * 2 // 3, index - span // 3]
    nearest = {min(there, key=lambda k: abs(k - each)) for each in wanted}
    return sorted(nearest) if len(nearest) == len(wanted) else []


def changed_blobs(grey: ByteImage, past: ByteImage) -> Blobs:
    """Return what stands out in the difference of a picture from its past.

    :param grey: HxW; the past is as large, and aligned to it.
    """
    blobs = blobs_in(np.asarray(cv2.addWeighted(grey, 1.0, past, -1.0, _UNCHANGED)))
    blobs = blobs.chosen(blobs.strength > _STANDS_OUT)
    return blobs.chosen(_shown(grey, blobs) > _SHOWN * np.abs(blobs.contrast))


def _shown(grey: ByteImage, blobs: Blobs) -> Numbers:
    """Return by how many grey values blobs stand out of a picture the way they changed it, N."""
    mean = cv2.blur(grey, (SMALL, SMALL)).astype(np.float64)
    x, y = np.rint(blobs.points).astype(int).T
    around = np.arange(-RING, RING + 1)
    rows = np.clip(y[:, None, None] + around[:, None], 0, grey.shape[0] - 1)
    columns = np.clip(x[:, None, None] + around, 0, grey.shape[1] - 1)
    usual = np.median(mean[rows, columns].reshape(len(x), around.size**2), axis=1)
    return np.asarray((mean[y, x] - usual) * np.sign(blobs.contrast))
