"""The command line of `turbseg_replay`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.cli.options import (
    add_cluster_options,
    add_parameter_options,
    add_section_options,
    command_parser,
)

VIEWS = ("overlay", "motion", "clutter")
"""What the topics for people are called."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_replay",
        description="Segment every frame of a bag and write the node's topics into another bag. "
        "With several bags, {bag} in the name of a picture, film or table stands for each one's "
        "name.",
    )
    parser.add_argument(
        "bags", nargs="+", type=Path, metavar="BAG", help="rosbag2 directory, or one file"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        required=True,
        metavar="OUT",
        help="bag to be written; for several BAGs a folder, with one called like each in it",
    )
    parser.add_argument(
        "--image-topic", metavar="T", help="images to segment, where the bag has several topics"
    )
    add_section_options(parser)
    parser.add_argument(
        "--overlay",
        type=Path,
        metavar="PICTURE",
        help="also draw nine frames with what was found, in the format that the name ends in: "
        ".png, .jpg, .webp, .bmp or .tif",
    )
    parser.add_argument(
        "--video",
        type=Path,
        metavar="FILM",
        help="also make a film of every frame with what was found, .mp4, .mkv or .mov: H.264 "
        "where PyAV is installed, else MPEG-4",
    )
    parser.add_argument(
        "--objects",
        type=Path,
        metavar="TABLE",
        help="also write a row for each object, .csv or (where PyArrow is installed) .parquet: "
        "when, from where to where, how fast, how large",
    )
    parser.add_argument(
        "--object-pictures",
        type=Path,
        metavar="DIR",
        help="also write each object's best picture into a folder",
    )
    parser.add_argument(
        "--views",
        type=_names_of_views,
        default=(),
        metavar="NAMES",
        help=f"also write the node's topics for people, of {', '.join(VIEWS)}: names, commas "
        "between",
    )
    add_cluster_options(parser, "Several bags are replayed side by side.")
    add_parameter_options(parser)
    return parser


def _names_of_views(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    for name in names:
        if name not in VIEWS:
            raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(VIEWS)}")
    return names
