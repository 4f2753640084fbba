"""Publishing of results."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from turbseg_ros.ros.messages import Output
from turbseg_ros.segmentation.frame import SegmentationResult

# Reliable, which every subscription accepts; results that a slow listener may catch up on.
_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class ResultPublisher:
    """Publishes each result on the topics of `outputs`, below the node's name."""

    def __init__(self, node: Node, outputs: Iterable[Output]) -> None:
        self._publishers = [
            (output, node.create_publisher(output.type, f"~/{output.name}", _QOS))
            for output in outputs
        ]

    def publish(self, result: SegmentationResult) -> None:
        """Publish one result; what is made on demand only where someone listens."""
        for output, publisher in self._publishers:
            if output.on_demand and not publisher.get_subscription_count():
                continue
            publisher.publish(output.build(result))
