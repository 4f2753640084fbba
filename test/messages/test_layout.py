"""Serialised by a layout, as rclpy does it with the message's class."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import ImageMarker

from turbseg_ros.messages.layout import (
    installed_layout,
    layout_of_definitions,
    serialised_fields,
)

NAME = "visualization_msgs/msg/ImageMarker"


def test_rclpy_reads_what_an_installed_layout_wrote() -> None:
    layout = installed_layout(NAME)
    assert layout is not None
    written = serialised_fields(
        NAME,
        {
            "header": {"stamp": {"sec": 3, "nanosec": 7}, "frame_id": "lens"},
            "ns": "outlines",
            "scale": 2.5,
            "filled": 1,
            "points": [{"x": 1.0, "y": -2.0}, {"z": 0.5}],
            "outline_colors": [{"g": 0.25, "a": 1.0}],
        },
        layout,
    )
    assert deserialize_message(written, ImageMarker) == ImageMarker(
        header=Header(stamp=Time(sec=3, nanosec=7), frame_id="lens"),
        ns="outlines",
        scale=2.5,
        filled=1,
        points=[Point(x=1.0, y=-2.0), Point(z=0.5)],
        outline_colors=[ColorRGBA(g=0.25, a=1.0)],
    )


def test_what_nobody_gave_is_empty_and_what_a_version_lacks_is_left_out() -> None:
    layout = installed_layout(NAME)
    assert layout is not None
    assert deserialize_message(serialised_fields(NAME, {}, layout), ImageMarker) == ImageMarker()
    time = "builtin_interfaces/msg/Time"
    of_definitions = layout_of_definitions({time: "int32 sec\nuint32 nanosec\n"})
    assert of_definitions == installed_layout(time)
    written = serialised_fields(time, {"sec": -1, "picosec": 4}, of_definitions)
    assert deserialize_message(written, Time) == Time(sec=-1)


@pytest.mark.parametrize("name", ["no_such_msgs/msg/Thing", "std_msgs/msg/NoSuchThing"])
def test_there_is_no_layout_of_what_is_not_installed(name: str) -> None:
    assert installed_layout(name) is None
