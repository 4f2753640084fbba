"""Measures on masks and tracks that are drawn by hand."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from turbseg_ros.evaluation.metrics import (
    IdSwitchCounter,
    ObjectJaccard,
    PixelCounter,
    boundary_f,
    dice,
    false_ids,
    foreground_fraction,
    jaccard,
    object_overlaps,
    true_components,
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


def cdnet_f_measure(frames: Iterable[tuple[np.ndarray, np.ndarray]]) -> float:
    """CDnet's F-measure, from its four counts, pixel by pixel."""
    tp = fp = fn = 0
    for predicted, true in frames:
        for found, is_there in zip(predicted.ravel().tolist(), true.ravel().tolist(), strict=True):
            tp += bool(found and is_there)
            fp += bool(found and not is_there)
            fn += bool(not found and is_there)
    precision, recall = tp / max(tp + fp, 1), tp / max(tp + fn, 1)
    return 2 * precision * recall / max(precision + recall, 1e-12)


@given(hnp.arrays(bool, (3, 2, 5, 6)))
def test_pixel_f_is_that_of_cdnet(frames: np.ndarray) -> None:
    counter = PixelCounter()
    for predicted, true in frames:
        counter.add(predicted, true)
    if not frames[:, 1].any():
        assert counter.f_measure is None
    else:
        assert counter.f_measure == pytest.approx(cdnet_f_measure(frames))


@pytest.mark.parametrize("seed", range(4))
def test_each_object_has_the_mean_iou_and_dice_of_its_frames(seed: int) -> None:
    """As sums over masks, for that pairing of ids which gives the best mean IoU."""
    frames = np.random.default_rng(seed).integers(0, 3, (4, 2, 20, 30))
    counter = ObjectJaccard()
    for predicted, true in frames:
        counter.add(object_overlaps(predicted, true))
    pairings = []
    for partners in ((1, 2), (2, 1)):
        iou, dices = [], []
        for true_id, partner in zip((1, 2), partners, strict=True):
            masks = [(p == partner, t == true_id) for p, t in frames]
            iou.append(np.mean([(p & t).sum() / (p | t).sum() for p, t in masks]))
            dices.append(np.mean([2 * (p & t).sum() / (p.sum() + t.sum()) for p, t in masks]))
        pairings.append((np.mean(iou), iou, dices))
    _, iou, dices = max(pairings)
    assert counter.by_object == pytest.approx(dict(zip((1, 2), iou, strict=True)))
    assert counter.dice_by_object == pytest.approx(dict(zip((1, 2), dices, strict=True)))


def test_foreground_fraction_is_a_share_of_the_image() -> None:
    assert foreground_fraction(square(0, 0, 20)) == pytest.approx(0.04)


def switches(*frames: tuple[np.ndarray, np.ndarray]) -> int | None:
    counter = IdSwitchCounter()
    for prediction, truth in frames:
        counter.add(object_overlaps(prediction, truth))
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


def false_objects(prediction: np.ndarray, truth: np.ndarray) -> int:
    return len(false_ids(object_overlaps(prediction, truth)))


def test_an_object_beside_a_true_one_is_false() -> None:
    truth = square(10, 10, 20)
    stray = square(60, 60, 8, value=2)
    assert false_objects(truth, truth) == 0
    assert false_objects(truth + stray, truth) == 1
    assert false_objects(truth + stray, np.zeros_like(truth)) == 2


def test_a_fragment_and_a_loose_outline_are_not_false() -> None:
    truth = square(10, 10, 20)
    fragment = square(12, 12, 5)
    # Twice as wide and as high: a quarter of it is true, which is an IoU of a quarter.
    loose = square(0, 0, 40)
    assert (false_objects(fragment, truth), false_objects(loose, truth)) == (0, 0)
    # Three times: a ninth.
    assert false_objects(square(0, 0, 60), truth) == 1


def test_in_a_union_each_connected_part_is_a_true_object() -> None:
    small, large = square(5, 5, 6, value=255), square(40, 40, 40, value=255)
    truth = small + large
    # Loose around the small one: an IoU of a quarter with it, next to nothing with the union.
    loose = square(2, 2, 12)
    assert false_objects(loose, truth) == 1
    assert false_objects(loose, true_components(truth)) == 0
    assert sorted(np.unique(true_components(truth))) == [0, 1, 2]


def by_object(*frames: tuple[np.ndarray, np.ndarray]) -> dict[int | str, float] | None:
    scored = ObjectJaccard()
    for prediction, truth in frames:
        scored.add(object_overlaps(prediction, truth))
    return scored.by_object


def test_pixels_stolen_from_a_neighbour_count_though_the_union_is_right() -> None:
    truth = square(10, 10, 20) + square(30, 10, 20, value=2)
    stolen = truth.copy()
    stolen[10:30, 20:30] = 2
    assert jaccard(stolen, truth) == 1.0
    assert by_object((stolen, truth)) == pytest.approx({1: 0.5, 2: 20 / 30})


def test_each_true_object_has_one_label_for_the_whole_sequence() -> None:
    truth = square(10, 10, 20)
    assert by_object((truth * 5, truth), (truth * 5, truth), (truth * 6, truth)) == pytest.approx(
        {1: 2 / 3}
    )
    # One label can't stand for two.
    both = square(10, 10, 20) + square(30, 10, 20, value=2)
    assert by_object(((both != 0).astype(np.uint8), both)) == pytest.approx({1: 0.5, 2: 0.0})


def test_an_object_is_scored_over_the_frames_in_which_it_exists() -> None:
    truth = square(10, 10, 20)
    nothing = np.zeros_like(truth)
    assert by_object((truth, nothing), (truth, truth), (nothing, truth)) == {1: 0.5}


def test_without_objects_to_tell_apart_there_is_no_score_by_object() -> None:
    union = square(10, 10, 20, value=255)
    assert by_object((union, union)) is None
    assert by_object((union, np.zeros_like(union))) is None


@given(seed=st.integers(0, 2**32 - 1))
def test_the_labels_are_assigned_for_the_best_mean(seed: int) -> None:
    random = np.random.default_rng(seed)
    frames = [tuple(random.integers(0, 4, (2, 6, 6))) for _ in range(3)]
    scored = by_object(*frames)
    means = np.zeros((3, 3))
    for true_id, predicted_id in itertools.product(range(1, 4), range(1, 4)):
        there = [(p == predicted_id, t == true_id) for p, t in frames if (t == true_id).any()]
        if there:
            means[true_id - 1, predicted_id - 1] = np.mean([jaccard(p, t) for p, t in there])
    best = max(
        sum(means[row, column] for row, column in enumerate(order))
        for order in itertools.permutations(range(3))
    )
    assert scored is not None
    assert sum(scored.values()) == pytest.approx(best)
