"""The command line of `python -m turbseg_ros.cli stages`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import add_parameter_options, command_parser


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="stages", description="Draw what each stage of the method makes of one frame."
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 directory, or one file")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        required=True,
        metavar="PICTURE",
        help="picture to write: .png, .jpg, .webp, .bmp, .tif",
    )
    parser.add_argument(
        "--frame", type=int, default=30, metavar="N", help="number of the frame (%(default)s)"
    )
    parser.add_argument(
        "--image-topic", metavar="T", help="images to segment, where the bag has several topics"
    )
    add_parameter_options(parser)
    return parser
