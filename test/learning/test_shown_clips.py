"""Footage shown as it is, and as other cameras might have shown it."""

from __future__ import annotations

import numpy as np

from support.clips import assert_drawn_by_seed
from support.drawn_footage import DrawnFootage
from support.drawn_scene import DrawnScene
from turbseg_ros.learning.shown_clips import shown_clip, varied_clip

MOVER = DrawnFootage(DrawnScene((3, 0)))


class Block(DrawnFootage):
    """A white block before black: all that can be white, or black once it is inverted."""

    def pictures(self, first: int, count: int) -> list[np.ndarray]:
        masks = self.masks(first, count) or []
        return [np.dstack([mask.astype(np.uint8) * 255] * 3) for mask in masks]


def test_a_footage_is_shown_as_it_is_with_its_truth() -> None:
    clip = list(shown_clip(MOVER))
    assert len(clip) == MOVER.length
    for number, (frame, labels) in enumerate(clip):
        np.testing.assert_array_equal(labels > 0, MOVER.scene.truth(number))
        np.testing.assert_array_equal(frame.image, MOVER.pictures(number, 1)[0])


def test_a_long_footage_is_read_in_parts_and_all_of_it_is_shown() -> None:
    long = DrawnFootage(DrawnScene((1, 0)), length=40)
    shown = list(shown_clip(long))
    assert len(shown) == 40
    np.testing.assert_array_equal(shown[-1][0].image, long.pictures(39, 1)[0])
    assert all(np.diff([frame.stamp for frame, _ in shown]) > 0)


def test_a_footage_is_shown_no_wider_than_asked_for() -> None:
    frame, labels = next(shown_clip(MOVER, 80))
    assert frame.image.shape[1] == labels.shape[1] == 80


def test_the_same_seed_gives_the_same_clip_and_another_seed_another() -> None:
    assert_drawn_by_seed(lambda seed: varied_clip(seed, MOVER))


def test_clips_are_seen_by_cameras_of_all_kinds() -> None:
    shapes, kinds, directions = set(), set(), set()
    for seed in range(16):
        clip = list(varied_clip(seed, MOVER))
        assert len(clip) == MOVER.length
        for frame, labels in clip:
            assert frame.image.dtype == np.uint8
            assert frame.image.shape[:2] == labels.shape
            assert max(frame.image.shape[:2]) <= max(MOVER.pictures(0, 1)[0].shape)
        shapes.add(clip[0][1].shape)
        kinds.add(clip[0][0].image.ndim)
        columns = [np.nonzero(labels)[1].mean() for _, labels in clip if labels.any()]
        if len(columns) > 1:
            directions.add(columns[-1] > columns[0])
    assert len(shapes) > 8
    assert kinds == {2, 3}
    assert directions == {True, False}


def test_what_is_labelled_is_where_it_is_seen() -> None:
    agreement = []
    for seed in range(12):
        for frame, labels in varied_clip(seed, Block()):
            values = frame.image.astype(float)
            grey = values if values.ndim == 2 else values.mean(axis=2)
            if 0.01 < (labels > 0).mean() < 0.9:
                agreement.append(abs(np.corrcoef(grey.ravel(), labels.ravel() > 0)[0, 1]))
    assert len(agreement) > 40
    assert np.median(agreement) > 0.85
