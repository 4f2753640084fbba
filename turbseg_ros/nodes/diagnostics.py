"""What the node tells of itself on /diagnostics."""

from __future__ import annotations

import enum
import math
import statistics
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from turbseg_ros.messages.diagnostics import figures, remarks, status_name
from turbseg_ros.parameters import DiagnosticsParameters
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.load import ANSWERED_STEPS, Step

# Failures this long ago, in seconds, tell that a new one is no single accident.
_FAILURE_MEMORY = 10.0
# Seconds. Older stamps are of another clock: that of a recording, or the camera's uptime.
_DAY = 86400.0
_MAX_LATENCY = _DAY


class Event(enum.Enum):
    """What may happen to an image."""

    RECEIVED = "received"
    ANSWERED = "answered"
    COASTED = "answered by coasting"
    DROPPED = "dropped"
    LOST = "lost by the middleware"
    SKIPPED = "skipped"
    FAILED = "failed"
    INCOMPLETE = "answered without some output"
    DAMAGED = "passed over: damaged"
    BLIND = "passed over: blind"
    REPEATED = "passed over: repeated"
    CUT = "of another scene"


_EVENT_OF = {
    Condition.DAMAGED: Event.DAMAGED,
    Condition.BLIND: Event.BLIND,
    Condition.REPEATED: Event.REPEATED,
    Condition.CUT: Event.CUT,
}


@dataclass(frozen=True)
class Report:
    """What happened in a period; times in seconds.

    `events` counts the period, `totals` the whole run, and so do `steps` and `step_totals` the
    frames answered at each step of the load's ladder. The latencies are of the frames answered
    in the period. `failures` is how often segmenting failed lately, however many frames each of
    them cost. `silence` is the time since the last image, or since the start while there was
    none. `last` is the newest result, None while there is none.
    """

    period: float
    events: Counter[Event]
    totals: Counter[Event]
    latency_from_stamp: Sequence[float]
    latency_from_arrival: Sequence[float]
    failures: int
    silence: float
    last: SegmentationResult | None
    steps: Counter[Step]
    step_totals: Counter[Step]

    @property
    def answered_at(self) -> Step:
        """The furthest step at which a frame was answered in the period."""
        return max(self.steps, default=Step.FULL)

    @property
    def step(self) -> Step:
        """The furthest step that was taken in the period."""
        return Step.DROPPING if self.events[Event.DROPPED] else self.answered_at

    def rate(self, event: Event) -> float:
        """How often something happened, in Hz."""
        return self.events[event] / self.period


class Statistics:
    """Counts what happens to images; any thread may tell it or ask."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._totals: Counter[Event] = Counter()
        self._step_totals: Counter[Step] = Counter()
        self._last: SegmentationResult | None = None
        self._last_image = clock()
        self._failure_times: deque[float] = deque()
        self._begin_period()

    def count(self, event: Event, times: int = 1) -> None:
        """Note that something happened to `times` images."""
        with self._lock:
            self._count(event, times)

    def answered(
        self, result: SegmentationResult, *, since_stamp: float, since_arrival: float
    ) -> None:
        """Note a published result and how long, in seconds, its frame took."""
        with self._lock:
            self._count(Event.ANSWERED, 1)
            self._count(Event.COASTED, int(result.coasted))
            if result.condition in _EVENT_OF:
                self._count(_EVENT_OF[result.condition], 1)
            self._steps[result.step] += 1
            self._step_totals[result.step] += 1
            self._last = result
            self._from_stamp.append(since_stamp)
            self._from_arrival.append(since_arrival)

    def expect_images(self) -> None:
        """Count the time without an image from now on."""
        with self._lock:
            self._last_image = self._clock()

    def failed(self, frames: int = 1) -> None:
        """Note that something failed and cost so many frames their results."""
        with self._lock:
            self._count(Event.FAILED, frames)
            self._failure_times.append(self._clock())

    def take(self) -> Report:
        """Return what happened since the last time, and begin a new period."""
        with self._lock:
            now = self._clock()
            while self._failure_times and now - self._failure_times[0] > _FAILURE_MEMORY:
                self._failure_times.popleft()
            report = Report(
                period=max(now - self._began, 1e-9),
                events=self._events,
                totals=Counter(self._totals),
                latency_from_stamp=self._from_stamp,
                latency_from_arrival=self._from_arrival,
                failures=len(self._failure_times),
                silence=now - self._last_image,
                last=self._last,
                steps=self._steps,
                step_totals=Counter(self._step_totals),
            )
            self._begin_period()
        return report

    def _count(self, event: Event, times: int) -> None:
        self._events[event] += times
        self._totals[event] += times
        if event is Event.RECEIVED:
            self._last_image = self._clock()

    def _begin_period(self) -> None:
        self._began = self._clock()
        self._events: Counter[Event] = Counter()
        self._steps: Counter[Step] = Counter()
        self._from_stamp: list[float] = []
        self._from_arrival: list[float] = []


@dataclass(frozen=True)
class NodeState:
    """How the node stands.

    While it is `enabled`, it is `idle` when it hears no images since nobody listens to results.
    `publishers` and `reliability` are those of its image topic; `mismatch` tells what other type
    it carries, if it does. `pause_timeout` is the silence, in seconds, after which the input
    counts as stale. `limits` are what the user asks for. `has_time` is False while the node waits
    for /clock. `look_ahead` is the number of frames that have to follow one before it is answered;
    `waiting` images have not been looked at yet. `device` is what it computes on.
    """

    topic: str
    enabled: bool
    idle: bool
    publishers: int
    mismatch: str
    reliability: str
    pause_timeout: float
    limits: DiagnosticsParameters
    has_time: bool
    latency_mode: str
    look_ahead: int
    waiting: int
    device: str


def status_message(name: str, report: Report, state: NodeState) -> DiagnosticStatus:
    """Return the status of a node called `name`: a level, the reasons for it, and figures."""
    findings = list(_findings(report, state))
    level = max((level for level, _ in findings), default=DiagnosticStatus.OK)
    return DiagnosticStatus(
        level=level,
        name=status_name(name),
        message="; ".join(text for _, text in findings) or "segmenting",
        hardware_id=report.last.frame.frame_id if report.last else "",
        values=[KeyValue(key=key, value=value) for key, value in _figures(report, state)],
    )


def _findings(report: Report, state: NodeState) -> Iterator[tuple[bytes, str]]:
    ok, warn, error = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
    if not state.enabled:
        yield ok, "disabled"
        return
    if state.idle:
        yield ok, "idle: nobody listens to results"
        return
    if not report.totals[Event.RECEIVED]:
        yield (
            warn,
            (state.mismatch or f"no image yet on {state.topic} ({state.publishers} publishers)"),
        )
        return
    if report.silence > state.pause_timeout:
        yield error, f"no image on {state.topic} for {report.silence:.1f} s"
    elif report.rate(Event.RECEIVED) < state.limits.min_rate:
        yield warn, f"input below {state.limits.min_rate:g} Hz"
    if report.failures == 1:
        yield warn, "segmenting failed once; the log tells why"
    elif report.failures:
        yield error, f"segmenting failed {report.failures} times; the log tells why"
    if report.events[Event.COASTED]:
        yield ok, f"{report.events[Event.COASTED]} images {Event.COASTED.value}"
    for event in (Event.REPEATED, Event.CUT):
        if report.events[event]:
            yield ok, f"{report.events[event]} images {event.value}"
    for event in (
        Event.DROPPED,
        Event.LOST,
        Event.SKIPPED,
        Event.INCOMPLETE,
        Event.DAMAGED,
        Event.BLIND,
    ):
        if report.events[event]:
            yield warn, f"{report.events[event]} images {event.value}"
    if report.last and _relative_tilt(report.last) > state.limits.max_turbulence:
        yield warn, f"turbulence of {report.last.tilt:.1f} px: objects may be missed"
    if report.last:
        yield from ((ok, remark) for remark in remarks(report.last))
    if state.publishers > 1:
        yield warn, f"{state.publishers} publishers on {state.topic}: their images mix"
    if offset := _foreign_clock(report):
        yield ok, f"stamps are {offset} this node's clock: latency from stamp is not known"
    if not state.has_time:
        yield warn, "use_sim_time is set, but nothing comes on /clock"


def _known_latency_from_stamp(report: Report, state: NodeState) -> Sequence[float]:
    """Return the latencies; none where there is no time, or stamps are of another clock."""
    return report.latency_from_stamp if state.has_time and not _foreign_clock(report) else ()


def _foreign_clock(report: Report) -> str:
    """Return how far stamps lie from the node's clock if that can't be latency, "" otherwise.

    Answers come after images were taken, and within a day.
    """
    latencies = report.latency_from_stamp
    if not latencies or 0.0 <= min(latencies) <= max(latencies) <= _MAX_LATENCY:
        return ""
    offset = statistics.median(latencies)
    if min(latencies) >= 0.0 or offset > _MAX_LATENCY:
        return f"{max(latencies) / _DAY:.0f} days behind"
    return f"{-min(latencies):.3f} s ahead of"


def _relative_tilt(result: SegmentationResult) -> float:
    """Return the turbulence in per cent of the picture's width, NaN while unknown."""
    return 100.0 * result.tilt / result.frame.image.shape[1]


def _accuracy(report: Report) -> str:
    """Return what the load's step costs, in words; no measurement of what is seen now."""
    full, reached = Step.FULL.j, report.answered_at.j
    told = f"{full:.2f}" if reached == full else f"{reached:.2f} instead of {full:.2f}"
    dropped = ", no masks of dropped images" if report.step is Step.DROPPING else ""
    return f"{told}{dropped} (the evaluation's scenes, default parameters)"


def _figures(report: Report, state: NodeState) -> Iterator[tuple[str, str]]:
    yield "input topic", state.topic
    yield "input publishers", str(state.publishers)
    yield "input reliability", state.reliability
    yield "input rate (Hz)", f"{report.rate(Event.RECEIVED):.1f}"
    yield "output rate (Hz)", f"{report.rate(Event.ANSWERED):.1f}"
    for origin, latencies in (
        ("stamp", _known_latency_from_stamp(report, state)),
        ("arrival", report.latency_from_arrival),
    ):
        for percentile in (50, 95):
            value = np.percentile(latencies, percentile) if latencies else math.nan
            yield f"latency from {origin} p{percentile} (ms)", f"{1000 * value:.1f}"
    yield "device", state.device
    yield "latency mode", state.latency_mode
    yield "look-ahead (frames)", str(state.look_ahead)
    yield "images waiting", str(state.waiting)
    for event in Event:
        yield f"images {event.value}", str(report.totals[event])
    yield "load step", report.step.label
    yield "J of the load step", _accuracy(report)
    for step in ANSWERED_STEPS:
        yield f"images answered at step {step.label}", str(report.step_totals[step])
    if report.last:
        yield from figures(report.last)
