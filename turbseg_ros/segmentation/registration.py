"""Ego-motion between frames: translation first, then an affine transform.

All transforms are 3x3 matrices of float64 that take homogeneous pixel coordinates (x, y, 1) of one
frame to those of another.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.exposure import exposure_between
from turbseg_ros.segmentation.geometry import pixel_grid, translation

Points = npt.NDArray[np.float32]

# Corners are taken from all over the picture, faint ones too: with strong ones alone, an affine
# transform would follow the objects before a plain sky.
_CORNERS, _MIN_QUALITY, _CORNER_DISTANCE = 400, 2e-4, 8
# The translation is a good guess: what is left fits into a small pyramid.
_LK_WINDOW, _LK_LEVELS = (11, 11), 2
_MIN_CORNERS = 12
_RANSAC_REPROJECTION_PIXELS = 1.0
# Two pictures have nothing in common when the peak of their phase correlation, times the root of
# the number of pixels, is no higher than chance makes it, and their grey values, once they are
# aligned, don't correlate. At 432x243 pixels, chance reaches a peak of 0.04 and a correlation of
# 0.1; frames of one scene stay above 0.19 and 0.47, even where the camera is panned fast.
_CHANCE_PEAK, _MIN_CORRELATION = 30.0, 0.4
# Share of the picture that must overlap for its correlation to mean something.
_MIN_OVERLAP = 0.25
# A telephoto view neither turns over nor zooms by a tenth within one frame.
_MAX_CHANGE_OF_SHAPE = 0.1


def phase_correlation(source: ByteImage, target: ByteImage) -> tuple[Matrix, float]:
    """Return the translation that takes `source` to `target`, and the peak that shows it.

    The peak is 1 for a pure translation. A picture of one grey value lies anywhere: it gets the
    identity and a peak of 0.

    :param source: HxW grey image.
    :param target: HxW grey image of the same size.
    """
    if source.min() == source.max() or target.min() == target.max():
        return np.eye(3), 0.0
    window = _hanning_window((source.shape[1], source.shape[0]))
    (dx, dy), peak = cv2.phaseCorrelate(
        source.astype(np.float32), target.astype(np.float32), window
    )
    return translation(dx, dy), peak


@functools.lru_cache(maxsize=4)
def _hanning_window(size: tuple[int, int]) -> npt.NDArray[np.float32]:
    return cv2.createHanningWindow(size, cv2.CV_32F)


def register_affine(
    source: ByteImage, target: ByteImage, overlay: Mask | None = None
) -> Matrix | None:
    """Return the affine transform that takes `source` to `target`.

    Corners are followed by pyramidal Lucas-Kanade from where the translation puts them, and an
    affine transform is fitted by RANSAC, so that moving objects do not take part. Where the
    picture carries too few corners, or they agree on nothing a camera could do, the translation
    stands. None when the pictures have nothing in common: a cut, a covered lens, a torn frame.

    :param overlay: hxw, coarser: what is no scene, and whose corners aren't followed.
    """
    # Half of the resolution tells as well what to follow, and about where it has gone.
    size = (source.shape[1] // 2, source.shape[0] // 2)
    halves = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (source, target)]
    coarse, peak = phase_correlation(*halves)
    shift = 2.0 * coarse[:2, 2]
    # Lucas-Kanade takes a change of exposure for motion.
    source = exposure_between(source, target, translation(*-shift)).applied_to(source, channels=1)
    affine = _affine_of_corners(source, target, _corners(halves[0], overlay), shift)
    if affine is None or np.abs(affine[:, :2] - np.eye(2)).max() > _MAX_CHANGE_OF_SHAPE:
        found, _ = phase_correlation(source, target)
    else:
        found = np.vstack([affine, [0.0, 0.0, 1.0]])
    by_chance = peak * np.sqrt(halves[0].size) < _CHANCE_PEAK
    if by_chance and _correlation(source, target, found) < _MIN_CORRELATION:
        return None
    return found


def _corners(half: ByteImage, overlay: Mask | None) -> Points:
    """Find corners in a picture of half the size; return them in pixels of the whole, Nx1x2."""
    scene = None
    if overlay is not None and overlay.any():
        free = cv2.dilate(overlay.view(np.uint8), np.ones((3, 3), np.uint8)) == 0
        scene = cv2.resize(free.view(np.uint8), half.shape[::-1], interpolation=cv2.INTER_NEAREST)
    corners = cv2.goodFeaturesToTrack(half, _CORNERS, _MIN_QUALITY, _CORNER_DISTANCE, mask=scene)
    if corners is None:
        return np.zeros((0, 1, 2), np.float32)
    # The middles of both pictures' first pixels lie apart.
    return 2.0 * corners.reshape(-1, 1, 2).astype(np.float32) + np.float32(0.5)


def _affine_of_corners(
    source: ByteImage, target: ByteImage, corners: Points, shift: npt.NDArray[np.float64]
) -> Matrix | None:
    """Return the 2x3 transform that most corners agree on; None when they are too few.

    :param shift: about how far `source` has moved to become `target`, (x, y).
    """
    if len(corners) < _MIN_CORNERS:
        return None
    followed, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        corners,
        corners + shift.astype(np.float32),
        winSize=_LK_WINDOW,
        maxLevel=_LK_LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    kept = found.ravel() == 1
    if np.count_nonzero(kept) < _MIN_CORNERS:
        return None
    affine, _ = cv2.estimateAffine2D(
        np.ascontiguousarray(corners[kept]),
        np.ascontiguousarray(followed[kept]),
        method=cv2.RANSAC,
        ransacReprojThreshold=_RANSAC_REPROJECTION_PIXELS,
    )
    return None if affine is None else np.asarray(affine)


def _correlation(source: ByteImage, target: ByteImage, transform: Matrix) -> float:
    """Return the correlation of grey values where `transform` lays one picture over another."""
    seen = visible((source.shape[0], source.shape[1]), transform)
    if np.count_nonzero(seen) < _MIN_OVERLAP * seen.size:
        return 0.0
    there, here = align(target, transform)[seen].astype(float), source[seen].astype(float)
    if not there.std() or not here.std():
        return 0.0
    return float(np.corrcoef(here, there)[0, 1])


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
    """Return which pixels of the reference frame lie within the other image, HxW.

    :param margin: pixels by which a point must lie inside the other image's border.
    """
    height, width = shape
    there = cv2.transform(pixel_grid(shape), to_image[:2])
    least, most = (margin, margin), (width - 1 - margin, height - 1 - margin)
    inside: npt.NDArray[np.bool_] = cv2.inRange(there, least, most) > 0
    return inside
