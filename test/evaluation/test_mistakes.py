"""What is wrong in a frame: where, how much, and in which words."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.evaluation.mistakes import mistakes_in_boxes, mistakes_in_masks
from turbseg_ros.messages.detections import IGNORED, Box, Detection


def labels(*places: tuple[slice, slice]) -> np.ndarray:
    """Labels of 40x60 pixels with an object at each place."""
    image = np.zeros((40, 60), np.uint16)
    for number, place in enumerate(places, start=1):
        image[place] = number
    return image


def box(*numbers: float, kind: str = "") -> Detection:
    left, top, width, height = numbers
    box_: Box = (left, top, width, height)
    return Detection(box_, "1", kind)


LEFT, RIGHT = np.s_[10:20, 5:15], np.s_[10:20, 40:50]


def test_pixels_are_missed_or_false_or_neither() -> None:
    wrong = mistakes_in_masks(labels(np.s_[10:20, 0:10]), labels(LEFT))
    assert np.array_equal(wrong.missed, labels(np.s_[10:20, 10:15]) != 0)
    assert np.array_equal(wrong.false, labels(np.s_[10:20, 0:5]) != 0)
    assert wrong.quality == pytest.approx(50 / 150)
    assert wrong.verdict == "J 0.33"
    assert len(wrong.outlines) == 1 and not wrong.boxes


def test_what_is_to_be_ignored_is_neither_missed_nor_false() -> None:
    wrong = mistakes_in_masks(labels(LEFT), labels(RIGHT), labels(np.s_[:, :]))
    assert not wrong.anywhere.any()
    assert wrong.quality == 1.0


def test_a_box_is_missed_where_nothing_touches_it_and_what_touches_none_is_false() -> None:
    true = [box(5, 10, 10, 10), box(20, 30, 4, 4), box(50.0, -3.0, 20.0, 6.0)]
    wrong = mistakes_in_boxes(labels(LEFT, RIGHT), true)
    expected = labels(np.s_[30:34, 20:24], np.s_[0:3, 50:60])
    assert np.array_equal(wrong.missed, expected != 0)
    assert np.array_equal(wrong.false, labels(RIGHT) != 0)
    assert wrong.quality == pytest.approx(1 / 4)
    assert wrong.verdict == "1 of 3 boxes hit, 1 false"
    assert wrong.boxes == tuple(each.box for each in true)


def test_boxes_to_be_ignored_are_not_drawn_and_what_lies_in_them_is_not_false() -> None:
    wrong = mistakes_in_boxes(labels(LEFT), [box(0, 0, 30, 30, kind=IGNORED)])
    assert (wrong.boxes, wrong.quality, wrong.verdict) == ((), 1.0, "nothing there")
    assert not wrong.anywhere.any()
    alarm = mistakes_in_boxes(labels(RIGHT), [])
    assert (alarm.quality, alarm.verdict) == (0.0, "nothing there, 1 false")
