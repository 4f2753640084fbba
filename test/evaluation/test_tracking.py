"""MOTA, IDF1 and HOTA, held against the figures of TrackEval 1.3.0 on the same scenes."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.evaluation.tracking import TrackingScorer

# What its CLEAR, Identity and HOTA (mean over alpha) gave for `scene(seed)`.
TRACKEVAL = {
    0: (0.08196721311475409, 0.5681818181818182, 0.4345459002101719),
    1: (-0.0390625, 0.49070631970260226, 0.3706215155434429),
    2: (0.08, 0.5405405405405406, 0.4096919677885703),
    3: (0.07936507936507936, 0.5724907063197026, 0.4659008440445205),
    4: (0.034482758620689655, 0.6015625, 0.4600271661978074),
    5: (0.09375, 0.5777777777777777, 0.4439256330257959),
}


def scene(seed: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Objects that come and go, found well or badly, under ids that are mostly theirs."""
    random = np.random.default_rng(seed)
    frames = []
    for _ in range(40):
        true = np.flatnonzero(random.random(4) < 0.8)
        predicted = np.flatnonzero(random.random(5) < 0.7)
        iou = random.random((true.size, predicted.size)) ** 2
        iou[(true[:, None] == predicted) & (random.random(iou.shape) < 0.8)] = 0.9
        frames.append((true, predicted, np.round(iou, 2)))
    return frames


@pytest.mark.parametrize(("seed", "expected"), TRACKEVAL.items())
def test_scores_are_those_of_the_benchmarks_own_code(
    seed: int, expected: tuple[float, float, float]
) -> None:
    scorer = TrackingScorer()
    for true, predicted, iou in scene(seed):
        scorer.add(true.tolist(), predicted.tolist(), iou)
    scores = scorer.scores()
    assert scores is not None
    assert (scores.mota, scores.idf1, scores.hota) == pytest.approx(expected, abs=1e-12)


def test_a_perfect_tracker_scores_one() -> None:
    scorer = TrackingScorer()
    for _ in range(3):
        scorer.add(["a", "b"], [7, 9], np.eye(2))
    scores = scorer.scores()
    assert scores is not None
    assert (scores.mota, scores.idf1, scores.hota) == pytest.approx((1.0, 1.0, 1.0))


def test_a_blind_one_scores_nothing() -> None:
    scorer = TrackingScorer()
    scorer.add(["a"], [], np.zeros((1, 0)))
    scores = scorer.scores()
    assert scores is not None
    assert (scores.mota, scores.idf1, scores.hota) == (0.0, 0.0, 0.0)


def test_without_true_objects_there_are_no_scores() -> None:
    scorer = TrackingScorer()
    scorer.add([], [3], np.zeros((0, 1)))
    assert scorer.scores() is None
