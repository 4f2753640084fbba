"""The command line of `turbseg_import`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.bag.topics import IMAGE_TOPIC
from turbseg_ros.cli.options import command_parser, positive_count, positive_number

FOLDER_RATE = 30.0  # Hz
"""The frame rate of folders, unless another is asked for."""

WHOLE_PICTURE = "all"
"""Says in place of a file that nothing moves in the whole picture."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_import",
        description="Make a bag of a video file or a folder of frames, with masks, boxes or still "
        "regions as truth.",
        epilog="Masks hold 0 for background and 255 for all objects together, or labels 1, 2... "
        "or the colours of DAVIS-2017 to tell them apart, or the levels of CDnet. Frames and "
        "masks pair by order.",
    )
    parser.add_argument(
        "source",
        type=Path,
        metavar="SRC",
        help="video, TIFF of many pages, folder of frames, or folder of a sequence with frames/ "
        "and masks/ in it; "
        "masks are found too in a tree beside that of the frames, as DAVIS has it: "
        "JPEGImages/480p/NAME and Annotations/480p/NAME",
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="bag to be written")
    _add_truth(parser)
    parser.add_argument(
        "--rate",
        type=positive_number,
        metavar="HZ",
        help="evenly spaced frames at this rate (default: the video's own stamps; for folders "
        f"{FOLDER_RATE:g}, or times that the files are named by)",
    )
    parser.add_argument(
        "--skip", type=positive_count, default=0, metavar="N", help="leave out the first N frames"
    )
    parser.add_argument(
        "--frames", type=positive_count, metavar="N", help="take no more than N frames"
    )
    parser.add_argument("--topic", default=IMAGE_TOPIC, help="default: %(default)s")
    return parser


def _add_truth(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("truth, one of")
    kinds = group.add_mutually_exclusive_group()
    kinds.add_argument("--masks", type=Path, metavar="DIR", help="folder with a mask a frame")
    kinds.add_argument(
        "--boxes",
        type=Path,
        metavar="FILE",
        help="MOTChallenge text (gt.txt), COCO-VID JSON, or JSON with [left, top, width, height] "
        "or null for each frame of each clip",
    )
    kinds.add_argument(
        "--still",
        metavar="FILE",
        help=f"where nothing moves: {WHOLE_PICTURE}, where a picture is white, or where a file "
        "like that of regions.file has objects looked for",
    )
    parser.add_argument(
        "--clip", metavar="NAME", help="which clip of --boxes it is (default: as SRC is called)"
    )
    parser.add_argument(
        "--partial-truth",
        action="store_true",
        help="not all that moves has a box: what is found beside them isn't false",
    )
