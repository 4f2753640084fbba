"""Refine-Net: its examples, its training, its export, and how it runs by OpenCV."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.drawn_scene import DrawnScene
from turbseg_ros.cli import train as train_cli
from turbseg_ros.learning.examples import Examples, examples_from, rendered_clip
from turbseg_ros.learning.pretrained import PretrainedRefiner
from turbseg_ros.learning.random_scenes import random_scene
from turbseg_ros.learning.window_input import CHANNELS, SIDE
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame

torch = pytest.importorskip("torch", reason="torch is not installed: make test-learning")

from torch import Generator, Tensor  # noqa: E402

from turbseg_ros.learning import training  # noqa: E402
from turbseg_ros.learning.export import read_weights, write_onnx, write_weights  # noqa: E402
from turbseg_ros.learning.refine_net import WIDTHS, RefineNet, deepened  # noqa: E402
from turbseg_ros.learning.training import (  # noqa: E402
    augmented,
    blended,
    hazy,
    held_out_scores,
    loss_of,
    train,
)

# Training takes a minute on an idle machine, and many on a busy one.
pytestmark = [pytest.mark.usefixtures("one_torch_thread"), pytest.mark.timeout(900)]

PARAMETERS = Parameters.from_mapping({"resolution.processing": 160, "refine.mode": "none"})
CLIP_LENGTH = 20


def drawn_clip(scene: DrawnScene) -> Iterator[tuple[Frame, np.ndarray]]:
    for number, image in enumerate(scene.images(CLIP_LENGTH)):
        yield Frame(number, image), scene.truth(number).astype(np.uint16)


@pytest.fixture(scope="module")
def lessons() -> Examples:
    scenes = [DrawnScene((3, 0)), DrawnScene((2, 1), (20, 20)), DrawnScene((-3, 0), (100, 50))]
    return Examples.joined([examples_from(drawn_clip(each), PARAMETERS) for each in scenes])


@pytest.fixture(scope="module")
def unseen() -> Examples:
    return examples_from(drawn_clip(DrawnScene((-2, 1), (110, 30), side=30)), PARAMETERS)


def test_examples_hold_what_the_network_sees_and_what_is_right(lessons: Examples) -> None:
    assert lessons.inputs.shape == (len(lessons), len(CHANNELS), SIDE, SIDE)
    assert lessons.truth.shape == lessons.ruled.shape == (len(lessons), SIDE, SIDE)
    assert np.isfinite(lessons.inputs).all()
    assert np.abs(lessons.inputs).max() < 3.0
    assert lessons.truth.min() == 0.0
    assert lessons.truth.max() == 1.0
    # Object and truth lie at the same place: what differs most from the background is object.
    difference = lessons.inputs[:, CHANNELS.index("difference")]
    foreground_mask = difference > 0.6
    assert (lessons.truth[foreground_mask] > 0.5).mean() > 0.8


def test_augmenting_moves_picture_and_truth_alike(lessons: Examples) -> None:
    torch.manual_seed(3)
    random = torch.Generator().manual_seed(3)
    truth = torch.from_numpy(lessons.truth[:8, None]).float()
    inputs = torch.from_numpy(lessons.inputs[:8]).float()
    # A channel that nothing is done to but to move it.
    inputs[:, CHANNELS.index("moving")] = 0.0
    share = CHANNELS.index("share")
    inputs[:, share] = truth[:, 0]
    varied, moved = augmented(inputs, truth, random)
    assert varied.shape == inputs.shape
    for picture, right in zip(varied[:, share], moved[:, 0], strict=True):
        assert np.corrcoef(picture.ravel(), right.ravel())[0, 1] > 0.99
    assert not torch.equal(moved, truth)


def test_haze_takes_contrast_away_and_leaves_noise() -> None:
    random = torch.Generator().manual_seed(2)
    grey, light, deviation, motion = (
        CHANNELS.index(name) for name in ("grey", "light", "deviation", "motion")
    )
    clear = torch.zeros(2, len(CHANNELS), SIDE, SIDE)
    clear[:, light], clear[:, deviation], clear[:, motion] = 0.8, 0.5, 0.7
    seen = hazy(clear.clone(), torch.tensor([1.0, 0.25]), random)
    torch.testing.assert_close(seen[0], clear[0])
    assert float(seen[1, light].mean()) == pytest.approx(0.2)
    # As many times the noise as make a half are a quarter of that: 1 / 4 of x in x / (x + 1).
    assert float(seen[1, deviation].mean()) == pytest.approx(0.25 / 1.25)
    assert float(seen[1, motion].mean()) == pytest.approx(0.7)
    assert float(seen[1, grey].std()) == pytest.approx(0.09, rel=0.05)


def test_the_loss_is_least_for_the_truth() -> None:
    truth = torch.zeros(1, 1, SIDE, SIDE)
    truth[..., 20:60, 20:60] = 1.0
    right, shifted = (truth * 2 - 1) * 9.0, (truth.roll(10, dims=-1) * 2 - 1) * 9.0
    assert loss_of(right, truth) < 0.01
    assert loss_of(shifted, truth) > 10 * loss_of(right, truth)


def test_what_is_drawn_in_a_window_without_an_object_counts_twice() -> None:
    doubtful, nothing = torch.zeros(1, 1, SIDE, SIDE), torch.zeros(1, 1, SIDE, SIDE)
    speck = nothing.clone()
    speck[..., 40:42, 40:42] = 1.0
    # The cross-entropy of an even chance is log 2; the Dice coefficients are nearly alike.
    more = float(loss_of(doubtful, nothing) - loss_of(doubtful, speck))
    assert more == pytest.approx(np.log(2.0), abs=0.01)


def test_a_step_sees_half_as_many_windows_of_shown_footage_as_of_others(
    lessons: Examples, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Examples(np.ones_like(lessons.inputs[:2]), lessons.truth[:2], lessons.ruled[:2])
    seen: list[list[bool]] = []

    def kept(inputs: Tensor, truth: Tensor, random: Generator) -> tuple[Tensor, Tensor]:
        seen.append([bool((each == 1.0).all()) for each in inputs])
        return inputs, truth

    monkeypatch.setattr(training, "augmented", kept)
    next(train(lessons, seed=1, steps=2, batch=4, report_every=2, shown=shown))
    assert seen == [[False] * 4 + [True] * 2] * 2


def test_training_lowers_the_loss_and_beats_the_rules_on_an_unseen_scene(
    lessons: Examples, unseen: Examples
) -> None:
    losses, nets = zip(*train(lessons, seed=1, steps=160, batch=8, report_every=40), strict=True)
    assert losses[-1] < 0.6 * losses[0]
    scores = held_out_scores(nets[-1], unseen)
    assert scores.windows == len(unseen)
    assert scores.j > scores.j_ruled + 0.03


def test_training_is_repeatable(lessons: Examples) -> None:
    (first, net), (second, other) = (next(train(lessons, 5, 2, 4, 2)) for _ in range(2))
    assert first == second
    for one, two in zip(net.state_dict().values(), other.state_dict().values(), strict=True):
        assert torch.equal(one, two)


def test_a_blend_lies_between_two_networks() -> None:
    torch.manual_seed(6)
    one, other = RefineNet(3), RefineNet(3)
    between = blended(one, other, 0.25)
    for name, value in between.state_dict().items():
        expected = 0.25 * one.state_dict()[name] + 0.75 * other.state_dict()[name]
        torch.testing.assert_close(value, expected.to(value.dtype))
    assert between is not other


def test_a_level_more_changes_nothing_until_it_is_trained(tmp_path: Path) -> None:
    torch.manual_seed(3)
    net = RefineNet(len(CHANNELS), WIDTHS[:-1])
    maps = torch.randn(16, len(CHANNELS), SIDE, SIDE)
    with torch.no_grad():
        net.train()(maps)  # its statistics are not those of the start
        deeper = deepened(net, WIDTHS[-1], maps)
        judged = net.eval()(maps)
        torch.testing.assert_close(deeper.eval()(maps), judged, atol=1e-4, rtol=1e-3)
    deeper.train()(maps).mean().backward()
    assert float(deeper.join[-1][0].weight.grad[:, WIDTHS[-2] :].abs().max()) > 0.0
    for each in (net, deeper):
        write_weights(each, tmp_path / "weights.safetensors")
        again = read_weights(tmp_path / "weights.safetensors")
        assert again.widths == each.widths


def test_opencv_gives_what_torch_gives(tmp_path: Path) -> None:
    torch.manual_seed(4)
    net = RefineNet(len(CHANNELS)).eval()
    maps = torch.randn(1, len(CHANNELS), SIDE, SIDE)
    write_onnx(net, tmp_path / "net.onnx")
    assert b".py" not in (tmp_path / "net.onnx").read_bytes()  # no paths of this machine
    run = cv2.dnn.readNetFromONNX(str(tmp_path / "net.onnx"))
    run.setInput(maps.numpy())
    with torch.inference_mode():
        np.testing.assert_allclose(run.forward(), net(maps).numpy(), atol=1e-4)


def test_random_scenes_are_repeatable_and_differ() -> None:
    one, again, other = (random_scene(np.random.default_rng(seed), 9) for seed in (7, 7, 8))
    assert one == again
    assert one != other
    for seed in range(60):
        drawn = random_scene(np.random.default_rng(seed), 9)
        assert drawn.frames == 9
        assert 0 <= len(drawn.objects) <= 4
    frames = [frame for frame, _ in rendered_clip(seed=7, frames=2)]
    assert [frame.image.shape[1] for frame in frames] == [one.width] * 2


def test_the_command_writes_networks_that_run_and_a_record(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(
        train_cli, "rendered_clip", lambda seed, frames: drawn_clip(DrawnScene((seed, 0)))
    )
    out = tmp_path / "out" / "weights"
    command = ["-o", str(out), "--scenes", "2", "--first-scene", "2", "--steps", "4"]
    assert train_cli.main(command) == 0
    assert "held-out J" in capsys.readouterr().out
    assert sorted(path.name for path in out.parent.iterdir()) == ["weights"]
    record = json.loads((out / "training.json").read_text())
    assert record["curve"][-1]["step"] == 4
    assert "--seed 1" in record["command"]
    PretrainedRefiner(out / "refine_net.onnx")
    assert read_weights(out / "refine_net.safetensors").widths == WIDTHS
    assert train_cli.main(command) == 2
    assert "exists already" in capsys.readouterr().err
