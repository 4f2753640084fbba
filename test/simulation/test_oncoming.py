"""Scenes of what comes closer, drawn at random."""

from __future__ import annotations

import pytest

from turbseg_ros.simulation.oncoming import oncoming_scene

SEEDS = range(40)


def test_a_seed_has_one_scene_and_each_another() -> None:
    assert oncoming_scene(7) == oncoming_scene(7)
    assert len({oncoming_scene(seed).objects for seed in SEEDS}) == len(SEEDS)


@pytest.mark.parametrize("seed", SEEDS)
def test_objects_grow_or_shrink_and_hardly_leave_their_place(seed: int) -> None:
    scene = oncoming_scene(seed)
    assert 1 <= len(scene.objects) <= 3
    for each in scene.objects:
        positions = each.path.positions(scene.frames)
        scales = each.path.scale_factors(scene.frames)
        assert scales[-1] > 1.14 or scales[-1] < 0.89
        assert abs(positions[-1, 0] - positions[0, 0]) <= 12
        assert abs(positions[-1, 1] - positions[0, 1]) < 60


def test_tilt_and_landscape_go_round() -> None:
    scenes = [oncoming_scene(seed) for seed in range(12)]
    assert len({scene.landscape for scene in scenes}) == 3
    assert sorted({scene.turbulence.tilt_px for scene in scenes}) == pytest.approx(
        [0.3, 0.7, 1.2, 1.8]
    )
