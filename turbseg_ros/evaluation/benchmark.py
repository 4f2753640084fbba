"""How long a frame takes: the whole, its stages and its baselines, beside a yardstick.

Milliseconds depend on the machine and on what else it does. Everything here takes turns, a few
frames each, with one optical flow of a fixed kind, whose ratio means the same everywhere.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage
from turbseg_ros.evaluation.baselines import Method, TurbsegMethod
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, Segmenter
from turbseg_ros.segmentation.observer import StageObserver

YARDSTICK_SIZE = (432, 240)
"""Width and height of the pictures whose flow is the yardstick."""

# Frames that each method gets at a turn, and seconds for which its threads may finish then.
_BLOCK = 10
_PAUSE = 0.05


@dataclass(frozen=True)
class Cost:
    """What a frame costs, in milliseconds: percentiles of the time, and of processors the median.

    Processors may work at the same time, and on flows of the next frame once a frame is answered.
    """

    p50: float
    p95: float
    p99: float
    processors: float


@dataclass(frozen=True)
class Timing:
    """What methods took for frames of one size.

    `frames` gives each method's cost by its name, `yardstick` that of the flow beside it;
    `stages` gives the mean milliseconds a frame that calls of each stage took, less those of
    other stages within; stages run in several threads, so they may add up to more than the whole.
    """

    size: tuple[int, int]
    frames: Mapping[str, Cost]
    yardstick: Cost
    stages: Mapping[str, float]

    def ratio(self, name: str) -> float:
        """Return the median time of a method in medians of the yardstick."""
        return self.frames[name].p50 / self.yardstick.p50

    def processor_ratio(self, name: str) -> float:
        """Return the same for the time of processors, which other processes disturb less."""
        return self.frames[name].processors / self.yardstick.processors


@dataclass(frozen=True)
class Footprint:
    """What a process that does nothing but segment needs.

    `mebibytes` is the most memory that was ever resident; `start_seconds` the time that the
    process takes to load all that it needs, `first_result_seconds` that from its first frame to
    its first result, the next frame always at hand.
    """

    mebibytes: float
    start_seconds: float
    first_result_seconds: float


def endless(clip: Sequence[ByteImage], size: tuple[int, int], rate_hz: float) -> Iterator[Frame]:
    """Return a clip forward and backward without end, scaled to cover `size` (width, height)."""
    width, height = size
    there_and_back = [*range(len(clip)), *range(len(clip) - 2, 0, -1)]
    number = 0
    while True:
        picture = clip[there_and_back[number % len(there_and_back)]]
        scale = max(width / picture.shape[1], height / picture.shape[0])
        wide, high = round(width / scale), round(height / scale)
        image = cv2.resize(picture[:high, :wide], size, interpolation=cv2.INTER_CUBIC)
        # As in the node while nobody looks at its overlay.
        yield Frame(round((1 + number / rate_hz) * 1e9), image, image_wanted=False)
        number += 1


def measure(
    methods: Sequence[Method], frames: Iterable[Frame], warm_up: int, size: tuple[int, int]
) -> Timing:
    """Time methods on the same frames, a few at a turn; the stages are those of the first one.

    :param warm_up: frames that are not counted, while memories fill.
    """
    default = cv2.getNumThreads()
    clock = StageClock()
    segmenters = [_observed(methods[0], clock), *(method.segmenter() for method in methods[1:])]
    # The method makes do with its own threads, the others have OpenCV's.
    threads = [1 if isinstance(each, TurbsegMethod) else default for each in methods]
    flow = _YardstickFlow()
    meters = [_Meter() for _ in methods]
    yardstick = _Meter()
    coming = iter(frames)
    for frame in itertools.islice(coming, warm_up):
        for segmenter in segmenters:
            segmenter.push(frame)
        flow.compute(flow.prepared(frame))
    while block := list(itertools.islice(coming, _BLOCK)):
        cv2.setNumThreads(threads[0])
        clock.running = True
        meters[0].run(segmenters[0].push, block)
        clock.running = False
        for meter, segmenter, count in zip(meters[1:], segmenters[1:], threads[1:], strict=True):
            cv2.setNumThreads(count)
            meter.run(segmenter.push, block)
        cv2.setNumThreads(default)
        yardstick.run(flow.compute, [flow.prepared(frame) for frame in block])
    counted = len(yardstick.seconds)
    return Timing(
        size=size,
        frames={method.name: meter.cost() for method, meter in zip(methods, meters, strict=True)},
        yardstick=yardstick.cost(),
        stages={name: 1e3 * total / counted for name, total in clock.seconds.items()},
    )


class _Meter:
    """Takes the time of something done to one item after the other."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self._processor_seconds: list[float] = []

    def run(self, action: Callable[[Any], object], items: Sequence[Any]) -> None:
        """Do it to each item."""
        processors = time.process_time()
        for item in items:
            began = time.perf_counter()
            action(item)
            self.seconds.append(time.perf_counter() - began)
        # Threads may be at work ahead: that is no one else's time.
        time.sleep(_PAUSE)
        self._processor_seconds.append((time.process_time() - processors) / len(items))

    def cost(self) -> Cost:
        """Sum up what was measured."""
        p50, p95, p99 = (1e3 * float(ms) for ms in np.percentile(self.seconds, [50, 95, 99]))
        return Cost(p50, p95, p99, 1e3 * float(np.median(self._processor_seconds)))


class StageClock(StageObserver):
    """Adds up the time that stages take while it is running.

    A stage's time is its own less that of the stages within it, in the same thread.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.running = False
        self._lock = threading.Lock()
        self._within = threading.local()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Take the time while a stage works."""
        outer = getattr(self._within, "seconds", 0.0)
        self._within.seconds = 0.0
        began = time.perf_counter()
        try:
            yield
        finally:
            took = time.perf_counter() - began
            if self.running:
                with self._lock:
                    self.seconds[name] += took - self._within.seconds
            self._within.seconds = outer + took


def _observed(method: Method, clock: StageClock) -> Segmenter:
    """Make a method's segmenter; the clock looks at its stages where it has some."""
    if isinstance(method, TurbsegMethod):
        return motion_segmenter(method.parameters, clock)
    return method.segmenter()


def footprint(parameters: Parameters, frames: Iterable[Frame]) -> Footprint:
    """Segment frames in a process of their own and tell what it needs."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    began = time.perf_counter()
    process = context.Process(target=_segment_from, args=(there, parameters), daemon=True)
    process.start()
    there.close()
    first_result = float("nan")
    with here:
        here.recv()
        loaded = time.perf_counter()
        for frame in frames:
            here.send(frame)
            if here.recv() and math.isnan(first_result):
                first_result = time.perf_counter() - loaded
        here.send(None)
        mebibytes = here.recv()
    process.join()
    return Footprint(mebibytes, loaded - began, first_result)


def _segment_from(connection: Connection, parameters: Parameters) -> None:
    # A Ctrl-C goes to all processes at a terminal; this one ends with its parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    segmenter = motion_segmenter(parameters)
    with contextlib.suppress(EOFError, BrokenPipeError):
        _answer(connection, segmenter)


def _answer(connection: Connection, segmenter: Segmenter) -> None:
    connection.send("ready")
    while (frame := connection.recv()) is not None:
        connection.send(len(segmenter.push(frame)))
    connection.send(_most_resident())


def _most_resident() -> float:
    """Return the most MiB of this process that ever were resident."""
    # Unlike getrusage's, this figure doesn't begin with what the parent process had.
    lines = Path("/proc/self/status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith("VmHWM:"))
    return int(kibibytes) / 1024


class _YardstickFlow:
    """One DIS flow, OpenCV's medium preset, between successive pictures of one small size."""

    def __init__(self) -> None:
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._previous: ByteImage | None = None

    def prepared(self, frame: Frame) -> ByteImage:
        """Return the small grey picture of a frame."""
        small = cv2.resize(frame.image, YARDSTICK_SIZE, interpolation=cv2.INTER_AREA)
        return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY) if small.ndim == 3 else small

    def compute(self, grey: ByteImage) -> None:
        """Compute the flow from the picture before to this one."""
        previous = grey if self._previous is None else self._previous
        self._previous = grey
        self._dis.calc(previous, grey, None)
