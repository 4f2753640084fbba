"""Writes a trained Refine-Net, for OpenCV to run and for torch to go on with."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path

import torch
from onnx import ModelProto
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from turbseg_ros.learning.refine_net import WIDTHS, RefineNet
from turbseg_ros.learning.torch_import import NetworkError
from turbseg_ros.learning.window_input import CHANNELS, SIDE


def write_onnx(net: RefineNet, path: Path) -> None:
    """Write a network as ONNX, for one window at a time."""
    example = torch.zeros(1, len(CHANNELS), SIDE, SIDE)
    # The exporter tells its progress on standard output.
    with contextlib.redirect_stdout(io.StringIO()):
        program = torch.onnx.export(
            net.eval(), (example,), dynamo=True, input_names=["maps"], output_names=["logits"]
        )
    path.write_bytes(without_notes(program.model_proto).SerializeToString())


def without_notes(model: ModelProto) -> ModelProto:
    """Return a model without the exporter's notes, which name the files of this machine."""
    bare = ModelProto()
    bare.CopyFrom(model)
    graph = bare.graph
    for part in (bare, graph, *graph.node, *graph.input, *graph.output, *graph.value_info):
        part.ClearField("metadata_props")
    for weights in graph.initializer:
        weights.ClearField("metadata_props")
    return bare


def write_weights(net: RefineNet, path: Path) -> None:
    """Write a network's weights as safetensors."""
    # In training, channels are last in memory.
    weights = {name: value.contiguous() for name, value in net.state_dict().items()}
    path.write_bytes(save(weights))


def read_weights(path: Path) -> RefineNet:
    """Return the network whose weights `write_weights` wrote, of as many levels as they have.

    :raises NetworkError: when the file is missing or holds others.
    """
    try:
        weights = load(path.read_bytes())
        net = RefineNet(len(CHANNELS), _widths(weights))
        net.load_state_dict(weights)
    except OSError as error:
        raise NetworkError(f"{path}: {error.strerror or error}") from error
    except (RuntimeError, SafetensorError) as error:
        reason = str(error).splitlines()[0]
        raise NetworkError(f"{path}: not a refining network's weights ({reason})") from error
    return net


def _widths(weights: Mapping[str, Tensor]) -> tuple[int, ...]:
    """Return the feature maps of each level of a network with these weights."""
    fine: list[int] = []
    while (join := weights.get(f"join.{len(fine)}.0.weight")) is not None:
        fine.append(len(join))
    coarsest = weights.get(f"narrow.{len(fine) - 1}.weight")
    return WIDTHS if coarsest is None else (*fine, coarsest.shape[1])
