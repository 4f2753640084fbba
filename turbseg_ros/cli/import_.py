"""`turbseg_import`: a video or a folder of frames, with its masks, into a bag."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt
from sensor_msgs.msg import Image

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.bag.topics import IMAGE_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.errors import (
    StopRequest,
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import positive_number, with_progress
from turbseg_ros.datasets.clip import (
    Clip,
    FrameFormat,
    ImageFolder,
    find_clip,
    frame_format,
)
from turbseg_ros.datasets.masks import Labels, mask_meaning
from turbseg_ros.messages.images import (
    ImageConversionError,
    encoding_of,
    message_from_image,
)

_FRAME_ID = "camera"
# ROS takes time 0 for "not set", so clips begin a second later.
_START_NS = 1_000_000_000
_FOLDER_RATE = 30.0  # Hz


@executable("turbseg_import")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = _parser().parse_args(arguments)
    clip = find_clip(options.source, options.masks)
    rate = options.rate or _own_rate(clip, options.source)
    stated = clip.frames.stated_count
    with stopping_at_signals("turbseg_import") as stop, BagWriter(options.out) as bag:
        count = _write(clip, bag, options.topic, rate, stop)
        partial = interrupted_after(count, stated)
        if stop.cut:
            bag.mark_partial(partial)
    if stop.cut:
        print(f"turbseg_import: {options.out} is partial: {partial}", file=sys.stderr)
        return stop.status
    if stated is not None and stated != count:
        print(f"{options.source} states {stated} frames; {count} could be read", file=sys.stderr)
    print(f"{options.out}: {count} frames at {rate:g} Hz on {options.topic}, {_truth_of(clip)}")
    return 0


def _write(clip: Clip, bag: BagWriter, topic: str, rate: float, stop: StopRequest) -> int:
    """Write a clip's images and labels until stopped; return the number of frames."""
    form = frame_format(clip.frames)
    truth = itertools.repeat(None) if clip.masks is None else _labels(clip.masks, form)
    taken = stop.until_stopped(form.conform(clip.frames))
    frames = with_progress(taken, topic, clip.frames.stated_count)
    count = 0
    for frame, labels in zip(frames, truth, strict=False):
        stamp = _START_NS + round(count / rate * 1e9)
        bag.write(topic, _message(frame, stamp), stamp)
        if labels is not None:
            bag.write(TRUTH_TOPIC, _message(labels, stamp), stamp)
        count += 1
    return count


def _message(image: npt.NDArray[Any], stamp: int) -> Image:
    try:
        return message_from_image(image, encoding_of(image), stamp, _FRAME_ID)
    except ImageConversionError as error:
        raise ClipError(str(error)) from error


def _labels(masks: ImageFolder, form: FrameFormat) -> Iterator[Labels]:
    meaning = mask_meaning(masks)
    for number, mask in enumerate(masks):
        height, width = mask.shape[:2]
        if (height, width) != (form.height, form.width):
            raise ClipError(
                f"mask {number} is {width}x{height}, its frame {form.width}x{form.height} pixels"
            )
        yield meaning.labels(mask)


def _own_rate(clip: Clip, source: Path) -> float:
    if isinstance(clip.frames, ImageFolder):
        return _FOLDER_RATE
    if clip.frames.rate is None:
        raise UsageError(f"{source} states no frame rate; return it with --rate")
    return clip.frames.rate


def _truth_of(clip: Clip) -> str:
    if clip.masks is None:
        return "no masks"
    return f"masks of {clip.masks.folder} on {TRUTH_TOPIC}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="turbseg_import",
        description="Make a bag of a video file or a folder of frames, with masks as truth.",
        epilog="Masks hold 0 for background and 255 for all objects together, or labels 1, 2... "
        "or the colours of DAVIS-2017 to tell them apart. Frames and masks pair by order.",
    )
    parser.add_argument(
        "source",
        type=Path,
        metavar="SRC",
        help="video, folder of frames, or folder of a sequence with frames/ and masks/ in it; "
        "masks are found too in a tree beside that of the frames, as DAVIS has it: "
        "JPEGImages/480p/NAME and Annotations/480p/NAME",
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="bag to be written")
    parser.add_argument("--masks", type=Path, metavar="DIR", help="folder with a mask a frame")
    parser.add_argument(
        "--rate",
        type=positive_number,
        metavar="HZ",
        help=f"frame rate (default: the video's own; {_FOLDER_RATE:g} for folders)",
    )
    parser.add_argument("--topic", default=IMAGE_TOPIC, help="default: %(default)s")
    return parser
