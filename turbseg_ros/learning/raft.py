"""RAFT optical flow (Teed and Deng 2020), by torchvision's modules."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torchvision.models import optical_flow as models

from turbseg_ros.arrays import ByteImage, Flow
from turbseg_ros.learning.torch_import import NetworkError

_BUILDERS = {"raft_small": models.raft_small, "raft_large": models.raft_large}
_PUBLISHED = {
    "raft_small": models.Raft_Small_Weights.DEFAULT,
    "raft_large": models.Raft_Large_Weights.DEFAULT,
}
# RAFT works on an eighth of the picture, and its correlation pyramid needs 16 pixels of that.
_STRIDE = 8
_MIN_SIDE = 128
# What RAFT's authors call the parameters that torchvision calls otherwise, one step at a time.
_RENAMED = (
    (r"^module\.", ""),
    (r"^fnet\.", "feature_encoder."),
    (r"^cnet\.", "context_encoder."),
    (r"_encoder\.conv1\.", "_encoder.convnormrelu.0."),
    (r"_encoder\.norm1\.", "_encoder.convnormrelu.1."),
    (r"_encoder\.conv2\.", "_encoder.conv."),
    (r"(layer\d\.\d)\.conv(\d)\.", r"\1.convnormrelu\2.0."),
    (r"(layer\d\.\d)\.norm(\d)\.", r"\1.convnormrelu\2.1."),
    (r"block\.encoder\.convc(\d)\.", r"block.motion_encoder.convcorr\1.0."),
    (r"block\.encoder\.convf(\d)\.", r"block.motion_encoder.convflow\1.0."),
    (r"block\.encoder\.conv\.", "block.motion_encoder.conv.0."),
    (r"block\.gru\.conv([zrq])(\d?)\.", r"block.recurrent_block.convgru\2.conv\1."),
    (r"convgru\.", "convgru1."),
    (r"^update_block\.mask\.0\.", "mask_predictor.convrelu.0."),
    (r"^update_block\.mask\.2\.", "mask_predictor.conv."),
)
# The last norm of a block that shrinks, which the authors' checkpoints also list under
# `downsample.1`.
_LISTED_TWICE = re.compile(r"^module\..*\.norm[34]\.")


class RaftFlow:
    """Computes all flows of a frame in one batch.

    On a GPU it runs in half precision where it can. `device` says where: cpu or cuda.

    :param architecture: raft_small or raft_large.
    :param weights: checkpoint of torchvision or of RAFT's authors; without one, torchvision
        fetches its own.
    :param device: auto, cpu or cuda; auto takes the GPU where there is one.
    :raises NetworkError: when the weights or the device can't be had.
    """

    def __init__(self, architecture: str, weights: Path | None, device: str) -> None:
        self.device = resolved_device(device)
        net = _BUILDERS[architecture](weights=None)
        _load(net, architecture, _checkpoint(architecture, weights), weights)
        self._net = net.eval().to(device=self.device, memory_format=torch.channels_last)

    def flows_to(self, source: ByteImage, targets: Mapping[int, ByteImage]) -> dict[int, Flow]:
        """Return the flow F(t→t+k), HxWx2, for every neighbour {k: HxW grey, aligned to t}."""
        if not targets:
            return {}
        second = self._batch(np.stack(list(targets.values())))
        first = self._batch(source[None]).expand_as(second)
        # Half precision where RAFT bears it: coordinates, for one, stay whole.
        halved = torch.autocast(self.device, torch.half, enabled=self.device == "cuda")
        with torch.inference_mode(), halved:
            flows = self._net(first, second)[-1].float()
        height, width = source.shape
        cropped = flows[..., :height, :width].permute(0, 2, 3, 1).cpu().numpy()
        return {k: np.ascontiguousarray(flow) for k, flow in zip(targets, cropped, strict=True)}

    def close(self) -> None:
        """Keep the network: others may use it, too."""

    def _batch(self, images: ByteImage) -> Tensor:
        """Bring NxHxW grey values to what RAFT takes: three channels, -1 to 1, sides it likes."""
        grey = torch.from_numpy(images).to(self.device, torch.float32)[:, None] / 127.5 - 1.0
        height, width = images.shape[1:]
        padding = (0, _padded(width) - width, 0, _padded(height) - height)
        padded = functional.pad(grey, padding, mode="replicate")
        return padded.expand(-1, 3, -1, -1).contiguous(memory_format=torch.channels_last)


def resolved_device(asked: str) -> str:
    """Return where networks run: cpu or cuda.

    :param asked: auto, cpu or cuda.
    :raises NetworkError: when a GPU was asked for that torch can't use.
    """
    if asked == "cpu":
        return "cpu"
    if torch.cuda.is_available():
        return "cuda"
    if asked == "auto":
        return "cpu"
    reason = "sees no GPU" if torch.backends.cuda.is_built() else "was built without CUDA"
    raise NetworkError(f"device cuda: torch {torch.__version__} {reason}; take auto or cpu")


def _padded(length: int) -> int:
    return max(-(-length // _STRIDE) * _STRIDE, _MIN_SIDE)


def _checkpoint(architecture: str, weights: Path | None) -> object:
    """Read a checkpoint's content, fetched if none is named."""
    if weights is None:
        try:
            return _PUBLISHED[architecture].get_state_dict(progress=False, check_hash=True)
        except (OSError, RuntimeError) as error:
            raise NetworkError(
                f"flow.backend {architecture}: torchvision's weights can't be fetched"
                f" ({_line(error)}); name a file with flow.weights"
            ) from error
    try:
        content = io.BytesIO(weights.read_bytes())
    except OSError as error:
        raise NetworkError(f"flow.weights {weights}: {error.strerror or error}") from error
    try:
        return torch.load(content, map_location="cpu", weights_only=True)
    except Exception as error:  # torch and pickle raise whatever a spoilt file makes them
        raise NetworkError(f"flow.weights {weights}: no checkpoint ({_line(error)})") from error


def _load(net: nn.Module, architecture: str, content: object, weights: Path | None) -> None:
    if not isinstance(content, Mapping) or not all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in content.items()
    ):
        raise NetworkError(f"flow.weights {weights}: holds something else than named tensors")
    try:
        net.load_state_dict(_as_torchvision_names(content))
    except RuntimeError as error:
        raise NetworkError(f"flow.weights {weights}: not those of {architecture}") from error


def _as_torchvision_names(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Rename the parameters of the authors' checkpoints; torchvision's own stay."""
    renamed = {}
    for name, value in parameters.items():
        if _LISTED_TWICE.match(name):
            continue
        if name.startswith("module."):
            for pattern, replacement in _RENAMED:
                name = re.sub(pattern, replacement, name)
        renamed[name] = value
    return renamed


def _line(error: Exception) -> str:
    """Return an error's first line."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0]
