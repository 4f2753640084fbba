"""The command line of `turbseg_benchmark`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import add_parameter_options, command_parser, positive_count
from turbseg_ros.evaluation import BASELINES, CONTRIB_BASELINES

_SIZES = ((640, 480), (1280, 720), (1920, 1080))
_MAX_OBJECTS = 32


def _sizes(text: str) -> tuple[tuple[int, int], ...]:
    """Read sizes such as 640x480,1920x1080."""
    try:
        sizes = tuple(_size(item) for item in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: give sizes as 640x480,1920x1080") from error
    if not all(64 <= side <= 8192 for size in sizes for side in size):
        raise argparse.ArgumentTypeError(f"{text}: sides have 64 to 8192 pixels")
    return sizes


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def _counts(text: str) -> tuple[int, ...]:
    """Read numbers of objects such as 0,2,8."""
    try:
        counts = tuple(int(item) for item in text.split(","))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: give numbers as 0,2,8") from error
    if not all(0 <= count <= _MAX_OBJECTS for count in counts):
        raise argparse.ArgumentTypeError(f"{text}: give 0 to {_MAX_OBJECTS} objects")
    return counts


def _baselines(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in BASELINES]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"no baseline {unknown[0]}; there are {', '.join(BASELINES)}"
        )
    return names


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_benchmark",
        description=(
            "Time the method, its stages and its baselines on a rendered clip, turn by turn with "
            "one DIS flow of a fixed size, and give the ratio to that."
        ),
    )
    parser.add_argument(
        "--sizes",
        type=_sizes,
        default=_SIZES,
        metavar="WxH,WxH",
        help="of the frames (640x480,1280x720,1920x1080)",
    )
    parser.add_argument(
        "--frames",
        type=positive_count,
        default=100,
        metavar="N",
        help="frames that are timed, after others to warm up (%(default)s)",
    )
    parser.add_argument(
        "--objects",
        type=_counts,
        default=(2,),
        metavar="N,N",
        help="moving objects, in a clip of its own each (2)",
    )
    parser.add_argument(
        "--baselines",
        "--rivals",
        type=_baselines,
        default=[name for name in BASELINES if name not in CONTRIB_BASELINES],
        metavar="NAMES",
        help=f"some of {','.join(BASELINES)} (all but {', '.join(CONTRIB_BASELINES)})",
    )
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="BAG",
        help="also time turbseg_replay of a bag beside the method alone, its frames in memory",
    )
    parser.add_argument("--json", type=Path, metavar="F", help="also write the figures as JSON")
    add_parameter_options(parser)
    return parser
