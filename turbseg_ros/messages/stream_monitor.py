"""Whether a frame goes on where the one before it stopped, and when it was taken.

The node and what reads bags decide here, by the same rules; only what they call arrival differs:
when a message came, or when it was recorded.
"""

from __future__ import annotations

import enum
import statistics
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

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
# While the rate is not known yet, so long a hole may be a slow camera's period.
_FIRST_GAP_SECONDS = 10.0
# A camera slower than this is not waited for.
_MAX_PAUSE_TIMEOUT = 60.0
# Spacings that are kept across a pause: the pause, which may be a slow camera's first, must not
# outvote them, and three slow ones must.
_STEPS_KEPT = 2
# Spacings that are averaged where most are far shorter than that, as those within a burst.
_AVERAGED = 4
# Of the last so many frames, those whose stamps are unusable: from then on no stamp is believed,
# until as many in a row have been sound.
_MAX_UNSOUND, _SOUND_FRAMES = 3, 16
# Spacings below this, in seconds, are no camera's.
_MIN_PERIOD = 1e-4


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
    """How a frame follows the one before it, and what tells so.

    `frame` is the frame with the time that it counts as taken at, when it arrived, the stream's
    period, and whether a new stream begins with it. `notice` is a line for the log, once in a
    monitor's life: that stamps are unusable.
    """

    continuity: Continuity
    frame: Frame
    reason: str = ""
    notice: str = ""

    @property
    def action(self) -> Action:
        """What to do with the frame."""
        return self.continuity.action


def stamps_tell(stamps: Sequence[int]) -> bool:
    """Whether the stamps of a recorded series tell its messages apart: most differ."""
    return len(stamps) < 2 or 2 * len({*stamps}) > len(stamps)


def pause_timeout_for(period: float) -> float:
    """Return after how many seconds without a frame a stream of a period has paused.

    :param period: seconds from one frame to the next; 0 while unknown.
    """
    return min(max(_GAP_SECONDS, _GAP_PERIODS * period), _MAX_PAUSE_TIMEOUT)


class StreamMonitor:
    """Judges the frames of one camera in the order in which they arrive.

    Stamps tell when frames were taken, as long as they do: a stamp of 0 that comes twice, and some
    that repeat with another picture or go back a little, are unusable. The time of arrival stands
    in for them then.
    """

    def __init__(self) -> None:
        self._last: _Seen | None = None
        self._steps = _Steps()
        self._arrival_steps = _Steps()
        self._stamps_tell = True
        # Of the latest frames, whether their stamps are usable.
        self._sound: deque[bool] = deque(maxlen=_SOUND_FRAMES)
        self._noticed = False

    @property
    def pause_timeout(self) -> float:
        """Seconds without a frame after which the stream has paused."""
        return pause_timeout_for(self._arrival_steps.usual)

    @property
    def period(self) -> float | None:
        """Seconds from one frame to the next; None while unknown."""
        usual = self._steps.usual
        return usual if usual > _MIN_PERIOD else None

    def judge(
        self,
        frame: Frame,
        arrival: int,
        after_drops: bool = False,
        received: int | None = None,
    ) -> Verdict:
        """Say what to do with the next frame, which arrived at `arrival` (steady nanoseconds).

        A stamp that repeats or comes a little late is skipped, unless it is unusable: such a
        frame counts as taken when it arrived. A jump back in time (a bag that loops), a long gap,
        another size or pixel type restarts: what follows is a new stream.

        :param after_drops: whether frames before it came, but were dropped: that is no gap. To
            begin anew, and to answer all frames at hand for it, would only cost more of them.
        :param received: the same arrival on the clock that stamps are of; by default `arrival`.
        """
        received = arrival if received is None else received
        last = self._last
        if last is None:
            self._last = _Seen(frame, frame.stamp or received, arrival, received)
            return Verdict(Continuity.CONTINUES, self._dated(begins=False))
        told_before = self._stamps_tell
        step, time = self._step(last, frame, arrival, received)
        continuity, reason = self._compare(last.frame, frame, step, after_drops)
        if continuity.action is Action.SKIP:
            if frame.stamp:
                # It came all the same: no pause.
                self._last = replace(last, arrival=arrival, received=received)
            return Verdict(continuity, frame, reason)
        restarts = continuity.action is Action.RESTART
        if restarts:
            self._steps.fade()
            self._arrival_steps.fade()
        if continuity is not Continuity.WENT_BACK and self._stamps_tell == told_before:
            time = max(time, last.time + 1)
        self._steps.add(step)
        self._arrival_steps.add((arrival - last.arrival) / _NANOSECONDS)
        self._last = _Seen(frame, time, arrival, received)
        return Verdict(continuity, self._dated(begins=restarts), reason, self._notice(frame, time))

    def forget(self) -> None:
        """Take whatever comes next for the start of a stream; its rate may be that of before."""
        self._last = None

    def _dated(self, begins: bool) -> Frame:
        assert self._last is not None
        return replace(
            self._last.frame,
            stamp=self._last.time,
            received=self._last.received,
            period=self.period,
            begins_stream=begins,
        )

    def _step(self, last: _Seen, frame: Frame, arrival: int, received: int) -> tuple[float, int]:
        """Return by how many seconds a frame follows the last one, and when it was taken."""
        told_before = self._stamps_tell
        arrival_step = max(arrival - last.arrival, 1)
        self._weigh(last.frame, frame, arrival_step / _NANOSECONDS)
        if self._stamps_tell and told_before:
            return (frame.stamp - last.frame.stamp) / _NANOSECONDS, frame.stamp
        time = frame.stamp if self._stamps_tell else received
        if self._stamps_tell != told_before:
            # Two clocks: only arrivals can be compared.
            return arrival_step / _NANOSECONDS, time
        step = (received - last.received) / _NANOSECONDS
        # That two arrive at once, or the clock is set back a little, tells nothing of them.
        return (max(step, 1.0 / _NANOSECONDS) if step >= -_LATE_SECONDS else step), time

    def _weigh(self, last: Frame, frame: Frame, arrival_step: float) -> None:
        """Decide whether stamps are believed from now on."""
        step = (frame.stamp - last.stamp) / _NANOSECONDS
        if step == 0.0 and self._stamps_tell and _same_picture(last, frame):
            # The same message twice, unless stamps are not set and nothing happens for long.
            self._stamps_tell = bool(frame.stamp) or arrival_step < _GAP_SECONDS
            return
        self._sound.append(step > 0.0 or step < -self._lateness)
        unsound = self._sound.count(False)
        if self._stamps_tell:
            not_set = step == 0.0 and frame.stamp == 0
            self._stamps_tell = unsound < _MAX_UNSOUND and not not_set
        else:
            self._stamps_tell = len(self._sound) == _SOUND_FRAMES and not unsound

    @property
    def _lateness(self) -> float:
        return max(_LATE_SECONDS, _LATE_PERIODS * self._steps.usual)

    @property
    def _max_gap(self) -> float:
        period = self._steps.usual
        return pause_timeout_for(period) if period else _FIRST_GAP_SECONDS

    def _compare(
        self, last: Frame, frame: Frame, step: float, after_drops: bool
    ) -> tuple[Continuity, str]:
        if step == 0.0:
            return Continuity.REPEATED, "it has the stamp of the frame before"
        if -self._lateness <= step < 0.0:
            return Continuity.LATE, f"it comes {-step:.3f} s late"
        if step < 0.0:
            return Continuity.WENT_BACK, f"time jumped back by {-step:.3f} s"
        if not after_drops and step > self._max_gap:
            return Continuity.PAUSED, f"no frame for {step:.3f} s"
        before, now = _format(last), _format(frame)
        if before != now:
            return Continuity.CHANGED, f"the image changed from {before} to {now}"
        return Continuity.CONTINUES, ""

    def _notice(self, frame: Frame, time: int) -> str:
        if self._noticed or time == frame.stamp:
            return ""
        self._noticed = True
        kind = "repeat or go back while pictures change" if frame.stamp else "are not set"
        return (
            f"stamps are unusable: they {kind}; images count as taken when they arrived, or were "
            "recorded, and results are stamped so"
        )


@dataclass(frozen=True)
class _Seen:
    """The frame as it came, when it counts as taken, and when it arrived on two clocks."""

    frame: Frame
    time: int
    arrival: int
    received: int


class _Steps:
    """The latest spacings of a series of times, in seconds."""

    def __init__(self) -> None:
        self._steps: deque[float] = deque(maxlen=_RATE_FRAMES - 1)

    def add(self, step: float) -> None:
        """Take note of the next one, unless it is no camera's."""
        if 0.0 < step <= _MAX_PAUSE_TIMEOUT:
            self._steps.append(step)

    def fade(self) -> None:
        """Let what is to come count for more than what was."""
        self._steps = deque(list(self._steps)[-_STEPS_KEPT:], maxlen=_RATE_FRAMES - 1)

    @property
    def usual(self) -> float:
        """Seconds; 0 while unknown. The median; where times come in bursts, that of averages."""
        if not self._steps:
            return 0.0
        # Of two, the smaller one: the other may be a pause.
        median = statistics.median_low(self._steps)
        steps = list(self._steps)
        averages = [
            sum(steps[begin : begin + _AVERAGED]) / _AVERAGED
            for begin in range(len(steps) - _AVERAGED + 1)
        ]
        average = statistics.median_low(averages) if len(averages) > _AVERAGED else 0.0
        return average if average > 2.0 * median else median


def _same_picture(one: Frame, other: Frame) -> bool:
    floats = one.image.dtype.kind == "f"
    return bool(np.array_equal(one.image, other.image, equal_nan=floats))


def _format(frame: Frame) -> str:
    height, width = frame.shape
    channels = frame.image.shape[2:]
    return f"{width}x{height}x{channels[0] if channels else 1} {frame.image.dtype}"
