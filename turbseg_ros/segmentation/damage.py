"""Whether a frame shows the scene that the frame before showed, all over or in part.

A frame may arrive with rows that are grey, smeared, torn or left over from the frame before; a
thermal camera shows its shutter. Block by block it is compared with the frame before, aligned: a
block is lost where its texture is gone, or is another. Objects, and what they uncover, lose some
blocks in each frame, noise takes away correlation everywhere: what is usual is followed, and only
what goes far beyond is damage.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.geometry import scaling

# Side of a block, at half of the processing resolution.
_BLOCK = 8
# With fewer blocks to compare, nothing is said.
_MIN_BLOCKS = 12
# Standard deviation in grey values below which a block has no texture; nor have the plainest of
# them, in per cent.
_MIN_TEXTURE, _PLAINEST = 1.0, 35.0
# A block is lost below this share of the usual correlation; where even the usual one is no better
# than so, noise hides the texture, and only its end is told.
_LOST, _MIN_CORRELATION = 0.5, 0.45
# Texture has ended below this share of what it was, the picture's own change of contrast apart.
_ENDED = 0.3
# Grey values by which a block differs from what the others' change of exposure makes of it.
_JUMP = 30.0
# Share of the blocks, and how many, that are lost beyond what is usual in a damaged frame, and the
# share in a blind one. Usual is twice the mean and four mean deviations.
_DAMAGED, _MIN_DAMAGED, _BLIND = 0.06, 5, 0.85
_MEANS, _DEVIATIONS = 2.0, 4.0
# Share of the rows that are to the bit those of the frame before.
_FROZEN = 0.25
# Where rows usually repeat by as much, the picture is coded or drawn so.
_NEVER_FROZEN, _SELDOM_REPEATED = 0.02, 0.5
# Share by which what is usual follows the newest frame.
_ADAPTATION = 0.2


@dataclass(frozen=True)
class Usual:
    """What is usual from one sound frame to the next.

    `correlation` is the median over the blocks, 0 while unknown, `lost` and `frozen` are the
    shares of the blocks and rows that are so, `deviation` is by how much `lost` changes.
    """

    correlation: float = 0.0
    lost: float = 0.0
    deviation: float = 0.1
    frozen: float = 1.0

    def following(self, correlation: float, lost: float, frozen: float) -> Usual:
        """Return what is usual after another frame."""

        def followed(so_far: float, newest: float) -> float:
            return so_far + _ADAPTATION * (newest - so_far)

        return Usual(
            correlation=followed(self.correlation or correlation, correlation),
            lost=followed(self.lost, lost),
            deviation=followed(self.deviation, abs(lost - self.lost)),
            frozen=followed(self.frozen, frozen),
        )

    @property
    def most(self) -> float:
        """The largest share of blocks that a sound frame loses."""
        return _MEANS * self.lost + _DEVIATIONS * self.deviation


def judged(
    grey: ByteImage, previous: ByteImage, from_previous: Matrix | None, usual: Usual | None
) -> tuple[Condition, Usual | None]:
    """Return what a frame is like, and what is usual if it is taken for sound.

    :param grey: HxW at processing resolution.
    :param previous: the last sound frame, HxW.
    :param from_previous: takes that one's pixels to the frame's; None if they have nothing in
        common.
    :param usual: what was so up to the last sound frame; None where that one is the first of its
        scene, and may be damaged as well as this one.
    """
    if from_previous is None:
        return (Condition.SOUND if usual is None else Condition.BLIND), usual
    half, half_before = _halved(grey), _halved(previous)
    frozen = _frozen_share(half, half_before)
    so_far = usual or Usual()
    correlation, lost, blocks = _compared(half, half_before, from_previous, so_far.correlation)
    after = so_far.following(correlation, lost, frozen)
    if usual is None:
        return Condition.SOUND, after
    if frozen == 1.0 and usual.frozen < _SELDOM_REPEATED and np.array_equal(grey, previous):
        return Condition.REPEATED, after
    if lost > max(usual.most, _BLIND):
        return Condition.BLIND, after
    is_damaged = lost > usual.most + _DAMAGED and lost * blocks >= _MIN_DAMAGED
    is_frozen = frozen > _FROZEN and usual.frozen < _NEVER_FROZEN
    return (Condition.DAMAGED if is_damaged or is_frozen else Condition.SOUND), after


def _halved(grey: ByteImage) -> ByteImage:
    """Return a picture at half the size, cut to whole blocks.

    Noise, and what registration leaves, matter less there.
    """
    side = 2 * _BLOCK
    rows, columns = (max(length // side, 1) * side for length in grey.shape)
    return cv2.resize(grey[:rows, :columns], (columns // 2, rows // 2))


def _frozen_share(half: ByteImage, before: ByteImage) -> float:
    """Return the share of rows that hold what they held before, those of one value left out."""
    varied = (half[:, 1:] != half[:, :-1]).any(axis=1)
    if not varied.any():
        return 1.0
    changed = (half != before).any(axis=1)
    return float(np.count_nonzero(varied & ~changed) / np.count_nonzero(varied))


def _compared(
    half: ByteImage, before: ByteImage, from_previous: Matrix, usual: float
) -> tuple[float, float, int]:
    """Return the median correlation of blocks, the share that is lost, and of how many.

    :param usual: median correlation of the frames before, 0 while unknown.
    """
    to_half = scaling(0.5, 0.5)
    in_half = to_half @ from_previous @ np.linalg.inv(to_half)
    aligned = cv2.warpAffine(
        before,
        in_half[:2],
        half.shape[::-1],
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    here, there = half.astype(np.float32), aligned.astype(np.float32)
    mean, mean_before = _blocks(here), _blocks(there)
    variance = _blocks(here * here) - mean * mean
    variance_before = _blocks(there * there) - mean_before * mean_before
    covariance = _blocks(here * there) - mean * mean_before
    deviation, deviation_before = (np.sqrt(np.maximum(v, 0)) for v in (variance, variance_before))
    seen = _seen_before(mean.shape, np.linalg.inv(in_half), half.shape)
    if np.count_nonzero(seen) < _MIN_BLOCKS:
        return usual, 0.0, 0
    least = max(float(np.percentile(deviation_before[seen], _PLAINEST)), _MIN_TEXTURE)
    textured = seen & (deviation_before >= least)
    if np.count_nonzero(textured) < _MIN_BLOCKS:
        return usual, 0.0, 0
    correlation = covariance / np.maximum(deviation * deviation_before, 1e-3)
    ratio = deviation / np.maximum(deviation_before, 1e-3)
    lost = ratio < _ENDED * float(np.percentile(ratio[textured], 90))
    middle = float(np.median(correlation[textured]))
    reference = usual or middle
    if reference >= _MIN_CORRELATION:
        lost |= correlation < _LOST * reference
    lost &= textured
    jumped = seen & _jumped(mean_before, mean, textured & ~lost)
    blocks = int(np.count_nonzero(textured | jumped))
    return middle, float(np.count_nonzero(lost | jumped)) / blocks, blocks


def _blocks(picture: Map) -> Map:
    """Return the mean of each block."""
    size = (picture.shape[1] // _BLOCK, picture.shape[0] // _BLOCK)
    means: Map = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return means


def _seen_before(
    blocks: tuple[int, ...], to_before: Matrix, shape: tuple[int, ...]
) -> npt.NDArray[np.bool_]:
    """Return which blocks lay wholly within the frame before."""
    middle = (_BLOCK - 1) / 2
    y, x = np.mgrid[: blocks[0], : blocks[1]] * float(_BLOCK) + middle
    u, v = (to_before[row, 0] * x + to_before[row, 1] * y + to_before[row, 2] for row in (0, 1))
    inside: Mask = (
        (u >= middle) & (u <= shape[1] - 1 - middle) & (v >= middle) & (v <= shape[0] - 1 - middle)
    )
    return inside


def _jumped(before: Map, mean: Map, sound: Mask) -> Mask:
    """Return which blocks have another brightness than a change of exposure would give them."""
    if np.count_nonzero(sound) < _MIN_BLOCKS:
        return np.zeros_like(sound)
    x, y = before[sound], mean[sound]
    # Sound blocks correlate: a plain regression will do.
    gain = float(np.cov(x, y)[0, 1] / max(float(x.var()), 1.0))
    gain = min(max(gain, 0.3), 3.0)
    offset = float(np.median(y - gain * x))
    jumped: Mask = np.abs(mean - gain * before - offset) > _JUMP
    return jumped
