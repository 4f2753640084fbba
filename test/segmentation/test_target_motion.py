"""Which paths of small targets are found to be those of things that move."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.segmentation.target_motion import FollowedTargets, have_moved

FRAMES = 96
# What stands, all round the picture.
STANDING = [
    (x, y) for x in (20.0, 160.0, 300.0) for y in (20.0, 120.0, 220.0) if (x, y) != (160, 120)
]
MIDDLE = (160.0, 120.0)
# Parts of a large thing beside the middle of the picture.
PARTS = [(170.0 + x, 112.0 + y) for x in (0.0, 10.0, 20.0) for y in (0.0, 12.0)]


def found(
    places: list[tuple[float, float]], come: list[float], moved: frozenset[int] = frozenset()
) -> list[int]:
    """Return which of some targets are found to move, that have come so far to the right."""
    steps = np.linspace(-1.0, 0.0, FRAMES)[None, :, None] * np.array([1.0, 0.0])
    paths = np.array(places)[:, None] + np.array(come)[:, None, None] * steps
    paths = paths + np.random.default_rng(1).normal(0.0, 0.05, paths.shape)
    # The camera moves: nothing is fixed to the picture.
    sightings = paths + 10.0 * steps
    targets = FollowedTargets(
        paths,
        sightings,
        np.array(places),
        np.full(len(places), 20.0),
        np.isin(np.arange(len(places)), sorted(moved)),
    )
    return np.nonzero(have_moved(targets, 4, 24, FRAMES))[0].tolist()


def test_what_has_come_away_from_what_stands_has_moved() -> None:
    assert found([MIDDLE, *STANDING], [5.0] + [0.0] * len(STANDING)) == [0]


def test_the_parts_of_one_large_thing_have_one_say() -> None:
    come = [1.5] + [40.0] * len(PARTS) + [0.0] * len(STANDING)
    assert 0 not in found([MIDDLE, *PARTS, *STANDING], come)


def test_what_moves_does_not_vouch_for_the_scene() -> None:
    # Two of three others near it move, and the third stands as it does.
    places = [(20.0, 20.0), (100.0, 20.0), (20.0, 100.0), (100.0, 100.0), (300.0, 220.0)]
    come = [1.5, 40.0, -40.0, 40.0, 0.0]
    assert 0 not in found(places, come, moved=frozenset({1, 2, 3}))


@pytest.mark.parametrize("spread", [20.0, 200.0])
def test_nothing_is_believed_where_what_stands_is_one_thing(spread: float) -> None:
    corner = [(40.0 + spread * x, 40.0 + spread * y) for x in (0.0, 0.5, 1.0) for y in (0.0, 1.0)]
    assert found([(300.0, 60.0), *corner], [9.0] + [0.0] * len(corner)) == [0] * (spread > 80.0)
