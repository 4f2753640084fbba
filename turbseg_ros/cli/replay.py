"""`turbseg_replay`: a bag through the method, its results into another bag."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import logging
import sys
import traceback
from collections import Counter
from collections.abc import Collection, Iterator, Sequence

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames, ahead
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import type_name_of
from turbseg_ros.bag.topics import DIAGNOSTICS_TOPIC, RESULT_NAMESPACE
from turbseg_ros.bag.writer import BagWriter, serialised
from turbseg_ros.cli.errors import (
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.memory import keep_large_buffers
from turbseg_ros.cli.options import parameters_from, section_from, with_progress
from turbseg_ros.cli.outputs import check_folder, check_new, check_picture, check_suffix
from turbseg_ros.cli.parsers.replay import build_parser
from turbseg_ros.exports.film import SUFFIXES as FILM_SUFFIXES
from turbseg_ros.exports.film import Film, FilmError
from turbseg_ros.exports.object_table import SUFFIXES as TABLE_SUFFIXES
from turbseg_ros.exports.object_table import ObjectTable
from turbseg_ros.factory import clip_segmenter
from turbseg_ros.messages.diagnostics import ResultDiagnostics
from turbseg_ros.messages.events import EventMessages, EventWatch
from turbseg_ros.messages.results import CentroidMarkers, Output, outputs, slot_output, views
from turbseg_ros.overlay import OverlayStrip, write_picture
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import SegmentationResult, segment
from turbseg_ros.throttle import ThrottledLogger

_LOGGER = logging.getLogger(__name__)


class ResultWriter:
    """Writes results to the node's topics in a bag, at the times at which images were recorded.

    A slot has its topic from the first object on that holds it, with a mask for each frame. An
    output that fails is warned about, throttled, and counted in `failed` under its name; the
    others are written all the same.

    :param patience: frames that an object lives unseen.
    :param shown: names of the topics for people that are written, too.
    """

    def __init__(self, bag: BagWriter, patience: int, shown: Collection[str] = ()) -> None:
        self._bag = bag
        wanted = (view for view in views() if view.name in shown)
        events = EventMessages(EventWatch(lambda: patience))
        self._outputs = (*outputs(0, CentroidMarkers(), events), *wanted)
        self._slots: dict[int, Output] = {}
        self._diagnostics = ResultDiagnostics(RESULT_NAMESPACE)
        self._throttled = ThrottledLogger(_LOGGER)
        self.failed: Counter[str] = Counter()

    def write(self, result: SegmentationResult) -> None:
        """Append one result.

        :raises BagError: when it can't be written.
        """
        for moving_object in result.objects:
            if moving_object.slot >= 0 and moving_object.slot not in self._slots:
                self._slots[moving_object.slot] = slot_output(moving_object.slot)
        frame = result.frame
        # A camera's clock may be set before the epoch, a bag's time can't.
        recorded_at = max(frame.stamp if frame.received is None else frame.received, 0)
        for output in (*self._outputs, *self._slots.values()):
            self._write(output, result, recorded_at)
        diagnostics = self._diagnostics.message(result)
        if diagnostics is not None:
            type_name = type_name_of(diagnostics)
            cdr = serialised(diagnostics)
            self._bag.write_serialized(DIAGNOSTICS_TOPIC, type_name, cdr, recorded_at)

    def _write(self, output: Output, result: SegmentationResult, recorded_at: int) -> None:
        try:
            messages = [serialised(message) for message in output.build(result)]
        except Exception:
            # Whatever it is, the other outputs may be sound.
            self.failed[output.name] += 1
            self._throttled.warning(
                output.name, f"output {output.name} failed: {traceback.format_exc()}"
            )
            return
        topic = f"{RESULT_NAMESPACE}/{output.name}"
        for cdr in messages:
            self._bag.write_serialized(topic, output.type_name, cdr, recorded_at)


@executable("turbseg_replay")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status."""
    options = build_parser().parse_args(arguments)
    keep_large_buffers()
    parameters = parameters_from(options)
    reader = BagReader(options.bag, section_from(options))
    frames = BagFrames(reader, reader.find_image_topic(options.image_topic))
    _check_outputs(options)
    exports = _Exports(options, len(frames))
    count = 0
    conditions: Counter[Condition] = Counter()
    with (
        stopping_at_signals("turbseg_replay") as stop,
        BagWriter(options.out) as bag,
        exports,
    ):

        def shown(epochs: range) -> Iterator[int]:
            for epoch in with_progress(epochs, title="refining", unit="epoch"):
                # Before the last epoch there is nothing to keep.
                stop.check()
                yield epoch

        segmenter = clip_segmenter(parameters, shown)
        results = ResultWriter(bag, parameters.tracking.max_age, options.views)
        # The next frames are read and segmented while a result is written. When it is stopped,
        # those that were read get their results.
        taken = stop.until_stopped(frames)
        images = ahead(with_progress(taken, reader.path.name, len(frames)))
        for result in ahead(segment(images, segmenter)):
            results.write(result)
            exports.add(result)
            count += 1
            conditions[result.condition] += 1
        if stop.cut and not count:
            stop.check()
        if not count:
            raise BagError(f"{reader.path}: none of {len(frames)} images could be read")
        if stop.cut:
            bag.mark_partial(interrupted_after(count, len(frames)))
    exports.write()
    if stop.cut:
        partial = interrupted_after(count, len(frames))
        print(f"turbseg_replay: {options.out} is partial: {partial}", file=sys.stderr)
        return stop.status
    lost = f", {frames.lost} images lost with what is damaged" if frames.lost else ""
    failed = "".join(
        f", {name} missing in {times} frames" for name, times in results.failed.items()
    )
    noticed = "".join(
        f", {conditions[condition]} {condition.value}"
        for condition in Condition
        if condition is not Condition.SOUND and conditions[condition]
    )
    print(
        f"{options.out}: {count} results, {frames.skipped} images skipped{noticed}{lost}{failed}"
    )
    print(exports.objects.summary())
    return 1 if failed else 0


class _Exports(contextlib.ExitStack):
    """What is made of the results beside the bag, as the options ask; used in a `with`."""

    def __init__(self, options: argparse.Namespace, frames: int) -> None:
        super().__init__()
        self._options = options
        self._strip = OverlayStrip(frames)
        self.objects = ObjectTable(pictures=options.object_pictures is not None)
        film = None if options.video is None else self.enter_context(Film(options.video))
        self._sinks = [sink for sink in (self._strip, self.objects, film) if sink is not None]

    def add(self, result: SegmentationResult) -> None:
        """Take the next result.

        :raises UsageError: when a film can't be written.
        """
        try:
            for sink in self._sinks:
                sink.add(result)
        except FilmError as error:
            raise UsageError(str(error)) from error

    def write(self) -> None:
        """Write what is written at the end."""
        if self._options.overlay is not None:
            write_picture(self._options.overlay, self._strip.picture())
        if self._options.objects is not None:
            self.objects.write(self._options.objects)
        if self._options.object_pictures is not None:
            self.objects.write_pictures(self._options.object_pictures)


def _check_outputs(options: argparse.Namespace) -> None:
    check_new(options.out)
    extras = (options.overlay, options.video, options.objects, options.object_pictures)
    for path in extras:
        if path is not None and options.out.absolute() in path.absolute().parents:
            raise UsageError(f"{path} lies in the bag to be written; name another place")
    if options.overlay is not None:
        check_picture(options.overlay)
    if options.video is not None:
        check_suffix(options.video, FILM_SUFFIXES)
    if options.objects is not None:
        check_suffix(options.objects, TABLE_SUFFIXES)
        if options.objects.suffix.lower() == ".parquet":
            importlib.import_module("pyarrow")  # missing, it is told before the work
    if options.object_pictures is not None:
        check_folder(options.object_pictures)
