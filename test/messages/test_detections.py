"""Boxes as messages: what other libraries read of them, and what is refused."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from turbseg_ros.messages.cdr import SerialisedDataError
from turbseg_ros.messages.detections import (
    DEFINITIONS,
    TYPE_HASH,
    TYPE_NAME,
    Detection,
    detections_from,
    serialised_detections,
)

STAMP = 3_000_000_007
NUMBERS = st.floats(0.0, 1e4)
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
DETECTIONS = st.builds(
    Detection, st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), TEXTS, TEXTS, st.floats(0.0, 1.0)
)


def other_library():
    """Return the message types as the rosbags library understands our definitions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for name, text in DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


STORE = other_library()


@given(st.lists(DETECTIONS, max_size=3))
def test_another_library_reads_what_was_written(detections: list[Detection]) -> None:
    message = STORE.deserialize_cdr(serialised_detections(detections, STAMP, "lens"), TYPE_NAME)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
    assert message.header.frame_id == "lens"
    for written, read in zip(detections, message.detections, strict=True):
        left, top, width, height = written.box
        assert read.bbox.center.position.x == left + width / 2
        assert read.bbox.center.position.y == top + height / 2
        assert (read.bbox.size_x, read.bbox.size_y) == (width, height)
        (result,) = read.results
        assert (result.hypothesis.class_id, result.hypothesis.score) == (
            written.class_id,
            written.score,
        )
        assert read.id == written.id


@given(st.lists(DETECTIONS, max_size=3))
def test_boxes_come_back_as_they_were(detections: list[Detection]) -> None:
    stamp, read = detections_from(memoryview(serialised_detections(detections, STAMP)))
    assert stamp == STAMP
    for before, after in zip(detections, read, strict=True):
        assert after.box == pytest.approx(before.box)
        assert (after.id, after.class_id, after.score) == (
            before.id,
            before.class_id,
            before.score,
        )


def test_the_hash_is_that_of_the_definitions() -> None:
    assert STORE.hash_rihs01(TYPE_NAME) == TYPE_HASH


def test_of_several_hypotheses_the_surest_counts_and_rotated_boxes_stand_upright() -> None:
    kinds = {name: STORE.types[name] for name in STORE.types}
    written = STORE.deserialize_cdr(
        serialised_detections([Detection((8, 9, 4, 2), "7", "car", 0.4)], STAMP), TYPE_NAME
    )
    (detection,) = written.detections
    detection.bbox.center.theta = math.pi / 2
    surer = kinds["vision_msgs/msg/ObjectHypothesis"](class_id="van", score=0.5)
    detection.results.append(
        kinds["vision_msgs/msg/ObjectHypothesisWithPose"](surer, detection.results[0].pose)
    )
    _, (read,) = detections_from(memoryview(STORE.serialize_cdr(written, TYPE_NAME)))
    assert read.box == pytest.approx((9, 8, 2, 4))
    assert (read.id, read.class_id, read.score) == ("7", "van", 0.5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 1.7e308])
def test_boxes_that_are_none_are_refused(value: float) -> None:
    box = (0.0, 0.0, value, 1.0)
    with pytest.raises(SerialisedDataError):
        detections_from(memoryview(serialised_detections([Detection(box, "1")], STAMP)))


def test_cut_messages_are_refused() -> None:
    whole = serialised_detections([Detection((1, 2, 3, 4), "1")], STAMP)
    for length in range(len(whole)):
        with pytest.raises(SerialisedDataError):
            detections_from(memoryview(whole[:length]))
