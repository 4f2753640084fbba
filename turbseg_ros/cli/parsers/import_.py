"""The command line of `turbseg_import`."""

from __future__ import annotations

import argparse
from pathlib import Path

from turbseg_ros.bag.topics import IMAGE_TOPIC
from turbseg_ros.cli.options import command_parser, positive_number

FOLDER_RATE = 30.0  # Hz
"""The frame rate of folders, unless another is asked for."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of its arguments."""
    parser = command_parser(
        prog="turbseg_import",
        description="Make a bag of a video file or a folder of frames, with masks as truth.",
        epilog="Masks hold 0 for background and 255 for all objects together, or labels 1, 2... "
        "or the colours of DAVIS-2017 to tell them apart. Frames and masks pair by order.",
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
    parser.add_argument("--masks", type=Path, metavar="DIR", help="folder with a mask a frame")
    parser.add_argument(
        "--rate",
        type=positive_number,
        metavar="HZ",
        help="evenly spaced frames at this rate (default: the video's own stamps; for folders "
        f"{FOLDER_RATE:g}, or times that the files are named by)",
    )
    parser.add_argument("--topic", default=IMAGE_TOPIC, help="default: %(default)s")
    return parser
