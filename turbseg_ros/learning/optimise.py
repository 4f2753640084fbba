"""Refine-Net as the paper has it (section 3.3): fitted to the clip itself, without any truth.

A U-Net gives the masks α from frame and motion map M. It is fitted to the coarse masks β, to what
the flow makes of the neighbours' β, and of its own masks for them; then, for some more epochs, β
is re-grouped by 2-means every few. Where the paper can't be taken at its word:

- Its losses are printed as differences of entropies, which are least for any certain mask; here
  they are cross-entropies.
- A mask is warped from frame t to t+g by looking up where F(t+g→t) leads, for the flow F(t→t+g)
  would have to be splatted.
- One network judges all objects of the clip, each in a channel of its own.
- A pixel's mask values over time are those of the frames within two of it, followed by the flow.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from turbseg_ros.learning.refine_net import RefineNet
from turbseg_ros.segmentation.background import Box
from turbseg_ros.segmentation.flow import dis_flow
from turbseg_ros.segmentation.frame import (
    Frame,
    MovingObject,
    SegmentationResult,
    label_of,
)
from turbseg_ros.segmentation.pipeline import MotionSegmenter

Labels = npt.NDArray[np.uint16]
Maps = npt.NDArray[np.float32]
Epochs = Callable[[range], Iterable[int]]
"""Hands epochs on while it shows how many have passed."""

_NEIGHBOURS = (-2, -1, 1, 2)
# Weights γ2 and γ3 of the losses that look at neighbours, each over all g; γ1 is 1.
_NEIGHBOUR_WEIGHT = 0.1
_GROUPED_EPOCHS = 10
_REGROUP_EVERY = 3
# What the frame's width counts for among the mask values that pixels are grouped by.
_WAY_ACROSS = 0.25
# Consecutive frames that are judged together.
_BATCH = 4
_RATE = 5e-3
_SEED = 1
# The net halves the picture three times.
_STRIDE = 8
# Motion, in multiples of the median in its frame, that comes to half of the range.
_HALF_MOTION = 5.0


@dataclass(frozen=True)
class Clip:
    """A whole clip at processing resolution, as tensors of T frames.

    `inputs` is Tx2xHxW, grey and motion; `coarse` is TxKxHxW, the masks β of K objects; `flows`
    holds for each g the flow F(t+g→t), TxHxWx2 in pixels, 0 where there is no frame t+g.
    """

    inputs: Tensor
    coarse: Tensor
    flows: dict[int, Tensor]


class ClipRefiner:
    """Segments a clip and, when it has ended, refines all its masks.

    No result is given before `flush`.
    """

    def __init__(
        self, segmenter: MotionSegmenter, epochs: int, grouping: bool, shown: Epochs = iter
    ) -> None:
        self._segmenter = segmenter
        self._epochs = epochs
        self._grouping = grouping
        self._shown = shown
        self._results: list[SegmentationResult] = []

    def push(self, frame: Frame) -> list[SegmentationResult]:
        """Take the next frame; give nothing yet."""
        self._results += self._segmenter.push(frame)
        return []

    def flush(self) -> list[SegmentationResult]:
        """Give the results of all frames, refined."""
        results, self._results = [*self._results, *self._segmenter.flush()], []
        ids = sorted({found.id for result in results for found in result.objects})
        shapes = {result.motion_map.shape for result in results}
        if not ids or len(shapes) > 1:
            return results
        masks = refined_masks(clip_of(results, ids), self._epochs, self._grouping, self._shown)
        return [
            _with_masks(result, ids, probabilities)
            for result, probabilities in zip(results, masks, strict=True)
        ]


def refined_masks(clip: Clip, epochs: int, grouping: bool, shown: Epochs = iter) -> Maps:
    """Fit the network to a clip; give each pixel's probability of each object, TxKxHxW."""
    torch.manual_seed(_SEED)
    net = RefineNet(clip.inputs.shape[1], outputs=clip.coarse.shape[1])
    optimiser = torch.optim.Adam(net.parameters(), lr=_RATE)
    coarse = clip.coarse
    total = epochs + (_GROUPED_EPOCHS if grouping else 0)
    for epoch in shown(range(total)):
        if epoch >= epochs and (epoch - epochs) % _REGROUP_EVERY == 0:
            coarse = regrouped(_judged(net, clip), clip.flows)
        for frames in _batches(len(clip.inputs)):
            loss = consistency_loss(net(clip.inputs[list(frames)]), coarse, clip.flows, frames)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    masks: Maps = _judged(net, clip).numpy()
    return masks


def consistency_loss(
    logits: Tensor, coarse: Tensor, flows: dict[int, Tensor], frames: range
) -> Tensor:
    """Give γ1·L1 + γ2·Σ L2 + γ3·Σ L3 as cross-entropies, for consecutive frames.

    :param logits: of α, NxKxHxW, for `frames` only.
    :param coarse: β of the whole clip, TxKxHxW.
    """
    loss = functional.binary_cross_entropy_with_logits(logits, coarse[list(frames)])
    masks = torch.sigmoid(logits).detach()
    count = len(coarse)
    for g in _NEIGHBOURS:
        # Frame t's masks as seen in frame t+g, for those that both are in the batch.
        pairs = [t for t in frames if t + g in frames and 0 <= t + g < count]
        if not pairs:
            continue
        first = frames.start
        seen_from = [t + g - first for t in pairs]
        flow = flows[g][pairs]
        for source in (coarse[pairs], masks[[t - first for t in pairs]]):
            warped = warp(source, flow)
            pulled = functional.binary_cross_entropy_with_logits(logits[seen_from], warped)
            loss = loss + _NEIGHBOUR_WEIGHT * pulled
    return loss


def warp(masks: Tensor, flow: Tensor) -> Tensor:
    """Look up masks, NxKxHxW, where a flow, NxHxWx2 in pixels, leads from each pixel."""
    height, width = masks.shape[2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    column = (2.0 * (x + flow[..., 0]) + 1.0) / width - 1.0
    row = (2.0 * (y + flow[..., 1]) + 1.0) / height - 1.0
    grid = torch.stack([column, row], dim=-1)
    return functional.grid_sample(masks, grid, padding_mode="border", align_corners=False)


def regrouped(masks: Tensor, flows: dict[int, Tensor]) -> Tensor:
    """Group each frame's pixels by 2-means on their mask values over time, x and y; TxKxHxW.

    Pixels of the group where the masks are larger get 1, the others 0.
    """
    count, objects, height, width = masks.shape
    y, x = np.mgrid[:height, :width].astype(np.float32) * (_WAY_ACROSS / width)
    grouped = torch.zeros_like(masks)
    for t in range(count):
        earlier = [(g, t - g) for g in _NEIGHBOURS if 0 <= t - g < count]
        values = [masks[t], *(warp(masks[[s]], flows[g][[s]])[0] for g, s in earlier)]
        over_time = torch.stack(values).numpy()
        for k in range(objects):
            features = np.stack([*over_time[:, k], x, y], axis=-1).reshape(height * width, -1)
            grouped[t, k] = torch.from_numpy(_two_means(features, len(values))).view(height, width)
    return grouped


def _two_means(features: Maps, values: int) -> Maps:
    """Give 1 for the group whose first so many `values` are larger, 0 for the other."""
    brightness = features[:, :values].mean(axis=1)
    if brightness.max() < 0.5:
        return np.zeros(len(features), np.float32)
    labels = (brightness > 0.5).astype(np.int32)[:, None]
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 20, 1e-3)
    _, labels, centres = cv2.kmeans(
        features, 2, labels, criteria, 1, cv2.KMEANS_USE_INITIAL_LABELS
    )
    foreground = int(np.argmax(centres[:, :values].mean(axis=1)))
    return (labels[:, 0] == foreground).astype(np.float32)


def clip_of(results: Sequence[SegmentationResult], ids: Sequence[int]) -> Clip:
    """Bring a clip's frames, motion maps and coarse masks to processing resolution."""
    shape = results[0].motion_map.shape
    size = (_padded(shape[1]), _padded(shape[0]))
    greys = [_grey(result.frame.image, size) for result in results]
    inputs = [
        np.stack([grey / 64.0 - 2.0, cv2.resize(_relative(result.motion_map), size)])
        for grey, result in zip(greys, results, strict=True)
    ]
    coarse = [
        np.stack([_covered(result, identity, size) for identity in ids]) for result in results
    ]
    return Clip(
        torch.from_numpy(np.stack(inputs).astype(np.float32)),
        torch.from_numpy(np.stack(coarse)),
        {g: torch.from_numpy(_flows(greys, g)) for g in _NEIGHBOURS},
    )


def _flows(greys: Sequence[npt.NDArray[np.uint8]], g: int) -> Maps:
    """Give F(t+g→t) for every t."""
    flows = np.zeros((len(greys), *greys[0].shape, 2), np.float32)
    for t, grey in enumerate(greys):
        if 0 <= t + g < len(greys):
            flows[t] = dis_flow(greys[t + g], grey, variational_iterations=1)
    return flows


def _grey(image: npt.NDArray[np.generic], size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Give a frame as 8-bit grey from its darkest to its brightest hundredth."""
    values = np.asarray(image, np.float32)
    grey = values.mean(axis=2) if values.ndim == 3 else values
    dark, bright = np.nanpercentile(grey, (1, 99))
    stretched = np.nan_to_num((grey - dark) * (255.0 / max(bright - dark, 1e-6)))
    resized = cv2.resize(np.clip(stretched, 0, 255), size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(resized), np.uint8)


def _relative(motion_map: Maps) -> Maps:
    usual = max(float(np.median(motion_map)), 1e-3)
    return motion_map / (motion_map + _HALF_MOTION * usual)


def _covered(result: SegmentationResult, identity: int, size: tuple[int, int]) -> Maps:
    """Give what share of each pixel an object covers, at another size."""
    mask = np.zeros(result.labels.shape, np.float32)
    if any(found.id == identity for found in result.objects):
        mask = (result.labels == label_of(identity)).astype(np.float32)
    covered: Maps = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    return covered


def _with_masks(
    result: SegmentationResult, ids: Sequence[int], probabilities: Maps
) -> SegmentationResult:
    """Draw a frame's objects anew: each pixel is the likeliest one's, if any is likely."""
    height, width = result.labels.shape
    enlarged = np.stack([cv2.resize(each, (width, height)) for each in probabilities])
    best = enlarged.argmax(axis=0)
    likely = enlarged.max(axis=0) > 0.5
    labels = np.zeros((height, width), np.uint16)
    objects = []
    for found in result.objects:
        mask = likely & (best == ids.index(found.id))
        if mask.any():
            labels[mask] = label_of(found.id)
            objects.append(_redrawn(found, mask))
    return dataclasses.replace(result, labels=labels, objects=tuple(objects))


def _redrawn(found: MovingObject, mask: npt.NDArray[np.bool_]) -> MovingObject:
    box = Box.around(mask)
    y, x = np.nonzero(mask)
    return dataclasses.replace(
        found,
        centroid=(float(x.mean()), float(y.mean())),
        area=len(x),
        box=(box.x0, box.y0, box.x1 - box.x0, box.y1 - box.y0),
    )


def _batches(count: int) -> list[range]:
    """Split a clip into batches of consecutive frames, elsewhere each time."""
    first = int(torch.randint(_BATCH, (1,)))
    bounds = sorted({0, count, *range(first, count, _BATCH)})
    batches = [range(*pair) for pair in itertools.pairwise(bounds)]
    return [batches[int(i)] for i in torch.randperm(len(batches))]


def _judged(net: RefineNet, clip: Clip) -> Tensor:
    """Give α of all frames, TxKxHxW.

    Maps are normalised by the frames at hand: after so few steps, running means still lag behind.
    """
    net.train()
    with torch.no_grad():
        return torch.cat([torch.sigmoid(net(part)) for part in clip.inputs.split(_BATCH)])


def _padded(length: int) -> int:
    return -(-length // _STRIDE) * _STRIDE
