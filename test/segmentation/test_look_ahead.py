"""How the frames that a result may wait for are spent."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.average import MeanAverage, SlopeAverage
from turbseg_ros.segmentation.look_ahead import WHOLE_CLIP, LookAhead

# Frames in which the tracker confirms an object by default.
TO_CONFIRM = 6
SLOPE = SlopeAverage()


def spent(frames: int, to_confirm: int = TO_CONFIRM, **flow: int) -> LookAhead:
    changes = {"latency.look_ahead": frames, **{f"flow.{name}": n for name, n in flow.items()}}
    parameters = Parameters().replace(changes)
    return LookAhead.of(parameters, SLOPE.intervals(parameters.flow.interval), to_confirm)


@given(
    frames=st.integers(3, 60),
    interval=st.integers(1, 16),
    every=st.integers(1, 8),
    to_confirm=st.integers(0, 40),
)
def test_a_result_comes_after_as_many_frames_as_are_allowed(
    frames: int, interval: int, every: int, to_confirm: int
) -> None:
    look_ahead = spent(frames, to_confirm, interval=interval, every=every)
    assert look_ahead.frames == frames
    assert min(look_ahead.segmentation, look_ahead.measuring) > 0
    assert look_ahead.confirmation >= 0
    assert look_ahead.lag >= 0


def test_by_default_motion_is_known_in_time_and_a_frame_is_left_for_objects() -> None:
    look_ahead = spent(Parameters().latency.look_ahead)
    assert look_ahead.lag == 0
    assert look_ahead.neighbours == 2
    assert look_ahead.confirmation == 1


def test_more_frames_widen_the_flow_first_then_confirm_objects_then_spare_slow_machines() -> None:
    widths = [spent(frames).neighbours for frames in range(3, 20)]
    confirmations = [spent(frames).confirmation for frames in range(8, 15)]
    assert widths == sorted(widths)
    assert spent(8).neighbours == 4
    assert confirmations == list(range(1, 8))
    assert spent(14).measuring == 2
    assert spent(15).measuring == 4
    assert spent(15).confirmation == TO_CONFIRM


def test_with_fewer_frames_than_motion_takes_it_comes_late() -> None:
    assert [spent(frames).lag for frames in (3, 4, 5, 6)] == [2, 1, 0, 0]
    assert spent(6, interval=16).lag == 8 + 2 - 5


def test_a_mean_needs_its_whole_interval_ahead() -> None:
    mean = MeanAverage(4)
    look_ahead = LookAhead.of(Parameters(), mean.intervals(4), TO_CONFIRM)
    assert look_ahead.neighbours == 4
    assert look_ahead.frames == Parameters().latency.look_ahead


def test_what_waits_for_the_end_of_a_clip_has_all_its_frames() -> None:
    look_ahead = spent(3, WHOLE_CLIP)
    assert look_ahead.neighbours == 4
    assert look_ahead.lag == 0
    assert look_ahead.frames > 10**9


def test_a_causal_result_waits_for_nothing() -> None:
    causal = Parameters().replace({"latency.mode": "causal"})
    look_ahead = LookAhead.of(causal, SLOPE.intervals(4), TO_CONFIRM)
    assert (look_ahead.frames, look_ahead.neighbours, look_ahead.segmentation) == (0, 0, 0)
    assert look_ahead.lag == look_ahead.measuring == 2


def test_the_first_results_wait_until_objects_are_confirmed_or_the_warm_up_is_worked_off() -> None:
    look_ahead = spent(6)
    kept = [look_ahead.results_kept(segmented) for segmented in range(60)]
    assert kept[:24] == [TO_CONFIRM] * 24
    assert kept == sorted(kept, reverse=True)
    assert all(before - after <= 1 for before, after in itertools.pairwise(kept))
    assert kept[40:] == [look_ahead.confirmation] * 20
    assert spent(30).results_kept(0) == spent(30).confirmation
