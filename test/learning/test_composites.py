"""Composites of footage: nothing of this needs torch."""

from __future__ import annotations

import numpy as np
import pytest

from support.clips import assert_drawn_by_seed
from support.drawn_footage import DrawnFootage
from support.drawn_scene import DrawnScene
from turbseg_ros.learning.composites import Material, composite_clip
from turbseg_ros.learning.examples import Examples, examples_from
from turbseg_ros.learning.shown_clips import shown_clip
from turbseg_ros.learning.window_input import CHANNELS, SIDE
from turbseg_ros.parameters import Parameters

GROUND = DrawnFootage(DrawnScene(None), length=1, has_masks=False)
MOVER = DrawnFootage(DrawnScene((3, 0)))
MATERIAL = Material([GROUND], [MOVER])
FRAMES = 4


def test_the_same_seed_gives_the_same_clip_and_another_seed_another() -> None:
    assert_drawn_by_seed(lambda seed: composite_clip(seed, FRAMES, MATERIAL))


def test_clips_hold_objects_of_all_sizes_and_cameras_of_all_kinds() -> None:
    kinds, covered, labels_seen = set(), [], 0
    for seed in range(16):
        clip = list(composite_clip(seed, 2, MATERIAL))
        assert 1 <= len(clip) <= 2
        for frame, labels in clip:
            image = frame.image
            assert image.shape[:2] == labels.shape
            assert image.shape[1] <= 640
            assert labels.dtype == np.uint16
            kinds.add((image.dtype.name, image.ndim))
            labels_seen = max(labels_seen, int(labels.max()))
        covered.append(float((labels > 0).mean()))
    assert {("uint8", 2), ("uint8", 3), ("uint16", 2)} <= kinds
    assert labels_seen > 1
    assert min(covered) == 0.0
    assert 0.05 < max(covered) < 0.9


def test_what_is_labelled_moves_and_is_what_was_drawn() -> None:
    """A white block in black footage is all that can be white in a composite of it."""

    class Block(DrawnFootage):
        def pictures(self, first: int, count: int) -> list[np.ndarray]:
            masks = self.masks(first, count) or []
            return [np.dstack([mask.astype(np.uint8) * 255] * 3) for mask in masks]

    material = Material([], [Block()])
    overlaps = []
    for seed in range(18):
        for frame, labels in composite_clip(seed, 2, material):
            if frame.image.dtype != np.uint8 or not 0.02 < (labels > 0).mean() < 0.5:
                continue
            values = frame.image.astype(float)
            grey = values if values.ndim == 2 else values.mean(axis=2)
            overlaps.append(abs(np.corrcoef(grey.ravel(), labels.ravel() > 0)[0, 1]))
    assert len(overlaps) > 4
    assert np.median(overlaps) > 0.8


def test_without_objects_drawn_ones_move() -> None:
    covered = [
        (labels > 0).any()
        for seed in range(8)
        for _, labels in composite_clip(seed, 1, Material([GROUND], []))
    ]
    assert any(covered)


def test_of_nothing_nothing_is_made() -> None:
    with pytest.raises(ValueError, match="neither"):
        next(composite_clip(0, FRAMES, Material([], [])))


@pytest.fixture(scope="module")
def windows() -> Examples:
    parameters = Parameters.from_mapping({"resolution.processing": 160, "refine.mode": "none"})
    return examples_from(shown_clip(DrawnFootage(length=20)), parameters, step=2)


def test_windows_are_as_many_as_the_frames_asked_for(windows: Examples) -> None:
    parameters = Parameters.from_mapping({"resolution.processing": 160, "refine.mode": "none"})
    footage = shown_clip(DrawnFootage(length=20))
    all_frames = examples_from(footage, parameters, step=1, ruled=False)
    assert len(all_frames) > 1.5 * len(windows) > 0
    assert not all_frames.ruled.any()
    assert windows.ruled.any()


def test_windows_on_disk_are_the_windows(windows: Examples, tmp_path) -> None:
    stored = Examples.on_disk(iter([windows, windows]), tmp_path)
    assert len(stored) == 2 * len(windows)
    for name in ("inputs", "truth", "ruled"):
        joined = np.concatenate([getattr(windows, name)] * 2)
        np.testing.assert_array_equal(getattr(stored, name), joined)
    assert isinstance(stored.inputs, np.memmap)


def test_no_windows_on_disk_are_none(tmp_path) -> None:
    stored = Examples.on_disk(iter([]), tmp_path)
    assert stored.inputs.shape == (0, len(CHANNELS), SIDE, SIDE)


def test_windows_are_read_as_they_were_written(windows: Examples, tmp_path) -> None:
    windows.save(tmp_path / "clip.npz")
    again = Examples.load(tmp_path / "clip.npz")
    for name in ("inputs", "truth", "ruled"):
        np.testing.assert_array_equal(getattr(again, name), getattr(windows, name))
    assert [path.name for path in tmp_path.iterdir()] == ["clip.npz"]


def test_files_that_hold_no_windows_are_refused(windows: Examples, tmp_path) -> None:
    (tmp_path / "text.npz").write_text("no windows")
    np.savez(tmp_path / "other.npz", inputs=np.zeros(3), truth=np.zeros(3), ruled=np.zeros(3))
    np.savez(tmp_path / "part.npz", inputs=np.zeros(3))
    for name in ("text.npz", "other.npz", "part.npz", "missing.npz"):
        with pytest.raises(ValueError, match=name):
            Examples.load(tmp_path / name)
