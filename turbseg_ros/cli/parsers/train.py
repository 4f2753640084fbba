"""The command line of `turbseg_train`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser, positive_count


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_train",
        description="Render scenes drawn at random, take the method's windows on them, train "
        "Refine-Net on their truth, and write it as ONNX and safetensors with a record of the "
        "training. One scene in ten is held out.",
    )
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="DIR", help="folder to be written"
    )
    parser.add_argument(
        "--scenes", type=positive_count, default=60, metavar="N", help="default: %(default)s"
    )
    parser.add_argument(
        "--first-scene", type=int, default=100, metavar="N", help="seed (%(default)s)"
    )
    parser.add_argument(
        "--frames", type=positive_count, default=30, metavar="N", help="a scene (%(default)s)"
    )
    parser.add_argument(
        "--steps", type=positive_count, default=2500, metavar="N", help="default: %(default)s"
    )
    parser.add_argument(
        "--workers",
        type=positive_count,
        default=1,
        metavar="N",
        help="processes that render (%(default)s); the windows are the same",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of the network (%(default)s)"
    )
    return parser
