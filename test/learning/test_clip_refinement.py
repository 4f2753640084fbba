"""Refine-Net fitted to a clip: warps, groups, losses, and a whole drawn clip."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.drawn_scene import DrawnScene, jaccard
from turbseg_ros.factory import clip_segmenter, motion_segmenter
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

torch: Any = pytest.importorskip("torch", reason="torch is not installed: make test-learning")
Tensor = Any

from turbseg_ros.learning.clip_refinement import (  # noqa: E402
    Clip,
    consistent_target,
    redrawn,
    refined_masks,
    regrouped,
    warp,
)

# Training takes a minute on an idle machine, and many on a busy one.
pytestmark = [pytest.mark.usefixtures("one_torch_thread"), pytest.mark.timeout(900)]

SCENE = DrawnScene((3, 1), (20, 20), side=30)
NEIGHBOURS = (-2, -1, 1, 2)
SCENE_IMAGES = list(SCENE.images(14))
# Grown regions as masks, as in the paper.
COARSE = {"resolution.processing": 160, "outline.method": "none"}


def squares(count: int) -> np.ndarray:
    return np.stack([SCENE.truth(t) for t in range(count)])[:, None].astype(np.float32)


def true_flows(masks: np.ndarray) -> dict[int, Tensor]:
    """F(t+g→t) of the square; the ground is at rest."""
    flows = {}
    for g in NEIGHBOURS:
        flow = np.zeros((len(masks), *masks.shape[2:], 2), np.float32)
        for t in range(len(masks)):
            if 0 <= t + g < len(masks):
                flow[t][masks[t + g, 0] > 0] = (-3 * g, -1 * g)
        flows[g] = torch.from_numpy(flow)
    return flows


@pytest.mark.parametrize("g", NEIGHBOURS)
def test_a_mask_is_warped_to_where_the_object_is_in_the_other_frame(g: int) -> None:
    masks = squares(6)
    flows = true_flows(masks)
    warped = warp(torch.from_numpy(masks[2:3]), flows[g][2:3])
    inside = masks[2 + g, 0] > 0
    np.testing.assert_allclose(warped[0, 0].numpy()[inside], 1.0, atol=1e-4)


def test_the_one_target_stands_for_the_sum_of_all_losses() -> None:
    generator = torch.Generator().manual_seed(1)
    coarse, masks, alpha = (torch.rand(5, 1, 16, 24, generator=generator) for _ in range(3))
    flows = {g: 3.0 * torch.randn(5, 16, 24, 2, generator=generator) for g in NEIGHBOURS}
    t, gamma = 2, 0.1
    entropy = torch.nn.functional.binary_cross_entropy
    losses = entropy(alpha[[t]], coarse[[t]])
    for g in NEIGHBOURS:
        for source in (coarse, masks):
            seen = warp(source[[t - g]], flows[g][[t - g]])
            losses = losses + gamma * entropy(alpha[[t]], seen)
    target = consistent_target(coarse, masks, flows)[[t]]
    weights = 1.0 + 2.0 * len(NEIGHBOURS) * gamma
    torch.testing.assert_close(weights * entropy(alpha[[t]], target), losses)


def test_a_mask_that_flickers_is_drawn_towards_its_neighbours() -> None:
    masks = squares(6)
    flows = true_flows(masks)
    steady = torch.from_numpy(masks)
    inside = masks[3, 0] > 0
    assert consistent_target(steady, steady, flows)[3, 0].numpy()[inside].min() > 0.99
    flickering = steady.clone()
    flickering[3] = 0.0
    drawn = consistent_target(flickering, steady, flows)[3, 0].numpy()
    assert 0.2 < drawn[inside].min() < 0.6
    assert drawn[~inside].mean() < 0.05


def test_what_moves_goes_to_the_nearest_object_and_what_touches_none_is_left_out() -> None:
    labels = np.zeros((40, 80), np.uint16)
    labels[10:20, 10:20], labels[10:20, 40:50] = 7, 9
    objects = tuple(
        MovingObject(k, 0, (0.0, 0.0), (1.0, 0.0), 1, (0, 0, 1, 1), ((3.0, 4.0),)) for k in (7, 9)
    )
    frame = Frame(1, np.zeros((40, 80), np.uint8))
    result = SegmentationResult(frame, labels, objects, np.zeros((20, 40), np.float32), 0.1, "")
    probability = np.zeros((40, 80), np.float32)
    probability[8:22, 8:52] = 0.9
    probability[30:34, 60:70] = 0.9
    drawn = redrawn(result, probability)
    assert set(np.unique(drawn.labels)) == {0, 7, 9}
    np.testing.assert_array_equal(
        drawn.labels > 0, np.where(np.arange(40) < 22, 1, 0)[:, None] * (probability > 0.5) > 0
    )
    assert (drawn.labels[8:22, 8:29] == 7).all()
    assert (drawn.labels[8:22, 31:52] == 9).all()
    assert [found.trail for found in drawn.objects] == [((3.0, 4.0),)] * 2
    gone = redrawn(result, np.where(np.arange(80) < 30, probability, 0.0).astype(np.float32))
    assert [found.id for found in gone.objects] == [7]


def test_grouping_closes_gaps_and_drops_what_flickers() -> None:
    masks = squares(6)
    flows = true_flows(masks)
    broken = masks.copy()
    broken[3, 0, 34:38, 34:44] = 0.0
    broken[3, 0, 80:84, 140:150] = 1.0
    assert (masks[3, 0, 34:38, 34:44] == 1.0).all()
    grouped = regrouped(torch.from_numpy(broken), flows).numpy()
    assert set(np.unique(grouped)) <= {0.0, 1.0}
    assert jaccard(grouped[3, 0] > 0, masks[3, 0] > 0) > 0.9
    assert not regrouped(torch.zeros(3, 1, 16, 16), true_flows(np.zeros((3, 1, 16, 16)))).any()


def test_fitting_smooths_coarse_masks_and_is_repeatable() -> None:
    near = (slice(None), slice(None), slice(8, 72), slice(8, 88))
    truth = squares(10)[near]
    random = np.random.default_rng(1)
    coarse = np.where(random.random(truth.shape) < 0.15, 1.0 - truth, truth).astype(np.float32)
    images = np.stack(SCENE_IMAGES[:10])[:, None][near] / 64.0 - 2.0
    inputs = np.concatenate([images, truth * 0.8], axis=1).astype(np.float32)
    clip = Clip(torch.from_numpy(inputs), torch.from_numpy(coarse), true_flows(truth))
    seen: list[int] = []
    masks = refined_masks(clip, 15, True, lambda epochs: (seen.append(e) or e for e in epochs))
    assert seen == list(range(25))
    assert jaccard(masks > 0.5, truth > 0) > jaccard(coarse > 0.5, truth > 0) + 0.2
    np.testing.assert_array_equal(
        refined_masks(clip, 2, False), refined_masks(clip, 2, grouping=False)
    )


def segmented(mode: str) -> list[SegmentationResult]:
    parameters = Parameters.from_mapping(
        {**COARSE, "refine.mode": mode, "refine.epochs": 12, "refine.grouping": False}
    )
    segmenter = clip_segmenter(parameters)
    frames = [Frame(number, image) for number, image in enumerate(SCENE_IMAGES)]
    results = [result for frame in frames for result in segmenter.push(frame)]
    return [*results, *segmenter.flush()]


def test_a_clip_is_refined_with_its_ids_and_frames() -> None:
    coarse, refined = segmented("none"), segmented("optimise")
    assert [r.frame.stamp for r in refined] == [r.frame.stamp for r in coarse]
    assert {f.id for r in refined for f in r.objects} == {f.id for r in coarse for f in r.objects}
    for result in refined:
        assert {found.id for found in result.objects} == set(np.unique(result.labels)) - {0}
        for found in result.objects:
            y, x = np.nonzero(result.labels == found.id)
            assert found.area == len(x)
            np.testing.assert_allclose(found.centroid, (x.mean(), y.mean()), atol=1e-6)
    assert any((a.labels != b.labels).any() for a, b in zip(coarse, refined, strict=True))


def test_a_clip_without_objects_stays_as_it_is() -> None:
    segmenter = clip_segmenter(Parameters.from_mapping({**COARSE, "refine.mode": "optimise"}))
    still = DrawnScene(velocity=None)
    for number, image in enumerate(still.images(8)):
        segmenter.push(Frame(number, image))
    results = segmenter.flush()
    assert len(results) == 8
    assert not any(result.labels.any() for result in results)


def test_the_live_method_refuses_what_needs_the_whole_clip() -> None:
    with pytest.raises(ParameterError, match="needs the whole clip"):
        motion_segmenter(Parameters.from_mapping({"refine.mode": "optimise"}))
