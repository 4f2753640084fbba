"""How sure objects are."""

from __future__ import annotations

import pytest

from turbseg_ros.segmentation.certainty import certainty


def test_what_keeps_its_shape_is_surer() -> None:
    scores = [certainty(ious) for ious in ([0.9, 0.9], [0.9, 0.5], [0.9, 0.1, 0.9])]
    assert scores == sorted(scores, reverse=True)
    assert 0.99 < scores[0] < 1.0


@pytest.mark.parametrize("ious", [[], [0.0], [1.0], [1.0] * 12])
def test_it_is_a_probability(ious: list[float]) -> None:
    assert 0.5 < certainty(ious) < 1.0
