"""Turbulence on somebody's own clip: frames and truth warped by the same tilt.

This is how the paper made its turbulent DAVIS clips (Qin et al., ECCV 2024).
"""

from __future__ import annotations

import cv2
import numpy as np

from turbseg_ros.arrays import Image

from .turbulence import BlurField, Field, TiltField, Turbulence, blur, warp


class ClipWarper:
    """Puts turbulence on the frames of one clip, one by one in their order.

    All frames must have the `shape` (height, width) given; the same for the same seed.
    """

    def __init__(self, shape: tuple[int, int], turbulence: Turbulence, seed: int = 0) -> None:
        tilt_rng, blur_rng = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        self._shape = shape
        self._tilts = TiltField(shape, turbulence, tilt_rng)
        self._blurs = BlurField(shape, turbulence, blur_rng)

    def distort(self, image: Image, labels: Image | None) -> tuple[Image, Image | None]:
        """Return the next frame and its truth as seen through the air, dtypes kept.

        `image` is HxW or HxWx3, uint8, uint16 or float32; `labels` HxW of integers, 0 the
        background.

        :raises ValueError: when a shape is not the clip's.
        """
        for picture in (image, labels):
            if picture is not None and picture.shape[:2] != self._shape:
                raise ValueError(f"a frame of {picture.shape[:2]} in a clip of {self._shape}")
        tilt = self._tilts.next()
        seen = blur(warp(image.astype(np.float32), tilt), self._blurs.next())
        if np.issubdtype(image.dtype, np.integer):
            seen = np.rint(np.clip(seen, 0, np.iinfo(image.dtype).max))
        truth = None if labels is None else warp_labels(labels, tilt)
        return seen.astype(image.dtype), truth


def warp_labels(labels: Image, tilt: Field) -> Image:
    """Return the labels as seen through the tilt: each where its mask covers half a pixel."""
    warped = np.zeros_like(labels)
    for value in np.unique(labels[labels != 0]):
        mask = (labels == value).astype(np.float32)
        warped[warp(mask, tilt, interpolation=cv2.INTER_LINEAR) > 0.5] = value
    return warped
