"""Outlines and names for Foxglove: what another library reads, in each version's layout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from turbseg_ros.bag.schema import message_definition
from turbseg_ros.messages.image_annotations import (
    DEFINITIONS,
    TYPE_HASH,
    TYPE_NAME,
    image_annotations,
    no_annotations,
)
from turbseg_ros.messages.layout import layout_of_definitions
from turbseg_ros.overlay import colour_of
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

STAMP = 3_000_000_007
TIME = {"builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n"}
# As foxglove_msgs was before 3.3: without what was added ahead of the other fields and after.
OLDER = {
    name: "".join(
        line + "\n"
        for line in text.splitlines()
        if "KeyValuePair" not in line and not (name == TYPE_NAME and "Time" in line)
    )
    for name, text in DEFINITIONS.items()
}


def store_of(definitions: Mapping[str, str]) -> Any:
    """Return the message types as the rosbags library understands definitions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for name, text in definitions.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


def result(*boxes: tuple[int, int, int, int]) -> SegmentationResult:
    """Rectangles on a 90x60 frame, with ids from 1 on."""
    labels = np.zeros((60, 90), np.uint16)
    objects = []
    for number, (x, y, width, height) in enumerate(boxes, 1):
        labels[y : y + height, x : x + width] = number
        objects.append(
            MovingObject(
                id=number,
                slot=number - 1,
                centroid=(x + (width - 1) / 2, y + (height - 1) / 2),
                velocity=(3.0, -4.0),
                area=width * height,
                box=(x, y, width, height),
                trail=(),
            )
        )
    return SegmentationResult(
        frame=Frame(STAMP, np.zeros((60, 90), np.uint8), "camera"),
        labels=labels,
        objects=tuple(objects),
        motion_map=np.zeros((30, 45), np.float32),
        tilt=0.3,
        ego_motion_model="affine",
    )


@pytest.mark.parametrize("definitions", [DEFINITIONS, OLDER])
def test_another_library_reads_outlines_and_names(definitions: Mapping[str, str]) -> None:
    found = result((5, 7, 10, 8), (70, 40, 20, 20))
    layout = layout_of_definitions({**definitions, **TIME})
    message = store_of(definitions).deserialize_cdr(image_annotations(found, layout), TYPE_NAME)
    assert not message.circles
    first, second = message.points
    assert first.type == 2  # LINE_LOOP
    # The pixel at (5, 7) has its centre half a pixel from its corner.
    corners = {(point.x, point.y) for point in first.points}
    assert corners == {(5.5, 7.5), (14.5, 7.5), (14.5, 14.5), (5.5, 14.5)}
    blue, green, red = colour_of(2)
    colour = second.outline_color
    assert (colour.r, colour.g, colour.b, colour.a) == (red / 255, green / 255, blue / 255, 1.0)
    assert first.fill_color.a == 0.0
    for each in (*message.points, *message.texts):
        assert (each.timestamp.sec, each.timestamp.nanosec) == (3, 7)
    assert [text.text for text in message.texts] == ["1", "2"]
    assert message.texts[1].position.x == 70.0
    assert all(text.position.y >= text.font_size for text in message.texts)


@pytest.mark.parametrize(("size", "thickness"), [((60, 90), 2.0), ((1080, 1920), 4.0)])
def test_lines_and_letters_go_by_the_pictures_size(
    size: tuple[int, int], thickness: float
) -> None:
    small = result((5, 40, 10, 8))
    labels = np.zeros(size, np.uint16)
    labels[40:48, 5:15] = 1
    message = store_of(DEFINITIONS).deserialize_cdr(
        image_annotations(replace(small, labels=labels)), TYPE_NAME
    )
    assert message.points[0].thickness == thickness
    assert message.texts[0].font_size == pytest.approx(np.clip(size[0] / 28, 9, 30) / 0.7)


def test_names_tell_the_speed_where_it_is_known() -> None:
    found = result((5, 7, 10, 8))
    found = replace(found, objects=(replace(found.objects[0], period=0.1),))
    (text,) = store_of(DEFINITIONS).deserialize_cdr(image_annotations(found), TYPE_NAME).texts
    assert text.text == "1 50 px/s"


def test_without_objects_or_at_the_end_of_a_stream_nothing_is_drawn() -> None:
    for serialised in (image_annotations(result()), no_annotations(result().frame)):
        message = store_of(DEFINITIONS).deserialize_cdr(serialised, TYPE_NAME)
        assert not message.points
        assert not message.texts
        assert (message.timestamp.sec, message.timestamp.nanosec) == (3, 7)


def test_bags_carry_the_definition_and_its_hash() -> None:
    assert store_of(DEFINITIONS).hash_rihs01(TYPE_NAME) == TYPE_HASH
    definition = message_definition(TYPE_NAME)
    assert definition.type_hash == TYPE_HASH
    read = get_types_from_msg(definition.text, TYPE_NAME)
    assert DEFINITIONS.keys() <= read.keys()
