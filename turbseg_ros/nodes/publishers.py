"""Publishing of results."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable

import numpy as np
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from turbseg_ros.bag.schema import is_installed, message_class
from turbseg_ros.messages.results import Output
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.throttle import ThrottledLogger


class ResultPublisher:
    """Publishes each result on the topics of `outputs`, below the node's name.

    Reliably, which every subscription accepts, and so deep that a slow listener may catch up. An
    output that fails is logged by its name, throttled, and `on_incomplete` is told once for each
    result that some output failed of; the other outputs go out all the same.
    """

    def __init__(
        self,
        node: Node,
        outputs: Iterable[Output],
        on_incomplete: Callable[[], None] = lambda: None,
    ) -> None:
        self._throttled = ThrottledLogger(node.get_logger())
        self._on_incomplete = on_incomplete
        # That of the last result, without its image.
        self._last: Frame | None = None
        self._publishers = [
            (output, _publisher(node, output)) for output in outputs if _has_type(node, output)
        ]

    def publish(self, result: SegmentationResult) -> None:
        """Publish one result where someone listens; what is stateful, in any case."""
        frame = result.frame
        self._last = Frame(frame.stamp, np.zeros((1, 1), np.uint8), frame.frame_id)
        succeeded = [
            self._publish(output, publisher, result)
            for output, publisher in self._publishers
            if result.frame.image_wanted or not output.shows_image
        ]
        if not all(succeeded):
            self._on_incomplete()

    def remove_marks(self) -> None:
        """Take away what the last result left on viewers' screens."""
        last, self._last = self._last, None
        if last is None:
            return
        for output, publisher in self._publishers:
            for message in output.remove(last):
                publisher.publish(message)

    def _publish(self, output: Output, publisher: Publisher, result: SegmentationResult) -> bool:
        """Publish a result on one topic where it is asked for; return whether that went well."""
        try:
            if output.stateful or publisher.get_subscription_count():
                for message in output.build(result):
                    publisher.publish(message)
        except Exception:
            # Whatever it is, the other outputs may be sound.
            self._throttled.error(
                output.name, f"output {output.name} failed: {traceback.format_exc()}"
            )
            return False
        return True

    @property
    def listened(self) -> bool:
        """Whether someone listens to any result."""
        return any(publisher.get_subscription_count() for _, publisher in self._publishers)

    @property
    def image_wanted(self) -> bool:
        """Whether someone listens to what shows a frame's image."""
        return any(
            publisher.get_subscription_count()
            for output, publisher in self._publishers
            if output.shows_image
        )

    def wait_until_received(self, timeout: float) -> bool:
        """Wait until all listeners have acknowledged everything; False when time runs out.

        :param timeout: seconds.
        """
        deadline = time.monotonic() + timeout
        return all(
            publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
            for _, publisher in self._publishers
        )


def _has_type(node: Node, output: Output) -> bool:
    """Whether an output's type is installed; where it is not, the log says what is missing."""
    if is_installed(output.type_name):
        return True
    package = output.type_name.partition("/")[0]
    node.get_logger().info(
        f"~/{output.name} is not published: {package} is not installed "
        f"(apt install ros-$ROS_DISTRO-{package.replace('_', '-')})"
    )
    return False


def _publisher(node: Node, output: Output) -> Publisher:
    return node.create_publisher(
        message_class(output.type_name),
        f"~/{output.name}",
        QoSProfile(depth=output.depth, reliability=ReliabilityPolicy.RELIABLE),
        # A listener that asks for more is warned itself. To be warned here, too, rclpy would look
        # at two events of each topic whenever an image comes: 0.6 ms.
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )
