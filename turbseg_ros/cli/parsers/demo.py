"""The command line of `python -m turbseg_ros.cli demo`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="demo",
        description="Play a bag into the live node over DDS; record, score and draw its answers.",
    )
    parser.add_argument(
        "--bag",
        type=Path,
        default=Path("bags/normal"),
        metavar="BAG",
        help="bag with images and their truth (%(default)s)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="results (%(default)s)"
    )
    parser.add_argument(
        "--minimum-j",
        type=float,
        default=0.7,
        metavar="J",
        help="mean J below which the demonstration has failed (%(default)s)",
    )
    return parser
