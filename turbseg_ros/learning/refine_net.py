"""Refine-Net as a module: a small U-Net (Ronneberger et al. 2015)."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTHS = (8, 16, 32, 48, 96)
"""Feature maps of each level, finest first, of the network that knows objects beforehand.

Coarse levels cost little: the last takes a seventh of its operations, and has two thirds of its
weights.
"""


class RefineNet(nn.Module):  # type: ignore[misc]  # torch is read as untyped
    """Return logits of object against background for every pixel: NxKxHxW for NxCxHxW.

    H and W are divisible by 2 to the number of levels below the first.

    :param channels: maps that go in.
    :param widths: feature maps of each level, finest first.
    :param outputs: kinds of object K that are judged apart.
    """

    def __init__(
        self, channels: int, widths: tuple[int, ...] = (8, 16, 32, 48), outputs: int = 1
    ) -> None:
        super().__init__()
        self.channels, self.widths, self.outputs = channels, widths, outputs
        self.first = _convolution(channels, widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(
                nn.MaxPool2d(2), _convolution(fine, coarse), _convolution(coarse, coarse)
            )
            for fine, coarse in itertools.pairwise(widths)
        )
        self.narrow = nn.ModuleList(
            nn.Conv2d(coarse, fine, 1) for fine, coarse in itertools.pairwise(widths)
        )
        self.join = nn.ModuleList(_convolution(2 * fine, fine) for fine in widths[:-1])
        self.judge = nn.Conv2d(widths[0], outputs, 1)

    def forward(self, maps: Tensor) -> Tensor:
        """Judge every pixel."""
        levels = self.levels(maps)
        joined = levels.pop()
        for narrow, join in zip(reversed(self.narrow), reversed(self.join), strict=True):
            enlarged = functional.interpolate(narrow(joined), scale_factor=2.0, mode="nearest")
            joined = join(torch.cat([levels.pop(), enlarged], dim=1))
        judged: Tensor = self.judge(joined)
        return judged

    def levels(self, maps: Tensor) -> list[Tensor]:
        """Return the feature maps of each level before they are joined, finest first."""
        levels = [self.first(maps)]
        for step in self.down:
            levels.append(step(levels[-1]))
        return levels


def deepened(net: RefineNet, width: int, maps: Tensor) -> RefineNet:
    """Return a network with a coarser level more, which judges as `net` does until it is trained.

    What the new level tells is weighed by 0 at first, what there was is passed on (Chen et al.
    2016, "Net2Net").

    :param width: feature maps of the new level.
    :param maps: NxCxHxW, examples of what is judged: batches are normalised in training, and what
        is passed on is to keep their mean and variance.
    """
    deeper = RefineNet(net.channels, (*net.widths, width), net.outputs)
    deeper.load_state_dict({**deeper.state_dict(), **net.state_dict()})
    convolution, normalisation, _ = deeper.join[-1]
    nn.init.dirac_(convolution.weight)
    with torch.no_grad():
        coarsest = net.eval().levels(maps)[-1]
        mean = coarsest.mean(dim=(0, 2, 3))
        variance = coarsest.var(dim=(0, 2, 3), unbiased=False)
        normalisation.running_mean.copy_(mean)
        normalisation.running_var.copy_(variance)
        normalisation.weight.copy_((variance + normalisation.eps).sqrt())
        normalisation.bias.copy_(mean)
    return deeper


def _convolution(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )
