"""Boxes as `vision_msgs/Detection2DArray`, whether that package is installed or not.

The layout is that of vision_msgs 4 (ROS 2 Humble to Jazzy).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from std_msgs.msg import Header

from turbseg_ros.messages.cdr import FieldReader, FieldWriter, SerialisedDataError
from turbseg_ros.messages.images import stamp_to_ns

Box = tuple[float, float, float, float]
"""Left, top, width and height, in pixels; (0, 0) is the corner of the image."""

TYPE_NAME = "vision_msgs/msg/Detection2DArray"
TYPE_HASH = "RIHS01_214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968"
"""What REP 2016 gives for the definitions below."""

DEFINITIONS = {
    TYPE_NAME: "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id\n"
    ),
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/BoundingBox2D": (
        "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n"
    ),
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
}
"""The definition of the type, and of those of its package that it is made of."""

DEPENDENCIES = (
    "std_msgs/msg/Header",
    "builtin_interfaces/msg/Time",
    "geometry_msgs/msg/PoseWithCovariance",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/Point",
    "geometry_msgs/msg/Quaternion",
)
"""What else it is made of."""

IGNORED = "ignored"
"""The class of what is neither an object nor false when it is found."""

# Away from a picture's corner; far beyond any picture.
_MAX_PIXELS = 1e9
# A PoseWithCovariance: position, orientation and covariance.
_POSE_NUMBERS = 3 + 4 + 36


@dataclass(frozen=True)
class Detection:
    """A box, the object that it belongs to, and what that is, where it is known."""

    box: Box
    id: str
    class_id: str = ""
    score: float = 1.0


def is_box(numbers: Sequence[float]) -> bool:
    """Whether a point, a width and a height make a box of a picture: finite, and none negative.

    Sums of what is near the end of the numbers' range would be infinite.
    """
    return all(abs(number) < _MAX_PIXELS for number in numbers) and min(numbers[2:]) >= 0.0


def serialised_detections(
    detections: Sequence[Detection], stamp_ns: int, frame_id: str = ""
) -> bytes:
    """Return boxes as a serialised message; the stamp is in nanoseconds."""
    header = Header(frame_id=frame_id)
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 10**9)
    fields = FieldWriter()
    fields.header(header)
    fields.number("I", len(detections))
    for detection in detections:
        fields.header(header)
        fields.number("I", 1)
        fields.text(detection.class_id)
        # Its score, and no pose: a position of 0, an orientation of 1.
        for value in (detection.score, *(0.0,) * 6, 1.0, *(0.0,) * 36):
            fields.number("d", value)
        left, top, width, height = detection.box
        for value in (left + width / 2, top + height / 2, 0.0, width, height):
            fields.number("d", value)
        fields.text(detection.id)
    return fields.serialised()


def detections_from(serialised: memoryview) -> tuple[int, tuple[Detection, ...]]:
    """Return the stamp, in nanoseconds, and the boxes of a serialised message.

    Of several hypotheses on one the surest stands, of a box that is rotated the upright one
    around it.

    :raises SerialisedDataError: when it is no such message.
    """
    fields = FieldReader(serialised)
    stamp = stamp_to_ns(fields.header().stamp)
    return stamp, tuple(_detection(fields) for _ in range(fields.number("I")))


def _detection(fields: FieldReader) -> Detection:
    fields.header()
    score, class_id = -math.inf, ""
    for _ in range(fields.number("I")):
        its_class, its_score = fields.text(), fields.real()
        score, class_id = max((score, class_id), (its_score, its_class))
        for _ in range(_POSE_NUMBERS):
            fields.real()
    x, y, theta, width, height = (fields.real() for _ in range(5))
    if not math.isfinite(theta) or not is_box((x, y, width, height)):
        raise SerialisedDataError("a box is smaller than nothing, or beyond any picture")
    cosine, sine = abs(math.cos(theta)), abs(math.sin(theta))
    upright = width * cosine + height * sine, width * sine + height * cosine
    box = (x - upright[0] / 2, y - upright[1] / 2, *upright)
    return Detection(box, fields.text(), class_id, 1.0 if score == -math.inf else score)
