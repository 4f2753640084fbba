"""The command line of `turbseg_evaluate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.bag.topics import LABELS_TOPIC, TRUTH_TOPIC
from turbseg_ros.cli.options import (
    add_cluster_options,
    add_parameter_options,
    add_section_options,
    command_parser,
)
from turbseg_ros.evaluation import BASELINES

# Stronger ones than this leave nothing to see.
_STRONGEST = 20.0


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _strengths(text: str) -> list[float]:
    """Read strengths in pixels, and put them in order."""
    try:
        strengths = sorted({float(item) for item in text.split(",")})
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: give pixels, as 0,0.5,1") from error
    if not all(0 <= strength <= _STRONGEST for strength in strengths):
        raise argparse.ArgumentTypeError(f"{text}: give 0 to {_STRONGEST:g} pixels")
    return strengths


def _seed(text: str) -> int:
    seed = int(text)
    if seed < 0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return seed


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_evaluate",
        description="Segment bags and score the results against the truth that the bags hold.",
    )
    parser.add_argument(
        "bags", nargs="*", type=Path, metavar="BAG", help="rosbag2 directory, or one file"
    )
    parser.add_argument(
        "--image-topic", metavar="T", help="images to segment, where bags have several topics"
    )
    parser.add_argument(
        "--truth-topic", default=TRUTH_TOPIC, metavar="T", help="true labels (%(default)s)"
    )
    add_section_options(parser)
    parser.add_argument("--json", type=Path, metavar="F", help="also write the scores as JSON")
    parser.add_argument(
        "--csv", type=Path, metavar="DIR", help="also write every table as DIR/NAME.csv"
    )
    parser.add_argument(
        "--latex", type=Path, metavar="DIR", help="also write every table as DIR/NAME.tex"
    )
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="also write DIR/index.html, with pictures"
    )
    parser.add_argument(
        "--curves", type=Path, metavar="DIR", help="also draw the curves, as DIR/*_curve.svg"
    )
    _add_comparisons(parser)
    add_cluster_options(
        parser, "What runs side by side shares the processor, and its fps and ms show that."
    )
    parser.add_argument(
        "--compare",
        nargs=2,
        type=Path,
        metavar=("BEFORE", "AFTER"),
        help="no BAG, but the --json files of two evaluations: differences, and how sure they are",
    )
    recorded = parser.add_argument_group("recorded results, instead of segmenting")
    recorded.add_argument(
        "--predictions", type=Path, metavar="BAG", help="bag with the labels found in BAG"
    )
    recorded.add_argument(
        "--labels-topic", default=LABELS_TOPIC, metavar="T", help="found labels (%(default)s)"
    )
    add_parameter_options(parser)
    return parser


def _add_comparisons(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("comparisons, a table each")
    group.add_argument(
        "--baselines",
        "--rivals",
        type=_names,
        default=[],
        metavar="NAMES",
        help="other methods on the same frames, and in the curves: some of "
        f"{','.join(BASELINES)}; package.module:Class, a segmenter of yours; NAME=FOLDER, masks "
        "that others found, a folder a bag; NAME=FILE, other parameters",
    )
    group.add_argument(
        "--tilt-curve",
        type=_strengths,
        metavar="PX,PX",
        help="J under added turbulence: rms tilt an axis, as 0,0.5,1,2,3",
    )
    group.add_argument(
        "--shake-curve",
        type=_strengths,
        metavar="PX,PX",
        help="J under added shake: rms step an axis from frame to frame, as 0,1,2,4",
    )
    group.add_argument(
        "--variant",
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="the method with this parameter changed, beside as configured; may be repeated",
    )
    group.add_argument(
        "--ablation", action="store_true", help="the method with one thing changed at a time"
    )
    group.add_argument(
        "--sensitivity",
        action="store_true",
        help="the method with each number among its parameters halved, and doubled",
    )
    group.add_argument(
        "--seed",
        type=_seed,
        default=0,
        metavar="N",
        help="of added turbulence and shake (%(default)s)",
    )
