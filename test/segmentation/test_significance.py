"""How far chance takes what isn't there: simulated, and compared with what is asked."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.segmentation.significance import chance_per_test, jitter, significant_displacement

EVERY = 4


@pytest.mark.parametrize(("spread", "clutter"), [(0.3, 0.0), (1.0, 0.0), (0.3, 0.2), (1.0, 0.5)])
@pytest.mark.parametrize("frames", [8, 40])
@pytest.mark.parametrize("chance", [0.1, 0.001])
def test_shimmer_goes_further_as_seldom_as_asked(
    spread: float, clutter: float, frames: int, chance: float
) -> None:
    rng = np.random.default_rng(1)
    count = 200_000
    ends = rng.normal(0.0, spread, (2, count, 2))
    steps = rng.normal(0.0, clutter / np.sqrt(2), (frames // EVERY, count, 2)) * EVERY
    displacements = np.linalg.norm(ends[1] - ends[0] + steps.sum(axis=0), axis=1)
    wanted = significant_displacement(spread, clutter, frames, EVERY, chance)
    assert np.mean(displacements > wanted) == pytest.approx(chance, rel=0.25)


def test_an_hour_of_shimmer_gives_about_as_many_alarms_as_allowed() -> None:
    rng = np.random.default_rng(2)
    per_hour, hours, tracks = 20.0, 40, 3
    chance = chance_per_test(per_hour, EVERY, tracks)
    tests = int(hours * 3600 * 30 / EVERY) * tracks
    displacements = np.linalg.norm(
        rng.normal(0.0, 0.5, (tests, 2)) - rng.normal(0.0, 0.5, (tests, 2)), axis=1
    )
    alarms = np.count_nonzero(displacements > significant_displacement(0.5, 0.0, 8, EVERY, chance))
    assert alarms / hours == pytest.approx(per_hour, rel=0.15)


def test_more_must_be_travelled_where_the_place_is_cluttered_and_for_fewer_false_alarms() -> None:
    calm = significant_displacement(0.3, 0.0, 8, EVERY, 1e-4)
    assert significant_displacement(0.3, 0.3, 8, EVERY, 1e-4) > 1.5 * calm
    assert significant_displacement(0.3, 0.0, 8, EVERY, 1e-6) > 1.1 * calm


def test_every_way_is_significant_where_any_number_of_false_alarms_is_allowed() -> None:
    assert significant_displacement(0.3, 0.3, 8, EVERY, chance_per_test(1e6, EVERY, 1)) == 0.0


@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_jitter_is_measured_against_a_steady_way(spread: float) -> None:
    rng = np.random.default_rng(3)
    found = [
        jitter(list(np.arange(30)[:, None] * [1.5, -0.7] + rng.normal(0.0, spread, (30, 2))), 0.0)
        for _ in range(200)
    ]
    assert np.median(found) == pytest.approx(spread, rel=0.2)


def test_a_steady_way_has_no_more_jitter_than_is_usual() -> None:
    places = list(np.arange(60)[:, None] * np.array([2.0, 1.0]))
    assert jitter(places, 0.5) < 0.2


def test_few_places_have_the_usual_jitter() -> None:
    assert jitter([np.zeros(2), np.ones(2)], 0.8) == pytest.approx(0.8)


def test_an_outline_that_is_mended_once_is_no_jitter() -> None:
    places = [np.array([2.0 * k, 0.0]) for k in range(20)]
    places[10:] = [place + np.array([8.0, 5.0]) for place in places[10:]]
    assert jitter(places, 0.3) < 0.3
