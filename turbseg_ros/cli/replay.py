"""`turbseg_replay`: bags through the method, the results of each into another bag."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import logging
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from tqdm import tqdm

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.frames import BagFrames, ahead
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import type_name_of
from turbseg_ros.bag.section import WHOLE, Section
from turbseg_ros.bag.topics import DIAGNOSTICS_TOPIC, RESULT_NAMESPACE
from turbseg_ros.bag.writer import BagWriter, serialised
from turbseg_ros.cli.errors import (
    Interrupted,
    StopRequest,
    UsageError,
    executable,
    interrupted_after,
    stopping_at_signals,
)
from turbseg_ros.cli.memory import keep_large_buffers
from turbseg_ros.cli.options import job_progress, parameters_from, section_from, with_progress
from turbseg_ros.cli.outputs import check_folder, check_new, check_picture, check_suffix
from turbseg_ros.cli.parsers.replay import build_parser
from turbseg_ros.execution import ClusterError, Failure, Progress, job_runner, usable_workers
from turbseg_ros.exports.film import SUFFIXES as FILM_SUFFIXES
from turbseg_ros.exports.film import Film, FilmError
from turbseg_ros.exports.object_table import SUFFIXES as TABLE_SUFFIXES
from turbseg_ros.exports.object_table import ObjectTable
from turbseg_ros.factory import clip_segmenter
from turbseg_ros.messages.diagnostics import ResultDiagnostics
from turbseg_ros.messages.events import EventMessages, EventWatch
from turbseg_ros.messages.results import CentroidMarkers, Output, outputs, slot_output, views
from turbseg_ros.overlay import OverlayStrip, write_picture
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import SegmentationResult, segment
from turbseg_ros.throttle import ThrottledLogger

_LOGGER = logging.getLogger(__name__)


class ResultWriter:
    """Writes results to the node's topics in a bag, at the times at which images were recorded.

    A slot has its topic from the first object on that holds it, with a mask for each frame. An
    output that fails is warned about, throttled, and counted in `failed` under its name; the
    others are written all the same.

    :param max_age: frames that an object lives unseen.
    :param shown: names of the topics for people that are written, too.
    """

    def __init__(self, bag: BagWriter, max_age: int, shown: Collection[str] = ()) -> None:
        self._bag = bag
        wanted = (view for view in views() if view.name in shown)
        events = EventMessages(EventWatch(lambda: max_age))
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


@dataclass(frozen=True)
class Replayed:
    """What came of one bag: lines for people, and the exit status that it alone would have.

    `cut` tells that a signal ended it early.
    """

    lines: tuple[str, ...]
    status: int = 0
    cut: bool = False


@dataclass(frozen=True)
class ReplayJob:
    """One bag to be replayed into another, `out`, and what else is to be made of its results."""

    name: str
    bag: Path
    out: Path
    parameters: Parameters
    image_topic: str | None = None
    section: Section = WHOLE
    views: tuple[str, ...] = ()
    overlay: Path | None = None
    video: Path | None = None
    objects: Path | None = None
    object_pictures: Path | None = None
    foreseen: ClassVar[tuple[type[Exception], ...]] = (BagError, ParameterError, UsageError)

    @property
    def title(self) -> str:
        """What a progress bar calls it."""
        return self.bag.name

    @property
    def full_name(self) -> str:
        """What tells it from other jobs."""
        return self.name

    def check(self) -> None:
        """See that all it writes can be written.

        :raises UsageError: when something can't.
        """
        check_new(self.out)
        for path in (self.overlay, self.video, self.objects, self.object_pictures):
            if path is not None and self.out.absolute() in path.absolute().parents:
                raise UsageError(f"{path} lies in the bag to be written; name another place")
        if self.overlay is not None:
            check_picture(self.overlay)
        if self.video is not None:
            check_suffix(self.video, FILM_SUFFIXES)
        if self.objects is not None:
            check_suffix(self.objects, TABLE_SUFFIXES)
            if self.objects.suffix.lower() == ".parquet":
                importlib.import_module("pyarrow")  # missing, it is told before the work
        if self.object_pictures is not None:
            check_folder(self.object_pictures)

    def run(self, progress: Progress = iter) -> Replayed:
        """Replay the bag; what it comes to when a signal stops it is kept, and marked as partial.

        :raises BagError: when it can't be read, or holds no image that can.
        :raises ParameterError: when the method can't be made as the parameters say.
        :raises UsageError: when something can't be written.
        """
        reader = BagReader(self.bag, self.section)
        frames = BagFrames(reader, reader.find_image_topic(self.image_topic))
        self.check()
        exports = _Exports(self, len(frames))
        count = 0
        conditions: Counter[Condition] = Counter()
        with _stoppable() as stop, BagWriter(self.out) as bag, exports:

            def shown(epochs: range) -> Iterator[int]:
                # Bars of several processes would write over one another.
                seen: Iterable[int] = epochs
                if progress is not iter:
                    seen = with_progress(epochs, title="refining", unit="epoch")
                for epoch in seen:
                    # Before the last epoch there is nothing to keep.
                    stop.check()
                    yield epoch

            segmenter = clip_segmenter(self.parameters, shown)
            results = ResultWriter(bag, self.parameters.tracking.max_age, self.views)
            # The next frames are read and segmented while a result is written. When it is
            # stopped, those that were read get their results.
            images = ahead(stop.until_stopped(progress(frames)))
            for result in ahead(segment(images, segmenter)):
                results.write(result)
                exports.add(result)
                count += 1
                conditions[result.condition] += 1
            if stop.cut and not count:
                stop.check()
            if not count:
                raise BagError(f"{reader.path}: none of {len(frames)} images could be read")
            partial = interrupted_after(count, len(frames)) if stop.cut else ""
            if partial:
                bag.mark_partial(partial)
        exports.write()
        if partial:
            return Replayed((f"{self.out} is partial: {partial}",), stop.status, cut=True)
        lost = f", {frames.lost} images lost with what is damaged" if frames.lost else ""
        failed = "".join(
            f", {name} missing in {times} frames" for name, times in results.failed.items()
        )
        noticed = "".join(
            f", {conditions[condition]} {condition.value}"
            for condition in Condition
            if condition is not Condition.SOUND and conditions[condition]
        )
        skipped = f"{frames.skipped} images skipped"
        told = f"{self.out}: {count} results, {skipped}{noticed}{lost}{failed}"
        return Replayed((told, exports.objects.summary()), status=1 if failed else 0)


@executable("turbseg_replay")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status, 1 when a bag couldn't be replayed."""
    options = build_parser().parse_args(arguments)
    keep_large_buffers()
    parameters = parameters_from(options)
    if len(options.bags) == 1 and options.scheduler is None:
        (job,) = _jobs(options, parameters)
        replayed = job.run(job_progress(job))
        _tell(replayed)
        return replayed.status
    jobs = _jobs(options, parameters)
    if len(jobs) > 1:
        check_folder(options.out)
    for job in jobs:
        job.check()
    try:
        return _replay_all(jobs, options)
    except ClusterError as error:
        raise UsageError(str(error)) from error


def _replay_all(jobs: Sequence[ReplayJob], options: argparse.Namespace) -> int:
    """Replay several bags, as many at a time as the options say; return the exit status."""
    workers = min(options.workers or usable_workers(), len(jobs))
    status = done = 0
    try:
        with job_runner(workers, options.scheduler, job_progress) as doing:
            for outcome in with_progress(doing(jobs), "replay", total=len(jobs), unit="bag"):
                if isinstance(outcome, Failure):
                    tqdm.write(f"turbseg_replay: {outcome.reason}", file=sys.stderr)
                    status = 1
                    continue
                _tell(outcome)
                status = max(status, outcome.status)
                if outcome.cut:
                    break
                done += 1
    except Interrupted as interrupted:
        status = int(interrupted.code or 0)
    if status > 1:
        partial = interrupted_after(done, len(jobs), "bags")
        begun = "is marked as partial" if options.scheduler is None else "is the cluster's to end"
        print(f"turbseg_replay: {partial}; what was begun {begun}", file=sys.stderr)
    return status


def _tell(replayed: Replayed) -> None:
    for line in replayed.lines:
        if replayed.cut:
            tqdm.write(f"turbseg_replay: {line}", file=sys.stderr)
        else:
            tqdm.write(line)


def _jobs(options: argparse.Namespace, parameters: Parameters) -> list[ReplayJob]:
    """Return a job for each bag; of several, each one's outputs are named after its bag.

    :raises UsageError: when outputs of two bags would be the same.
    """
    several = len(options.bags) > 1
    names = [bag.stem if bag.is_file() else bag.absolute().name for bag in options.bags]
    twice = [name for name, times in Counter(names).items() if times > 1]
    if twice:
        raise UsageError(f"two bags are called {twice[0]}; replay them one after the other")

    def of_bag(option: str, name: str) -> Path | None:
        path: Path | None = getattr(options, option)
        if path is None or not several:
            return path
        if "{bag}" not in str(path):
            example = path.with_name(f"{path.stem}_{{bag}}{path.suffix}")
            raise UsageError(
                f"--{option.replace('_', '-')} {path} is one for several bags; put {{bag}} where "
                f"their names shall stand, as {example}"
            )
        return Path(str(path).replace("{bag}", name))

    return [
        ReplayJob(
            str(bag),
            # Another process may have another working directory.
            bag.absolute(),
            options.out.absolute() / name if several else options.out,
            parameters,
            options.image_topic,
            section_from(options),
            tuple(options.views),
            *(of_bag(each, name) for each in ("overlay", "video", "objects", "object_pictures")),
        )
        for bag, name in zip(options.bags, names, strict=True)
    ]


def _stoppable() -> contextlib.AbstractContextManager[StopRequest]:
    """Let signals stop the work, where they can: in the main thread, not in one of a cluster's."""
    if threading.current_thread() is threading.main_thread():
        return stopping_at_signals("turbseg_replay")
    return contextlib.nullcontext(StopRequest())


class _Exports(contextlib.ExitStack):
    """What is made of the results beside the bag, as the job asks; used in a `with`."""

    def __init__(self, job: ReplayJob, frames: int) -> None:
        super().__init__()
        self._job = job
        self._strip = OverlayStrip(frames)
        self.objects = ObjectTable(pictures=job.object_pictures is not None)
        film = None if job.video is None else self.enter_context(Film(job.video))
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
        if self._job.overlay is not None:
            write_picture(self._job.overlay, self._strip.picture())
        if self._job.objects is not None:
            self.objects.write(self._job.objects)
        if self._job.object_pictures is not None:
            self.objects.write_pictures(self._job.object_pictures)
