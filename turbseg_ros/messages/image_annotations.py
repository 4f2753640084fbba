"""Outlines and names as `foxglove_msgs/ImageAnnotations`, whether that package is there or not.

Where it is installed, as its version has them: fields were added since the first for ROS 2 Jazzy.
Elsewhere in the layout that Jazzy's packages have now.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from turbseg_ros.messages.images import ns_to_stamp
from turbseg_ros.messages.layout import (
    Layout,
    installed_layout,
    layout_of_definitions,
    serialised_fields,
)
from turbseg_ros.overlay import colour_of, line_width, simplified_outlines, text_height
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

TYPE_NAME = "foxglove_msgs/msg/ImageAnnotations"
TYPE_HASH = "RIHS01_bc4e578b1ef80953415d6f966a4cab305c8a44c8b64fc405312b6f06a08fc45e"
"""What REP 2016 gives for the definitions below."""

DEFINITIONS = {
    TYPE_NAME: (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/CircleAnnotation[] circles\n"
        "foxglove_msgs/PointsAnnotation[] points\nfoxglove_msgs/TextAnnotation[] texts\n"
        "foxglove_msgs/KeyValuePair[] metadata\n"
    ),
    "foxglove_msgs/msg/CircleAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nfloat64 diameter\n"
        "float64 thickness\nfoxglove_msgs/Color fill_color\nfoxglove_msgs/Color outline_color\n"
        "foxglove_msgs/KeyValuePair[] metadata\n"
    ),
    "foxglove_msgs/msg/PointsAnnotation": (
        "builtin_interfaces/Time timestamp\nuint8 type\nfoxglove_msgs/Point2[] points\n"
        "foxglove_msgs/Color outline_color\nfoxglove_msgs/Color[] outline_colors\n"
        "foxglove_msgs/Color fill_color\nfloat64 thickness\n"
        "foxglove_msgs/KeyValuePair[] metadata\n"
    ),
    "foxglove_msgs/msg/TextAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring text\n"
        "float64 font_size\nfoxglove_msgs/Color text_color\nfoxglove_msgs/Color background_color\n"
        "foxglove_msgs/KeyValuePair[] metadata\n"
    ),
    "foxglove_msgs/msg/Point2": "float64 x\nfloat64 y\n",
    "foxglove_msgs/msg/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
    "foxglove_msgs/msg/KeyValuePair": "string key\nstring value\n",
}
"""The definition of the type, and of those of its package that it is made of."""

DEPENDENCIES = ("builtin_interfaces/msg/Time",)
"""What else it is made of."""

_LINE_LOOP = 2
# Of a font's size, the part above the base line; and pixels from a text to its object.
_CAPITALS, _ABOVE = 0.7, 3.0


@functools.cache
def _layout() -> Layout:
    time = {DEPENDENCIES[0]: "int32 sec\nuint32 nanosec\n"}
    return installed_layout(TYPE_NAME) or layout_of_definitions({**DEFINITIONS, **time})


def image_annotations(result: SegmentationResult, layout: Layout | None = None) -> bytes:
    """Return all outlines, and each object's id and speed above it, as a serialised message.

    :param layout: that of the type, by default that of the installed package or of Jazzy's.
    """
    stamp = _stamp(result.frame)
    height, width = result.labels.shape
    thickness, font_size = line_width(width), text_height(height) / _CAPITALS
    return serialised_fields(
        TYPE_NAME,
        {
            "timestamp": stamp,
            "points": [
                _loop(stamp, found, contour, thickness)
                for found in result.objects
                for contour in simplified_outlines(result.labels, found)
            ],
            "texts": [_text(stamp, found, font_size) for found in result.objects],
        },
        layout or _layout(),
    )


def no_annotations(frame: Frame) -> bytes:
    """Return what takes the annotations away when no more frames come after this one."""
    return serialised_fields(TYPE_NAME, {"timestamp": _stamp(frame)}, _layout())


def _loop(stamp: Any, found: MovingObject, contour: Any, thickness: float) -> dict[str, Any]:
    return {
        "timestamp": stamp,
        "type": _LINE_LOOP,
        "points": [_point(x + 0.5, y + 0.5) for x, y in contour.tolist()],
        "outline_color": _colour(found.id),
        "thickness": thickness,
    }


def _text(stamp: Any, found: MovingObject, font_size: float) -> dict[str, Any]:
    text = str(found.id)
    if (velocity := found.velocity_per_second) is not None:
        text += f" {math.hypot(*velocity):.0f} px/s"
    left, top = found.box[:2]
    return {
        "timestamp": stamp,
        # Of its lower left corner; above the picture nothing would be seen.
        "position": _point(left, max(top - _ABOVE, font_size)),
        "text": text,
        "font_size": font_size,
        "text_color": _colour(found.id),
    }


def _stamp(frame: Frame) -> dict[str, int]:
    stamp = ns_to_stamp(frame.stamp)
    return {"sec": stamp.sec, "nanosec": stamp.nanosec}


def _point(x: float, y: float) -> dict[str, float]:
    """Return a position, where (0, 0) is the corner of the first pixel, not its centre."""
    return {"x": x, "y": y}


def _colour(object_id: int) -> dict[str, float]:
    blue, green, red = colour_of(object_id)
    return {"r": red / 255.0, "g": green / 255.0, "b": blue / 255.0, "a": 1.0}
