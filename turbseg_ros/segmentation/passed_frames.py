"""Frames that don't go on from the last sound one: held until it is known what they were.

Where the old scene comes back, they were damaged, and are passed over as if they had not been
there. Where it doesn't, they are the first ones of another scene, or of the same after a change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import Matrix
from turbseg_ros.segmentation.camera_state import CameraTrack
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.damage import Usual
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.segmentation.pending_result import PendingResult
from turbseg_ros.segmentation.preparation import PreparedFrame
from turbseg_ros.segmentation.registration import register
from turbseg_ros.segmentation.track import Observation, Tracker

MAX_PASSED = 8
"""Frames for which the old scene may be away, or nothing be said, before that is taken to last."""

# A part of the picture that stays away for longer is no damage: something large came before it.
_PARTLY_AWAY = 3
# A picture that is repeated for longer is what the camera has to show.
_MAX_REPEATS = 30
# Frames in a row that show one other scene at the stream's end, from which on it is a cut.
_CUT_AT_END = 2


@dataclass(frozen=True)
class WaitingFrame:
    """A frame whose condition is settled, and that waits to be answered.

    `from_previous` takes the processing pixels of the last sound frame to its own.
    """

    frame: Frame
    condition: Condition
    from_previous: Matrix


@dataclass(frozen=True)
class ReadyFrame:
    """A prepared frame, with what is kept of it for its result."""

    frame: Frame
    prepared: PreparedFrame

    @property
    def condition(self) -> Condition:
        """What it was like."""
        return self.prepared.condition

    def waiting(self) -> WaitingFrame:
        """Return what its answer takes."""
        return WaitingFrame(self.frame, self.condition, self.prepared.from_previous)

    def known_as(self, condition: Condition) -> ReadyFrame:
        """Return it with another condition."""
        return replace(self, prepared=replace(self.prepared, condition=condition))


@dataclass(frozen=True)
class _Held:
    """A frame in doubt; `from_held` takes the pixels of the one before to its own.

    None if those two have nothing in common, or there is none before.
    """

    ready: ReadyFrame
    from_held: Matrix | None


class DoubtfulFrames:
    """Takes frames as they come and gives each back, in order, once its condition is settled.

    Those that are sound by then join the window, the first one that is a cut begins another with
    those after it, the others are passed over. It holds no more than `MAX_PASSED` frames and one.

    :param causal: whether each frame is to be answered at once: one that is passed over stays so.
    """

    def __init__(self, causal: bool) -> None:
        self._causal = causal
        self._held: list[_Held] = []
        self._repeats = 0

    def take(self, ready: ReadyFrame) -> list[ReadyFrame]:
        """Take the next frame; return those whose conditions are settled by it."""
        is_repeated = ready.condition is Condition.REPEATED
        self._repeats = self._repeats + 1 if is_repeated else 0
        if self._repeats > _MAX_REPEATS:
            ready = ready.known_as(Condition.SOUND)
        if is_repeated or ready.condition is Condition.SOUND:
            return [*self._release(), ready]
        self._hold(ready)
        lasting = self._new_scene(MAX_PASSED + 1) or self._changed_scene(_PARTLY_AWAY + 1)
        if lasting:
            return lasting
        if self._causal:
            return [ready]
        if len(self._held) > MAX_PASSED:
            return [self._held.pop(0).ready]
        return []

    def settle(self) -> list[ReadyFrame]:
        """Return what is held, no frame following for now."""
        return self._new_scene(_CUT_AT_END) or self._changed_scene(2) or self._release()

    def _hold(self, ready: ReadyFrame) -> None:
        before = self._held[-1].ready.prepared.grey if self._held else None
        found = None if before is None else register(before, ready.prepared.grey)
        self._held.append(_Held(ready, None if found is None else found.motion))
        if self._causal:
            # They are answered already.
            del self._held[: -MAX_PASSED - 1]

    def _release(self) -> list[ReadyFrame]:
        """Give out what is held as what it seemed to be."""
        released = [] if self._causal else [held.ready for held in self._held]
        self._held.clear()
        return released

    def _new_scene(self, least: int) -> list[ReadyFrame]:
        """Return what is held if so many frames, up to the newest, show one other scene."""
        first = len(self._held) - 1
        while first > 0 and self._held[first].from_held is not None:
            first -= 1
        scene = self._held[first:] if self._held else []
        if len(scene) < least or scene[-1].ready.condition is not Condition.BLIND:
            return []
        before = [held.ready for held in self._held[:first]]
        cut = _as_beginning([scene[-1]] if self._causal else scene)
        self._held.clear()
        return cut if self._causal else before + cut

    def _changed_scene(self, least: int) -> list[ReadyFrame]:
        """Return what is held if so many frames, up to the newest, show part of the old scene."""
        newest = [held.ready for held in self._held[-least:]]
        if len(newest) < least or any(r.condition is not Condition.DAMAGED for r in newest):
            return []
        given = newest[-1:] if self._causal else [held.ready for held in self._held]
        self._held.clear()
        return _as_going_on(given)


def _as_beginning(scene: Sequence[_Held]) -> list[ReadyFrame]:
    """Return frames as the first ones of their scene."""
    found: list[ReadyFrame] = []
    for held in scene:
        is_first = not found
        transform = None if is_first else held.from_held
        prepared = replace(
            held.ready.prepared,
            from_previous=np.eye(3) if transform is None else transform,
            continues=transform is not None,
            condition=Condition.CUT if is_first else Condition.SOUND,
            usual=None if is_first else Usual(),
            camera=CameraTrack(),
        )
        found.append(replace(held.ready, prepared=prepared))
    return found


def _as_going_on(frames: Sequence[ReadyFrame]) -> list[ReadyFrame]:
    """Return frames as ones that go on from the last sound one, each registered to the one before.

    All were registered to the last sound one. Those that are blind stay so.
    """
    found: list[ReadyFrame] = []
    before = np.eye(3)
    for ready in frames:
        if ready.condition is not Condition.DAMAGED:
            found.append(ready)
            continue
        transform = ready.prepared.from_previous
        prepared = replace(
            ready.prepared,
            from_previous=transform @ np.linalg.inv(before),
            condition=Condition.SOUND,
        )
        found.append(replace(ready, prepared=prepared))
        before = transform
    return found


def passed_over(
    ready: WaitingFrame, last: PendingResult, tracker: Tracker, in_a_row: int
) -> PendingResult:
    """Answer a frame that says nothing: objects go on unseen, for no longer than they may.

    :param last: that of the last sound frame, whose picture a repeated one shows.
    :param in_a_row: how many frames, with this one, have been passed over.
    """
    frame, condition, resolution = ready.frame, ready.condition, last.resolution
    shape = resolution.detail_shape
    camera = last.camera.lost() if condition is Condition.BLIND else last.camera
    if condition is Condition.BLIND and in_a_row > MAX_PASSED:
        nothing = np.broadcast_to(np.zeros((), np.uint8), (*shape, 1))
        tracker.update([], np.eye(3), 0.0, nothing)
        return PendingResult(frame, resolution, camera, regions=last.regions, condition=condition)
    # Tracks stay in the sound frame's pixels, to which the next one is registered.
    known = tracker.coast(np.eye(3), shape)
    if condition is Condition.REPEATED:
        return replace(last, frame=frame, condition=condition)
    shown: list[Observation] = []
    if condition is Condition.DAMAGED:
        transform = resolution.to_detail(ready.from_previous)
        shown = [_moved(observation, transform, shape) for observation in known]
    return PendingResult(
        frame, resolution, camera, observations=shown, regions=last.regions, condition=condition
    )


def _moved(observation: Observation, transform: Matrix, shape: tuple[int, int]) -> Observation:
    """Return an observation in another frame's pixels, of some shape."""
    seen = observation.detection
    outline = seen.outline.resampled(transform, shape, cv2.INTER_NEAREST)
    return replace(observation, detection=replace(seen, box=outline.box, mask=outline.mask))
