"""Ids that stay, for detections that are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.detections import PLAIN, STILL_CAMERA, seen
from support.drawn_scene import jaccard, texture
from turbseg_ros.arrays import ByteImage
from turbseg_ros.segmentation.cropped_mask import Box
from turbseg_ros.segmentation.front import UNCUT, Sides
from turbseg_ros.segmentation.kalman_tracker import KalmanTracker
from turbseg_ros.segmentation.kmeans_ids import KMeansIds, kmeans_ids
from turbseg_ros.segmentation.track import Detection, Observation, Track, joined

CONFIRMATION, MAX_AGE, SLOTS = 4, 10, 3


def tracker_of(**changes: Any) -> KalmanTracker:
    known: dict[str, Any] = {
        "min_hits": CONFIRMATION,
        "false_alarms_per_hour": 1.0,
        "max_age": MAX_AGE,
        "slots": SLOTS,
    }
    return KalmanTracker(**{**known, **changes})


def crossing(
    frame: int, start: tuple[float, float], velocity: tuple[float, float], **shape: Any
) -> Detection:
    """Where something that moves at constant velocity is seen in a frame."""
    x, y = (p + frame * v for p, v in zip(start, velocity, strict=True))
    return seen(x, y, velocity, **shape)


def pan(x: float, y: float) -> np.ndarray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def update(
    tracker: KalmanTracker,
    detections: Sequence[Detection],
    ego_motion: np.ndarray = STILL_CAMERA,
    tilt: float = 0.1,
    slewing: bool = False,
) -> list[Observation]:
    return tracker.update(detections, ego_motion, tilt, PLAIN, slewing)


def only(observations: Sequence[Observation]) -> Observation:
    (observation,) = observations
    return observation


def follow(
    tracker: KalmanTracker,
    frames: range,
    start: tuple[float, float],
    velocity: tuple[float, float],
) -> Observation:
    """Show the tracker one object in some frames; return its last observation."""
    for frame in frames:
        observation = only(update(tracker, [crossing(frame, start, velocity)]))
    return observation


def wait(tracker: KalmanTracker, frames: int) -> None:
    for _ in range(frames):
        assert update(tracker, []) == []


def test_what_rests_where_an_object_went_out_of_sight_is_not_taken_for_it() -> None:
    tracker = tracker_of()
    follow(tracker, range(12), (5, 30), (3, 0))
    wait(tracker, 3)
    # What hides it stands out a little from what was seen there before.
    hiding = [seen(5 + 3 * frame, 28, height=16, moving=False) for frame in range(15, 18)]
    for detection in hiding:
        assert [each.track.confirmed for each in update(tracker, [detection])] == [False]
    behind = only(update(tracker, [crossing(18, (5, 30), (3, 0))]))
    assert behind.track.id == 1


def test_an_object_that_stops_in_sight_is_seen_on() -> None:
    tracker = tracker_of()
    last = follow(tracker, range(12), (5, 30), (3, 0))
    for _ in range(4):
        assert only(update(tracker, [seen(5 + 33, 30, moving=False)])).track is last.track


def test_a_candidate_knows_its_area_and_centroid() -> None:
    mask = np.array([[True, True, False], [True, False, False]])
    detection = Detection(Box(10, 20, 13, 22), mask, (0.0, 0.0), True)
    assert detection.area == 3
    np.testing.assert_allclose(detection.centroid, (10 + 1 / 3, 20 + 1 / 3))


def test_an_object_keeps_its_id_at_constant_velocity() -> None:
    tracker = tracker_of()
    ids = []
    for frame in range(60):
        observation = only(update(tracker, [crossing(frame, (5, 30), (3, 0))]))
        ids.append(observation.track.id)
    assert ids == [0] * (CONFIRMATION - 1) + [1] * (61 - CONFIRMATION)
    np.testing.assert_allclose(observation.velocity, (3, 0), atol=0.2)
    np.testing.assert_allclose(observation.track.position, (5 + 59 * 3 + 9.5, 35.5), atol=1.0)


def test_an_object_is_known_once_it_was_seen_often_enough() -> None:
    for min_hits in (1, 2, 6):
        tracker = tracker_of(min_hits=min_hits, false_alarms_per_hour=1e6)
        assert tracker.delay == min_hits - 1
        for frame in range(min_hits):
            detection = crossing(frame, (5, 30), (3, 0))
            observation = only(update(tracker, [detection], tilt=0.0))
            assert observation.track.confirmed == (frame == min_hits - 1)


def test_earlier_observations_learn_the_id_of_their_track() -> None:
    tracker = tracker_of()
    first = follow(tracker, range(1), (5, 30), (3, 0))
    assert not first.track.confirmed
    follow(tracker, range(1, 4), (5, 30), (3, 0))
    assert first.track.confirmed
    assert first.track.id == 1


def test_what_goes_fast_is_followed_though_no_flow_tells_its_velocity() -> None:
    tracker = tracker_of()
    for frame in range(12):
        standing = replace(seen(20 + 30 * frame, 60, width=40, height=30), flow_known=False)
        (observation,) = update(tracker, [standing], tilt=0.3)
    assert observation.track.id == 1
    assert observation.velocity == pytest.approx((30.0, 0.0), abs=2.0)


def test_an_edge_that_stands_out_here_and_there_never_becomes_an_object() -> None:
    tracker, random = tracker_of(), np.random.default_rng(4)
    for _ in range(60):
        x, width = random.integers(100, 130), int(random.integers(30, 60))
        edge = replace(seen(float(x), 60, width=width, height=8), flow_known=False)
        for observation in update(tracker, [edge], tilt=0.3):
            assert not observation.track.confirmed


@pytest.mark.parametrize(("height", "tracks"), [(40, 1), (120, 2)])
def test_what_stands_out_is_not_taken_for_something_of_another_size(
    height: int, tracks: int
) -> None:
    tracker = tracker_of()
    found = [
        only(update(tracker, [replace(seen(100, 60, width=40, height=each), flow_known=False)]))
        for each in (30, height)
    ]
    assert len({id(observation.track) for observation in found}) == tracks


@pytest.mark.parametrize(("aside", "same"), [(0, True), (20, False)])
def test_an_object_out_of_sight_is_not_taken_for_something_large_that_moves_beside_it(
    aside: int, same: bool
) -> None:
    tracker = tracker_of()
    before = follow(tracker, range(12), (50, 60), (3, 0)).track
    wait(tracker, 3)
    large = seen(50 + 3 * 15, 60 + aside, width=120, height=60, velocity=(3.0, 0.0))
    after = only(update(tracker, [large]))
    assert (after.track is before) == same


def test_what_wanders_along_the_border_never_becomes_an_object() -> None:
    # To and fro by 5 pixels a frame, and down by one in two.
    tracker = tracker_of()
    for frame in range(20):
        outline = seen(2 + 5 * (frame % 2), 30 + 0.5 * frame, width=12, height=20)
        for observation in update(
            tracker, [replace(outline, cut_sides=Sides(left=True))], tilt=0.1
        ):
            assert not observation.track.confirmed


@pytest.mark.parametrize("flow_known", [True, False])
def test_what_enters_becomes_an_object_by_its_front_end(flow_known: bool) -> None:
    # A thin end comes in by 8 pixels a frame, and what is high stays at the border for now: the
    # middle of what is seen goes a quarter as far.
    entering = []
    for frame in range(3, 14):
        outline = seen(160 - 8 * frame, 60, (-8.0, 0.0), width=8 * frame, height=30)
        mask = outline.mask.copy()
        mask[:22, : max(8 * frame - 24, 0)] = False
        entering.append(
            replace(outline, mask=mask, cut_sides=Sides(right=True), flow_known=flow_known)
        )
    confirmed = confirmed_at(entering)
    assert confirmed is not None
    assert confirmed < 7
    by_its_middle = confirmed_at(replace(each, cut_sides=UNCUT) for each in entering)
    assert by_its_middle is None or by_its_middle > confirmed


def test_an_object_that_hides_for_some_frames_keeps_its_id() -> None:
    tracker = tracker_of()
    before = follow(tracker, range(8), (5, 30), (3, 0))
    wait(tracker, MAX_AGE - 2)
    after = only(update(tracker, [crossing(8 + MAX_AGE - 2, (5, 30), (3, 0))]))
    assert after.track is before.track
    assert after.track.id == 1


def test_an_object_that_hides_for_too_long_ends() -> None:
    tracker = tracker_of()
    follow(tracker, range(8), (5, 30), (3, 0))
    wait(tracker, MAX_AGE + 1)
    assert not tracker.expected_objects(STILL_CAMERA, (96, 160))
    later = 8 + MAX_AGE + 1
    after = follow(tracker, range(later, later + CONFIRMATION), (5, 30), (3, 0))
    assert after.track.id == 2


@pytest.mark.parametrize(
    ("aside", "grey", "same"), [(19, 128, True), (19, 230, False), (60, 128, False)]
)
def test_an_object_that_turned_while_it_hid_has_its_id_again_if_it_looks_like_it(
    aside: int, grey: int, same: bool
) -> None:
    tracker = tracker_of()
    before = follow(tracker, range(12), (50, 60), (3, 0)).track
    wait(tracker, 4)
    image = np.full_like(PLAIN, grey)
    for frame in range(16, 22):
        there = crossing(frame, (50, 60 + aside), (3, 0))
        (found,) = tracker.update([there], STILL_CAMERA, 0.1, image)
    assert found.track is not before
    assert (found.track.id == before.id) == same
    assert found.track.slot == (before.slot if same else 1)


def test_an_object_that_lost_its_shape_has_its_id_again() -> None:
    tracker = tracker_of()
    before = follow(tracker, range(12), (50, 60), (3, 0)).track
    frame, track = 12, before
    while track is before:
        width, height = (36, 6) if frame % 2 else (6, 36)
        left, top = 60 + 3 * frame - width // 2, 66 - height // 2
        changed = seen(left, top, (3, 0), width=width, height=height)
        track = only(update(tracker, [changed])).track
        frame += 1
    assert frame < 40
    found = follow(tracker, range(frame, frame + 6), (50, 60), (3, 0))
    assert found.track is not before
    assert found.track.id == before.id


def test_objects_that_cross_keep_their_ids() -> None:
    tracker = tracker_of()
    ids: dict[float, set[int]] = {1.0: set(), -1.0: set()}
    for frame in range(40):
        detections = [
            crossing(frame, (10, 30), (3, 0)),
            crossing(frame, (130, 34), (-3, 0)),
        ]
        for observation in update(tracker, detections):
            if observation.track.confirmed:
                ids[np.sign(observation.velocity[0])].add(observation.track.id)
    assert sorted(ids.values(), key=min) == [{1}, {2}]


def test_objects_that_hide_each_other_keep_their_ids() -> None:
    tracker = tracker_of()
    ids: dict[float, set[int]] = {1.0: set(), -1.0: set()}
    for frame in range(40):
        right = crossing(frame, (10, 30), (3, 0))
        left = crossing(frame, (130, 32), (-3, 0))
        hidden = abs(right.box.x0 - left.box.x0) < 12
        for observation in update(tracker, [right] if hidden else [right, left]):
            if observation.track.confirmed:
                ids[np.sign(observation.velocity[0])].add(observation.track.id)
    assert sorted(ids.values(), key=min) == [{1}, {2}]


def test_an_object_behind_a_pole_stays_one() -> None:
    tracker = tracker_of()
    before = follow(tracker, range(8), (5, 30), (3, 0))
    left, right = seen(29, 30, (3, 0), width=8), seen(40, 30, (3, 0), width=9)
    parted = only(update(tracker, [left, right]))
    assert parted.track is before.track
    np.testing.assert_array_equal(union_mask([parted.detection]), union_mask([left, right]))


def test_an_object_keeps_its_id_though_a_part_of_it_was_seen_apart() -> None:
    tracker = tracker_of()
    for frame in range(10):
        legs = crossing(frame, (5, 40), (2, 0), height=8)
        update(tracker, [legs])
    # The middle of the whole lies nearer to the part that is new than to the one that is known.
    legs, trunk = (crossing(10, (5, y), (2, 0), height=h) for y, h in ((40, 8), (24, 10)))
    assert {observed.track.id for observed in update(tracker, [legs, trunk])} == {0, 1}
    whole = crossing(11, (5, 24), (2, 0), height=24)
    assert only(update(tracker, [whole])).track.id == 1


def test_two_objects_side_by_side_are_two() -> None:
    tracker = tracker_of()
    for frame in range(10):
        detections = [crossing(frame, (5, y), (3, 0)) for y in (20, 40)]
        observations = update(tracker, detections)
    assert sorted(o.track.id for o in observations) == [1, 2]
    assert sorted(o.track.slot for o in observations) == [0, 1]


def swaying(frame: int, reach: float) -> Detection:
    """Something that goes to and fro, and flow that sees it do so."""
    phase = 2 * np.pi * frame / 12
    speed = 2 * np.pi / 12 * reach
    return seen(60 + reach * np.sin(phase), 30, (speed * np.cos(phase), 0.0))


def test_what_sways_at_a_place_known_to_be_cluttered_never_becomes_an_object() -> None:
    tracker = tracker_of()
    for frame in range(80):
        detection = replace(swaying(frame, reach=2.0), clutter=0.7)
        assert not only(update(tracker, [detection])).track.confirmed


def confirmed_at(detections: Iterable[Detection], **changes: float) -> int | None:
    """The frame in which what is seen becomes an object, None if in none."""
    tracker = tracker_of(**changes)
    for frame, detection in enumerate(detections):
        if only(update(tracker, [detection])).track.confirmed:
            return frame
    return None


def creeping(clutter: float = 0.0) -> list[Detection]:
    slowly = [crossing(k, (20.0, 20.0), (1.0, 0.0)) for k in range(60)]
    return [replace(detection, clutter=clutter) for detection in slowly]


def test_it_takes_longer_where_the_place_is_cluttered_and_where_alarms_must_be_rarer() -> None:
    calm, cluttered = confirmed_at(creeping()), confirmed_at(creeping(clutter=0.6))
    careful = confirmed_at(creeping(clutter=0.6), false_alarms_per_hour=1e-6)
    assert calm is not None
    assert cluttered is not None
    assert careful is not None
    assert calm < cluttered < careful


def test_a_place_that_jumps_must_be_seen_twice_as_often_but_not_at_the_border() -> None:
    flickering = [seen(20.0 + 2 * k, 20.0 + 3 * (k % 2), (2.0, 0.0)) for k in range(16)]
    entering = [replace(detection, cut_sides=Sides(bottom=True)) for detection in flickering]
    at_once, late = confirmed_at(entering), confirmed_at(flickering)
    assert at_once is not None
    assert late is not None
    assert late >= 2 * CONFIRMATION - 1 > at_once


@pytest.mark.parametrize(("flow", "known"), [(1.5, True), (-1.5, False)])
def test_what_goes_against_its_own_flow_never_becomes_an_object(flow: float, known: bool) -> None:
    going = [seen(20 + 2 * k, 20, (flow, 0.0)) for k in range(12)]
    assert (confirmed_at(going) is not None) is known


def test_an_outline_that_jumped_back_once_becomes_an_object_if_it_goes_with_its_flow() -> None:
    # As that of two cars does which are drawn as one at first.
    places = (40, 34, 34.8, 35.6, 36.4, 37.2, 38.0)
    assert confirmed_at(seen(x, 20, (0.8, 0.0), width=30) for x in places) is not None


def test_what_begins_where_something_got_nowhere_must_come_clear_of_it() -> None:
    tracker = tracker_of()
    for _ in range(40):
        update(tracker, [seen(60, 30, (2.0, 0.0), width=40, height=4)])
    wait(tracker, 2)
    going = [seen(60 + 2 * k, 30, (2.0, 0.0), width=40, height=4) for k in range(20)]
    suspected = next(
        frame
        for frame, detection in enumerate(going)
        if only(update(tracker, [detection])).track.confirmed
    )
    elsewhere = confirmed_at(going)
    assert elsewhere is not None
    # The root of its area, which is 13 pixels wide, not its length.
    assert elsewhere < suspected <= 8


def test_where_an_object_that_had_travelled_gets_nowhere_others_begin_as_elsewhere() -> None:
    def bar(x: float) -> Detection:
        return seen(x, 30, (2.0, 0.0), width=40, height=4)

    tracker = tracker_of()
    for k in range(20):
        update(tracker, [bar(20 + 2 * k)])
    for _ in range(60):
        # It has stopped, and flow says that it has not.
        update(tracker, [bar(58)])
        if not tracker.expected_objects(STILL_CAMERA, (96, 160)):
            break
    wait(tracker, 2)
    going = [bar(60 + 2 * k) for k in range(20)]
    told = [only(update(tracker, [detection])).track.confirmed for detection in going]
    assert told.index(True) == confirmed_at(going)


def test_what_sways_widely_is_no_object_for_long() -> None:
    tracker = tracker_of()
    known = [
        any(o.track.confirmed for o in update(tracker, [swaying(frame, reach=6.0)]))
        for frame in range(200)
    ]
    assert not any(known[40:])


def small_target(x: float, y: float, *numbers: int) -> Detection:
    return replace(seen(x, y, width=4, height=4), targets=frozenset(numbers))


def test_what_was_followed_for_long_becomes_an_object_though_it_hardly_moves() -> None:
    small = small_target(100, 100, 1)
    assert confirmed_at([small] * 8) == CONFIRMATION - 1
    assert confirmed_at([replace(small, targets=frozenset())] * 8) is None


@pytest.mark.parametrize(("number", "same"), [(1, True), (2, False)])
def test_a_small_target_keeps_its_id_wherever_it_was_followed_to(number: int, same: bool) -> None:
    tracker = tracker_of()
    for _ in range(8):
        before = only(update(tracker, [small_target(100, 100, 1)])).track
    wait(tracker, 3)
    there = only(update(tracker, [small_target(140, 120, number)])).track
    assert before.confirmed
    assert (there is before) == same


@pytest.mark.parametrize(("number", "same"), [(1, True), (0, False)])
def test_what_stood_is_none_of_what_hides_it_but_for_a_target_that_is_followed(
    number: int, same: bool
) -> None:
    tracker = tracker_of()
    small = small_target(100, 100, 1)
    for _ in range(8):
        before = only(update(tracker, [small])).track
    hidden = replace(small, targets=frozenset(), stands=before.id, hidden=True)
    passes = replace(small_target(102, 100, 1), targets=frozenset({number} - {0}))
    there = only(update(tracker, [hidden, passes])).track
    assert (there is before) == same


@pytest.mark.parametrize(
    ("width", "moving", "taken"), [(4, False, 1), (12, False, 0), (5, True, 1)]
)
def test_noise_does_not_stand_for_a_small_target(width: int, moving: bool, taken: int) -> None:
    tracker = tracker_of()
    for _ in range(8):
        known = only(update(tracker, [small_target(100, 100, 1)])).track
    outline = replace(seen(100, 100, width=width, height=width), moving=moving)
    found = update(tracker, [outline])
    assert sum(observation.track is known for observation in found) == taken


def test_what_stands_still_never_becomes_an_object() -> None:
    tracker = tracker_of()
    for _ in range(20):
        assert not only(update(tracker, [seen(60, 30)])).track.confirmed


def test_flow_that_takes_nothing_along_is_no_object() -> None:
    tracker = tracker_of()
    for frame in range(20):
        # Its flow says 2 pixels a frame, and it comes a quarter of one.
        detection = seen(60 + frame / 4, 30, (2.0, 0.0))
        assert not only(update(tracker, [detection])).track.confirmed


@pytest.mark.parametrize(("tilt", "known"), [(0.0, True), (3.0, False)])
def test_in_strong_turbulence_an_object_must_come_further(tilt: float, known: bool) -> None:
    tracker = tracker_of()
    for frame in range(6):
        detection = crossing(frame, (5, 30), (0.8, 0))
        observation = only(update(tracker, [detection], tilt=tilt))
    assert observation.track.confirmed == known


def test_a_single_sight_is_forgotten() -> None:
    tracker = tracker_of()
    for frame in range(0, 40, 4):
        follow(tracker, range(frame, frame + 1), (5, 30), (3, 0))
        wait(tracker, 3)
    assert tracker.next_id == 1


def test_an_object_that_stops_is_kept_until_max_age() -> None:
    tracker = tracker_of()
    last = follow(tracker, range(8), (5, 30), (3, 0))
    for _ in range(MAX_AGE):
        standing = seen(26, 30, moving=False)
        assert only(update(tracker, [standing])).track is last.track
    assert len(tracker.expected_objects(STILL_CAMERA, (96, 160))) == 1
    update(tracker, [standing])
    assert not tracker.expected_objects(STILL_CAMERA, (96, 160))


def test_ids_are_never_used_again() -> None:
    tracker = tracker_of()
    ids = []
    for number in range(5):
        ids.append(follow(tracker, range(6), (5, 10 * number), (3, 0)).track.id)
        if number % 2:
            tracker.reset()
        else:
            wait(tracker, MAX_AGE + 1)
    assert ids == [1, 2, 3, 4, 5]
    assert tracker.next_id == 6


def test_another_tracker_goes_on_counting() -> None:
    tracker, successor = tracker_of(), tracker_of()
    follow(tracker, range(6), (5, 30), (3, 0))
    successor.continue_ids(tracker)
    assert follow(successor, range(6), (5, 30), (3, 0)).track.id == 2


def rows(frame: int, *lines: int) -> list[Detection]:
    return [crossing(frame, (5, 20 * line), (3, 0)) for line in lines]


def test_slots_are_kept_freed_and_used_again() -> None:
    tracker = tracker_of()
    for frame in range(8):
        observations = update(tracker, rows(frame, 0, 1, 2))
    assert [o.track.slot for o in observations] == [0, 1, 2]
    # The one in the middle is gone; another comes.
    for frame in range(8, 8 + MAX_AGE + 1):
        update(tracker, rows(frame, 0, 2))
    for frame in range(8 + MAX_AGE + 1, 8 + MAX_AGE + 7):
        observations = update(tracker, rows(frame, 0, 2, 4))
    assert [(o.track.id, o.track.slot) for o in observations] == [(1, 0), (3, 2), (4, 1)]


def test_an_object_without_a_free_slot_has_an_id_all_the_same() -> None:
    tracker = tracker_of()
    for frame in range(8):
        observations = update(tracker, rows(frame, 0, 1, 2, 3))
    assert sorted(o.track.id for o in observations) == [1, 2, 3, 4]
    assert sorted(o.track.slot for o in observations) == [-1, 0, 1, 2]


def test_reset_frees_the_slots() -> None:
    tracker = tracker_of(slots=1)
    follow(tracker, range(6), (5, 30), (3, 0))
    tracker.reset()
    assert follow(tracker, range(6), (5, 30), (3, 0)).track.slot == 0


def confirmed_in_slew(step: float, scene: float, rest: int = 0) -> list[bool]:
    """Whether what is seen in eight frames of a slew, and then in some of rest, is an object.

    :param step: pixels by which it goes on in the picture from one frame of the slew to the next.
    :param scene: those by which the scene does, as its registration has it.
    """
    tracker = tracker_of()
    passing = [seen(50.0 + step * k, 30.0, (step - scene, 0.0)) for k in range(8)]
    resting = [seen(50.0 + step * 7, 30.0)] * rest
    turns = [STILL_CAMERA, *[pan(scene, 0.0)] * 7]
    found = [
        update(tracker, [detection], turn, slewing=True)
        for detection, turn in zip(passing, turns, strict=True)
    ]
    found += [update(tracker, [detection]) for detection in resting]
    return [only(each).track.confirmed for each in found]


def test_in_a_slew_nothing_becomes_an_object_that_goes_with_the_scene() -> None:
    assert confirmed_in_slew(step=1.0, scene=6.0)[-1]
    # A part of the scene, whose registration has come four of its six pixels.
    assert not any(confirmed_in_slew(step=6.0, scene=4.0))


def test_what_may_have_been_the_scene_in_a_slew_begins_anew_after_it() -> None:
    assert not any(confirmed_in_slew(step=6.0, scene=4.0, rest=8))


def test_ego_motion_carries_tracks_along() -> None:
    tracker = tracker_of()
    # The camera's pan moves the scene by (-10, 4), within which the object moves by (2, 0).
    for frame in range(12):
        detection = seen(200 - 8 * frame, 10 + 4 * frame, (2.0, 0.0))
        observation = only(update(tracker, [detection], pan(-10, 4)))
    assert observation.track.id == 1
    np.testing.assert_allclose(observation.velocity, (2, 0), atol=0.2)
    # The trail is where the object was in the scene, in this frame's pixels.
    steps = np.diff(observation.trail, axis=0)
    np.testing.assert_allclose(steps[2:], np.tile((2, 0), (len(steps) - 2, 1)), atol=0.5)


def test_a_camera_that_moves_does_not_make_objects_of_the_scene() -> None:
    tracker = tracker_of()
    for frame in range(20):
        detection = seen(200 - 8 * frame, 30, (0.3, 0.0))
        assert not only(update(tracker, [detection], pan(-8, 0))).track.confirmed


def test_a_turn_of_the_camera_turns_velocities() -> None:
    tracker = tracker_of()
    follow(tracker, range(10), (5, 30), (3, 0))
    quarter = np.array([[0.0, -1.0, 100.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    observation = only(update(tracker, [seen(54.5, 39.5, (0.0, 3.0))], quarter))
    assert observation.track.id == 1
    np.testing.assert_allclose(observation.velocity, (0, 3), atol=0.3)


def test_an_object_is_expected_where_it_is_headed() -> None:
    tracker = tracker_of()
    follow(tracker, range(8), (5, 30), (3, 0))
    (expected,) = tracker.expected_objects(pan(-10, 4), (96, 160))
    true = np.zeros((96, 160), bool)
    true[34:46, 19:39] = True
    assert jaccard(expected.outline.in_frame(true.shape), true) > 0.8


def test_a_hidden_object_is_expected_where_it_has_got_to() -> None:
    tracker = tracker_of()
    follow(tracker, range(8), (5, 30), (3, 0))
    wait(tracker, 4)
    (expected,) = tracker.expected_objects(STILL_CAMERA, (96, 160))
    true = np.zeros((96, 160), bool)
    true[30:42, 41:61] = True
    assert jaccard(expected.outline.in_frame(true.shape), true) > 0.8


def test_a_hidden_object_is_expected_where_the_camera_has_turned() -> None:
    tracker = tracker_of()
    for frame in range(8):
        update(tracker, [seen(120 - 5 * frame, 30, (3.0, 0.0))], pan(-8, 0))
    for _ in range(3):
        update(tracker, [], pan(-8, 0))
    (expected,) = tracker.expected_objects(pan(-8, 0), (96, 160))
    true = np.zeros((96, 160), bool)
    true[30:42, 65:85] = True
    assert jaccard(expected.outline.in_frame(true.shape), true) > 0.8


def test_what_is_no_object_is_not_expected() -> None:
    tracker = tracker_of()
    follow(tracker, range(CONFIRMATION - 1), (5, 30), (3, 0))
    assert not tracker.expected_objects(STILL_CAMERA, (96, 160))


def test_an_object_that_gets_nowhere_ends() -> None:
    tracker = tracker_of()
    follow(tracker, range(8), (5, 30), (3, 0))
    for _ in range(60):
        # It has stopped, and flow says that it has not.
        update(tracker, [seen(26, 30, (3.0, 0.0))])
    assert not tracker.expected_objects(STILL_CAMERA, (96, 160))
    assert tracker.next_id == 2


def test_a_track_may_end_where_another_one_is() -> None:
    tracker = tracker_of()
    follow(tracker, range(8), (5, 30), (3, 0))
    last = 26, 30
    wait(tracker, MAX_AGE)
    # Long gone from there, the object ends while another is seen just where it was seen last.
    update(tracker, [seen(*last, (-3.0, 0.0))])


def union_mask(detections: Iterable[Detection]) -> np.ndarray:
    picture = np.zeros((160, 160), bool)
    for detection in detections:
        picture[detection.box.slices] |= detection.mask
    return picture


def coasting(tracker: KalmanTracker, frame: int, detection: Detection) -> list[Observation]:
    """Look for a detection in every fourth frame only."""
    if frame % 4:
        return tracker.coast(STILL_CAMERA, (200, 400))
    return update(tracker, [detection])


def test_an_object_that_is_seen_in_every_fourth_frame_is_carried_along_between() -> None:
    tracker = tracker_of()
    for frame in range(40):
        there = crossing(frame, (30.0, 40.0), (3.0, 1.0))
        observation = only(coasting(tracker, frame, there))
        assert observation.track.id == (1 if frame >= 4 else 0)
        assert jaccard(
            observation.detection.outline.in_frame((200, 400)), there.outline.in_frame((200, 400))
        ) > (0.8 if frame >= 8 else 0.5)


def test_what_changes_its_shape_becomes_no_object_by_being_carried_along() -> None:
    tracker = tracker_of()
    for frame in range(40):
        wide = frame % 8 == 0
        there = crossing(
            frame, (30.0, 40.0), (1.0, 0.0), width=40 if wide else 8, height=6 if wide else 40
        )
        for observation in coasting(tracker, frame, there):
            assert not observation.track.confirmed


def test_an_object_is_carried_out_of_the_frame_at_its_own_pace() -> None:
    tracker = tracker_of()
    for frame in range(12):
        update(tracker, [crossing(frame, (320.0, 40.0), (5.0, 0.0))])
    # Its right edge is at 395 of 400 pixels.
    widths = []
    for _ in range(7):
        observations = tracker.coast(STILL_CAMERA, (200, 400))
        widths.append(only(observations).detection.area / 12 if observations else 0)
    assert widths == pytest.approx([20, 15, 10, 5, 0, 0, 0], abs=1)


def test_where_objects_are_carried_along_the_one_in_front_comes_first() -> None:
    """Of two that hide each other, whoever paints the first one first shows what is to be seen."""
    tracker = tracker_of()
    picture = PLAIN.copy()
    for frame in range(16):
        behind, front = crossing(frame, (10, 30), (3, 0)), crossing(frame, (90, 34), (-3, 0))
        picture[:] = 128
        for detection, grey in ((behind, 220), (front, 20)):
            picture[detection.box.slices][detection.mask] = grey
        observations = tracker.update(
            [joined([behind, front])] if frame > 10 else [behind, front],
            STILL_CAMERA,
            0.1,
            picture,
        )
    assert len(observations) == 2
    coasted = tracker.coast(STILL_CAMERA, (480, 864))
    assert [np.sign(each.velocity[0]) for each in coasted] == [-1.0, 1.0]


def test_what_was_not_found_comes_no_nearer_to_being_an_object_while_it_is_carried() -> None:
    tracker = tracker_of()
    first = only(update(tracker, [crossing(0, (30.0, 40.0), (3.0, 0.0))]))
    update(tracker, [])
    hits = first.track.hits
    assert tracker.coast(STILL_CAMERA, (200, 400)) == []
    assert first.track.hits == hits


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_whatever_is_seen_ids_and_slots_are_unique(seed: int) -> None:
    random = np.random.default_rng(seed)
    tracker = tracker_of(min_hits=2, false_alarms_per_hour=1e6, max_age=3)
    ids_of: dict[int, int] = {}
    tracks = []
    for _ in range(20):
        detections = [
            seen(
                random.uniform(0, 100),
                random.uniform(0, 100),
                (random.normal(0, 3), random.normal(0, 3)),
                width=int(size),
            )
            for size in random.integers(3, 30, random.integers(0, 5))
        ]
        observations = update(tracker, detections)
        np.testing.assert_array_equal(
            union_mask(o.detection for o in observations), union_mask(detections)
        )
        live = [o.track for o in observations if o.track.confirmed]
        slots = [track.slot for track in live if track.slot >= 0]
        assert len(slots) == len(set(slots))
        assert len({track.id for track in live}) == len(live)
        for track in live:
            tracks.append(track)
            assert ids_of.setdefault(id(track), track.id) == track.id
    # What was lost may have given its id to what appeared anew, and is not seen again then.
    turns = [track for track, _ in itertools.groupby(sorted(tracks, key=lambda each: each.id))]
    assert len(turns) == len({id(track) for track in tracks})


# Not a single one, see below.
POINTS = st.lists(st.tuples(st.floats(0, 1000), st.floats(0, 1000)), max_size=40).filter(
    lambda points: len(points) != 1
)


@settings(max_examples=30, deadline=None)
@given(points=POINTS, count=st.integers(1, 12))
def test_kmeans_gives_every_mask_an_id_up_to_k(
    points: list[tuple[float, float]], count: int
) -> None:
    centroids = [np.array(point) for point in points]
    ids = kmeans_ids(centroids, count)
    assert len(ids) == len(points)
    assert set(ids) <= set(range(1, count + 1))
    np.testing.assert_array_equal(kmeans_ids(centroids, count), ids)
    # What lies in one place is one object.
    of_place: dict[tuple[float, float], set[int]] = {}
    for point, identity in zip(np.asarray(points, np.float32).reshape(-1, 2), ids, strict=True):
        of_place.setdefault(tuple(point), set()).add(int(identity))
    assert all(len(found) == 1 for found in of_place.values())


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_kmeans_ids_are_those_of_the_clusters_drawn(count: int) -> None:
    random = np.random.default_rng(count)
    middles = [np.array([100.0 * k, 60.0 * (k % 2)]) for k in range(count)]
    centroids = [middle + random.normal(0, 5, 2) for _ in range(20) for middle in middles]
    ids = kmeans_ids(centroids, count).reshape(20, count)
    assert (ids == ids[0]).all()
    assert sorted(ids[0]) == list(range(1, count + 1))


def test_kmeans_splits_an_object_that_crosses_the_view() -> None:
    # As the paper's does: it goes by place, not by time.
    across = [np.array([10.0 * frame, 50.0]) for frame in range(20)]
    assert set(kmeans_ids(across, 2)) == {1, 2}


def test_kmeans_has_no_more_ids_than_there_are_places() -> None:
    ids = kmeans_ids([np.array([1.0, 1.0]), np.array([9.0, 9.0]), np.array([1.0, 1.0])], 7)
    assert ids[0] == ids[2] != ids[1]
    assert set(ids) == {1, 2}


def test_kmeans_of_a_single_mask_is_one_id() -> None:
    assert list(kmeans_ids([np.array([3.0, 4.0])], 2)) == [1]


def test_kmeans_of_nothing_is_nothing() -> None:
    assert kmeans_ids([], 3).shape == (0,)


def kmeans_clip(unifier: KMeansIds, *counts: int) -> list[list[Observation]]:
    """A clip with so many masks in each frame, all in places far apart."""
    clip = [
        unifier.update([seen(60 * k, 40) for k in range(count)], STILL_CAMERA, 0.1, PLAIN)
        for count in counts
    ]
    unifier.settle()
    return clip


def test_k_is_the_number_of_masks_that_frames_hold_most_often() -> None:
    clip = kmeans_clip(KMeansIds(slots=8), 2, 0, 2, 3, 2, 0, 0, 0, 0, 1)
    ids = {observation.track.id for frame in clip for observation in frame}
    assert ids == {1, 2}


def test_nothing_is_known_before_the_clip_has_ended() -> None:
    unifier = KMeansIds(slots=8)
    observations = [only(unifier.update([seen(5, 5)], STILL_CAMERA, 0.1, PLAIN)) for _ in range(3)]
    assert not any(observation.track.confirmed for observation in observations)
    unifier.settle()
    for observation in observations:
        assert observation.track.confirmed
        assert (observation.track.id, observation.track.slot) == (1, 0)


def test_the_next_clip_has_ids_of_its_own() -> None:
    unifier = KMeansIds(slots=8)
    first = kmeans_clip(unifier, 2, 2)
    second = kmeans_clip(unifier, 3, 3)
    assert {o.track.id for frame in first for o in frame} == {1, 2}
    assert {o.track.id for frame in second for o in frame} == {3, 4, 5}
    assert unifier.next_id == 6


def test_a_clip_without_masks_has_no_ids() -> None:
    unifier = KMeansIds(slots=8)
    assert kmeans_clip(unifier, 0, 0) == [[], []]
    assert unifier.next_id == 1


def test_a_clip_that_is_forgotten_gets_no_ids() -> None:
    unifier = KMeansIds(slots=8)
    (observation,) = unifier.update([seen(5, 5)], STILL_CAMERA, 0.1, PLAIN)
    unifier.reset()
    unifier.settle()
    assert not observation.track.confirmed
    assert unifier.next_id == 1


def passing_car(frame: int, *, beside: int, speed: int = 9) -> tuple[Detection, ByteImage]:
    """What no flow shows to move, outlined with its shadow in some frames, and that frame."""
    x, y, (height, width), shadow = 60 + frame * speed, 100, (24, 30), 30
    image = np.full((240, 640), 150, np.uint8)
    image[y : y + height, x : x + width] = texture((height, width), 2)
    image[y + height // 2 : y + height, x - shadow : x] = 90
    left = x - (beside if frame % 2 else 0)
    box = Box(left, y, x + width, y + height)
    mask = np.ones(box.shape, bool)
    mask[: height // 2, : x - left] = False
    return Detection(box, mask, (0.0, 0.0), True, flow_known=False), image[..., None]


@pytest.mark.parametrize("beside", [0, 30], ids=["alone", "with its shadow now and then"])
def test_what_flow_does_not_show_to_move_is_followed_by_its_picture(beside: int) -> None:
    tracker = tracker_of()
    for frame in range(9):
        detection, image = passing_car(frame, beside=beside)
        observation = only(tracker.update([detection], STILL_CAMERA, 0.1, image))
    assert observation.track.id == 1
    np.testing.assert_allclose(observation.velocity, (9.0, 0.0), atol=1.5)


def test_one_wrong_step_of_its_picture_is_no_way() -> None:
    detection, _ = passing_car(0, beside=0)
    track = Track.started(detection, 0.1)
    track.hits = 5
    track.steps = [np.array(step) for step in [(0.2, 0.0), (-0.1, 0.2), (14.0, 1.0), (0.1, -0.2)]]
    assert track.stepped is not None
    displacement, path_length = track.stepped
    assert displacement < 1.0
    assert path_length > 14.0


def test_a_picture_from_before_a_frame_that_was_not_looked_at_is_not_looked_for() -> None:
    tracker = tracker_of()
    for frame in range(9):
        detection, image = passing_car(frame, beside=0)
        track = only(tracker.update([detection], STILL_CAMERA, 0.1, image)).track
    assert track.template is not None
    tracker.coast(STILL_CAMERA, (240, 640))
    assert track.template is None
    detection, image = passing_car(10, beside=0)
    assert only(tracker.update([detection], STILL_CAMERA, 0.1, image)).track is track
    np.testing.assert_allclose(track.velocity, (9.0, 0.0), atol=1.5)


def test_what_flow_lost_is_followed_by_its_picture() -> None:
    tracker = tracker_of()
    for frame in range(8):
        detection, image = passing_car(frame, beside=0, speed=15)
        # So flow sees of it what lies beside.
        detection = replace(detection, flow_known=True, velocity=(5.0, 1.0))
        observation = only(tracker.update([detection], STILL_CAMERA, 0.1, image))
    np.testing.assert_allclose(observation.velocity, (15.0, 0.0), atol=1.0)
    assert min(observation.track.shape_ious[1:]) > 0.9


def test_what_flow_tells_is_not_looked_for() -> None:
    tracker = tracker_of()
    for frame in range(8):
        detection, image = passing_car(frame, beside=0, speed=2)
        detection = replace(detection, flow_known=True, velocity=(2.0, 0.0))
        track = only(tracker.update([detection], STILL_CAMERA, 0.1, image)).track
        assert track.template is None
