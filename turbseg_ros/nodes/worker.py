"""The thread that turns images into results, so that receiving them never waits for that."""

from __future__ import annotations

import functools
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from turbseg_ros.messages.images import ImageConversionError
from turbseg_ros.messages.stream_monitor import Action, StreamMonitor
from turbseg_ros.nodes.diagnostics import Event, Statistics
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.throttle import ThrottledLogger

_SECOND = 1e9
# Seconds that the last frames may take when the node stops; ros2 launch kills it after ten.
_STOP_TIMEOUT = 8.0
# Seconds in which images that wait in the middleware are taken while nothing is segmented.
_GRACE = 0.25


class LiveSegmenter(Protocol):
    """The part of `MotionSegmenter` that the worker drives."""

    def push(self, frame: Frame, waiting: int = 0) -> list[SegmentationResult]:
        """Take the next frame; return the results that are ready, in order.

        :param waiting: frames that wait to be pushed after it.
        """

    def flush(self, waiting: Callable[[], int]) -> list[SegmentationResult]:
        """Return the results of all frames that still wait for later ones.

        :param waiting: tells how many frames wait to be pushed by then.
        """

    def reset(self) -> None:
        """Forget all frames and tracks; ids go on growing."""

    def reconfigure(self, parameters: Parameters) -> None:
        """Go on with other parameters; ids go on growing."""

    def empty_result(self, frame: Frame) -> SegmentationResult:
        """Return the result of a frame in which nothing was found."""

    def close(self) -> None:
        """End the segmenter's threads."""


@dataclass(frozen=True)
class Arrival:
    """A message and when it came: in steady nanoseconds, and on the clock of stamps.

    `after_drops` tells whether those before it were dropped.
    """

    message: Any
    time: int
    after_drops: bool = False
    received: int = 0


Command = Callable[[], None]


class Inbox:
    """What waits for the worker: commands, all of them, and images, of which the newest stay."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._arrivals: deque[Arrival] = deque()
        self._commands: deque[Command] = deque()
        self._filled = threading.Condition()

    def __len__(self) -> int:
        """Images that wait."""
        return len(self._arrivals)

    def put(self, arrival: Arrival) -> int:
        """Add an image; return how many older ones made room for it."""
        with self._filled:
            self._arrivals.append(arrival)
            dropped = len(self._arrivals) - self._capacity
            for _ in range(dropped):
                self._arrivals.popleft()
                self._arrivals[0] = replace(self._arrivals[0], after_drops=True)
            self._filled.notify()
        return max(dropped, 0)

    def command(self, command: Command) -> None:
        """Add a command, which goes before all waiting images."""
        with self._filled:
            self._commands.append(command)
            self._filled.notify()

    def clear(self) -> int:
        """Drop the waiting images; return how many they were."""
        with self._filled:
            dropped = len(self._arrivals)
            self._arrivals.clear()
        return dropped

    def take(self, timeout: float | None) -> Arrival | Command | None:
        """Wait for the next entry; None when there is none for `timeout` seconds."""
        with self._filled:
            self._filled.wait_for(lambda: self._commands or self._arrivals, timeout)
            if self._commands:
                return self._commands.popleft()
            return self._arrivals.popleft() if self._arrivals else None


class SegmentationWorker:
    """Segments images one after the other in a thread of its own.

    Every frame that goes into the segmenter gets exactly one result, handed to `publish` in the
    order of the frames: also when segmenting fails (the result is empty then), and also the last
    ones before a pause, whose look-ahead never comes: once the stream has paused, they are
    answered from what there is. Images are only left out before that point, and counted:
    the oldest when more than `queue_size` wait, and what can't be read or repeats. The segmenter
    is told how many wait, and may hurry.

    `convert` turns a message into a frame or raises `ImageConversionError`; `now` gives the
    time, in nanoseconds, on the clock of the frames' stamps. `on_pause` is called when no more
    images come, once their results are published: after a while without one, when the stream was
    said to end, and when the worker stops.
    """

    def __init__(
        self,
        segmenter: LiveSegmenter,
        convert: Callable[[Any], Frame],
        publish: Callable[[SegmentationResult], None],
        now: Callable[[], int],
        statistics: Statistics,
        logger: Any,
        queue_size: int,
        on_pause: Callable[[], None] = lambda: None,
    ) -> None:
        self._segmenter = segmenter
        self._convert = convert
        self._publish = publish
        self._now = now
        self._statistics = statistics
        self._logger = logger
        self._throttled = ThrottledLogger(logger)
        self._inbox = Inbox(queue_size)
        self._on_pause = on_pause
        self._monitor = StreamMonitor()
        # Frames that wait for their result, and when they arrived, in order.
        self._unanswered: deque[tuple[Frame, int]] = deque()
        self._last_arrival = 0
        # Whether images come, and whether more are to come once those that wait are answered.
        self._streaming = False
        self._more_to_come = True
        self._running = True
        self._abandoned = False
        self._thread = threading.Thread(target=self._run, name="segmentation", daemon=True)

    @property
    def pause_timeout(self) -> float:
        """Seconds without an image after which the stream has paused."""
        return self._monitor.pause_timeout

    @property
    def waiting(self) -> int:
        """Images that wait to be segmented."""
        return len(self._inbox)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def submit(self, message: Any) -> None:
        """Queue an image, in place of the oldest if too many wait."""
        self._statistics.count(Event.RECEIVED)
        self._more_to_come = True
        arrival = Arrival(message, time.monotonic_ns(), received=self._now())
        dropped = self._inbox.put(arrival)
        if dropped:
            self._statistics.count(Event.DROPPED, dropped)
            self._throttled.warning(
                Event.DROPPED, "images come faster than they are segmented: the oldest are dropped"
            )

    def restart(self, reason: str) -> None:
        """Answer the frames at hand and take what follows for a new stream."""
        self._inbox.command(lambda: self._restart(reason))

    def end_stream(self) -> None:
        """Say that no more images come: once those that wait are answered, it is a pause."""
        self._more_to_come = False
        # Wakes the thread, which may be waiting for an image.
        self._inbox.command(lambda: None)

    def reconfigure(self, parameters: Parameters) -> None:
        """Answer the frames at hand and go on with other parameters."""
        self._inbox.command(lambda: self._reconfigure(parameters))

    def stop(self) -> None:
        """Answer the frames at hand, drop the images that wait, and end the thread."""
        self._statistics.count(Event.DROPPED, self._inbox.clear())
        self._inbox.command(self._stop)
        self._thread.join(_STOP_TIMEOUT)
        if self._thread.is_alive():
            self._logger.warning("stopping takes too long: the last frames go unanswered")
            self._abandoned = True
        else:
            self._segmenter.close()

    def _run(self) -> None:
        while self._running:
            entry = self._inbox.take(self._time_to_pause())
            try:
                if entry is None:
                    self._pause()
                elif isinstance(entry, Arrival):
                    self._segment(entry)
                else:
                    entry()
            except Exception:
                # Whatever it is, the next image may be sound.
                self._log_error("worker", traceback.format_exc())

    def _time_to_pause(self) -> float | None:
        if not self._streaming:
            return None
        if not self._more_to_come:
            return 0.0
        silence = (time.monotonic_ns() - self._last_arrival) / _SECOND
        # On a busy machine the thread that takes images may have had no chance to.
        return max(self._monitor.pause_timeout - silence, _GRACE)

    def _segment(self, arrival: Arrival) -> None:
        try:
            frame = self._convert(arrival.message)
        except ImageConversionError as error:
            self._skip(type(error).__name__, str(error))
            return
        verdict = self._monitor.judge(
            frame, arrival.time, arrival.after_drops, received=arrival.received
        )
        if verdict.notice:
            self._logger.warning(verdict.notice)
        if verdict.action is Action.SKIP:
            self._skip(verdict.continuity, verdict.reason)
            return
        if verdict.action is Action.RESTART:
            self._throttled.info(verdict.continuity, f"new window: {verdict.reason}")
            self._begin_stream()
        frame = verdict.frame
        self._unanswered.append((frame.kept(), arrival.time))
        self._last_arrival = arrival.time
        self._streaming = True
        self._answer(
            functools.partial(self._segmenter.push, frame, waiting=self.waiting),
            f"the image of {_seconds(frame.stamp)} s",
        )

    def _skip(self, kind: Hashable, reason: str) -> None:
        self._statistics.count(Event.SKIPPED)
        self._throttled.warning(kind, f"image skipped: {reason}")

    def _begin_stream(self) -> None:
        self._flush()
        self._segmenter.reset()

    def _restart(self, reason: str) -> None:
        self._logger.info(f"new window: {reason}")
        self._monitor.forget()
        self._begin_stream()

    def _reconfigure(self, parameters: Parameters) -> None:
        self._flush()
        self._segmenter.reconfigure(parameters)

    def _stop(self) -> None:
        self._running = False
        self._pause()

    def _pause(self) -> None:
        self._flush()
        self._streaming = False
        self._on_pause()

    def _flush(self) -> None:
        flush = functools.partial(self._segmenter.flush, lambda: self.waiting)
        self._answer(flush, "the last images before a pause")
        if self._unanswered:
            self._recover("images were left without a result")

    def _answer(self, segment: Callable[[], list[SegmentationResult]], what: str) -> None:
        try:
            results = segment()
        except ParameterError as error:
            # What was asked for doesn't fit these images, which is no fault of ours.
            self._recover(f"segmenting {what} failed: {error}")
            return
        except Exception:
            self._recover(f"segmenting {what} failed: {traceback.format_exc()}")
            return
        for result in results:
            self._publish_answer(result)

    def _recover(self, error: str) -> None:
        """Return empty results to all frames that are left, and begin a new window."""
        self._log_error("segmentation", error)
        self._statistics.failed(len(self._unanswered))
        self._monitor.forget()
        self._segmenter.reset()
        for frame, _ in list(self._unanswered):
            self._publish_answer(self._segmenter.empty_result(frame))

    def _publish_answer(self, result: SegmentationResult) -> None:
        stamp = result.frame.stamp
        _, arrived = self._unanswered.popleft()
        if self._abandoned:
            return
        try:
            self._publish(result)
        except Exception:
            self._statistics.failed()
            self._log_error(
                "publishing",
                f"the result of {_seconds(stamp)} s was not published: {traceback.format_exc()}",
            )
            return
        self._statistics.answered(
            result,
            since_stamp=(self._now() - stamp) / _SECOND,
            since_arrival=(time.monotonic_ns() - arrived) / _SECOND,
        )

    def _log_error(self, kind: str, text: str) -> None:
        # What fails because the node is gone already is no news.
        if not self._abandoned:
            self._throttled.error(kind, text)


def _seconds(stamp: int) -> str:
    """Return a stamp in nanoseconds as ROS tools show it."""
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"
