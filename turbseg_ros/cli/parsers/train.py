"""The command line of `turbseg_train`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser, positive_count


def _count(text: str) -> int:
    """Read a whole number that is not below 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return value


def _share(text: str) -> float:
    """Read a share, from 0 to less than 1."""
    value = float(text)
    if not 0 <= value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to less than 1")
    return value


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_train",
        description="Make clips whose truth is known, take the method's windows on them, train "
        "Refine-Net on these, and write it as ONNX and safetensors with a record of the "
        "training. Clips are scenes drawn at random and, where folders are named, composites of "
        "pictures and videos. One drawn scene in ten is held out, or the sequences of --held-out.",
    )
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="DIR", help="folder to be written"
    )
    parser.add_argument(
        "--scenes", type=_count, default=60, metavar="N", help="drawn ones (%(default)s)"
    )
    parser.add_argument(
        "--first-scene", type=int, default=100, metavar="N", help="seed (%(default)s)"
    )
    parser.add_argument(
        "--frames", type=positive_count, default=30, metavar="N", help="a clip (%(default)s)"
    )
    parser.add_argument(
        "--every",
        type=positive_count,
        default=3,
        metavar="N",
        help="learn from windows of every N-th frame (%(default)s)",
    )
    parser.add_argument(
        "--steps", type=positive_count, default=2500, metavar="N", help="default: %(default)s"
    )
    parser.add_argument(
        "--workers",
        type=positive_count,
        default=1,
        metavar="N",
        help="processes that make clips (%(default)s); the windows are the same",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of the network (%(default)s)"
    )
    parser.add_argument(
        "--start",
        type=Path,
        metavar="FILE",
        help="go on from a network's refine_net.safetensors (default: from nothing)",
    )
    parser.add_argument(
        "--keep",
        type=_share,
        default=0.0,
        metavar="SHARE",
        help="of --start's network in the one that is written (%(default)s): less of what it "
        "knew is lost",
    )
    _add_footage(parser)
    return parser


def _add_footage(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "footage",
        "Folders of videos and of sequences: folders of frames, with their masks beside them as "
        "in DAVIS or in SEQUENCE/frames and SEQUENCE/masks.",
    )
    group.add_argument(
        "--backgrounds",
        type=Path,
        metavar="DIR",
        help="pictures, videos and sequences to put objects before",
    )
    group.add_argument(
        "--objects",
        type=Path,
        metavar="DIR",
        help="sequences with masks: they are shown as they are, and objects are cut out of them",
    )
    group.add_argument(
        "--held-out",
        type=Path,
        metavar="DIR",
        help="sequences with masks that show how training goes; nothing is learnt from them",
    )
    group.add_argument(
        "--composites",
        type=_count,
        default=200,
        metavar="N",
        help="clips made of the footage (%(default)s)",
    )
    group.add_argument(
        "--first-composite", type=int, default=0, metavar="N", help="seed (%(default)s)"
    )
    group.add_argument(
        "--shown",
        type=_count,
        default=0,
        metavar="N",
        help="times that each of --objects is shown whole as well (%(default)s): first as it is, "
        "then smaller, in part, backwards, grey, through air, with noise; --start's network "
        "draws outlines in it",
    )
    group.add_argument(
        "--windows",
        type=Path,
        metavar="DIR",
        help="keep each clip's windows there, and take those that are there already",
    )
