"""Refine-Net as the paper has it (section 3.3): fitted to the clip itself, without any truth.

A U-Net gives the mask α of all that moves from frame and motion map M. It is fitted to the coarse
mask β, to what the flow makes of the neighbours' β, and of its own masks for them; then, for some
more epochs, β is re-grouped by 2-means every few. Where the paper can't be taken at its word:

- Its losses are printed as differences of entropies, which are least for any certain mask; here
  they are cross-entropies.
- A mask is warped from frame t to t+g by looking up where F(t+g→t) leads, for the flow F(t→t+g)
  would have to be splatted.
- One mask holds all objects, which are told apart afterwards by their coarse masks: where an
  object's id changes within the clip, a mask of its own for each id would contradict itself.
- A pixel's mask values over time are those of the frames within two of it, followed by the flow.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from turbseg_ros.arrays import ByteImage, Labels, Map, Mask
from turbseg_ros.learning.refine_net import RefineNet
from turbseg_ros.segmentation.flow import dis_flow
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter
from turbseg_ros.segmentation.tone import ToneMap

Epochs = Callable[[range], Iterable[int]]
"""Hands epochs on while it shows how many have passed."""

_NEIGHBOURS = (-2, -1, 1, 2)
# Weights γ2 and γ3 of the losses that look at neighbours, for each g; γ1 is 1.
_NEIGHBOUR_WEIGHT = 0.1
_GROUPED_EPOCHS = 10
_REGROUP_EVERY = 3
# What the frame's width counts for among the mask values that pixels are grouped by.
_WAY_ACROSS = 0.25
# Frames that are judged together, fewer in a clip so short that an epoch had too few steps.
_BATCH = 4
_MIN_STEPS = 12
_RATE = 5e-3
_SEED = 1
# The net halves the picture three times.
_STRIDE = 8
# Motion, in multiples of the median in its frame, that comes to half of the range.
_HALF_MOTION = 5.0
# Bounds of the share that moving pixels have in a clip.
_MIN_SHARE, _MAX_SHARE = 1e-3, 0.5


@dataclass(frozen=True)
class Clip:
    """A whole clip at processing resolution, as tensors of T frames.

    `inputs` is TxCxHxW, colours (or grey) and motion; `coarse` is Tx1xHxW, the mask β; `flows`
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
        """Take the next frame; return nothing yet."""
        self._results += self._segmenter.push(frame)
        return []

    def flush(self) -> list[SegmentationResult]:
        """Return the results of all frames, refined."""
        results, self._results = [*self._results, *self._segmenter.flush()], []
        kinds = {(result.motion_map.shape, result.frame.image.shape[2:]) for result in results}
        if len(kinds) != 1 or not any(result.objects for result in results):
            return results
        masks = refined_masks(clip_of(results), self._epochs, self._grouping, self._shown)
        return [redrawn(result, mask) for result, mask in zip(results, masks[:, 0], strict=True)]


def refined_masks(clip: Clip, epochs: int, grouping: bool, shown: Epochs = iter) -> Map:
    """Fit the network to a clip; return each pixel's probability to move, Tx1xHxW."""
    torch.manual_seed(_SEED)
    net = _network(clip)
    optimiser = torch.optim.Adam(net.parameters(), lr=_RATE)
    # Before the first epoch nothing is known of α but β.
    coarse, masks = clip.coarse, clip.coarse.clone()
    batch = min(max(len(coarse) // _MIN_STEPS, 1), _BATCH)
    for epoch in shown(range(epochs + (_GROUPED_EPOCHS if grouping else 0))):
        if epoch >= epochs and (epoch - epochs) % _REGROUP_EVERY == 0:
            coarse = regrouped(masks, clip.flows)
        target = consistent_target(coarse, masks, clip.flows)
        for frames in torch.randperm(len(masks)).split(batch):
            logits = net(clip.inputs[frames])
            loss = functional.binary_cross_entropy_with_logits(logits, target[frames])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            masks[frames] = torch.sigmoid(logits).detach()
    # Map are normalised by the frames at hand: after so few steps, running means lag behind.
    with torch.no_grad():
        judged = torch.cat([torch.sigmoid(net(part)) for part in clip.inputs.split(batch)])
    probabilities: Map = judged.numpy()
    return probabilities


def _network(clip: Clip) -> RefineNet:
    """Make a network that gives every pixel the share of those that move, to begin with.

    From an even chance, the first epochs would go into learning that most pixels don't move.
    """
    net = RefineNet(clip.inputs.shape[1])
    share = clip.coarse.mean().clamp(_MIN_SHARE, _MAX_SHARE)
    torch.nn.init.constant_(net.judge.bias, float(torch.logit(share)))
    return net.to(memory_format=torch.channels_last)


def consistent_target(coarse: Tensor, masks: Tensor, flows: dict[int, Tensor]) -> Tensor:
    """Return the mask against which the cross-entropy of α is the paper's loss, eq. 5.

    That is γ1·L1 + γ2·Σ L2 + γ3·Σ L3: consistent with the coarse mask (L1, eq. 6), with the
    neighbours' coarse masks warped by the flow (L2, eq. 7), with its own ones (L3, eq. 8).

    All of these are cross-entropies of the same α, and a cross-entropy is linear in what it is
    taken against: β, the neighbours' β, and what α was in the last epoch for the neighbours. So
    their weighted mean does for all of them, up to the sum of the weights.

    :param coarse: β of the whole clip, Tx1xHxW.
    :param masks: α of the whole clip, Tx1xHxW.
    """
    count = len(coarse)
    total, weights = coarse.clone(), torch.ones(count, 1, 1, 1)
    for g in _NEIGHBOURS:
        # Frame t's masks as seen in frame t+g.
        sources = [t for t in range(count) if 0 <= t + g < count]
        seen_from = [t + g for t in sources]
        both = warp(coarse[sources] + masks[sources], flows[g][sources])
        total[seen_from] += _NEIGHBOUR_WEIGHT * both
        weights[seen_from] += 2.0 * _NEIGHBOUR_WEIGHT
    return total / weights


def warp(masks: Tensor, flow: Tensor) -> Tensor:
    """Look up masks, Nx1xHxW, where a flow, NxHxWx2 in pixels, leads from each pixel."""
    height, width = masks.shape[2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    column = (2.0 * (x + flow[..., 0]) + 1.0) / width - 1.0
    row = (2.0 * (y + flow[..., 1]) + 1.0) / height - 1.0
    grid = torch.stack([column, row], dim=-1)
    return functional.grid_sample(masks, grid, padding_mode="border", align_corners=False)


def regrouped(masks: Tensor, flows: dict[int, Tensor]) -> Tensor:
    """Group each frame's pixels by 2-means on mask values over time, x and y: eq. 9; Tx1xHxW.

    Pixels of the group where the masks are larger get 1, the others 0.
    """
    count, _, height, width = masks.shape
    y, x = np.mgrid[:height, :width].astype(np.float32) * (_WAY_ACROSS / width)
    grouped = torch.zeros_like(masks)
    for t in range(count):
        earlier = [(g, t - g) for g in _NEIGHBOURS if 0 <= t - g < count]
        values = [masks[t], *(warp(masks[[s]], flows[g][[s]])[0] for g, s in earlier)]
        over_time = torch.cat(values).numpy()
        features = np.stack([*over_time, x, y], axis=-1).reshape(height * width, -1)
        grouped[t, 0] = torch.from_numpy(_two_means(features, len(values))).view(height, width)
    return grouped


def _two_means(features: Map, values: int) -> Map:
    """Return 1 for the group whose first so many `values` are larger, 0 for the other."""
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


def clip_of(results: Sequence[SegmentationResult]) -> Clip:
    """Bring a clip's frames, motion maps and coarse masks to processing resolution."""
    shape = results[0].motion_map.shape
    size = (_padded(shape[1]), _padded(shape[0]))
    tone = ToneMap()
    pictures = [
        cv2.resize(tone(result.frame.image), size, interpolation=cv2.INTER_AREA)
        for result in results
    ]
    inputs = [
        np.dstack([picture / 64.0 - 2.0, cv2.resize(_relative(result.motion_map), size)])
        for picture, result in zip(pictures, results, strict=True)
    ]
    coarse = [_covered(result.labels > 0, size) for result in results]
    return Clip(
        torch.from_numpy(np.stack(inputs).astype(np.float32).transpose(0, 3, 1, 2)),
        torch.from_numpy(np.stack(coarse)[:, None]),
        {g: torch.from_numpy(_flows([_grey(each) for each in pictures], g)) for g in _NEIGHBOURS},
    )


def _flows(greys: Sequence[ByteImage], g: int) -> Map:
    """Return F(t+g→t) for every t."""
    flows = np.zeros((len(greys), *greys[0].shape, 2), np.float32)
    for t, grey in enumerate(greys):
        if 0 <= t + g < len(greys):
            flows[t] = dis_flow(greys[t + g], grey, variational_iterations=1)
    return flows


def _grey(picture: ByteImage) -> ByteImage:
    if picture.ndim == 2:
        return picture
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))


def _relative(motion_map: Map) -> Map:
    usual = max(float(np.median(motion_map)), 1e-3)
    return np.asarray(2.0 * motion_map / (motion_map + _HALF_MOTION * usual) - 1.0, np.float32)


def _covered(mask: Mask, size: tuple[int, int]) -> Map:
    """Return what share of each pixel a mask covers, at another size."""
    covered: Map = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return covered


def redrawn(result: SegmentationResult, probability: Map) -> SegmentationResult:
    """Draw a frame's objects anew, where pixels move rather than not.

    Each pixel goes to the object whose coarse mask is nearest; a part of what moves that touches
    none is left out, for it has no id.

    :param probability: that a pixel moves, at any size.
    """
    if not result.objects:
        return result
    height, width = result.labels.shape
    moves = cv2.resize(probability, (width, height)) > 0.5
    _, parts = cv2.connectedComponents(moves.astype(np.uint8))
    if result.regions is not None:
        moves &= ~result.regions.ignored((width, height))
    known = moves & np.isin(parts, parts[result.labels > 0])
    labels = np.where(known, _nearest(result.labels), 0).astype(np.uint16)
    objects = [
        _with_mask(found, labels == found.label)
        for found in result.objects
        if (labels == found.label).any()
    ]
    return dataclasses.replace(result, labels=labels, objects=tuple(objects))


def _nearest(labels: Labels) -> Labels:
    """Return every pixel the label that is nearest to it; some pixel has one."""
    _, indices = cv2.distanceTransformWithLabels(
        (labels == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label_at = np.zeros(indices.max() + 1, np.uint16)
    label_at[indices[labels > 0]] = labels[labels > 0]
    nearest: Labels = label_at[indices]
    return nearest


def _with_mask(found: MovingObject, mask: Mask) -> MovingObject:
    return MovingObject.from_mask(
        mask, found.id, found.slot, found.velocity, found.trail, period=found.period
    )


def _padded(length: int) -> int:
    return -(-length // _STRIDE) * _STRIDE
