"""A scene in which nothing moves for long: what is left out, and what is found all the same."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from support.drawn_clip import PARAMETERS, frames, stamps
from support.drawn_scene import DrawnScene
from support.segmenters import segmenter_by_rules
from turbseg_ros.segmentation import flow, scene_memory
from turbseg_ros.segmentation.frame import SegmentationResult

CALM = 96
AFTERWARDS = 36
NOTHING = DrawnScene(velocity=None)
EVERY = PARAMETERS.flow.every
IN_TURN = 3 * CALM // EVERY
SECOND = 53


def clip(velocity: tuple[int, int] | None) -> Iterator[np.ndarray]:
    """Nothing for long, and then a square, which goes on."""
    yield from NOTHING.images(CALM)
    yield from DrawnScene(velocity=velocity).images(AFTERWARDS)


def segmented(images: Iterator[np.ndarray]) -> list[SegmentationResult]:
    with segmenter_by_rules(PARAMETERS) as segmenter:
        results = [result for frame in frames(images) for result in segmenter.push(frame)]
        return results + segmenter.flush()


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return what grows by one with each flow that is computed."""
    computed: list[int] = []
    as_it_is = flow.dis_flow

    def counted(*arguments: object) -> np.ndarray:
        computed.append(1)
        return as_it_is(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(flow, "dis_flow", counted)
    return computed


def test_while_nothing_moves_motion_is_seldom_measured(measured: list[int]) -> None:
    frames_shown = 2 * CALM
    results = segmented(NOTHING.images(frames_shown))
    assert stamps(results) == list(range(frames_shown))
    assert not any(result.objects for result in results)
    # In the first seconds it is, and then once in four times.
    assert len(measured) < 0.7 * 2 * IN_TURN


def test_while_something_moves_motion_is_measured_in_turn(measured: list[int]) -> None:
    results = segmented(DrawnScene(velocity=(1, 0)).images(CALM))
    assert all(len(result.objects) == 1 for result in results[-CALM // 2 :])
    assert len(measured) >= IN_TURN


@pytest.mark.parametrize("velocity", [(3, 0), (1, 0)])
def test_what_comes_is_found_as_if_motion_had_been_measured_always(
    velocity: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = first_found(segmented(clip(velocity)))
    monkeypatch.setattr(scene_memory, "_MOST_LEFT_OUT", 0)
    assert found == first_found(segmented(clip(velocity)))


def first_found(results: list[SegmentationResult], count: int = 1) -> int:
    return next(result.frame.stamp for result in results if len(result.objects) >= count)
