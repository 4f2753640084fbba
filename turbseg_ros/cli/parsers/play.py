"""The command line of `turbseg_play`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import (
    add_section_options,
    command_parser,
    positive_count,
    positive_number,
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_play",
        description="Publish the messages of a bag in their own time.",
        epilog="ROS arguments follow --ros-args: -r /camera/image_raw:=TOPIC. "
        "The service /turbseg_play/pause (std_srvs/SetBool) pauses and resumes.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 directory, or one file")
    add_section_options(parser)
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
