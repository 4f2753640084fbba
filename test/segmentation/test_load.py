"""When load is shed: a paced stream, and a clock that only segmenting moves on."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import pytest

from support.drawn_clip import PARAMETERS, frames
from support.drawn_scene import DrawnScene
from support.paths import ROOT
from support.segmenters import segmenter_by_rules
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.load import ANSWERED_STEPS, Load, Step
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.observer import StageObserver

FRAMES = list(DrawnScene(velocity=(1, 0)).images(96))
QUEUE = PARAMETERS.queue_size


@dataclass
class Machine(StageObserver):
    """What frames cost, in periods of the camera, and what time it is by that.

    `first` is what the first one costs beside, for which nothing could be measured ahead.
    """

    outlined: float
    coasted: float
    first: float = 0.0
    time: float = 0.0
    begun: bool = False

    def motion(self, stamp: int, moving: Moving) -> None:
        self.time += self.coasted + (0.0 if self.begun else self.first)
        self.begun = True

    def detections(self, *_: object) -> None:
        self.time += self.outlined - self.coasted


@dataclass
class Run:
    """What became of a stream: its results, how many frames waited, and how many were late."""

    results: list[SegmentationResult] = field(default_factory=list)
    waiting: list[int] = field(default_factory=list)
    unanswered: list[int] = field(default_factory=list)
    dropped: int = 0

    @property
    def coasted(self) -> list[int]:
        return [result.frame.stamp for result in self.results if result.coasted]


def live(machine: Machine, parameters: Parameters = PARAMETERS) -> Run:
    """Push one frame a period, as soon as the machine is free; the newest of those that wait."""
    run, queue, coming = Run(), deque(), deque(frames(FRAMES))
    rules = parameters.replace({"refine.mode": "none"})
    with motion_segmenter(rules, machine) as segmenter:
        pushed = 0
        while coming or queue:
            if not queue:
                machine.time = max(machine.time, float(coming[0].stamp))
            while coming and coming[0].stamp <= machine.time:
                queue.append(coming.popleft())
            while len(queue) > parameters.queue_size + 1:
                queue.popleft()
                run.dropped += 1
            frame = queue.popleft()
            pushed += 1
            run.waiting.append(len(queue))
            run.results += segmenter.push(frame, len(queue))
            run.unanswered.append(pushed - len(run.results))
        run.results += segmenter.flush()
    return run


@pytest.mark.parametrize("first", [2.0, 3.9])
@pytest.mark.parametrize("outlined", [0.5, 0.75, 0.95])
def test_a_machine_that_keeps_up_outlines_every_frame(outlined: float, first: float) -> None:
    # 24 frames wait for their background by intention, and the first takes long.
    run = live(Machine(outlined=outlined, coasted=0.3, first=first))
    assert run.coasted == []
    assert max(run.waiting) <= QUEUE // 2
    assert len(run.results[0].objects) == 1


def test_what_has_piled_up_is_worked_off_by_a_machine_that_keeps_up() -> None:
    run = live(Machine(outlined=0.75, coasted=0.3, first=3.0))
    with segmenter_by_rules(PARAMETERS) as segmenter:
        look_ahead = segmenter.look_ahead
    assert max(run.unanswered) > look_ahead + 5
    assert max(run.unanswered[-8:]) <= look_ahead


def test_a_machine_that_is_too_slow_coasts_and_drops_nothing() -> None:
    run = live(Machine(outlined=1.3, coasted=0.4, first=3.0))
    assert run.dropped == 0
    assert len(run.results) == len(FRAMES)
    assert len(run.coasted) > len(FRAMES) / 4
    # What has piled up is worked off meanwhile.
    with segmenter_by_rules(PARAMETERS) as segmenter:
        assert max(run.unanswered[-10:]) <= segmenter.look_ahead + 1


def test_the_ladder_is_climbed_in_its_order_as_more_frames_wait() -> None:
    steps = [Load.of(waiting, PARAMETERS).step for waiting in range(QUEUE)]
    assert steps == sorted(steps)
    assert list(dict.fromkeys(steps)) == list(ANSWERED_STEPS)
    assert [steps.index(step) for step in ANSWERED_STEPS] == [
        0,
        PARAMETERS.latency.coast_from,
        PARAMETERS.latency.sparse_from,
    ]


def test_the_steps_of_the_ladder_have_names_and_cost_more_and_more() -> None:
    assert [step.label for step in Step] == ["full", "coasting", "sparse motion", "dropping"]
    assert [step for step in Step if step.j is None] == [Step.DROPPING]
    reached = [step.j for step in ANSWERED_STEPS if step.j is not None]
    assert reached == sorted(reached, reverse=True)


def test_the_documents_have_the_ladder_with_its_accuracy() -> None:
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in (ROOT / "docs" / "behaviour.md").read_text().splitlines()
    ]
    steps = {row[0].strip("`"): row for row in rows if row}
    for step in Step:
        told = steps[step.label][3].split(";")[0]
        assert told == ("no masks" if step.j is None else f"{step.j:.2f}")


def test_each_result_tells_the_step_that_it_was_segmented_at() -> None:
    calm = live(Machine(outlined=0.5, coasted=0.3))
    assert {result.step for result in calm.results} == {Step.FULL}
    busy = live(Machine(outlined=1.3, coasted=0.4, first=3.0))
    assert {result.step for result in busy.results if result.coasted} <= {*Step} - {Step.FULL}
    assert Step.COASTING in {result.step for result in busy.results}


def test_a_queue_that_hardly_holds_anything_has_no_patience() -> None:
    latency = PARAMETERS.latency
    short = PARAMETERS.replace({"queue_size": latency.coast_from})
    assert Load.of(latency.coast_from, short, piled_up=10).coasts


def test_nothing_is_excused_by_what_has_not_piled_up() -> None:
    coast_from = PARAMETERS.latency.coast_from
    assert Load.of(coast_from, PARAMETERS).coasts
    assert not Load.of(coast_from, PARAMETERS, piled_up=1).coasts
    assert Load.of(coast_from + 1, PARAMETERS, piled_up=1).coasts


def test_nothing_changes_while_load_is_never_shed() -> None:
    never = PARAMETERS.replace({"latency.coast_from": QUEUE + 1, "latency.sparse_from": QUEUE + 1})
    assert all(Load.of(waiting, never) == Load() for waiting in range(QUEUE))


def test_very_many_that_wait_go_before_what_has_piled_up() -> None:
    latency = PARAMETERS.latency
    assert Load.of(QUEUE, PARAMETERS, piled_up=10) == Load(True, True, frames_at_once=1)
    assert Load.of(latency.sparse_from - 1, PARAMETERS) == Load(True, False, frames_at_once=2)
