"""Whether a frame goes on where the one before it stopped."""

from __future__ import annotations

import enum
import itertools
import statistics
from collections import deque
from dataclasses import dataclass

from turbseg_ros.segmentation.frame import Frame

_NANOSECONDS = 1e9
# Frames whose spacing tells the stream's rate.
_RATE_FRAMES = 16
# Frames that come out of order by so little are late; further back, time itself has jumped.
_LATE_PERIODS = 3.0
_LATE_SECONDS = 0.1
# After a hole this long what is to come has little to do with what was.
_GAP_PERIODS = 10.0
_GAP_SECONDS = 1.0


class Action(enum.Enum):
    """What to do with a frame."""

    CONTINUE = enum.auto()
    SKIP = enum.auto()
    RESTART = enum.auto()


class Continuity(enum.Enum):
    """How a frame follows the one before it."""

    CONTINUES = enum.auto()
    REPEATED = enum.auto()
    LATE = enum.auto()
    WENT_BACK = enum.auto()
    PAUSED = enum.auto()
    CHANGED = enum.auto()

    @property
    def action(self) -> Action:
        """What to do with such a frame."""
        if self is Continuity.CONTINUES:
            return Action.CONTINUE
        skipped = self in (Continuity.REPEATED, Continuity.LATE)
        return Action.SKIP if skipped else Action.RESTART


@dataclass(frozen=True)
class Verdict:
    """How a frame follows the one before it, and what tells so."""

    continuity: Continuity
    reason: str = ""

    @property
    def action(self) -> Action:
        """What to do with the frame."""
        return self.continuity.action


class StreamMonitor:
    """Judges the frames of one camera in the order in which they arrive."""

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._stamp_steps = _Steps()
        self._arrival_steps = _Steps()

    @property
    def patience(self) -> float:
        """Seconds without a frame after which the stream has paused."""
        return max(_GAP_SECONDS, _GAP_PERIODS * self._arrival_steps.median)

    def judge(self, frame: Frame, arrival: int, after_drops: bool = False) -> Verdict:
        """Say what to do with the next frame, which arrived at `arrival` (steady nanoseconds).

        A stamp that repeats or comes a little late is skipped. A jump back in time (a bag that
        loops), a long gap, another size or pixel type restarts: what follows is a new stream.

        :param after_drops: whether frames before it came, but were dropped: that is no gap. To
            begin anew, and to answer all frames at hand for it, would only cost more of them.
        """
        verdict = self._compare(frame, after_drops)
        if verdict.action is Action.SKIP:
            return verdict
        if verdict.action is Action.RESTART:
            self.forget()
        self._last = frame
        self._stamp_steps.add(frame.stamp)
        self._arrival_steps.add(arrival)
        return verdict

    def forget(self) -> None:
        """Take whatever comes next for the start of a stream."""
        self._last = None
        self._stamp_steps = _Steps()
        self._arrival_steps = _Steps()

    def _compare(self, frame: Frame, after_drops: bool) -> Verdict:
        last = self._last
        if last is None:
            return Verdict(Continuity.CONTINUES)
        step = (frame.stamp - last.stamp) / _NANOSECONDS
        period = self._stamp_steps.median
        if step == 0.0:
            return Verdict(Continuity.REPEATED, "it has the stamp of the frame before")
        if -max(_LATE_SECONDS, _LATE_PERIODS * period) <= step < 0.0:
            return Verdict(Continuity.LATE, f"it comes {-step:.3f} s late")
        if step < 0.0:
            return Verdict(Continuity.WENT_BACK, f"time jumped back by {-step:.3f} s")
        if not after_drops and step > max(_GAP_SECONDS, _GAP_PERIODS * period):
            return Verdict(Continuity.PAUSED, f"no frame for {step:.3f} s")
        before, now = _format(last), _format(frame)
        if before != now:
            return Verdict(Continuity.CHANGED, f"the image changed from {before} to {now}")
        return Verdict(Continuity.CONTINUES)


class _Steps:
    """Spacing of the latest of a growing series of times in nanoseconds."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=_RATE_FRAMES)

    def add(self, time: int) -> None:
        self._times.append(time)

    @property
    def median(self) -> float:
        """Seconds; 0 while unknown."""
        times = list(self._times)
        if len(times) < 2:
            return 0.0
        steps = [later - earlier for earlier, later in itertools.pairwise(times)]
        return statistics.median(steps) / _NANOSECONDS


def _format(frame: Frame) -> str:
    height, width, *channels = frame.image.shape
    return f"{width}x{height}x{channels[0] if channels else 1} {frame.image.dtype}"
