"""The command line of `python -m turbseg_ros.cli real`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import command_parser, positive_count

SETS = ("far_targets", "sbi", "ucsd", "static_haze", "davis")
"""The folders that are looked for, in the order in which they are scored."""


def _sets(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in SETS]
    if unknown or not names:
        raise argparse.ArgumentTypeError(f"{text}: give some of {','.join(SETS)}")
    return names


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="real",
        description="Score clips of data sets that are on disk, each set in two halves: "
        "those with even numbers, from 0, in the order of their names, and the others.",
    )
    parser.add_argument(
        "data",
        type=Path,
        metavar="DATA",
        help="folder with far_targets/*.mp4 and boxes.json; sbi, ucsd and davis, with "
        "CLIP/frames and CLIP/masks; static_haze/frames, in which nothing moves",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        default=Path("out/real"),
        metavar="DIR",
        help="for bags and scores (%(default)s); bags that are there are taken as they are",
    )
    parser.add_argument(
        "--sets",
        type=_sets,
        default=list(SETS),
        metavar="NAMES",
        help=f"which of {','.join(SETS)} (all)",
    )
    parser.add_argument(
        "--frames", type=positive_count, metavar="N", help="take no more of a clip than N frames"
    )
    parser.add_argument(
        "--workers", type=positive_count, metavar="N", help="processes (as many as cores)"
    )
    return parser
