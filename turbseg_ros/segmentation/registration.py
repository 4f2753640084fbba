"""Ego-motion between frames: as much of an affine transform as the pictures confirm.

A plain sky, fog or a target that fills the view leave nothing to tell the camera's motion by. Then
a registration is held, and says so.

All transforms are 3x3 matrices of float64 that take homogeneous pixel coordinates (x, y, 1) of one
frame to those of another.
"""

from __future__ import annotations

import enum
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.exposure import exposure_between
from turbseg_ros.segmentation.geometry import (
    corner_displacement,
    pixel_grid,
    scaling,
    translation,
)

Points = npt.NDArray[np.float32]

# Corners are taken from all over the picture, faint ones too: with strong ones alone, an affine
# transform would follow the objects before a plain sky.
_CORNERS, _MIN_QUALITY, _CORNER_DISTANCE = 400, 2e-4, 8
# The translation is a good guess: what is left fits into a small pyramid.
_LK_WINDOW, _LK_LEVELS = (11, 11), 2
# How many times smaller pictures are in which corners are followed where these don't agree.
_COARSE = (2.0, 4.0)
# Share of the corners that must agree for the camera to stand, and pixels by which it may move the
# picture's corners from one frame to the next.
_MIN_STANDING, _STANDS = 0.6, 1.5
_MIN_CORNERS = 12
_RANSAC_REPROJECTION_PIXELS = 1.0
# Two pictures have nothing in common when the peak of their phase correlation, times the root of
# the number of pixels, is no higher than chance makes it, and their grey values, once they are
# aligned, don't correlate. At 432x243 pixels, chance reaches a peak of 0.04 and a correlation of
# 0.1; frames of one scene stay above 0.19 and 0.47, even where the camera is panned fast.
_CHANCE_PEAK, _MIN_CORRELATION = 30.0, 0.4
# Share of the picture that must overlap for its correlation to mean something.
_MIN_OVERLAP = 0.25
# Pixels at half of the resolution by which a shift is hardly told from rest.
_NEAR_REST = 3
# Cells of the grid below that fit rest better than a sudden motion of a camera that stood: then it
# stands. Cells whose texture stays, so many that it is no chance; the share of its contrast by
# which it may change, and the least contrast, in grey values.
_MIN_RESTING, _MIN_UNCHANGED, _UNCHANGED, _MIN_CONTRAST = 8, 4, 0.5, 3.0
# A telephoto view neither turns over nor zooms by a tenth within one frame.
_MAX_CHANGE_OF_SHAPE = 0.1
# What a model must have to be believed: the largest standard error, in pixels, with which it says
# where the picture's corners go, the cells of a grid in which corners agree on it, and how far
# those lie apart, rms in widths.
_MAX_ERROR, _MIN_CELLS, _MIN_SPREAD = 0.4, 6, 0.15
# Share of the corners that agree by no chance: of those in mere noise, which are found about where
# they are looked for, it is 0.15 to 0.29. Where fewer agree, those count that look as they did:
# that differ by less than this share of their contrast; noise differs by 0.6 of it.
_MIN_AGREEING, _LOOKS_ALIKE = 0.35, 0.45
# Least deviation of a followed corner, in pixels, and what its place is uncertain by, squared.
_LEAST_DEVIATION, _BLUR = 0.1, 1.0
# Cells of that grid, rows and columns. Without corners that agree, a translation is believed where
# it makes the difference of the pictures by so much smaller in so many of them, and larger in few.
_GRID, _BETTER, _MIN_BETTER = (6, 8), 0.8, 12
_TO_HALF = scaling(0.5, 0.5)
# Share of the picture from which on objects have no vote, and what has none is hidden from the
# phase correlation, too: a few corners on smaller ones are outvoted anyway.
_MUCH = 0.1


class EgoMotionModel(enum.Enum):
    """What the camera's motion was told by; the values are what is published."""

    NONE = "none"
    """Nothing: there was nothing to compare a frame with."""
    AFFINE = "affine"
    SIMILARITY = "similarity"
    """Turn, zoom and translation, where corners confirm no more."""
    TRANSLATION = "translation"
    HELD = "held"
    """Nothing to hold on to in the pictures: what was known before is taken to go on."""


@dataclass(frozen=True)
class Registration:
    """What takes a frame's pixels to another's, and what that was told by.

    `motion` is the identity where the `model` is held; `stands` tells whether so many corners say
    that the camera stands that those of the next frame are first looked for where they were;
    `outvoted` that it is taken to be at rest though most of the picture moves otherwise.
    """

    motion: Matrix
    model: EgoMotionModel
    stands: bool = False
    outvoted: bool = False

    @property
    def is_supported(self) -> bool:
        """Whether the pictures tell the motion."""
        return self.model is not EgoMotionModel.HELD


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


def register(
    source: ByteImage,
    target: ByteImage,
    voteless: Mask | None = None,
    stands: bool = False,
    stood: bool = False,
) -> Registration | None:
    """Return how the camera's motion takes `source` to `target`, as far as they tell.

    Corners are followed by pyramidal Lucas-Kanade from where the translation puts them, and an
    affine transform is fitted by RANSAC, so that moving objects do not take part. Where corners
    are too few, or too close together, to confirm it, a similarity stands, or a translation, and
    at last the motion is held. None when the pictures have nothing in common: a cut, a covered
    lens, a torn frame.

    :param voteless: hxw, coarser: what of `source` is no scene, such as objects and what is burnt
        in. Its corners aren't followed.
    :param stands: whether the camera stood in `source`; see `Registration`.
    :param stood: whether it has stood for a while. Then what passes through much of its view,
        however fast, is not taken for its motion, nor for another scene, while enough of the scene
        stays where it is.
    """
    # Half of the resolution tells as well what to follow, and about where it has gone.
    half = _halved(source)
    scene = _scene(voteless, half.shape)
    corners = _corners(half, scene)
    if stands:
        as_target = exposure_between(source, target, np.eye(3)).applied_to(source, channels=1)
        found = _by_corners(as_target, target, corners, np.zeros(2))
        if found is not None and found.stands:
            return found
    halves = [half, _halved(target)]
    coarse, peak = phase_correlation(*_without(halves, scene))
    # By whole pixels: what lies between is an average, which carries less noise.
    if not _fits_more_of_it(halves, translation(*np.rint(coarse[:2, 2]))):
        coarse = np.eye(3)
    shift = 2.0 * coarse[:2, 2]
    # Lucas-Kanade takes a change of exposure for motion.
    source = exposure_between(source, target, translation(*-shift)).applied_to(source, channels=1)
    found = (
        _by_corners(source, target, corners, shift)
        or _by_coarse_corners(halves[0], halves[1], coarse[:2, 2], scene)
        or _by_shift(source, target, shift, scene)
    )
    if stood and _passes_before_what_rests(halves, found.motion, scene):
        return Registration(np.eye(3), EgoMotionModel.TRANSLATION, outvoted=True)
    by_chance = peak * np.sqrt(halves[0].size) < _CHANCE_PEAK
    if by_chance and _correlation(source, target, found.motion) < _MIN_CORRELATION:
        return found if stood and _much_is_unchanged(halves, scene) else None
    return found


def without_vote(overlay: Mask | None, objects: Mask) -> Mask | None:
    """Return which cells have no vote in a registration, hxw: no scene, and large objects.

    :param overlay: cells that are burnt into the picture, hxw; None while unknown.
    :param objects: cells that hold known objects, hxw.
    """
    if objects.mean() < _MUCH:
        return overlay
    return objects if overlay is None else objects | overlay


def _scene(voteless: Mask | None, shape: tuple[int, ...]) -> ByteImage | None:
    """Return where a picture of some shape is scene, HxW, 1 or 0; None if all of it is."""
    if voteless is None or not voteless.any():
        return None
    free = cv2.dilate(voteless.view(np.uint8), np.ones((3, 3), np.uint8)) == 0
    scene: ByteImage = cv2.resize(
        free.view(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST
    )
    return scene


def _without(images: Sequence[ByteImage], scene: ByteImage | None) -> Sequence[ByteImage]:
    """Return pictures whose large parts that are no scene fade into grey."""
    if scene is None or cv2.countNonZero(scene) > (1.0 - _MUCH) * scene.size:
        return images
    weight = cv2.blur(scene.astype(np.float32), (9, 9))
    faded = []
    for image in images:
        mean = np.float32(cv2.mean(image, mask=scene)[0])
        faded.append(np.rint(mean + (image - mean) * weight).astype(np.uint8))
    return faded


def _fits_more_of_it(halves: Sequence[ByteImage], motion: Matrix) -> bool:
    """Whether a motion fits more places of the picture than rest does.

    Large objects that go fast through the view give a higher peak than the scene behind them.

    :param halves: both pictures, HxW.
    """
    if _is_near_rest(motion, halves[0].shape):
        return True
    moved, at_rest = _fitting_cells(halves, motion)
    return bool(np.count_nonzero(moved) >= np.count_nonzero(at_rest))


def _passes_before_what_rests(
    halves: Sequence[ByteImage], motion: Matrix, scene: ByteImage | None
) -> bool:
    """Whether a motion of the whole resolution is that of what passes before a scene at rest.

    :param scene: what may vote, HxW; None if all of it.
    """
    of_halves = _TO_HALF @ motion @ np.linalg.inv(_TO_HALF)
    if _is_near_rest(of_halves, halves[0].shape):
        return False
    _, at_rest = _fitting_cells(halves, of_halves)
    return bool(np.count_nonzero(at_rest & _voting_cells(scene)) >= _MIN_RESTING)


def _much_is_unchanged(halves: Sequence[ByteImage], scene: ByteImage | None) -> bool:
    """Whether texture stays what it was in more places than chance would have it."""
    source, target = halves
    contrast, difference = (
        _in_cells(cv2.absdiff(source, each)) for each in (cv2.blur(source, _LK_WINDOW), target)
    )
    unchanged = (contrast > _MIN_CONTRAST) & (difference < _UNCHANGED * contrast)
    return bool(np.count_nonzero(unchanged & _voting_cells(scene)) >= _MIN_UNCHANGED)


def _is_near_rest(motion: Matrix, shape: tuple[int, ...]) -> bool:
    """Whether a motion takes no corner of a picture of some shape further than is told apart."""
    return corner_displacement(motion, (shape[1], shape[0])) < _NEAR_REST


def _fitting_cells(halves: Sequence[ByteImage], motion: Matrix) -> tuple[Mask, Mask]:
    """Return in which cells of the grid a motion fits better than rest, and rest than it."""
    source, target = halves
    shifted = cv2.warpAffine(
        source, motion[:2], source.shape[::-1], borderMode=cv2.BORDER_REPLICATE
    )
    moved, at_rest = (_in_cells(cv2.absdiff(each, target)) + 1.0 for each in (shifted, source))
    return moved < _BETTER * at_rest, at_rest < _BETTER * moved


def _in_cells(values: ByteImage) -> Map:
    """Return the mean of a picture over each cell of the grid, in whole grey values."""
    means = cv2.resize(values, _GRID[::-1], interpolation=cv2.INTER_AREA)
    return means.astype(np.float32)


def _voting_cells(scene: ByteImage | None) -> Mask:
    """Return which cells of the grid are mostly scene, as 1 or 0 in a picture tells, HxW."""
    return np.ones(_GRID, bool) if scene is None else _in_cells(scene) > 0


def _corners(half: ByteImage, scene: ByteImage | None) -> Points:
    """Find corners in a picture of half the size; return them in pixels of the whole, Nx2."""
    corners = cv2.goodFeaturesToTrack(half, _CORNERS, _MIN_QUALITY, _CORNER_DISTANCE, mask=scene)
    if corners is None:
        return np.zeros((0, 2), np.float32)
    # The middles of both pictures' first pixels lie apart.
    return 2.0 * corners.reshape(-1, 2).astype(np.float32) + np.float32(0.5)


def _by_corners(
    source: ByteImage, target: ByteImage, corners: Points, shift: npt.NDArray[np.float64]
) -> Registration | None:
    """Return the richest model that corners confirm; None where they confirm none.

    :param shift: about how far `source` has moved to become `target`, (x, y).
    """
    all_corners = len(corners)
    if all_corners < _MIN_CORNERS:
        return None
    there, found, difference = cv2.calcOpticalFlowPyrLK(
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
    corners, there = np.ascontiguousarray(corners[kept]), np.ascontiguousarray(there[kept])

    @functools.cache
    def alike() -> Mask:
        is_alike: Mask = difference.ravel()[kept] < _LOOKS_ALIKE * _contrast(source, corners)
        return is_alike

    size = (source.shape[1], source.shape[0])
    for model, fit in _FITS.items():
        motion = fit(corners, there)
        if motion is None:
            continue
        agreeing = _agreeing(model, motion, corners, there, alike, size)
        if agreeing:
            whole = np.vstack([motion, [0.0, 0.0, 1.0]])
            stands = (
                model is EgoMotionModel.AFFINE
                and agreeing >= _MIN_STANDING * all_corners
                and corner_displacement(whole, size) < _STANDS
            )
            return Registration(whole, model, stands)
    return None


def _by_coarse_corners(
    source: ByteImage,
    target: ByteImage,
    shift: npt.NDArray[np.float64],
    scene: ByteImage | None,
) -> Registration | None:
    """Return what corners confirm in pictures of half the size, or a quarter; else None.

    Strong turbulence moves each corner its own way by pixels: those of larger things less so.

    :param source: at half of the size, as all the others.
    :param shift: about how far `source` has moved to become `target`, (x, y).
    :param scene: what may vote; None where all of it may.
    """
    source = exposure_between(source, target, translation(*-shift)).applied_to(source, channels=1)
    for size in _COARSE:
        smaller = _halved(source)
        scene_smaller = None if scene is None else np.ascontiguousarray(scene[1::2, 1::2])
        found = _by_corners(source, target, _corners(smaller, scene_smaller), shift)
        if found is not None:
            scale = scaling(size, size)
            return Registration(scale @ found.motion @ np.linalg.inv(scale), found.model)
        source, target, scene, shift = smaller, _halved(target), scene_smaller, shift / 2.0
    return None


def _halved(image: ByteImage) -> ByteImage:
    size = (image.shape[1] // 2, image.shape[0] // 2)
    halved: ByteImage = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return halved


def _contrast(image: ByteImage, points: Points) -> npt.NDArray[np.uint8]:
    """Return the mean difference from the mean around each of some points, N."""
    differences = cv2.absdiff(image, cv2.blur(image, _LK_WINDOW))
    columns, rows = points.astype(int).T
    found: npt.NDArray[np.uint8] = cv2.blur(differences, _LK_WINDOW)[rows, columns]
    return found


def _fit_affine(corners: Points, there: Points) -> Matrix | None:
    found, _ = cv2.estimateAffine2D(
        corners, there, method=cv2.RANSAC, ransacReprojThreshold=_RANSAC_REPROJECTION_PIXELS
    )
    return None if found is None else np.asarray(found)


def _fit_similarity(corners: Points, there: Points) -> Matrix | None:
    found, _ = cv2.estimateAffinePartial2D(
        corners, there, method=cv2.RANSAC, ransacReprojThreshold=_RANSAC_REPROJECTION_PIXELS
    )
    return None if found is None else np.asarray(found)


def _fit_translation(corners: Points, there: Points) -> Matrix | None:
    return translation(*np.median(there - corners, axis=0).astype(float))[:2]


_FITS = {
    EgoMotionModel.AFFINE: _fit_affine,
    EgoMotionModel.SIMILARITY: _fit_similarity,
    EgoMotionModel.TRANSLATION: _fit_translation,
}


def _agreeing(
    model: EgoMotionModel,
    motion: Matrix,
    corners: Points,
    there: Points,
    alike: Callable[[], Mask],
    size: tuple[int, int],
) -> int:
    """Count the corners that agree on a motion, 2x3; 0 if they are too few to confirm it.

    Those of one small target don't, however many they are.

    :param alike: tells which corners look where they are found as they did, N.
    """
    if np.abs(motion[:, :2] - np.eye(2)).max() > _MAX_CHANGE_OF_SHAPE:
        return 0
    error = corners @ motion[:, :2].T + motion[:, 2] - there
    squared = np.square(error).sum(axis=1)
    agree = squared < _RANSAC_REPROJECTION_PIXELS**2
    if np.count_nonzero(agree) < _MIN_AGREEING * len(corners):
        agree &= alike()
    count = int(np.count_nonzero(agree))
    if count < _MIN_CORNERS:
        return 0
    points = corners[agree].astype(np.float64)
    rows, columns = _GRID
    cells = (points * (columns / size[0], rows / size[1])).astype(int) @ (1, columns)
    deviations = points - points.mean(axis=0)
    spread = deviations.T @ deviations / count
    if len(set(cells.tolist())) < _MIN_CELLS or np.trace(spread) < (_MIN_SPREAD * size[0]) ** 2:
        return 0
    # The variance of where each corner of the picture goes, by linear regression.
    reach = np.array([(x, y) for x in (0, size[0]) for y in (0, size[1])]) - points.mean(axis=0)
    if model is EgoMotionModel.AFFINE:
        leverage = (reach @ np.linalg.inv(spread + _BLUR * np.eye(2)) * reach).sum(axis=1).max()
    elif model is EgoMotionModel.SIMILARITY:
        leverage = np.square(reach).sum(axis=1).max() / np.trace(spread)
    else:
        leverage = 0.0
    variance = max(float(squared[agree].mean()) / 2.0, _LEAST_DEVIATION**2)
    return count if variance * (1.0 + leverage) / count < _MAX_ERROR**2 else 0


def _by_shift(
    source: ByteImage,
    target: ByteImage,
    shift: npt.NDArray[np.float64],
    scene: ByteImage | None,
) -> Registration:
    """Return the translation, where much of the scene fits better by it; else hold.

    :param shift: about how far `source` has moved to become `target`, (x, y).
    :param scene: what may vote, in a picture of half the size.
    """
    motion = translation(*shift)
    # By whole pixels: what lies between is an average, which carries less noise.
    whole = translation(*np.rint(shift))
    rows, columns = _GRID
    as_it_is, moved = (
        cv2.resize(
            cv2.absdiff(source, other).astype(np.float32),
            (columns, rows),
            interpolation=cv2.INTER_AREA,
        )
        for other in (target, align(target, whole))
    )
    better, worse = moved < _BETTER * as_it_is, as_it_is < _BETTER * moved
    if scene is not None:
        better &= cv2.resize(scene, (columns, rows), interpolation=cv2.INTER_AREA) > 0
    if np.count_nonzero(better) < _MIN_BETTER + 2 * np.count_nonzero(worse):
        return Registration(np.eye(3), EgoMotionModel.HELD)
    return Registration(motion, EgoMotionModel.TRANSLATION)


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
