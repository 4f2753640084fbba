"""Folders and bags as footage for composites."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from support.drawn_bag import write_drawn_bag
from turbseg_ros.cli.bag_footage import backgrounds_in, objects_in
from turbseg_ros.cli.errors import UsageError

SHAPE = (24, 32)


def numbered(folder: Path, count: int) -> None:
    """Frames that say by their grey value which they are."""
    folder.mkdir(parents=True)
    for number in range(count):
        cv2.imwrite(str(folder / f"{number:03}.png"), np.full(SHAPE, 10 + number, np.uint8))


def masked(folder: Path, count: int) -> None:
    """Masks whose first so many columns are white."""
    folder.mkdir(parents=True)
    for number in range(count):
        mask = np.zeros(SHAPE, np.uint8)
        mask[:, : number + 1] = 255
        cv2.imwrite(str(folder / f"{number:03}.png"), mask)


def test_backgrounds_are_pictures_and_sequences_each_by_itself(tmp_path: Path) -> None:
    numbered(tmp_path / "walk", 3)
    cv2.imwrite(str(tmp_path / "deep.png"), np.full(SHAPE, 40_000, np.uint16))
    (tmp_path / "about.txt").write_text("no picture")
    deep, walk = backgrounds_in(tmp_path)
    assert (deep.length, walk.length) == (1, 3)
    (picture,) = deep.pictures(0, 1)
    assert (picture.shape, picture.dtype) == ((*SHAPE, 3), np.uint8)
    assert [each[0, 0].tolist() for each in walk.pictures(1, 2)] == [[11] * 3, [12] * 3]
    assert walk.masks(0, 2) is None


def test_objects_come_with_the_masks_of_their_frames(tmp_path: Path) -> None:
    numbered(tmp_path / "dog" / "frames", 4)
    masked(tmp_path / "dog" / "masks", 4)
    (dog,) = objects_in(tmp_path)
    masks = dog.masks(2, 2)
    assert masks is not None
    assert [int(mask[0].sum()) for mask in masks] == [3, 4]


def test_trees_as_in_davis_are_read(tmp_path: Path) -> None:
    numbered(tmp_path / "JPEGImages" / "480p" / "dog", 2)
    masked(tmp_path / "Annotations" / "480p" / "dog", 2)
    (dog,) = objects_in(tmp_path / "JPEGImages" / "480p")
    assert dog.masks(0, 1) is not None


def test_large_pictures_are_shrunk(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((1200, 3200, 3), np.uint8))
    (picture,) = backgrounds_in(tmp_path)[0].pictures(0, 1)
    assert picture.shape == (600, 1600, 3)


def test_folders_that_hold_nothing_of_use_are_refused(tmp_path: Path) -> None:
    for make in (backgrounds_in, objects_in):
        with pytest.raises(UsageError, match="no such folder"):
            make(tmp_path / "missing")
        with pytest.raises(UsageError, match="holds no pictures"):
            make(tmp_path)
    numbered(tmp_path / "walk", 3)
    with pytest.raises(UsageError, match="no masks"):
        objects_in(tmp_path)


def test_bags_are_read_with_their_truth(tmp_path: Path) -> None:
    write_drawn_bag(tmp_path / "drive", [number * 33_000_000 for number in range(1, 5)])
    (drive,) = objects_in(tmp_path)
    assert drive.length == 4
    masks, pictures = drive.masks(1, 2), drive.pictures(1, 2)
    assert masks is not None
    assert len(masks) == len(pictures) == 2
    for mask, picture in zip(masks, pictures, strict=True):
        assert picture.shape == (*mask.shape, 3)
        assert mask.any()
        assert not mask.all()
