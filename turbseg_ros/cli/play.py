"""`turbseg_play`: publishes a bag, where there is no `ros2 bag play`."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.errors import Interrupted, UsageError, executable
from turbseg_ros.cli.options import positive_count, positive_number
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
        options = _parser().parse_args(remove_ros_args(command)[1:])
        if options.clock and options.stamp_now:
            raise UsageError(
                "--clock publishes the bag's time and --stamp-now another one; choose one of them"
            )
        reader = BagReader(options.bag)
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="turbseg_play",
        description="Publish the messages of a bag in their own time.",
        epilog="ROS arguments follow --ros-args: -r /camera/image_raw:=TOPIC. "
        "The service /turbseg_play/pause (std_srvs/SetBool) pauses and resumes.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 directory or MCAP file")
    parser.add_argument(
        "--rate", type=positive_number, default=1.0, metavar="R", help="times as fast (default: 1)"
    )
    parser.add_argument(
        "--loop", action="store_true", help="play it again and again; times in messages go on"
    )
    parser.add_argument("--clock", action="store_true", help="publish the bag's time on /clock")
    parser.add_argument(
        "--stamp-now",
        action="store_true",
        help="stamp messages with the time at which they are published, as a camera would",
    )
    parser.add_argument(
        "--topics", nargs="+", metavar="T", help="topics to publish (default: all)"
    )
    parser.add_argument(
        "--start-paused", action="store_true", help="wait for the service to resume"
    )
    parser.add_argument(
        "--recorded-qos",
        action="store_true",
        help="offer what was recorded, best effort too (default: reliable, which loses nothing)",
    )
    parser.add_argument(
        "--wait",
        type=positive_number,
        metavar="S",
        help="wait for subscribers to every image topic, S seconds at most",
    )
    parser.add_argument(
        "--subscribers",
        type=positive_count,
        default=1,
        metavar="N",
        help="how many --wait waits for (default: 1)",
    )
    return parser
