"""Publishing of results."""

from __future__ import annotations

import time
from collections.abc import Iterable

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from turbseg_ros.messages.results import Output
from turbseg_ros.segmentation.frame import SegmentationResult


class ResultPublisher:
    """Publishes each result on the topics of `outputs`, below the node's name.

    Reliably, which every subscription accepts, and so deep that a slow listener may catch up.
    """

    def __init__(self, node: Node, outputs: Iterable[Output]) -> None:
        self._publishers = [(output, _publisher(node, output)) for output in outputs]

    def publish(self, result: SegmentationResult) -> None:
        """Publish one result where someone listens; what is stateful, in any case."""
        for output, publisher in self._publishers:
            if output.shows_image and not result.frame.image_wanted:
                continue
            if output.stateful or publisher.get_subscription_count():
                publisher.publish(output.build(result))

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


def _publisher(node: Node, output: Output) -> Publisher:
    return node.create_publisher(
        output.type,
        f"~/{output.name}",
        QoSProfile(depth=output.depth, reliability=ReliabilityPolicy.RELIABLE),
        # A listener that asks for more is warned itself. To be warned here, too, rclpy would look
        # at two events of each topic whenever an image comes: 0.6 ms.
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )
