"""Training of Refine-Net on examples whose truth is known."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from turbseg_ros.learning.examples import Examples
from turbseg_ros.learning.refine_net import WIDTHS, RefineNet
from turbseg_ros.learning.window_input import CHANNELS

_PEAK_RATE = 3e-3
# Of a network that knows something already, which would be lost at the other.
_LATER_PEAK_RATE = 1.5e-3
_WEIGHT_DECAY = 1e-3
# Pixels that both halves of a Dice coefficient are smoothed by: an empty window counts little.
_SMOOTHING = 40.0

# Cross-entropy of a window without any object, as that of another with the same: what is invented
# is followed, and becomes an object.
_INVENTED = 2.0

# Share of the windows that are seen through haze, and the least contrast that it leaves there.
_HAZY, _LEAST_CONTRAST = 0.4, 0.1
# Noise of a camera in grey values of `grey`, which haze makes larger beside the contrast that is
# left, and the most that comes of it.
_NOISE, _MOST_NOISE = 0.03, 0.2

# Share of the steps that see windows so.
_UPSIDE_DOWN, _ON_ITS_SIDE = 0.15, 0.15

_MOVING, _CORE = CHANNELS.index("moving"), CHANNELS.index("core")
_GREY, _CHANGE = CHANNELS.index("grey"), CHANNELS.index("change")
_BACKGROUND = [
    CHANNELS.index(name)
    for name in ("change", "deviation", "difference", "known", "light", "colour")
]
_DEVIATION = CHANNELS.index("deviation")
_LIGHT, _COLOUR = CHANNELS.index("light"), CHANNELS.index("colour")
_MOTION = [CHANNELS.index(name) for name in ("motion", "share")]
_SIZE = [CHANNELS.index(name) for name in ("width", "height")]


def loss_of(logits: Tensor, truth: Tensor) -> Tensor:
    """Return cross-entropy plus one minus the Dice coefficient, averaged over windows.

    The cross-entropy of a window without an object counts more.

    :param logits: Nx1xHxW.
    :param truth: Nx1xHxW, from 0 to 1.
    """
    each = functional.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    is_empty = (truth.amax(dim=(1, 2, 3)) <= 0.5).float()
    entropy = (each.mean(dim=(1, 2, 3)) * (1.0 + (_INVENTED - 1.0) * is_empty)).mean()
    probability = torch.sigmoid(logits)
    common = (probability * truth).sum(dim=(1, 2, 3))
    total = (probability + truth).sum(dim=(1, 2, 3))
    dice = (2.0 * common + _SMOOTHING) / (total + _SMOOTHING)
    return entropy + (1.0 - dice).mean()


def augmented(inputs: Tensor, truth: Tensor, random: torch.Generator) -> tuple[Tensor, Tensor]:
    """Vary what a camera, the air or the flow might have varied.

    Windows are mirrored, shifted, stretched and turned a little, some are upside down or lie on
    their side, for things fly, fall and lean as they like; the picture gets another
    contrast and noise, some are hazy; the background gets less certain, or unknown in a part; the
    motion's smear is wider or narrower.
    """
    count = len(inputs)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, generator=random)

    def chosen(odds: float) -> Tensor:
        return (torch.rand(count, generator=random) < odds).float()

    mirror = 1.0 - 2.0 * chosen(0.5)
    turn, shear = uniform(-0.12, 0.12), uniform(-0.15, 0.15)
    scale_x, scale_y = uniform(0.75, 1.15), uniform(0.75, 1.15)
    to_source = torch.stack(
        [
            torch.stack([mirror * scale_x, shear + turn, uniform(-0.2, 0.2)], dim=1),
            torch.stack([-turn * mirror, scale_y, uniform(-0.2, 0.2)], dim=1),
        ],
        dim=1,
    )
    grid = functional.affine_grid(to_source, [count, 1, *inputs.shape[2:]], align_corners=False)
    both = functional.grid_sample(
        torch.cat([inputs, truth], dim=1), grid, padding_mode="border", align_corners=False
    )
    inputs, truth = both[:, :-1].contiguous(), both[:, -1:]

    def column(values: Tensor) -> Tensor:
        return values[:, None, None, None]

    stretch = torch.log2(torch.stack([scale_x, scale_y], dim=1)) / 3.0
    inputs[:, _SIZE] += stretch[..., None, None]
    inputs[:, [_GREY, _CHANGE]] *= column(uniform(0.6, 1.3))
    noise = torch.randn(inputs[:, :1].shape, generator=random)
    inputs[:, [_GREY]] += noise * column(uniform(0.0, 0.06))
    inputs[:, [_DEVIATION]] = inputs[:, [_DEVIATION]] ** column(uniform(0.7, 1.5))
    inputs[:, _MOTION] *= column(uniform(0.75, 1.2))
    left = _LEAST_CONTRAST ** uniform(0.0, 1.0)
    inputs = hazy(inputs, torch.where(chosen(_HAZY) > 0.0, left, 1.0), random)
    unknown = _blobs(count, inputs.shape[2:], random) * column(chosen(0.3))
    inputs[:, _BACKGROUND] *= 1.0 - unknown
    for channel in (_MOVING, _CORE):
        radius = int(torch.randint(-3, 4, (1,), generator=random))
        inputs[:, [channel]] = _widened(inputs[:, [channel]], radius)
    for axes, odds in (((2,), _UPSIDE_DOWN), ((2, 3), _ON_ITS_SIDE)):
        if torch.rand(1, generator=random) < odds:
            inputs, truth = _turned(inputs, axes), _turned(truth, axes)
    return inputs, truth


def hazy(inputs: Tensor, contrast: Tensor, random: torch.Generator) -> Tensor:
    """Return windows as they are where haze leaves a share of the contrast, and all of the noise.

    Grey values are relative to a window's contrast, so that there it is noise that grows; what
    differs from the background by its light, its colour or more than its noise does so by less.

    :param inputs: NxCxHxW, which are changed.
    :param contrast: N, what is left of it, above 0, to 1.
    """
    contrast = contrast[:, None, None, None]
    inputs[:, [_LIGHT]] *= contrast
    for channel in (_COLOUR, _DEVIATION):
        # Both are of the form x / (x + half).
        value = inputs[:, [channel]].clamp(0.0, 1.0)
        inputs[:, [channel]] = contrast * value / (1.0 - (1.0 - contrast) * value)
    usual = (_NOISE * (1.0 / contrast - 1.0)).clamp(max=_MOST_NOISE)
    noise = torch.randn(inputs[:, :1].shape, generator=random) * usual
    inputs[:, [_GREY, _CHANGE]] += noise
    return inputs


def _turned(maps: Tensor, axes: tuple[int, ...]) -> Tensor:
    """Return maps upside down, axis 2, or with rows and columns exchanged, axes 2 and 3."""
    if len(axes) == 1:
        return maps.flip(*axes)
    turned = maps.transpose(*axes).contiguous()
    if maps.shape[1] > 1:
        turned[:, _SIZE] = turned[:, _SIZE[::-1]]
    return turned


def _blobs(count: int, shape: torch.Size, random: torch.Generator) -> Tensor:
    """Draw masks, Nx1xHxW, of a few large blobs."""
    coarse = torch.rand((count, 1, 5, 5), generator=random)
    smooth = functional.interpolate(coarse, size=shape, mode="bicubic", align_corners=False)
    return (smooth > 0.55).float()


def _widened(mask: Tensor, radius: int) -> Tensor:
    size = 2 * abs(radius) + 1
    if radius < 0:
        return -functional.max_pool2d(-mask, size, stride=1, padding=-radius)
    return functional.max_pool2d(mask, size, stride=1, padding=radius)


@dataclass(frozen=True)
class HeldOut:
    """How windows are told that were not trained on.

    `j` is the mean intersection over union, by the network and by the rules, where there is an
    object; `alarms` the share of the windows without one in which something is found.
    """

    windows: int
    j: float
    j_ruled: float
    alarms: float
    alarms_ruled: float


def held_out_scores(net: RefineNet, examples: Examples) -> HeldOut:
    """Score a network, and the rules, on examples that it was not trained on."""
    truth = examples.truth > 0.5
    found, ruled = probabilities(net, examples) > 0.5, examples.ruled > 0.5
    with_object = truth.any(axis=(1, 2))

    def jaccard(masks: npt.NDArray[np.bool_]) -> float:
        union = (masks | truth)[with_object].sum(axis=(1, 2))
        return _mean((masks & truth)[with_object].sum(axis=(1, 2)) / union)

    def alarms(masks: npt.NDArray[np.bool_]) -> float:
        return _mean(masks[~with_object].max(axis=(1, 2), initial=False))

    return HeldOut(len(examples), jaccard(found), jaccard(ruled), alarms(found), alarms(ruled))


def probabilities(net: RefineNet, examples: Examples) -> npt.NDArray[np.float32]:
    """Judge every pixel of examples, NxSIDExSIDE."""
    net.eval()
    with torch.inference_mode():
        batches = torch.from_numpy(examples.inputs).split(32)
        judged = [torch.sigmoid(net(batch.float()))[:, 0].numpy() for batch in batches]
    return np.concatenate(judged)


def blended(one: RefineNet, other: RefineNet, share: float) -> RefineNet:
    """Return a network between two, of which one was trained further from the other.

    Between what each does best lies one that does both nearly as well (Wortsman et al. 2022,
    "Robust fine-tuning of zero-shot models").

    :param share: of the first, from 0 to 1.
    """
    between = copy.deepcopy(other)
    first, second = one.state_dict(), other.state_dict()
    between.load_state_dict(
        {name: share * first[name] + (1.0 - share) * second[name] for name in second}
    )
    return between


def _mean(values: npt.NDArray[Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def train(
    examples: Examples,
    seed: int,
    steps: int,
    batch: int = 16,
    report_every: int = 50,
    start: RefineNet | None = None,
    shown: Examples | None = None,
) -> Iterator[tuple[float, RefineNet]]:
    """Train a network; every so many steps give the mean loss and how it stands.

    The same seed on the same machine gives the same network.

    :param start: the network to go on with, which is changed; from nothing otherwise.
    :param shown: more examples, of which each step sees half as many as of the others, however
        many there are of each.
    """
    torch.manual_seed(seed)
    random = torch.Generator().manual_seed(seed)
    net = RefineNet(len(CHANNELS), WIDTHS) if start is None else start
    peak = _PEAK_RATE if start is None else _LATER_PEAK_RATE
    # Takes a quarter less time on a processor.
    net.to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), lr=peak, weight_decay=_WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, peak, total_steps=steps)
    kinds = [(examples, batch)]
    if shown is not None and len(shown):
        kinds += [(shown, batch // 2)]
    losses = []
    for step in range(1, steps + 1):
        net.train()
        maps, right = augmented(*_picked(kinds, random), random)
        loss = loss_of(net(maps.contiguous(memory_format=torch.channels_last)), right)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses.append(loss.item())
        if step % report_every == 0 or step == steps:
            yield float(np.mean(losses)), net
            losses.clear()


def _picked(
    kinds: Sequence[tuple[Examples, int]], random: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Return windows picked at random, so many of each kind, and their truth, Nx1xHxW."""
    inputs, truth = [], []
    for examples, count in kinds:
        picked = torch.randint(len(examples), (count,), generator=random).numpy()
        inputs.append(torch.from_numpy(examples.inputs[picked]).float())
        truth.append(torch.from_numpy(examples.truth[picked, None]).float())
    return torch.cat(inputs), torch.cat(truth)
