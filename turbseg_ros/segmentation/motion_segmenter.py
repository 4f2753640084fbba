"""Frames in, one result for each out, in order: streams, cuts, and what waits for its result."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import TracebackType
from typing import TypeVar

from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.camera_state import CameraTrack
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.load import Load
from turbseg_ros.segmentation.look_ahead import LookAhead
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.passed_frames import (
    MAX_PASSED,
    DoubtfulFrames,
    ReadyFrame,
    WaitingFrame,
    passed_over,
)
from turbseg_ros.segmentation.pending_result import PendingResult
from turbseg_ros.segmentation.pipeline import Pipeline
from turbseg_ros.segmentation.preparation import FramePreparer
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.strategies import Strategies
from turbseg_ros.segmentation.track import Tracker

S = TypeVar("S", bound="MotionSegmenter")


class MotionSegmenter:
    """Segments what really moves, frame by frame.

    `push` takes frames in the order of time and returns the results that are ready; `flush`
    returns those of all frames that are left. Every frame gets exactly one result, in order. A
    frame of another size, kind or scene than those before, or one that begins a stream, starts a
    new window; ids go on. Frames that are damaged or repeated are passed over; see
    `DoubtfulFrames`. `close` ends its threads; used in a `with`, it closes itself.
    """

    def __init__(
        self,
        parameters: Parameters,
        strategies_for: Callable[[Parameters], Strategies],
        observer: StageObserver | None = None,
    ) -> None:
        """Set up without frames; see `turbseg_ros.factory`, which chooses the strategies.

        :param strategies_for: makes the strategies, and makes them anew with other parameters.
        :param observer: looks at what the stages make.
        """
        self._parameters = parameters
        self._strategies_for = strategies_for
        self._strategies = strategies_for(parameters)
        self._observer = observer or StageObserver()
        self._preparation = ThreadPoolExecutor(1, thread_name_prefix="preparation")
        self._motion = ThreadPoolExecutor(1, thread_name_prefix="motion")
        # None before a stream's first frame.
        self._stream: _Stream | None = None

    def __enter__(self: S) -> S:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End its threads; frames not yet answered are forgotten."""
        self.reset()
        self._preparation.shutdown()
        self._motion.shutdown()
        self._strategies.flow.close()

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other parameters and a new window; frames not yet answered are forgotten."""
        self.reset()
        before, self._strategies = self._strategies, self._strategies_for(parameters)
        self._parameters = parameters
        self._strategies.tracker.continue_ids(before.tracker)
        if before.flow is not self._strategies.flow:
            before.flow.close()

    def reset(self) -> None:
        """Forget all frames and end all objects; ids go on."""
        self._strategies.tracker.reset()
        if self._stream is not None:
            self._stream.cancel()
            self._stream = None

    @property
    def device(self) -> str:
        """Where optical flow is computed: cpu or cuda."""
        return self._strategies.flow.device

    @property
    def look_ahead(self) -> int:
        """Frames that must follow a frame before its result is given."""
        return self._look_ahead.frames

    @property
    def _look_ahead(self) -> LookAhead:
        strategies, widest = self._strategies, self._parameters.flow.interval
        intervals = strategies.measure.intervals(widest)
        return LookAhead.of(self._parameters, intervals, strategies.tracker.delay)

    def empty_result(self, frame: Frame) -> SegmentationResult:
        """Return the result of a frame in which nothing was found, as this segmenter gives it."""
        return PendingResult(frame, self._resolution_of(frame), CameraTrack()).result()

    def push(self, frame: Frame, waiting: int = 0) -> list[SegmentationResult]:
        """Take the next frame; return the results that are ready, of earlier frames mostly.

        Its image is still read until the next call.

        :param waiting: frames that wait to be pushed after it. Where there are as many as the
            parameters say, it is done sooner and less exactly; see `Load`.
        """
        load = Load.of(waiting, self._parameters)
        results = []
        if self._stream is not None and not self._stream.takes(frame):
            results = self.flush(lambda: waiting)
            self.reset()
        results += self._take_in(lambda: load)
        stream = self._stream = self._stream or self._begin(frame)
        stream.prepare(frame)
        if self._parameters.is_causal:
            results += self._take_in(lambda: load)
        stream = self._stream or stream
        return results + stream.advance(Load.of(waiting, self._parameters, stream.piled_up))

    def flush(self, waiting: Callable[[], int] = lambda: 0) -> list[SegmentationResult]:
        """Return the results of all frames that have none yet; `reset` begins another stream.

        :param waiting: tells how many frames wait meanwhile to be pushed afterwards; asked before
            each frame, which is segmented the sooner for it as in `push`.
        """

        def load() -> Load:
            return Load.of(waiting(), self._parameters)

        results = self._take_in(load)
        if self._stream is not None:
            results += self._join(self._stream.settle(), load)
        return results if self._stream is None else results + self._stream.finish(load)

    def _take_in(self, load: Callable[[], Load]) -> list[SegmentationResult]:
        """Let the frame that was prepared join the others; after a cut, return what was before."""
        return [] if self._stream is None else self._join(self._stream.take_in(), load)

    def _join(
        self, settled: Sequence[ReadyFrame], load: Callable[[], Load]
    ) -> list[SegmentationResult]:
        """Let frames join the stream, or be passed over; a cut ends it and begins another."""
        results = []
        for ready in settled:
            assert self._stream is not None
            if ready.condition is Condition.CUT:
                results += self._stream.finish(load)
                self.reset()
                self._stream = self._begin(ready.frame)
            self._stream.join(ready)
        return results

    def _resolution_of(self, frame: Frame) -> Resolution:
        sizes = self._parameters.resolution
        return Resolution.of(frame.shape, sizes.processing, sizes.detail)

    def _begin(self, frame: Frame) -> _Stream:
        resolution = self._resolution_of(frame)
        return _Stream(
            kind=_kind_of(frame),
            preparer=FramePreparer(
                resolution,
                self._preparation,
                self._observer,
                self._parameters.seed.small_targets,
            ),
            pipeline=Pipeline(
                resolution,
                self._parameters,
                self._strategies,
                self._look_ahead,
                self._motion,
                self._observer,
            ),
            tracker=self._strategies.tracker,
            look_ahead=self._look_ahead,
            causal=self._parameters.is_causal,
            observer=self._observer,
        )


class _Stream:
    """Frames of one kind and one scene, from the first on, until all have their results."""

    def __init__(
        self,
        kind: tuple[object, ...],
        preparer: FramePreparer,
        pipeline: Pipeline,
        tracker: Tracker,
        look_ahead: LookAhead,
        causal: bool,
        observer: StageObserver,
    ) -> None:
        self._kind = kind
        self._observer = observer
        self._preparer = preparer
        self._pipeline = pipeline
        self._tracker = tracker
        self._look_ahead = look_ahead
        self._segmented = 0
        self._doubtful = DoubtfulFrames(causal)
        # Frames not yet answered whose conditions are settled.
        self._waiting: deque[WaitingFrame] = deque()
        # How many frames have been passed over since the newest that joined the window, and since
        # the one that was segmented last.
        self._passed, self._unseen = 0, 0
        self._pending: deque[PendingResult] = deque()
        self._last: PendingResult | None = None

    @property
    def piled_up(self) -> int:
        """Frames that can be segmented now but for the one that is due."""
        return self._pipeline.window.piled_up

    def takes(self, frame: Frame) -> bool:
        """Whether a frame goes on where those before stopped, in their size and type."""
        return not frame.begins_stream and _kind_of(frame) == self._kind

    def prepare(self, frame: Frame) -> None:
        """Have the next frame prepared in the background."""
        window = self._pipeline.window
        self._preparer.start(frame, window.count, window.newest, self._pipeline.voteless())

    def take_in(self) -> list[ReadyFrame]:
        """Take the prepared frame; return those whose conditions are settled by it."""
        finished = self._preparer.finish()
        if finished is None:
            return []
        frame, prepared = finished
        if prepared.condition is not Condition.SOUND and self._passed <= MAX_PASSED:
            self._preparer.forget_tone()
        return self._doubtful.take(ReadyFrame(frame.kept(), prepared))

    def settle(self) -> list[ReadyFrame]:
        """Return the frames whose conditions are not settled as what they seem to be for now."""
        return self._doubtful.settle()

    def join(self, ready: ReadyFrame) -> None:
        """Let a frame join the window, or be passed over."""
        self._waiting.append(ready.waiting())
        if ready.condition.is_passed_over:
            self._passed += 1
            return
        self._passed = 0
        index = self._pipeline.window.count
        self._pipeline.append(replace(ready.prepared, index=index))

    def advance(self, load: Load) -> list[SegmentationResult]:
        """Segment what can be, as the load permits; return the results that are settled."""
        for _ in range(load.frames_at_once):
            # What shows nothing for long is answered, and nothing waits for its end.
            index = self._pipeline.window.pop_ready(ended=self._passed > MAX_PASSED)
            if index is None:
                break
            self._segment(index, load)
        self._answer_passed()
        return self._results(self._look_ahead.results_kept(self._segmented))

    def finish(self, load: Callable[[], Load]) -> list[SegmentationResult]:
        """Segment all that is left, as the load permits by then; return all their results."""
        while (index := self._pipeline.window.pop_ready(ended=True)) is not None:
            self._segment(index, load())
        self._answer_passed()
        self._tracker.settle()
        return self._results(0)

    def cancel(self) -> None:
        """Give up what is done in the background."""
        self._pipeline.cancel()

    def _segment(self, index: int, load: Load) -> None:
        self._answer_passed()
        waiting = self._waiting.popleft()
        pending = self._pipeline.segment_frame(index, waiting.frame, load)
        self._segmented += 1
        self._unseen = 0
        self._last = replace(pending, condition=waiting.condition, step=load.step)
        self._pending.append(self._last)

    def _answer_passed(self) -> None:
        """Answer the frames that were passed over after the one segmented last."""
        while self._waiting and self._waiting[0].condition.is_passed_over:
            assert self._last is not None
            self._unseen += 1
            waiting = self._waiting.popleft()
            self._pending.append(passed_over(waiting, self._last, self._tracker, self._unseen))

    def _results(self, kept: int) -> list[SegmentationResult]:
        """Return the results of all pending frames but the newest so many.

        Frames passed over tell nothing of tracks, and are no part of those, within reason.
        """
        if kept:
            passed = sum(pending.condition.is_passed_over for pending in self._pending)
            kept += min(passed, MAX_PASSED)
        results = []
        while len(self._pending) > kept:
            with self._observer.stage("labels"):
                results.append(self._pending.popleft().result())
        return results


def _kind_of(frame: Frame) -> tuple[object, ...]:
    return frame.shape, frame.image.shape[2:], frame.image.dtype
