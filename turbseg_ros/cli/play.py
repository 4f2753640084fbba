"""`turbseg_play`: publishes a bag, where there is no `ros2 bag play`."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.errors import Interrupted, UsageError, executable
from turbseg_ros.cli.options import section_from
from turbseg_ros.cli.parsers.play import build_parser
from turbseg_ros.nodes.player import Player, Timeline, lossless_qos, recorded_qos
from turbseg_ros.throttle import ThrottledLogger

# How long subscribers may take to acknowledge the last messages, in seconds.
_ACKNOWLEDGEMENT = 10.0


@executable("turbseg_play")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    command = sys.argv if arguments is None else ["turbseg_play", *arguments]
    with contextlib.suppress(Interrupted):  # how a loop ends
        _run(command)
    return 0


def _run(command: Sequence[str]) -> None:
    try:
        options = build_parser().parse_args(remove_ros_args(command)[1:])
        if options.clock and options.stamp_now:
            raise UsageError(
                "--clock publishes the bag's time and --stamp-now another one; choose one of them"
            )
        reader = BagReader(options.bag, section_from(options))
        rclpy.init(args=command, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # ROS arguments that can't be
        raise UsageError(str(error)) from error
    try:
        timeline = Timeline(options.rate, paused=options.start_paused)
        player = Player(
            reader,
            timeline,
            topics=options.topics,
            clock=options.clock,
            stamp_now=options.stamp_now,
            qos=recorded_qos if options.recorded_qos else lossless_qos,
        )
        try:
            _play(player, options)
        finally:
            player.destroy_node()
    finally:
        rclpy.try_shutdown()


def _play(player: Player, options: argparse.Namespace) -> None:
    log = player.get_logger()
    throttled = ThrottledLogger(log)
    if options.wait:
        missing = player.wait_for_subscribers(options.subscribers, options.wait)
        if missing:
            raise UsageError(
                f"within {options.wait:g} s fewer than {options.subscribers} subscribed to "
                f"{', '.join(missing)}"
            )
    while True:
        played = player.play()
        late = f"at most {played.lateness * 1e3:.1f} ms late"
        throttled.info("played", f"played {played.count} messages, {late}")
        if not (options.loop and played.count):
            break
    if not player.wait_until_received(_ACKNOWLEDGEMENT):
        log.warning("some subscribers have not acknowledged all messages")
