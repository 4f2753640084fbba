"""`turbseg_import`: a video or a folder of frames, with its masks, into a bag."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt
from sensor_msgs.msg import Image

from turbseg_ros.bag.errors import ClipError
from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.errors import (
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import with_progress
from turbseg_ros.cli.outputs import check_new
from turbseg_ros.cli.parsers.import_ import FOLDER_RATE, build_parser
from turbseg_ros.datasets.clip import (
    Clip,
    FrameFormat,
    find_clip,
    frame_format,
)
from turbseg_ros.datasets.images import ImageFolder
from turbseg_ros.datasets.masks import Labels, mask_meaning
from turbseg_ros.messages.images import (
    ImageConversionError,
    encoding_of,
    message_from_image,
)

_FRAME_ID = "camera"
# ROS takes time 0 for "not set", so clips begin a second later.
_START_NS = 1_000_000_000
# Frames whose distances differ by less are evenly spaced: containers count milliseconds.
_EVEN_NS = 2_500_000


@executable("turbseg_import")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    check_new(options.out)
    clip = find_clip(options.source, options.masks)
    rate = options.rate or _own_rate(clip, options.source)
    as_asked = options.rate is not None
    for note in clip.frames.notes(as_asked):
        print(note, file=sys.stderr)
    stated = clip.frames.stated_count
    with stopping_at_signals("turbseg_import") as stop, BagWriter(options.out) as bag:
        frames = stop.until_stopped(clip.frames.timed(rate, as_asked))
        stamps = _write(clip, bag, options.topic, frames)
        partial = interrupted_after(len(stamps), stated)
        if stop.cut:
            bag.mark_partial(partial)
    if stop.cut:
        print(f"turbseg_import: {options.out} is partial: {partial}", file=sys.stderr)
        return stop.status
    if stated is not None and stated not in (len(stamps), _frames_within(stamps, rate)):
        print(
            f"{options.source} states {stated} frames; {len(stamps)} could be read",
            file=sys.stderr,
        )
    print(
        f"{options.out}: {len(stamps)} frames {_spacing(stamps, rate)} on {options.topic}, "
        f"{_truth_of(clip)}"
    )
    return 0


def _write(
    clip: Clip, bag: BagWriter, topic: str, timed: Iterable[tuple[float, npt.NDArray[Any]]]
) -> list[int]:
    """Write a clip's images, at their times in seconds, and labels; return the stamps.

    Stamps are nanoseconds.
    """
    form = frame_format(clip.frames)
    truth = itertools.repeat(None) if clip.masks is None else _labels(clip.masks, form)
    frames = with_progress(timed, topic, clip.frames.stated_count)
    stamps: list[int] = []
    for (seconds, frame), labels in zip(frames, truth, strict=False):
        stamp = _START_NS + round(seconds * 1e9)
        bag.write(topic, _message(form.conform(len(stamps), frame), stamp), stamp)
        if labels is not None:
            bag.write(TRUTH_TOPIC, _message(labels, stamp), stamp)
        stamps.append(stamp)
    return stamps


def _frames_within(stamps: Sequence[int], rate: float) -> int:
    """Return how many frames at an even rate last as long: what some files state instead."""
    return round((stamps[-1] - stamps[0]) * 1e-9 * rate) + 1


def _spacing(stamps: Sequence[int], rate: float) -> str:
    steps = [after - before for before, after in itertools.pairwise(stamps)]
    if not steps or max(steps) - min(steps) <= _EVEN_NS:
        return f"at {rate:g} Hz"
    return (
        f"in {(stamps[-1] - stamps[0]) * 1e-9:.2f} s, as in the source: "
        f"{min(steps) * 1e-6:.0f} to {max(steps) * 1e-6:.0f} ms apart"
    )


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
        return FOLDER_RATE
    if clip.frames.rate is None:
        raise UsageError(f"{source} states no frame rate; give it with --rate")
    return clip.frames.rate


def _truth_of(clip: Clip) -> str:
    if clip.masks is None:
        return "no masks"
    return f"masks of {clip.masks.folder} on {TRUTH_TOPIC}"
