"""The live node around a `StubSegmenter`: `stub_node.py --cost S --fail-every N --ros-args`."""

from __future__ import annotations

import argparse
import signal
import sys
from unittest import mock


def run() -> int:
    """Run the node; return its exit status."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cost", type=float, default=0.0)
    parser.add_argument("--fail-every", type=int, default=0)
    options, ros_arguments = parser.parse_known_args()

    # As the node itself does before NumPy starts its threads.
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    from support.stub_segmenter import StubSegmenter
    from turbseg_ros.cli.node import main

    StubSegmenter.cost, StubSegmenter.fail_every = options.cost, options.fail_every
    with mock.patch("turbseg_ros.nodes.segmentation_node.motion_segmenter", StubSegmenter):
        return main(ros_arguments)


if __name__ == "__main__":
    sys.exit(run())
