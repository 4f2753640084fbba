"""The network that comes with the package, run by OpenCV alone."""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.drawn_scene import DrawnScene, jaccard, scene_behind, texture
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.learning.pretrained import SHIPPED, PretrainedRefiner
from turbseg_ros.learning.torch_import import NetworkError
from turbseg_ros.learning.window_input import CHANNELS, SIDE, window_input
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.background import AlignedFrame
from turbseg_ros.segmentation.cropped_mask import Box
from turbseg_ros.segmentation.foreground import AreaMasks, ObjectCrop
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

SCENE = DrawnScene()
# What the views of the ground differ by, in grey values.
GRAIN = (-4, -2, 0, 2, 4)
PARAMETERS = Parameters.from_mapping({"resolution.processing": 160, "refine.mode": "pretrained"})


def window(shape: tuple[int, int], channels: int = 1, seed: int = 0) -> ObjectCrop:
    """A dark block, half as wide and high as the window, moves over textured ground."""
    height, width = shape
    ground = np.dstack([texture(shape, seed + c, low=90, high=190) for c in range(channels)])
    block = np.zeros(shape, bool)
    block[height // 4 : -(height // 4), width // 4 : -(width // 4)] = True
    image = ground.copy()
    image[block] = 20
    views = [view_of((ground.astype(int) + offset).astype(np.uint8)) for offset in GRAIN]
    motion = cv2.GaussianBlur(block.astype(np.float32), (0, 0), 4.0) * 20.0
    area = AreaMasks(motion > 2.0, motion > 12.0, motion > 18.0, np.ones_like(motion, bool))
    return ObjectCrop(Box(0, 0, width, height), image, views, area, motion, 0.1)


def view_of(ground: np.ndarray) -> AlignedFrame:
    return AlignedFrame(scene_behind(ground, np.zeros(ground.shape[:2], bool)), np.eye(3))


def block_of(shape: tuple[int, int]) -> np.ndarray:
    return window(shape).image[..., 0] == 20


def segmented() -> list[SegmentationResult]:
    segmenter = motion_segmenter(PARAMETERS)
    frames = [Frame(number, image) for number, image in enumerate(SCENE.images(24))]
    return [result for frame in frames for result in segmenter.push(frame)] + segmenter.flush()


@pytest.mark.parametrize("shape", [(20, 24), (40, 200), (300, 260)])
@pytest.mark.parametrize("channels", [1, 3])
def test_an_input_has_one_size_and_range_whatever_the_window(
    shape: tuple[int, int], channels: int
) -> None:
    maps = window_input(window(shape, channels))
    assert (maps.shape, maps.dtype) == ((len(CHANNELS), SIDE, SIDE), np.float32)
    assert np.abs(maps).max() < 3.0


def test_the_input_tells_how_large_a_window_was() -> None:
    width, height = window_input(window((SIDE * 2, SIDE // 2)))[-2:]
    np.testing.assert_allclose(width, -1 / 3, rtol=1e-6)
    np.testing.assert_allclose(height, 1 / 3, rtol=1e-6)


def test_most_of_what_moves_moves_no_more_than_is_usual() -> None:
    maps = dict(zip(CHANNELS, window_input(window((SIDE, SIDE))), strict=True))
    share = maps["share"][maps["moving"] > 0.5]
    assert np.mean(share <= 1.0) == pytest.approx(0.85, abs=0.01)
    assert share.max() <= 1.5


def test_the_input_does_not_depend_on_exposure_or_gain() -> None:
    bright = window((60, 80))
    views = [view_of(view.scene.image[..., :-1] // 2 + 10) for view in bright.views]
    dark = replace(bright, image=bright.image // 2 + 10, views=views)
    change = np.abs(window_input(dark) - window_input(bright)).mean(axis=(1, 2))
    # Deviations only approach that, for no noise is taken to be lower than a camera's.
    assert np.delete(change, CHANNELS.index("deviation")).max() < 0.02


def test_nothing_is_told_of_a_background_that_is_unknown() -> None:
    known = window((60, 80))
    everywhere = np.ones((60, 80), bool)
    hidden = [AlignedFrame(scene_behind(known.image, everywhere), np.eye(3))] * len(known.views)
    maps = window_input(replace(known, views=hidden))
    assert np.isfinite(maps).all()
    for name in ("change", "deviation", "difference", "known"):
        assert not maps[CHANNELS.index(name)].any()


@pytest.mark.parametrize("shape", [(24, 32), (60, 80), (300, 400)])
def test_the_shipped_network_tells_an_object_from_its_background(shape: tuple[int, int]) -> None:
    (probability,) = PretrainedRefiner().refine([window(shape)])
    assert probability.shape == shape
    assert jaccard(probability > 0.5, block_of(shape)) > 0.7


def test_results_are_the_same_in_every_run_and_thread() -> None:
    windows = [window((60, 80), seed=seed) for seed in range(4)]
    once = PretrainedRefiner().refine(windows)
    refiners = [PretrainedRefiner() for _ in range(3)]
    with ThreadPoolExecutor(3) as executor:
        runs = list(executor.map(lambda refiner: refiner.refine(windows), refiners))
    for run in runs:
        for one, other in zip(once, run, strict=True):
            np.testing.assert_array_equal(one, other)


def test_the_method_outlines_objects_with_it() -> None:
    results = segmented()
    overlap = [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(results)]
    assert np.mean(overlap[4:]) > 0.7
    assert {found.id for result in results for found in result.objects} == {1}


def test_the_shipped_network_is_small_and_its_making_recorded() -> None:
    assert SHIPPED.stat().st_size < 3_000_000
    record = json.loads((SHIPPED.parent / "training.json").read_text())
    assert record["held_out"]["j"] > record["held_out"]["j_ruled"]
    trainings = record["before"]
    assert all(training.get("command", training.get("by")) for training in trainings)
    made = {training["gives"] for training in trainings}
    assert {name.removesuffix(", deepened") for name in record["blend"]["of"]} <= made
    for curve in (training["curve"] for training in trainings if "curve" in training):
        assert curve[-1]["loss"] < curve[0]["loss"]


def test_files_that_are_no_such_network_are_refused_in_one_line(tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt.onnx"
    spoilt.write_bytes(SHIPPED.read_bytes()[:20_000])
    text = tmp_path / "text.onnx"
    text.write_text("no network")
    for path in (tmp_path / "missing.onnx", spoilt, text, tmp_path):
        with pytest.raises(NetworkError) as refusal:
            PretrainedRefiner(path)
        assert str(path) in str(refusal.value)
        assert "\n" not in str(refusal.value)


def test_it_needs_no_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = None; "
        "from turbseg_ros.factory import motion_segmenter; "
        "from turbseg_ros.parameters import Parameters; "
        "motion_segmenter(Parameters.from_mapping({'refine.mode': 'pretrained'}))"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
