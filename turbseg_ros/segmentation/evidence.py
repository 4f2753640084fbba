"""What the pictures say of a motion: whether its flow explains what was seen better than rest.

Where there is no texture, optical flow invents motion, and what it invents is smooth, coherent and
even travels. The pictures tell: invented motion makes no neighbour more like the frame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Flow, Map, Mask
from turbseg_ros.segmentation.geometry import pixel_grid

Points = npt.NDArray[np.intp]

# Side of what flow compares, and times what noise makes of its contrast that something is there.
_PATCH, _TEXTURED = 9, 1.5
# Share of a patch's contrast, the mean range of grey values nearby, that it may differ by along
# the flow, and share of the picture that must be followed for it to speak for all of it.
_FOLLOWED, _MUCH = 0.25, 0.03
# Side of the smallest target, and how much stronger its evidence must be than a window's.
_TARGET, _WEIGHT = 3, 3.0
# Every so many pixels each way one tells the noise.
_NOISE_STEP = 5
# Share of the differences, the smallest, that tells the noise, and the mean difference of normal
# noise over the mean of that share.
_QUIET, _MEAN_OVER_QUIET = 0.75, 1.55
# Mean difference of two roundings of the same grey value: no picture of 8 bits is less noisy.
_ROUNDING = 1.0 / 3.0


@dataclass(frozen=True)
class PictureEvidence:
    """A frame, its neighbours and the flows to them.

    `grey` is HxW; `neighbours` holds, by interval, others aligned to it by the ego-motion, and
    `flows` what is left to go, HxWx2.
    """

    grey: ByteImage
    neighbours: Mapping[int, ByteImage]
    flows: Mapping[int, Flow]
    # Mean absolute difference of grey values that noise makes to neighbours asked for so far.
    _known_noise: dict[int, float] = field(default_factory=dict, repr=False, compare=False)

    def of(self, intervals: Collection[int]) -> PictureEvidence:
        """Return the evidence of the neighbours at some intervals alone."""
        return replace(
            self, neighbours={k: seen for k, seen in self.neighbours.items() if k in intervals}
        )

    def gain(self, x: Points, y: Points, size: int) -> Map:
        """Return by how much the flows explain windows better than rest does, in units of noise.

        It is the mean absolute difference of grey values to a neighbour at rest, less that along
        the flow, over what noise makes of it all over the picture; the mean over all neighbours.

        :param x: columns of the windows' middles, N.
        :param y: rows of them, N.
        :param size: side of the windows in pixels.
        """
        total = np.zeros(len(x), np.float32)
        if not (len(x) and self.neighbours):
            return total
        around = np.arange(size) - size // 2
        height, width = self.grey.shape
        rows = np.clip(y[:, None, None] + around[:, None], 0, height - 1)
        columns = np.clip(x[:, None, None] + around, 0, width - 1)
        place = (rows * width + columns).reshape(len(x), size * size)
        here = self.grey.ravel()[place].astype(np.float32)
        for k, neighbour in self.neighbours.items():
            at_rest = neighbour.ravel()[place]
            along_flow = _along_flow(neighbour, self.flows[k], place)
            difference = np.abs(here - at_rest) - np.abs(here - along_flow)
            total += _strongest(difference, size) / np.float32(self._noise_to(k))
        return total / np.float32(len(self.neighbours))

    def confirmed(self, strength: Map, size: int, least: float) -> Map:
        """Return seeds, HxW as `region_growing.seed_strength` scores them, that gain enough.

        :param size: side of a seed's window in pixels.
        :param least: gain that a seed must exceed; see `gain`. 0: the pictures aren't asked.
        """
        if not least:
            return strength
        y, x = np.nonzero(strength)
        refuted = self.gain(x, y, size) <= least
        left = strength.copy()
        left[y[refuted], x[refuted]] = 0.0
        return left

    def textured(self) -> Mask:
        """Return around which pixels there is something that flow can hold on to, HxW."""
        # Nine values of noise range over three standard deviations, and a difference of two
        # deviates by 1.13 on average.
        noise = max(map(self._noise_to, self.neighbours), default=_ROUNDING)
        contrast = cv2.blur(local_range(self.grey), (_PATCH, _PATCH))
        return np.asarray(contrast > _TEXTURED * 3.0 * noise / 1.13)

    def followed(self) -> Mask | None:
        """Return where the flows surely follow the picture, HxW; None where that is too little.

        There is texture, and each neighbour looks along its flow as the frame does. What goes too
        fast for flow leaves a smear far around it, which does not.
        """
        if not self.neighbours:
            return None
        least = np.float32(_FOLLOWED) * _mean_nearby(local_range(self.grey))
        followed = self.textured()
        grid = pixel_grid((self.grey.shape[0], self.grey.shape[1]))
        for k, neighbour in self.neighbours.items():
            target = cv2.add(grid, self.flows[k])
            along_flow = cv2.remap(
                neighbour, target, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            followed &= _mean_nearby(cv2.absdiff(self.grey, along_flow)) < least
        return followed if np.count_nonzero(followed) > _MUCH * followed.size else None

    def _noise_to(self, k: int) -> float:
        if k not in self._known_noise:
            self._known_noise[k] = self._measured_noise(k)
        return self._known_noise[k]

    def _measured_noise(self, k: int) -> float:
        points = pixel_grid((self.grey.shape[0], self.grey.shape[1]), _NOISE_STEP).astype(np.intp)
        place = points[..., 1] * self.grey.shape[1] + points[..., 0]
        here = self.grey.ravel()[place].astype(np.float32)
        difference = np.abs(here - _along_flow(self.neighbours[k], self.flows[k], place)).ravel()
        quiet = np.partition(difference, int(_QUIET * (len(difference) - 1)))
        mean = float(quiet[: max(int(_QUIET * len(difference)), 1)].mean())
        return max(_MEAN_OVER_QUIET * mean, _ROUNDING)


def _mean_nearby(values: ByteImage) -> Map:
    """Return the mean over the patch around each pixel, HxW."""
    mean: Map = cv2.boxFilter(values, cv2.CV_32F, (_PATCH, _PATCH))
    return mean


def local_range(grey: ByteImage) -> ByteImage:
    """Return the range of grey values among each pixel and its eight neighbours, HxW."""
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square)))


def _strongest(difference: Map, size: int) -> Map:
    """Return the mean over windows, N x size², or what a target smaller than them makes of it."""
    whole = difference.mean(axis=1)
    if size < _TARGET:
        return whole
    windows = np.lib.stride_tricks.sliding_window_view(
        difference.reshape(-1, size, size), (_TARGET, _TARGET), axis=(1, 2)
    )
    parts = windows.mean(axis=(3, 4)).max(axis=(1, 2))
    return np.where(whole > 0.0, np.maximum(whole, parts / np.float32(_WEIGHT)), whole)


def _along_flow(neighbour: ByteImage, flow: Flow, place: Points) -> Map:
    """Return the neighbour's grey values where the flow takes pixels, of the places' shape.

    :param place: indices of pixels, row by row.
    """
    width = neighbour.shape[1]
    start = np.stack([place % width, place // width], axis=-1).astype(np.float32)
    target = start + flow.reshape(-1, 2)[place]
    seen: Map = cv2.remap(
        neighbour, target, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float32)
    return seen
