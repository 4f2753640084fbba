"""`turbseg_import`: a video or a folder of frames, with its truth, into a bag."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import Image

from turbseg_ros.arrays import Mask
from turbseg_ros.bag.errors import ClipError
from turbseg_ros.bag.topics import IGNORED_TOPIC, TRUTH_BOXES_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.errors import (
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.options import with_progress
from turbseg_ros.cli.outputs import check_new
from turbseg_ros.cli.parsers.import_ import FOLDER_RATE, WHOLE_PICTURE, build_parser
from turbseg_ros.datasets.boxes import BoxTruth, read_boxes
from turbseg_ros.datasets.clip import (
    FRAME_FOLDERS,
    Clip,
    FrameFormat,
    find_clip,
    frame_format,
)
from turbseg_ros.datasets.images import ImageFolder
from turbseg_ros.datasets.masks import Labels, mask_meaning
from turbseg_ros.datasets.regions import read_region
from turbseg_ros.messages.detections import TYPE_NAME as BOXES_TYPE
from turbseg_ros.messages.detections import serialised_detections
from turbseg_ros.messages.images import (
    ImageConversionError,
    encoding_of,
    message_from_image,
)

T = TypeVar("T")

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
    if options.boxes is None and (options.partial_truth or options.clip):
        raise UsageError("--partial-truth and --clip say something of --boxes; give those")
    clip = find_clip(options.source, options.masks)
    rate = options.rate or _own_rate(clip, options.source)
    as_asked = options.rate is not None
    for note in clip.frames.notes(as_asked):
        print(note, file=sys.stderr)
    truth = _truth(options, clip)
    whole = not (options.frames or options.skip)
    stated = clip.frames.stated_count if whole else options.frames
    with stopping_at_signals("turbseg_import") as stop, BagWriter(options.out) as bag:
        taken = _part(clip.frames.timed(rate, as_asked), options)
        stamps = _write(truth, bag, options.topic, stop.until_stopped(taken), stated)
        partial = interrupted_after(len(stamps), stated)
        if stop.cut:
            bag.mark_partial(partial)
        elif truth.boxes is not None and whole:
            truth.boxes.check_count(len(stamps))
    if stop.cut:
        print(f"turbseg_import: {options.out} is partial: {partial}", file=sys.stderr)
        return stop.status
    if whole and stated is not None and stated not in (len(stamps), _frames_within(stamps, rate)):
        print(
            f"{options.source} states {stated} frames; {len(stamps)} could be read",
            file=sys.stderr,
        )
    print(
        f"{options.out}: {len(stamps)} frames {_spacing(stamps, rate)} on {options.topic}, "
        f"{truth.named}"
    )
    return 0


@dataclass(frozen=True)
class _Truth:
    """What a clip's truth is: labels of each frame that is taken, or boxes of all frames.

    The `first` that is taken has this number. Labels, HxW, come with what they say nothing of,
    where that isn't None; `ignored`, HxW, is that of all frames. `named` says what there is.
    """

    form: FrameFormat
    first: int
    named: str
    labels: Iterable[tuple[Labels, Mask | None]] | None = None
    boxes: BoxTruth | None = None
    ignored: Mask | None = None


def _truth(options: argparse.Namespace, clip: Clip) -> _Truth:
    form = frame_format(clip.frames)
    shape = (form.height, form.width)
    if options.boxes is not None:
        boxes = read_boxes(options.boxes, options.clip or _clip_name(options.source))
        everywhere = np.ones(shape, bool) if options.partial_truth else None
        partly = ", of part of what moves" if options.partial_truth else ""
        named = f"boxes of {options.boxes} on {TRUTH_BOXES_TOPIC}{partly}"
        return _Truth(form, options.skip, named, boxes=boxes, ignored=everywhere)
    if options.still is not None:
        still = None
        if options.still != WHOLE_PICTURE:
            still = ~read_region(Path(options.still), shape)
        named = f"nothing on {TRUTH_BOXES_TOPIC}, for nothing moves in: {options.still}"
        return _Truth(form, options.skip, named, boxes=BoxTruth({}, None), ignored=still)
    if clip.masks is None:
        return _Truth(form, options.skip, "no truth")
    named = f"masks of {clip.masks.folder} on {TRUTH_TOPIC}"
    return _Truth(form, options.skip, named, _part(_labels(clip.masks, form), options))


def _part(items: Iterable[T], options: argparse.Namespace) -> Iterator[T]:
    """Return the items of those frames that are to be taken."""
    end = options.skip + options.frames if options.frames else None
    return itertools.islice(items, options.skip, end)


def _clip_name(source: Path) -> str:
    """Return what data sets call a clip whose frames are there."""
    source = source.resolve()
    if source.is_dir() and source.name.lower() in FRAME_FOLDERS:
        return source.parent.name
    return source.name if source.is_dir() else source.stem


def _write(
    truth: _Truth,
    bag: BagWriter,
    topic: str,
    timed: Iterable[tuple[float, npt.NDArray[Any]]],
    count: int | None,
) -> list[int]:
    """Write a clip's images, at their times in seconds, and truth; return the stamps.

    Stamps are nanoseconds.
    """
    none: tuple[None, None] = (None, None)
    masks = itertools.repeat(none) if truth.labels is None else truth.labels
    frames = with_progress(timed, topic, count)
    stamps: list[int] = []
    for (seconds, frame), (labels, unknown) in zip(frames, masks, strict=False):
        stamp = _START_NS + round(seconds * 1e9)
        bag.write(topic, _message(truth.form.conform(len(stamps), frame), stamp), stamp)
        if labels is not None:
            bag.write(TRUTH_TOPIC, _message(labels, stamp), stamp)
        boxes = None if truth.boxes is None else truth.boxes.at(truth.first + len(stamps))
        if boxes is not None:
            content = serialised_detections(boxes, stamp, _FRAME_ID)
            bag.write_serialized(TRUTH_BOXES_TOPIC, BOXES_TYPE, content, stamp)
        ignored = unknown if stamps or truth.ignored is None else truth.ignored
        if ignored is not None:
            bag.write(IGNORED_TOPIC, _message(ignored.astype(np.uint8) * 255, stamp), stamp)
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


def _labels(masks: ImageFolder, form: FrameFormat) -> Iterator[tuple[Labels, Mask | None]]:
    meaning = mask_meaning(masks)
    for number, mask in enumerate(masks):
        height, width = mask.shape[:2]
        if (height, width) != (form.height, form.width):
            raise ClipError(
                f"mask {number} is {width}x{height}, its frame {form.width}x{form.height} pixels"
            )
        yield meaning.labels(mask), meaning.ignored_in(mask)


def _own_rate(clip: Clip, source: Path) -> float:
    if isinstance(clip.frames, ImageFolder):
        return FOLDER_RATE
    if clip.frames.rate is None:
        raise UsageError(f"{source} states no frame rate; give it with --rate")
    return clip.frames.rate
