"""Measures on masks and tracks that are drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from turbseg_ros.evaluation.metrics import (
    IdSwitchCounter,
    boundary_f,
    dice,
    foreground_fraction,
    jaccard,
)

MASKS = hnp.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30)))


def square(left: int, top: int, side: int, value: int = 1, size: int = 100) -> np.ndarray:
    labels = np.zeros((size, size), np.uint16)
    labels[top : top + side, left : left + side] = value
    return labels


def test_overlap_of_shifted_squares_is_as_counted() -> None:
    # Two 20x20 squares that share 10x20 pixels.
    truth, prediction = square(10, 10, 20), square(20, 10, 20)
    assert jaccard(prediction, truth) == pytest.approx(200 / 600)
    assert dice(prediction, truth) == pytest.approx(400 / 800)


def test_all_objects_count_as_one_foreground() -> None:
    truth = square(10, 10, 20) + square(50, 50, 20, value=2)
    prediction = square(10, 10, 20, value=7)
    assert jaccard(prediction, truth) == pytest.approx(0.5)


def test_masks_without_common_pixels_score_nothing() -> None:
    truth, prediction = square(10, 10, 20), square(60, 60, 20)
    assert jaccard(prediction, truth) == dice(prediction, truth) == 0.0
    assert boundary_f(prediction, truth) == 0.0


def test_empty_masks_agree_and_disagree_with_all_others() -> None:
    empty, full = np.zeros((40, 40), np.uint8), square(10, 10, 10, size=40)
    for measure in (jaccard, dice, boundary_f):
        assert measure(empty, empty) == 1.0
        assert measure(full, empty) == 0.0
        assert measure(empty, full) == 0.0


@given(mask=MASKS)
def test_a_mask_agrees_with_itself(mask: np.ndarray) -> None:
    assert jaccard(mask, mask) == dice(mask, mask) == boundary_f(mask, mask) == 1.0


@given(mask=MASKS, data=st.data())
def test_dice_follows_from_jaccard(mask: np.ndarray, data: st.DataObject) -> None:
    other = data.draw(hnp.arrays(np.bool_, mask.shape))
    j = jaccard(mask, other)
    assert dice(mask, other) == pytest.approx(2 * j / (1 + j))


def test_boundary_within_the_tolerance_is_right() -> None:
    # The diagonal of 100x100 is 141.4 px: 0.008 of it, rounded up, are 2 px.
    truth = square(30, 30, 30)
    assert boundary_f(square(32, 30, 30), truth) == 1.0
    assert 0.3 < boundary_f(square(33, 30, 30), truth) < 1.0


def test_boundary_of_a_square_too_large_all_round_is_wrong() -> None:
    assert boundary_f(square(20, 20, 50), square(30, 30, 30)) == 0.0


def reference_boundary_f(prediction: np.ndarray, truth: np.ndarray, tolerance: float) -> float:
    """The DAVIS 2016 definition by plain dilations of the whole image."""

    def boundary(mask: np.ndarray) -> np.ndarray:
        found = np.zeros_like(mask)
        for y, x in np.ndindex(mask.shape):
            corner = mask[y : y + 2, x : x + 2]
            found[y, x] = corner.any() != corner.all()
        return found

    radius = int(np.ceil(tolerance * np.linalg.norm(truth.shape)))
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disk = x**2 + y**2 <= radius**2
    predicted, true = boundary(prediction), boundary(truth)
    if not predicted.any() or not true.any():
        return float(predicted.any() == true.any())
    precision = (predicted & ndimage.binary_dilation(true, disk)).sum() / predicted.sum()
    recall = (true & ndimage.binary_dilation(predicted, disk)).sum() / true.sum()
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


@settings(max_examples=60, deadline=None)
@given(mask=MASKS, data=st.data(), tolerance=st.sampled_from([0.008, 0.05, 0.15]))
def test_boundary_f_is_that_of_davis(
    mask: np.ndarray, data: st.DataObject, tolerance: float
) -> None:
    other = data.draw(hnp.arrays(np.bool_, mask.shape))
    expected = reference_boundary_f(mask, other, tolerance)
    assert boundary_f(mask, other, tolerance) == pytest.approx(expected)


def test_foreground_fraction_is_a_share_of_the_image() -> None:
    assert foreground_fraction(square(0, 0, 20)) == pytest.approx(0.04)


def switches(*frames: tuple[np.ndarray, np.ndarray]) -> int | None:
    counter = IdSwitchCounter()
    for prediction, truth in frames:
        counter.add(prediction, truth)
    return counter.switches


def test_a_kept_id_is_no_switch() -> None:
    frames = [(square(x, 10, 20, value=5), square(x + 3, 10, 20)) for x in range(0, 60, 4)]
    assert switches(*frames) == 0


def test_a_new_id_after_a_gap_is_one_switch() -> None:
    truth = square(10, 10, 20)
    lost = np.zeros_like(truth)
    assert switches((truth * 5, truth), (lost, truth), (truth * 6, truth), (truth * 6, truth)) == 1


def test_exchanged_ids_are_two_switches() -> None:
    left, right = square(10, 10, 20), square(60, 10, 20)
    truth = left + 2 * right
    assert switches((3 * left + 4 * right, truth), (4 * left + 3 * right, truth)) == 2


def test_an_object_keeps_its_partner_while_it_fits() -> None:
    truth = square(10, 10, 20)
    before = truth * 3
    # Most of the object gets the id 4 now, but id 3 still overlaps enough.
    after = truth * 4
    after[10:30, 10:18] = 3
    assert switches((before, truth), (after, truth)) == 0


def test_a_stray_prediction_is_no_partner() -> None:
    truth = square(10, 10, 20)
    assert switches((truth * 3, truth), (square(28, 28, 20, value=9), truth)) == 0


def test_union_truth_leaves_switches_unknown() -> None:
    truth = square(10, 10, 20, value=255).astype(np.uint8)
    assert switches((square(10, 10, 20, value=3), truth)) is None
