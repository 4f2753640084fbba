"""RAFT with random weights: shapes, devices, checkpoints and what is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from turbseg_ros.dependencies import how_to_install
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.learning.torch_import import NetworkError
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.frame import Frame

torch: Any = pytest.importorskip("torch", reason="torch is not installed: make test-learning")
Tensor = Any

from torchvision.models.optical_flow import raft_large, raft_small  # noqa: E402

from turbseg_ros.learning.raft import RaftFlow, resolved_device  # noqa: E402


@pytest.fixture(scope="module")
def small_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(1)
    path = tmp_path_factory.mktemp("raft") / "small.pth"
    torch.save(raft_small(weights=None).state_dict(), path)
    return path


def picture(shape: tuple[int, int], seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def as_published_by_the_authors(parameters: dict[str, Tensor]) -> dict[str, Tensor]:
    """Name parameters as RAFT's authors do, some of them twice."""
    steps = (
        ("feature_encoder.", "fnet."),
        ("context_encoder.", "cnet."),
        ("net.convnormrelu.0.", "net.conv1."),
        ("net.convnormrelu.1.", "net.norm1."),
        ("net.conv.", "net.conv2."),
        ("block.motion_encoder.", "block.encoder."),
        ("mask_predictor.convrelu.0.", "update_block.mask.0."),
        ("mask_predictor.conv.", "update_block.mask.2."),
        ("encoder.convcorr1.0.", "encoder.convc1."),
        ("encoder.convcorr2.0.", "encoder.convc2."),
        ("encoder.convflow1.0.", "encoder.convf1."),
        ("encoder.convflow2.0.", "encoder.convf2."),
        ("encoder.conv.0.", "encoder.conv."),
        *((f".convnormrelu{n}.0.", f".conv{n}.") for n in (1, 2, 3)),
        *((f".convnormrelu{n}.1.", f".norm{n}.") for n in (1, 2, 3)),
        *(
            (f"recurrent_block.convgru{n}.conv{g}.", f"gru.conv{g}{n}.")
            for n in (1, 2)
            for g in "zrq"
        ),
    )
    named = {}
    for name, value in parameters.items():
        for ours, theirs in steps:
            name = name.replace(ours, theirs)
        named[f"module.{name}"] = value
        if ".downsample.1." in name:
            named[f"module.{name.replace('.downsample.1.', '.norm3.')}"] = value
    return named


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_on_a_gpu_flows_are_those_of_the_processor(small_weights: Path) -> None:
    shape = (240, 432)
    pictures = picture(shape, 0), {4: picture(shape, 1)}
    (quick,) = RaftFlow("raft_small", small_weights, "cuda").flows_to(*pictures).values()
    (whole,) = RaftFlow("raft_small", small_weights, "cpu").flows_to(*pictures).values()
    assert quick.dtype == np.float32
    # Half precision tells 14 from 14.01.
    assert np.sqrt(np.mean(whole**2)) > 1.0
    assert np.percentile(np.abs(quick - whole), 99) < 0.01 * np.sqrt(np.mean(whole**2))


def test_flows_have_the_pictures_size_whatever_that_is(small_weights: Path) -> None:
    raft = RaftFlow("raft_small", small_weights, "cpu")
    shape = (135, 171)
    flows = raft.flows_to(picture(shape, 0), {-2: picture(shape, 1), 2: picture(shape, 2)})
    assert list(flows) == [-2, 2]
    for flow in flows.values():
        assert (flow.shape, flow.dtype) == ((*shape, 2), np.float32)
        assert np.isfinite(flow).all()
    assert raft.flows_to(picture(shape, 0), {}) == {}


def test_a_flow_does_not_depend_on_the_others_of_its_batch(small_weights: Path) -> None:
    raft = RaftFlow("raft_small", small_weights, "cpu")
    source, one, other = (picture((128, 128), seed) for seed in range(3))
    together = raft.flows_to(source, {1: one, 2: other})
    np.testing.assert_allclose(raft.flows_to(source, {2: other})[2], together[2], atol=1e-3)


@pytest.mark.parametrize("build", [raft_small, raft_large])
def test_the_authors_checkpoints_are_read_too(build, tmp_path: Path, small_weights: Path) -> None:
    torch.manual_seed(2)
    net = build(weights=None)
    torch.save(net.state_dict(), tmp_path / "ours.pth")
    torch.save(as_published_by_the_authors(net.state_dict()), tmp_path / "theirs.pth")
    source, target = picture((128, 128), 0), picture((128, 128), 1)
    ours, theirs = (
        RaftFlow(build.__name__, tmp_path / name, "cpu").flows_to(source, {1: target})[1]
        for name in ("ours.pth", "theirs.pth")
    )
    np.testing.assert_array_equal(ours, theirs)


def spoilt(path: Path, small_weights: Path) -> Path:
    path.write_bytes(small_weights.read_bytes()[:5000])
    return path


def test_weights_that_cannot_be_used_are_refused_in_one_line(
    tmp_path: Path, small_weights: Path
) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no weights")
    listed = tmp_path / "list.pth"
    torch.save([1, 2], listed)
    refused = {
        tmp_path / "missing.pth": "No such file",
        tmp_path: "directory",
        text: "no checkpoint",
        spoilt(tmp_path / "spoilt.pth", small_weights): "no checkpoint",
        listed: "something else",
    }
    for path, reason in refused.items():
        with pytest.raises(NetworkError, match=reason) as refusal:
            RaftFlow("raft_small", path, "cpu")
        assert str(path) in str(refusal.value)
        assert "\n" not in str(refusal.value)
    with pytest.raises(NetworkError, match="not those of raft_large"):
        RaftFlow("raft_large", small_weights, "cpu")


def test_a_checkpoint_cannot_run_code(tmp_path: Path) -> None:
    class Intruder:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "intruded",))

    torch.save({"weight": Intruder()}, tmp_path / "intruder.pth")
    with pytest.raises(NetworkError, match="no checkpoint"):
        RaftFlow("raft_small", tmp_path / "intruder.pth", "cpu")
    assert not (tmp_path / "intruded").exists()


def test_devices_are_resolved_or_refused_with_the_reason(monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert [resolved_device(asked) for asked in ("auto", "cpu")] == ["cpu", "cpu"]
    monkeypatch.setattr(torch.backends.cuda, "is_built", lambda: True)
    with pytest.raises(NetworkError, match="sees no GPU"):
        resolved_device("cuda")
    monkeypatch.setattr(torch.backends.cuda, "is_built", lambda: False)
    with pytest.raises(NetworkError, match="built without CUDA"):
        resolved_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [resolved_device(asked) for asked in ("auto", "cpu", "cuda")] == ["cuda", "cpu", "cuda"]


def test_the_method_runs_on_raft(small_weights: Path) -> None:
    parameters = Parameters.from_mapping(
        {
            "flow.backend": "raft_small",
            "flow.weights": str(small_weights),
            "device": "cpu",
            "resolution.processing": 160,
        }
    )
    segmenter = motion_segmenter(parameters)
    assert segmenter.device == "cpu"
    results = []
    for number in range(3):
        results += segmenter.push(Frame(number, picture((96, 160), number)))
    assert len(results + segmenter.flush()) == 3


def test_missing_torch_is_told_in_one_line(monkeypatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ParameterError) as refusal:
        motion_segmenter(Parameters.from_mapping({"flow.backend": "raft_large"}))
    assert str(refusal.value) == (
        f"flow.backend raft_large needs torch: {how_to_install('torch')}"
    )


def test_the_default_method_imports_no_torch() -> None:
    code = (
        "import sys; from turbseg_ros.factory import motion_segmenter; "
        "from turbseg_ros.parameters import Parameters; motion_segmenter(Parameters()); "
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
