"""Ego-motion between frames: translation first, then an affine transform.

All transforms are 3x3 matrices of float64 that take homogeneous pixel coordinates (x, y, 1) of one
frame to those of another.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.geometry import pixel_grid

Matrix = npt.NDArray[np.float64]
GreyImage = npt.NDArray[np.uint8]

_CORNERS = 400
# The translation is a good guess: what is left fits into a small pyramid.
_PYRAMID_LEVELS = 2
_FEWEST_CORNERS = 12
_RANSAC_REPROJECTION_PIXELS = 1.0
# A telephoto view neither turns over nor zooms by a tenth within one frame.
_LARGEST_CHANGE_OF_SHAPE = 0.1


def register_translation(source: GreyImage, target: GreyImage) -> Matrix:
    """Give the translation that takes `source` to `target`, by phase correlation.

    A picture of one grey value has moved nowhere.

    :param source: HxW grey image.
    :param target: HxW grey image of the same size.
    """
    if source.min() == source.max() or target.min() == target.max():
        # A picture of one grey value lies anywhere.
        return np.eye(3)
    window = _hanning_window((source.shape[1], source.shape[0]))
    (dx, dy), _ = cv2.phaseCorrelate(source.astype(np.float32), target.astype(np.float32), window)
    return np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]])


@functools.lru_cache(maxsize=4)
def _hanning_window(size: tuple[int, int]) -> npt.NDArray[np.float32]:
    return cv2.createHanningWindow(size, cv2.CV_32F)


def _coarse_translation(source: GreyImage, target: GreyImage) -> tuple[float, float]:
    """Give about how far `source` has moved to become `target`, in pixels."""
    size = (source.shape[1] // 2, source.shape[0] // 2)
    halves = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (source, target)]
    translation = register_translation(*halves)[:2, 2]
    return 2.0 * float(translation[0]), 2.0 * float(translation[1])


def register_affine(source: GreyImage, target: GreyImage) -> Matrix:
    """Give the affine transform that takes `source` to `target`.

    Corners are followed by pyramidal Lucas-Kanade from where the translation puts them, and an
    affine transform is fitted by RANSAC, so that moving objects do not take part. Where the
    picture carries too few corners, or they agree on nothing a camera could do, the translation
    stands.
    """
    affine = _affine_of_corners(source, target)
    if affine is None or np.abs(affine[:, :2] - np.eye(2)).max() > _LARGEST_CHANGE_OF_SHAPE:
        return register_translation(source, target)
    return np.vstack([affine, [0.0, 0.0, 1.0]])


def _affine_of_corners(source: GreyImage, target: GreyImage) -> Matrix | None:
    """Give the 2x3 transform that most corners agree on; None when they are too few."""
    corners = cv2.goodFeaturesToTrack(source, _CORNERS, qualityLevel=0.01, minDistance=8)
    if corners is None or len(corners) < _FEWEST_CORNERS:
        return None
    corners = corners.reshape(-1, 1, 2).astype(np.float32)
    guess = corners + np.array(_coarse_translation(source, target), np.float32)
    followed, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        corners,
        guess,
        winSize=(15, 15),
        maxLevel=_PYRAMID_LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    kept = found.ravel() == 1
    if np.count_nonzero(kept) < _FEWEST_CORNERS:
        return None
    affine, _ = cv2.estimateAffine2D(
        np.ascontiguousarray(corners[kept]),
        np.ascontiguousarray(followed[kept]),
        method=cv2.RANSAC,
        ransacReprojThreshold=_RANSAC_REPROJECTION_PIXELS,
    )
    return None if affine is None else np.asarray(affine)


def align(image: npt.NDArray[np.uint8], to_image: Matrix) -> npt.NDArray[np.uint8]:
    """Resample `image` into the reference frame whose coordinates `to_image` takes to its own.

    Beyond the image its border is repeated, see :func:`visible`.
    """
    height, width = image.shape[:2]
    return cv2.warpAffine(
        image,
        to_image[:2],
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def visible(
    shape: tuple[int, int], to_image: Matrix, margin: float = 0.0
) -> npt.NDArray[np.bool_]:
    """Tell which pixels of the reference frame lie within the other image, HxW.

    :param margin: pixels by which a point must lie inside the other image's border.
    """
    height, width = shape
    there = cv2.transform(pixel_grid(shape), to_image[:2])
    least, most = (margin, margin), (width - 1 - margin, height - 1 - margin)
    inside: npt.NDArray[np.bool_] = cv2.inRange(there, least, most) > 0
    return inside
