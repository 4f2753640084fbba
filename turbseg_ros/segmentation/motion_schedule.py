"""When motion is measured, and what moves in the frames between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.parameters import FlowParameters, Parameters
from turbseg_ros.segmentation.average import LONG_BASELINE
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import middle_displacement
from turbseg_ros.segmentation.load import Load
from turbseg_ros.segmentation.look_ahead import LookAhead
from turbseg_ros.segmentation.motion import MotionMeasure, next_interval
from turbseg_ros.segmentation.motion_worker import MotionJob, MotionWorker
from turbseg_ros.segmentation.moving import Moving, propagated
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.window import FrameWindow

SPARSE = 2
"""Periods of measuring motion from one time to the next while very many frames wait."""
# Pixels at processing resolution by which the camera may turn within an interval: what it follows
# moves against the scene by as much, and flow must find it.
_FOLLOWED = 16.0
# Periods for which nothing must have been cut out for it to be said that nothing is there.
_CALM = 2


class MotionSchedule:
    """Has motion measured in every n-th frame, ahead of its use, and propagates it in between.

    :param look_ahead: frames that follow a frame before motion is measured in it, and for which
        that may take. Where it is segmented before that is done, what is measured is brought up
        to date by propagation.
    :param objects_in: tells where objects that have travelled will be in a frame, at detail
        resolution.
    """

    def __init__(
        self,
        window: FrameWindow,
        resolution: Resolution,
        measure: MotionMeasure,
        worker: MotionWorker,
        flow: FlowParameters,
        look_ahead: LookAhead,
        observer: StageObserver,
        objects_in: Callable[[int], Sequence[CroppedMask]] = lambda index: (),
    ) -> None:
        self._window = window
        self._resolution = resolution
        self._measure = measure
        self._worker = worker
        self._observer = observer
        self._every = flow.every
        self._widest = flow.interval
        self._interval = flow.interval
        self._look_ahead = look_ahead
        # By the frames in which motion is being measured: the one from which on it is known.
        self._known_from: dict[int, int] = {}
        self._due = 0
        self._submitted = -1
        self._objects_in = objects_in
        # Whether motion is measured twice as often for now.
        self._watches = self._answers_at_once
        self._last: Moving | None = None
        # Frames in a row in which nothing was cut out.
        self._empty_for = 0

    def what_moves(self, index: int, load: Load) -> Moving | None:
        """Return what moves in the next frame, and have the next measurement begun.

        None where there is nothing to compare the frame with.

        :param load: under which motion is to be measured more seldom from here on.
        """
        self._watches = self._watches and not load.coasts
        moving = self._what_moves(index)
        if moving is not None and moving.measured:
            self._interval = next_interval(self._interval, self._widest, moving.motion.disorder)
        self._last = moving
        self._measure_ahead(index, load.sparse_motion)
        return moving

    def keep_where(self, objects: Mask) -> None:
        """Propagate only what holds one of the objects, HxW at detail resolution.

        Where nothing is cut out now, nothing will be until motion is measured again.
        """
        self._empty_for = 0 if objects.any() else self._empty_for + 1
        if self._last is not None:
            self._last = self._last.where(objects)

    def watch_closely(self, something: bool) -> None:
        """Measure motion twice as often while something is to be decided.

        So it is where each frame is answered at once, and none waits. Else a result waits for that
        long anyway.
        """
        self._watches = something and self._answers_at_once

    @property
    def _answers_at_once(self) -> bool:
        return self._look_ahead.segmentation == 0

    @property
    def _period(self) -> int:
        return max(self._every // 2, 1) if self._watches else self._every

    @property
    def _in_use(self) -> LookAhead:
        """The look-ahead, of which measuring takes half a period while that is shorter."""
        if not self._watches:
            return self._look_ahead
        return replace(self._look_ahead, measuring=(self._period + 1) // 2)

    def _what_moves(self, index: int) -> Moving | None:
        if not self._window.shows_scene(index):
            self._drop_until(index)
            self._submitted = max(self._submitted, index)
            return None
        self._measure_at_once(index)
        known = [source for source, since in self._known_from.items() if since <= index]
        if known:
            source = max(known)
            del self._known_from[source]
            taken = self._worker.take(source)
            self._drop_until(source)
            if taken is None or taken.measured:
                found = self._propagated(taken, source, index)
                return None if found is None else replace(found, measured=True)
        return self._propagated(self._last, index - 1, index)

    def _measure_at_once(self, index: int) -> None:
        """Have motion measured where nothing is waited for any more, or can be propagated."""
        if self._submitted < self._due <= index - self._in_use.lag:
            self._submit(self._due, known_from=index)
        if self._last is not None and self._window[index].continues:
            return
        if self._answers_at_once:
            if not self._known_from:
                self._submit(index, known_from=index + self._in_use.lag)
        elif index in self._known_from:
            self._known_from[index] = index
        else:
            self._submit(index, known_from=index)

    def _drop_until(self, index: int) -> None:
        """Forget what is being measured in a frame and those before."""
        for source in [k for k in self._known_from if k <= index]:
            del self._known_from[source]
            self._worker.drop(source)

    def _propagated(self, moving: Moving | None, source: int, target: int) -> Moving | None:
        """Return what moves in one frame as it moves in a later one; None across a cut."""
        if moving is None or not self._window.goes_on(source, target):
            return None
        if source == target:
            return moving
        ego_motion = self._window.transform(source, target)
        with self._observer.stage("propagation"):
            return propagated(moving, ego_motion, self._resolution, target - source)

    def _measure_ahead(self, index: int, sparse: bool) -> None:
        """Have motion measured in the next frame that is due, while outlines are drawn."""
        if self._due <= min(self._submitted, index):
            period = self._every if sparse else self._period
            # Without look-ahead the newest frame itself may be due.
            before = max(self._submitted, index - 1)
            self._due = before // period * period + period * (SPARSE if sparse else 1)
        following = self._window.count - 1 - self._due
        is_at_hand = following >= self._look_ahead.neighbours and self._due <= index + self._every
        if is_at_hand and self._submitted < self._due:
            self._submit(self._due, known_from=max(self._due, index + self._in_use.measuring))

    def _submit(self, index: int, known_from: int) -> None:
        """Have motion measured in a frame.

        :param known_from: the frame in which that is waited for.
        """
        self._known_from[index] = known_from
        interval = self._interval_in(index)
        wanted = self._measure.intervals(interval)
        neighbourhood = self._window.neighbourhood(index, wanted)
        before, self._submitted = self._submitted, index
        self._worker.submit(
            MotionJob(
                index,
                neighbourhood,
                interval,
                self._window.transform_if_continuous(before, index),
                index - before,
                self._objects_in(index),
                self._unfollowed(),
            )
        )

    def _interval_in(self, index: int) -> int:
        """Return the interval in use, or a shorter one where the camera turns too far in it."""
        far = self._turned(index - self._interval, index)
        if far is None:
            far = self._turned(index, index + self._interval)
        if far is None or far <= _FOLLOWED:
            return self._interval
        return max(int(self._interval * _FOLLOWED / far), 1)

    def _turned(self, source: int, target: int) -> float | None:
        """Return how far the scene in the middle of a frame has gone by a later one, in pixels.

        None where either frame isn't at hand, or there is a cut between them.
        """
        if target >= self._window.count:
            return None
        motion = self._window.transform_if_continuous(source, target)
        if motion is None:
            return None
        return float(np.hypot(*middle_displacement(motion, self._resolution.processing)))

    def _unfollowed(self) -> Moving | None:
        """Return what was measured last, as it moved on, if nothing was cut out for a while."""
        if self._last is None or self._empty_for < _CALM * self._every:
            return None
        return replace(self._last, measured=False)


def frame_window(
    parameters: Parameters, measure: MotionMeasure, look_ahead: LookAhead
) -> FrameWindow:
    """Return an empty window that will hold the frames that a schedule asks for."""
    flow, outline = parameters.flow, parameters.outline
    return FrameWindow(
        # The frame in which motion was measured last is looked back to, too.
        reach=max(
            LONG_BASELINE * flow.interval,
            SPARSE * flow.every,
            *(-k for k in measure.intervals(flow.interval)),
        ),
        look_ahead=look_ahead.segmentation,
        warm_up=0 if parameters.is_causal else parameters.latency.warm_up,
        memory=outline.memory,
        key_step=outline.key_step,
    )
