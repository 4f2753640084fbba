"""What drives off leaves no ghost, nor does what became background stand out from before.

What stood there from the first frame on, or for so long that it was background, is part of what
the scene looked like. Once it has moved, the place it left would stand out from that; so earlier
frames that show it standing show no background there. When something has stood for so long that
it is background, those from before show none there either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Matrix
from turbseg_ros.segmentation.background import MaskedImage
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.occlusion import difference_beyond
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Observation, Track
from turbseg_ros.segmentation.window import FrameWindow

# Detail pixels around an object that may show some of it, and that it may lie aside before.
_GUARD, _ASIDE = 3, 2
# Grey values by which a pixel of it may differ, and the share of its pixels that must be alike.
_ALIKE, _MOST = 8.0, 0.8


@dataclass(frozen=True)
class _Beginning:
    """How a track was seen first: in which frame, its outline, and the picture in its box."""

    index: int
    outline: CroppedMask
    picture: ByteImage


class DepartedObjects:
    """Finds one stream's objects in the frames before they moved, and has them hidden there."""

    def __init__(self, window: FrameWindow, resolution: Resolution) -> None:
        self._window = window
        self._resolution = resolution
        self._beginnings: dict[Track, _Beginning] = {}

    def hide(self, index: int, observations: Sequence[Observation]) -> None:
        """Have tracks that became objects hidden in earlier frames that show them standing.

        The places of those that became background are hidden in all earlier frames.

        :param index: the frame that the observations are of.
        """
        image = self._window[index].detail
        known = self._beginnings
        self._beginnings = {}
        for seen in observations:
            track, outline = seen.track, seen.detection.outline
            if track.is_absorbed:
                self._hide(index, outline)
            elif track.hits == 1 and outline.area:
                known[track] = _Beginning(index, outline, image[outline.box.slices].copy())
        for track, beginning in known.items():
            if track.confirmed:
                self._hide(beginning.index, beginning.outline, beginning)
            elif track.misses <= 1:
                self._beginnings[track] = beginning

    def _hide(self, first: int, outline: CroppedMask, standing: _Beginning | None = None) -> None:
        """Hide an outline of a frame in those before it: in all, or those that show it `standing`.

        :param first: that frame.
        """
        window, shape = self._window, self._resolution.detail_shape
        if window.transform_if_continuous(first, window.count - 1) is None:
            return
        transforms = window.transforms_from(first)
        guarded = outline.dilated(_GUARD, shape)
        for other in window.key_frames(first):
            to_other = self._resolution.to_detail(transforms[other])
            if other < first and (
                standing is None or _shows(window[other].scene, to_other, standing)
            ):
                there = guarded.resampled(to_other, shape, cv2.INTER_NEAREST)
                window.mark_objects(other, [there])


def _shows(scene: MaskedImage, to_scene: Matrix, beginning: _Beginning) -> bool:
    """Whether a frame shows an object where it was seen first, in another frame."""
    box, mask = beginning.outline.box, beginning.outline.mask
    to_box = np.linalg.inv(to_scene @ translation(box.x0, box.y0))[:2]
    height, width = box.shape
    there = cv2.warpAffine(scene.image, to_box, (width, height), flags=cv2.INTER_LINEAR)
    there = there[..., :-1].reshape(beginning.picture.shape)
    difference = difference_beyond(there, beginning.picture, _ASIDE)
    return bool(np.mean(difference[mask] < _ALIKE) > _MOST)
