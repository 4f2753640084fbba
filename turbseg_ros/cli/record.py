"""`turbseg_record`: bags of a running node, only while something moves."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from turbseg_ros.bag.episodes import Episodes
from turbseg_ros.cli.errors import UsageError, executable, stopping_at_signals
from turbseg_ros.cli.outputs import check_folder
from turbseg_ros.cli.parsers.record import build_parser
from turbseg_ros.nodes.episode_recorder import EpisodeRecorder

_MEGABYTE = 1_000_000
# Seconds after which a signal is looked for.
_STEP = 0.1


@executable("turbseg_record")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable until SIGINT or SIGTERM, which end the bag well; return its status."""
    command = sys.argv if arguments is None else ["turbseg_record", *arguments]
    try:
        options = build_parser().parse_args(remove_ros_args(command)[1:])
        check_folder(options.out)
        rclpy.init(args=command, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # ROS arguments that can't be
        raise UsageError(str(error)) from error
    episodes = Episodes(
        options.out,
        pre_roll=options.pre_roll,
        post_roll=options.post_roll,
        max_bytes=options.memory * _MEGABYTE,
        max_seconds=options.split,
        on_begin=lambda path: print(f"{path}: recording", flush=True),
        on_end=_tell_end,
    )
    with stopping_at_signals("turbseg_record") as stop:
        try:
            recorder = EpisodeRecorder(episodes, _full_name(options.node), options.topics)
            while not stop.received:
                recorder.spin_once(_STEP)
            recorder.take_waiting()
            recorder.destroy_node()
            episodes.close()
        finally:
            rclpy.try_shutdown()
    return 0


def _full_name(node: str) -> str:
    return node if node.startswith("/") else f"/{node}"


def _tell_end(path: Path, messages: int) -> None:
    print(f"{path}: {messages} messages", flush=True)
