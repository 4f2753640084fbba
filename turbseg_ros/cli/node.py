"""`turbseg_node`: the live node as a process."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING

from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.memory import keep_large_buffers
from turbseg_ros.cli.parsers.node import build_parser
from turbseg_ros.presets import preset_path

if TYPE_CHECKING:
    from rclpy.executors import Executor

_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@executable("turbseg_node")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM, which end it well; return the exit status."""
    # From here on these signals only wake the thread that waits for them, wherever the process
    # is: importing rclpy, starting, working or ending. A second Ctrl-C changes nothing. Threads
    # started from here on inherit this, which is why NumPy is not imported any earlier.
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOP_SIGNALS)
    keep_large_buffers()

    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    command = sys.argv if arguments is None else [sys.argv[0], *arguments]
    try:
        options = build_parser().parse_args(remove_ros_args(command)[1:])
        if options.preset is not None:
            # Ahead of what else is given, which goes before it.
            preset = ["--ros-args", "--params-file", str(preset_path(options.preset)), "--"]
            command = [command[0], *preset, *command[1:]]
        rclpy.init(args=command, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise UsageError(str(error)) from error
    try:
        _run()
    finally:
        rclpy.try_shutdown()
    return 0


def _run() -> None:
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from turbseg_ros.nodes.segmentation_node import TurbsegNode

    node = TurbsegNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(
        target=_shut_down_on_signal, args=(executor,), name="signals", daemon=True
    ).start()
    try:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()
    finally:
        node.destroy_node()


def _shut_down_on_signal(executor: Executor) -> None:
    signal.sigwait(_STOP_SIGNALS)
    executor.create_task(executor.shutdown)
