"""Writes a trained Refine-Net, for OpenCV to run and for torch to go on with."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import torch
from safetensors.torch import save_file

from turbseg_ros.learning.refine_net import RefineNet
from turbseg_ros.learning.window_input import CHANNELS, SIDE


def write_onnx(net: RefineNet, path: Path) -> None:
    """Write a network as ONNX, for one window at a time."""
    example = torch.zeros(1, len(CHANNELS), SIDE, SIDE)
    # The exporter tells its progress on standard output.
    with contextlib.redirect_stdout(io.StringIO()):
        torch.onnx.export(
            net.eval(),
            (example,),
            str(path),
            dynamo=True,
            external_data=False,
            input_names=["maps"],
            output_names=["logits"],
        )


def write_weights(net: RefineNet, path: Path) -> None:
    """Write a network's weights as safetensors."""
    save_file(net.state_dict(), path)
