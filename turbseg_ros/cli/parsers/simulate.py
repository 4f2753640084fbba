"""The command line of `turbseg_simulate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_simulate",
        description="Render scenes seen through turbulent air into bags, with exact truth, or put "
        "turbulence on a bag of your own.",
    )
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--list", action="store_true", help="list the scenes")
    task.add_argument("--scene", metavar="NAME", help="render this scene, or 'all' of them")
    task.add_argument(
        "--warp", type=Path, metavar="BAG", help="warp this bag's images and their truth"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="OUT", help="bag to be written; with 'all' a folder"
    )
    parser.add_argument(
        "--tilt",
        type=float,
        metavar="PX",
        help="rms tilt an axis in pixels of the image, instead of the scene's own",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    parser.add_argument(
        "--image-topic", metavar="T", help="images to warp, where the bag has several topics"
    )
    return parser
