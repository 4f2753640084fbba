"""The command line of `turbseg_record`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser, positive_count, positive_number, seconds


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_record",
        description="Record what a node listens to and finds, only while something moves: a bag "
        "for each time, with what was before.",
        epilog="ROS arguments follow --ros-args.",
    )
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="DIR", help="folder for the bags"
    )
    parser.add_argument(
        "--pre-roll",
        type=seconds,
        default=5.0,
        metavar="S",
        help="seconds from before something was found (default: 5)",
    )
    parser.add_argument(
        "--post-roll",
        type=seconds,
        default=5.0,
        metavar="S",
        help="seconds without anything after which a bag ends (default: 5)",
    )
    parser.add_argument(
        "--split", type=positive_number, metavar="S", help="begin another bag after S seconds"
    )
    parser.add_argument(
        "--memory",
        type=positive_count,
        default=512,
        metavar="MB",
        help="memory for what was before (default: 512); where it is not enough, less is kept, "
        "and the log says so",
    )
    parser.add_argument(
        "--node",
        default="/turbseg",
        metavar="NAME",
        help="the node that segments (default: /turbseg)",
    )
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="T",
        help="topics to record (default: the node's images and camera_info, its markers, "
        "outlines, events and boxes, and /diagnostics)",
    )
    return parser
