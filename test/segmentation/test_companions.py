"""Parts of one object that were given ids of their own."""

from __future__ import annotations

from collections.abc import Sequence

from support.detections import PLAIN, STILL_CAMERA, seen
from turbseg_ros.segmentation.kalman_tracker import KalmanTracker
from turbseg_ros.segmentation.track import Detection

VELOCITY = (4.0, 0.0)
APART, TOUCHING = range(6), range(6, 36)


def rectangle(x: float, width: int) -> Detection:
    return seen(x, 100, VELOCITY, width=width, height=20)


def seen_ids(frames: Sequence[Sequence[Detection]]) -> list[set[int]]:
    """Return the ids that are seen in each frame."""
    tracker = KalmanTracker(min_hits=4, false_alarms_per_hour=1.0, max_age=10, slots=3)
    ids = []
    for detections in frames:
        observations = tracker.update(detections, STILL_CAMERA, 0.1, PLAIN)
        ids.append({each.track.id for each in observations if each.track.confirmed})
    return ids


def test_what_was_never_seen_apart_from_an_older_object_becomes_a_part_of_it() -> None:
    way = [10 + 4 * frame for frame in range(36)]
    in_two = [[rectangle(way[frame], 20), rectangle(way[frame] + 22, 40)] for frame in APART]
    in_one = [[rectangle(way[frame], 62)] for frame in TOUCHING]
    ids = seen_ids([*in_two, *in_one])
    assert ids[APART[-1]] == {1, 2}
    assert ids[-1] == {1}


def test_two_that_were_apart_stay_two_however_long_they_touch() -> None:
    way = [10 + 4 * frame for frame in range(36)]
    gaps = [12 - 2 * frame for frame in APART]
    in_two = [
        [rectangle(way[frame], 30), rectangle(way[frame] + 30 + gap, 30)]
        for frame, gap in zip(APART, gaps, strict=True)
    ]
    in_one = [[rectangle(way[frame], 60)] for frame in TOUCHING]
    ids = seen_ids([*in_two, *in_one])
    assert ids[-1] == {1, 2}


def test_two_that_go_otherwise_stay_two_though_they_always_touched() -> None:
    way = [10 + 4 * frame for frame in range(36)]
    in_two = [[rectangle(way[frame], 30), rectangle(way[frame] + 31, 30)] for frame in APART]
    # The one in front is slower: one outline gets shorter from frame to frame.
    in_one = [[rectangle(way[frame], 61 - (frame - APART.stop))] for frame in TOUCHING]
    ids = seen_ids([*in_two, *in_one[:20]])
    assert ids[-1] == {1, 2}
