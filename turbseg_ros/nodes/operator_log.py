"""What the log tells a person of the node's input and of what it sees, in few lines."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rclpy.qos import (
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from turbseg_ros.messages.cdr import compressed_image_view, image_view
from turbseg_ros.messages.events import Event
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.throttle import ThrottledLogger

IMAGE_TYPE, COMPRESSED_TYPE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_COMPRESSED = "/compressed"

# Seconds without an image after which the log says so.
_SILENCE = 3.0
# Topics that are named at most.
_MAX_TOPICS = 8
# Share of letters in common from which a name may be a misspelt one.
_ALIKE = 0.8
# Lines about objects, and about the camera, in so many seconds.
_MAX_EVENT_LINES, _EVENT_PERIOD = 5, 10.0


def first_image_text(serialised: memoryview, frame: Frame, compressed: bool) -> str:
    """Return the line about the first image: size, encoding and frame id."""
    height, width = frame.shape
    encoding = (
        compressed_image_view(serialised).format if compressed else image_view(serialised).encoding
    )
    return f"first image: {width}x{height} {encoding!r}, frame_id {frame.frame_id!r}"


def mismatch_text(topic: str, wanted: str, carried: Sequence[str]) -> str:
    """Return what is wrong with a topic that carries other types than the one wanted.

    Empty where the wanted type is among them, or there is none. Where the other transport takes
    them, the text says how.
    """
    if not carried or wanted in carried:
        return ""
    text = f"{topic} carries {', '.join(carried)}, not {wanted}"
    if {*carried} & {IMAGE_TYPE, COMPRESSED_TYPE}:
        text += f"; take it with {_arguments(topic, carried)}"
    return text


def missing_image_text(
    topic: str,
    wanted: str,
    reliability: str,
    published: Mapping[str, Sequence[str]],
    incompatible: str = "",
) -> str:
    """Return why no image may come, and where images are.

    :param wanted: the type that is subscribed to.
    :param published: types by topic, of what others publish.
    :param incompatible: what is asked of the topic's publishers that they don't offer, and what
        to set; empty where they offer all.
    """
    carried = published.get(topic, ())
    if wanted in carried:
        if incompatible:
            return incompatible
        reason = f"it is published, but nothing arrives (asked for as {reliability})"
    else:
        reason = mismatch_text(topic, wanted, carried) or "nobody publishes it"
    images = {
        name: types
        for name, types in published.items()
        if name != topic and {*types} & {IMAGE_TYPE, COMPRESSED_TYPE}
    }
    if not images:
        if carried:
            return reason
        return f"{reason}, nor any other image: does the camera run, in this ROS_DOMAIN_ID?"
    # One of much the same name is most likely the one that is meant, then a camera's own.
    alike = difflib.get_close_matches(topic, images, n=1, cutoff=_ALIKE)
    names = sorted(images, key=lambda name: (name not in alike, not _is_raw(name), name))
    listed = ", ".join(f"{name} ({', '.join(images[name])})" for name in names[:_MAX_TOPICS])
    more = f" and {len(names) - _MAX_TOPICS} more" if len(names) > _MAX_TOPICS else ""
    first = names[0]
    return f"{reason}; image topics: {listed}{more}; {_arguments(first, images[first])} takes it"


def incompatible_text(
    topic: str, asked: QoSProfile, offered: Iterable[QoSProfile], forced: bool
) -> str:
    """Return what a subscription asks for that no publisher of its topic offers, and what to set.

    Empty where some publisher offers all.

    :param forced: whether qos.reliability forces what is asked for, not an override of ROS.
    """
    text = ""
    for profile in offered:
        compatibility, reason = qos_check_compatible(profile, asked)
        if compatibility != QoSCompatibility.ERROR:
            return ""
        text = f"its publishers offer another QoS than is asked for: {reason}"
        if asked.reliability == ReliabilityPolicy.RELIABLE != profile.reliability:
            setting = (
                "qos.reliability:=auto"
                if forced
                else f"qos_overrides.{topic}.subscription.reliability:=best_effort"
            )
            text = (
                "its publishers offer best_effort, not reliable, so none is heard; "
                f"-p {setting} takes it"
            )
    return text


def _is_raw(topic: str) -> bool:
    return topic.removesuffix(_COMPRESSED).endswith("/image_raw")


def _arguments(topic: str, types: Sequence[str]) -> str:
    """Return the arguments with which the node takes the images of a topic."""
    transport = "raw" if IMAGE_TYPE in types else "compressed"
    if transport == "compressed" and not topic.endswith(_COMPRESSED):
        below = f"{topic}{_COMPRESSED}"
        return f"-r image_raw:={topic} -p image_transport:=compressed -r {below}:={topic}"
    base = topic if transport == "raw" else topic.removesuffix(_COMPRESSED)
    return f"-r image_raw:={base} -p image_transport:={transport}"


class InputWatch:
    """Warns once when no image comes, again when there is something else to say of it."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._said = ""
        self._received = 0

    def check(
        self,
        topic: str,
        silence: float,
        timeout: float,
        received: int,
        explain: Callable[[], str],
    ) -> None:
        """Take note of how long, in seconds, no image has come; to be called regularly.

        :param timeout: seconds that images may be apart.
        :param received: images that have come so far.
        :param explain: returns why none may come; called only while none does.
        """
        if silence < max(_SILENCE, timeout):
            # The first image is told of elsewhere.
            if self._said and self._received:
                self._logger.info(f"images come again on {topic}")
            self._said, self._received = "", received
            return
        reason = explain()
        if reason != self._said:
            self._logger.warning(f"no image on {topic} for {silence:.0f} s: {reason}")
        self._said = reason


class EventLog:
    """Tells the log what happens: of objects in a few lines in some seconds, and a count.

    What the camera does has lines of its own, so that many objects don't hide it.
    """

    def __init__(self, logger: ThrottledLogger) -> None:
        self._logger = logger

    @classmethod
    def on(cls, logger: Any) -> EventLog:
        """Make one that writes to a ROS logger."""
        return cls(ThrottledLogger(logger, period=_EVENT_PERIOD, burst=_MAX_EVENT_LINES))

    def add(self, event: Event) -> None:
        """Take note of something that happened."""
        self._logger.info("camera" if event.seen is None else "objects", event.text)

    def catch_up(self) -> None:
        """Tell how much was left out, once that may be told; to be called regularly."""
        self._logger.catch_up("objects", "more happened to objects")
        self._logger.catch_up("camera", "more happened to the camera")
