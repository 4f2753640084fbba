"""The ROS side of the viewer: listens to a node, and speaks to its parameter services."""

from __future__ import annotations

import functools
import queue
import time
from concurrent.futures import Future
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name
from sensor_msgs.msg import CompressedImage, Image
from visualization_msgs.msg import ImageMarker, MarkerArray

from turbseg_ros.messages.images import ImageConversionError, frame_from_serialised
from turbseg_ros.view.live_parameters import LiveParameters
from turbseg_ros.view.markers import ResultJoiner
from turbseg_ros.view.pictures import Jpeg, JpegEncoder, Pace, WaitingPictures
from turbseg_ros.view.state import Result, Status, ViewState

_STATUS_SUFFIX = ": segmentation"
_LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warn",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "error",
}
# How soon a browser that comes gets a picture, and a parameter is set, in seconds.
_TICK = 0.1
# Results that wait for pictures: ~/overlay comes after them.
_RECENT = 30
# What is older than these when a viewer is slow is of no interest.
_IMAGE_DEPTH = 2
# A viewer that hangs must cost its node nothing: unreliable, and newest first.
_RESULTS = QoSProfile(depth=30, reliability=ReliabilityPolicy.BEST_EFFORT)


class Viewer(Node):  # type: ignore[misc]  # rclpy is read as untyped
    """Tells `state` what a node publishes; images only while somebody looks.

    The picture is made of the camera's own images, so that a viewer costs the node no more than a
    message with outlines. Where no result has an image's stamp, because the node had to replace
    the camera's, it is `~/overlay`, which the node draws.

    :param node_name: full name of the node; "": that which is heard first.
    :param rate: most pictures a second.
    :param width: largest width of pictures in pixels.
    :param context: by default, rclpy's own.
    """

    def __init__(
        self,
        state: ViewState,
        *,
        node_name: str = "",
        rate: float = 15.0,
        width: int = 1280,
        context: Context | None = None,
    ) -> None:
        super().__init__("turbseg_view", context=context)
        self._state = state
        self._name = node_name
        self._encoder_width = width
        self._encoder = JpegEncoder(width)
        self._pace = Pace(rate)
        self._joiner = ResultJoiner()
        self._pictures = WaitingPictures()
        # Results by stamps, whose pictures may still come.
        self._recent: dict[int, Result] = {}
        self._watched = False
        self._draws_overlay = False
        self._input_topic = ""
        self._chosen: tuple[str, ReliabilityPolicy] | None = None
        self._images: Subscription | None = None
        self._results: list[Subscription] = []
        self._parameters: LiveParameters | None = None
        self._commands: queue.SimpleQueue[tuple[str, object, Future[str]]] = queue.SimpleQueue()
        self._diagnostics = self.create_subscription(
            DiagnosticArray, "/diagnostics", self._take_diagnostics, 10
        )
        # Goes on where the time of /clock stands still.
        self.create_timer(_TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if node_name:
            self._follow(node_name)

    def watch(self, watched: bool) -> None:
        """Say whether somebody looks at pictures; any thread may."""
        self._watched = watched

    def set_parameter(self, name: str, value: object) -> Future[str]:
        """Change a parameter of the node; any thread may.

        :return: gives the reason why not, "" when it has changed.
        """
        answer: Future[str] = Future()
        self._commands.put((name, value, answer))
        return answer

    def _follow(self, name: str) -> None:
        self._name = name
        self._results = [
            self.create_subscription(
                MarkerArray, f"{name}/centroids", self._take_markers, _RESULTS
            ),
            self.create_subscription(
                ImageMarker, f"{name}/annotations", self._take_annotations, _RESULTS
            ),
        ]
        self._parameters = LiveParameters(self, name, self._state.tell_parameters)

    def _tick(self) -> None:
        if self._parameters is not None:
            self._parameters.look()
        while not self._commands.empty():
            name, value, answer = self._commands.get()
            if self._parameters is None:
                answer.set_result("the node was not heard yet")
                continue
            self._parameters.set(name, value).add_done_callback(
                functools.partial(_hand_on, answer)
            )
        if self._pictures.are_in_vain and not self._draws_overlay:
            self.get_logger().info(
                f"results have other stamps than {self._input_topic}: looking at ~/overlay"
            )
            self._draws_overlay = True
        self._choose_images()

    def _choose_images(self) -> None:
        """Subscribe to the images that are to be seen now, if any are."""
        topic = ""
        if self._watched and self._name and self._state.is_there:
            topic = f"{self._name}/overlay" if self._draws_overlay else self._input_topic
        wanted = (topic, self._reliability(topic)) if topic else None
        if wanted == self._chosen:
            return
        if self._images is not None:
            self.destroy_subscription(self._images)
            self._images = None
        self._chosen = wanted
        self._pictures.clear()
        self._encoder = JpegEncoder(self._encoder_width)
        if wanted is not None:
            kind = CompressedImage if topic.endswith("/compressed") else Image
            self._images = self.create_subscription(
                kind,
                topic,
                functools.partial(self._take_image, topic, kind),
                QoSProfile(depth=_IMAGE_DEPTH, reliability=wanted[1]),
                raw=True,
            )

    def _reliability(self, topic: str) -> ReliabilityPolicy:
        """Return reliable where all publishers offer it: of large images the other loses most."""
        offered = [
            info.qos_profile.reliability for info in self.get_publishers_info_by_topic(topic)
        ]
        if offered and all(each == ReliabilityPolicy.RELIABLE for each in offered):
            return ReliabilityPolicy.RELIABLE
        return ReliabilityPolicy.BEST_EFFORT

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not status.name.endswith(_STATUS_SUFFIX):
                continue
            name = status.name.removesuffix(_STATUS_SUFFIX)
            if not _is_name(name):
                continue  # of something else that is called so
            if not self._name:
                self._follow(name)
            if name != self._name:
                self._state.tell_other(name)
                continue
            figures = {value.key: value.value for value in status.values}
            topic = figures.get("input topic", "")
            if not _is_name(topic):
                topic = ""
            if topic != self._input_topic:
                self._input_topic, self._draws_overlay = topic, False
            level = _LEVELS.get(status.level, "error")
            self._state.tell_status(Status(name, level, status.message, figures))

    def _take_markers(self, message: MarkerArray) -> None:
        self._take_result(self._joiner.add_markers(message))

    def _take_annotations(self, message: ImageMarker) -> None:
        if message.action == ImageMarker.REMOVE:
            self._joiner.clear()
            self._state.end_results()
            return
        self._take_result(self._joiner.add_annotations(message))

    def _take_result(self, result: Result | None) -> None:
        if result is None:
            return
        self._state.tell_result(result)
        picture = self._pictures.take(result.stamp)
        if picture is not None:
            self._show(picture, result)
            return
        self._recent[result.stamp] = result
        while len(self._recent) > _RECENT:
            del self._recent[next(iter(self._recent))]

    def _show(self, picture: Jpeg, result: Result) -> None:
        self._state.tell_picture(picture.data, picture.size, result, self._draws_overlay)

    def _take_image(self, topic: str, kind: type[Any], message: bytes) -> None:
        if not self._pace.lets_through(time.monotonic()):
            return
        try:
            frame = frame_from_serialised(memoryview(message), kind)
        except ImageConversionError as error:
            self._state.tell_picture_problem(f"{topic}: {error}")
            return
        picture = self._encoder.encode(frame.image)
        result = self._recent.get(frame.stamp)
        if result is None:
            self._pictures.add(frame.stamp, picture)
        else:
            self._show(picture, result)


def _is_name(name: str) -> bool:
    """Whether it can be the full name of a node or topic."""
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException:
        return False
    return True


def _hand_on(answer: Future[str], done: Future[str]) -> None:
    if answer.set_running_or_notify_cancel():
        answer.set_result(done.result())
