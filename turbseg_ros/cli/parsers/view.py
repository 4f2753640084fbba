"""The command line of `turbseg_view`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser, positive_count, positive_number


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_view",
        description="Show a running node in a browser: picture, objects, curves, parameters.",
        epilog="ROS arguments follow --ros-args.",
    )
    parser.add_argument(
        "--host",
        default="localhost",
        metavar="H",
        help="address to listen on (%(default)s: this machine only; 0.0.0.0: all, and then the "
        "page asks for the token that is printed)",
    )
    parser.add_argument(
        "--port", type=_port, default=8080, metavar="P", help="%(default)s; 0: any that is free"
    )
    parser.add_argument(
        "--node",
        default="",
        metavar="NAME",
        help="full name of the node, as /north/turbseg (default: the first that is heard)",
    )
    parser.add_argument(
        "--regions",
        type=Path,
        default=Path("regions.yaml"),
        metavar="FILE",
        help="where regions that are drawn on the page are saved (%(default)s)",
    )
    parser.add_argument(
        "--rate",
        type=positive_number,
        default=15.0,
        metavar="R",
        help="most pictures a second (%(default)g)",
    )
    parser.add_argument(
        "--width",
        type=positive_count,
        default=1280,
        metavar="W",
        help="largest width of pictures in pixels (%(default)s)",
    )
    return parser


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text} is no port")
    return value
