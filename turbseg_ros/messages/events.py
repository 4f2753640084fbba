"""What happens in a stream of results: objects come, stop and go, the camera moves or is blinded.

Events are found as plain objects first, of which the message and the log's lines are made.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

# Seconds over which an object's displacement tells whether it has stopped.
_STILL_SPAN = 0.5
# Displacement in that time, in diagonals of the object's box and at least in pixels: below the
# first pair it has stopped, above the second it moves again.
_STOPS, _STOPS_PX = 0.04, 1.0
_MOVES, _MOVES_PX = 0.12, 3.0
# Seconds for which the camera does something before that is told; a slew is over by then.
_CAMERA_SPAN = 0.5
# Seconds of sight after which the camera can be blinded anew.
_SIGHT_SPAN = 1.0


class EventKind(enum.Enum):
    """What happens; the values are what is published."""

    ENTERED = "entered"
    LEFT = "left"
    STOPPED = "stopped"
    MOVING = "moving"
    BACKGROUND = "background"
    CAMERA_STILL = "camera_still"
    CAMERA_FOLLOWING = "camera_following"
    CAMERA_SLEWING = "camera_slewing"
    CAMERA_LOST = "camera_lost"
    BLINDED = "blinded"


_OF_CAMERA = {
    CameraState.STILL: EventKind.CAMERA_STILL,
    CameraState.FOLLOWING: EventKind.CAMERA_FOLLOWING,
    CameraState.SLEWING: EventKind.CAMERA_SLEWING,
    CameraState.LOST: EventKind.CAMERA_LOST,
}
_TEXTS = {
    EventKind.CAMERA_STILL: "the camera stands",
    EventKind.CAMERA_FOLLOWING: "the camera follows: it pans or zooms steadily",
    EventKind.CAMERA_SLEWING: "the camera slews",
    EventKind.CAMERA_LOST: "nothing tells the camera's motion",
    EventKind.BLINDED: "nothing of the picture shows the scene",
}
_VERBS = {
    EventKind.MOVING: "moves again",
    EventKind.BACKGROUND: "stands for so long that it is background",
}
_TROUBLES = (EventKind.CAMERA_LOST, EventKind.BLINDED)


@dataclass(frozen=True)
class Event:
    """Something that happened, at `stamp` in nanoseconds.

    `seen` is the object that it happened to as it was then, and `seconds` for how long that had
    been seen; both None where it happened to the camera.
    """

    kind: EventKind
    stamp: int
    seen: MovingObject | None = None
    seconds: float | None = None

    @property
    def text(self) -> str:
        """What happened, for people."""
        if self.seen is None:
            return _TEXTS[self.kind]
        x, y = self.seen.centroid
        width, height = self.seen.box[2:]
        what = _VERBS.get(self.kind, self.kind.value)
        told = f"object {self.seen.id} {what} at ({x:.0f}, {y:.0f})"
        if self.kind in (EventKind.LEFT, EventKind.BACKGROUND):
            return f"{told}, seen for {self.seconds:.1f} s"
        return f"{told}, {width}x{height} px" if self.kind is EventKind.ENTERED else told


def event_message(event: Event, frame_id: str = "") -> DiagnosticStatus:
    """Return an event as a message.

    Its values are the stamp in seconds and, of an object, id, box (left, top, width and height)
    and place (x, y of the centroid), in pixels of the image.
    """
    values = {"stamp": f"{event.stamp // 10**9}.{event.stamp % 10**9:09d}"}
    if event.seen is not None:
        values["id"] = str(event.seen.id)
        values["box"] = ",".join(str(side) for side in event.seen.box)
        values["place"] = ",".join(f"{place:.1f}" for place in event.seen.centroid)
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if event.kind in _TROUBLES else DiagnosticStatus.OK,
        name=event.kind.value,
        message=event.text,
        hardware_id=frame_id,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


@dataclass
class _Story:
    """What is known of an object that is there: its first sight, its last, and whether it stands.

    `stamps` are those of its latest sights, `frame` the number of the frame of the last.
    """

    first: int
    last: MovingObject
    frame: int
    stands: bool = False
    stamps: deque[int] = field(default_factory=deque)


class EventWatch:
    """Tells what happens from one result to the next; an instance belongs to one stream.

    An object that is hidden for a while neither leaves nor enters anew: it has left, where and
    when it was seen last, once it has not been seen for longer than objects live unseen.

    :param max_age: returns for how many frames an object lives unseen.
    """

    def __init__(self, max_age: Callable[[], int]) -> None:
        self._max_age = max_age
        self._frames = 0
        self._stories: dict[int, _Story] = {}
        self._camera = _CameraWatch()

    def events(self, result: SegmentationResult) -> list[Event]:
        """Return what happened by the next result, in no more than one event for each change."""
        self._frames += 1
        found = list(self._camera.events(result))
        for seen in result.objects:
            found += self._of_object(seen, result.frame.stamp)
        gone = [
            id
            for id, story in self._stories.items()
            if self._frames - story.frame > self._max_age()
        ]
        return found + [_left(self._stories.pop(id)) for id in gone]

    def end(self) -> list[Event]:
        """Return what happened by the end of the stream: whatever was there has left."""
        gone, self._stories = self._stories, {}
        return [_left(story) for story in gone.values()]

    def _of_object(self, seen: MovingObject, stamp: int) -> Iterator[Event]:
        story = self._stories.get(seen.id)
        if seen.absorbed:
            # A frame that repeats this one says so, too.
            if story is not None:
                del self._stories[seen.id]
                yield Event(EventKind.BACKGROUND, stamp, seen, (stamp - story.first) / 1e9)
            return
        if story is None:
            story = self._stories[seen.id] = _Story(stamp, seen, self._frames)
            yield Event(EventKind.ENTERED, stamp, seen, 0.0)
        if self._frames - story.frame > 1:
            # Hidden, or not reported: its trail doesn't tell for how long.
            story.stamps.clear()
        story.last, story.frame = seen, self._frames
        story.stamps.append(stamp)
        displacement = _displacement(seen, story.stamps)
        if displacement is None:
            return
        limit, least = (_MOVES, _MOVES_PX) if story.stands else (_STOPS, _STOPS_PX)
        stands = displacement < max(limit * math.hypot(*seen.box[2:]), least)
        if stands != story.stands:
            story.stands = stands
            kind = EventKind.STOPPED if stands else EventKind.MOVING
            yield Event(kind, stamp, seen, (stamp - story.first) / 1e9)


class _CameraWatch:
    """Tells what the camera does once it has done so for a while, and that it was blinded."""

    def __init__(self) -> None:
        self._told = CameraState.STILL
        # What it does by the latest results, and since when.
        self._does: tuple[CameraState, int] | None = None
        self._blind_at: int | None = None

    def events(self, result: SegmentationResult) -> Iterator[Event]:
        """Yield what is to be told with the next result."""
        stamp = result.frame.stamp
        if result.condition is Condition.BLIND:
            if self._blind_at is None:
                yield Event(EventKind.BLINDED, stamp)
                # What the camera does, told anew, is what says that it sees again.
                self._told = CameraState.LOST
            self._blind_at, self._does = stamp, None
            return
        if self._blind_at is not None and stamp - self._blind_at > _SIGHT_SPAN * 1e9:
            self._blind_at = None
        state = result.camera
        if self._does is None or self._does[0] is not state:
            self._does = state, stamp
        since = self._does[1]
        lasts = stamp - since >= _CAMERA_SPAN * 1e9 or state is CameraState.SLEWING
        if lasts and state is not self._told:
            self._told = state
            yield Event(_OF_CAMERA[state], since)


def _left(story: _Story) -> Event:
    last = story.stamps[-1]
    return Event(EventKind.LEFT, last, story.last, (last - story.first) / 1e9)


def _displacement(seen: MovingObject, stamps: deque[int]) -> float | None:
    """Return how far an object came against the scene in a while, None where it is too new.

    :param stamps: those of its sights, the latest last; what is older than the while is dropped.
    """
    while len(stamps) > 2 and stamps[-1] - stamps[1] >= _STILL_SPAN * 1e9:
        stamps.popleft()
    frames = len(stamps) - 1
    # Less a microsecond, by which stamps that were rounded differ.
    if stamps[-1] - stamps[0] < _STILL_SPAN * 1e9 - 1e3 or len(seen.trail) <= frames:
        return None
    now, then = seen.trail[-1], seen.trail[-1 - frames]
    return math.dist(now, then)


class EventMessages:
    """Messages about what happens, stamped with their frame's frame_id, and who else is told.

    :param tell: is handed each event, for the log.
    """

    def __init__(
        self, watch: EventWatch, tell: Callable[[Event], None] = lambda event: None
    ) -> None:
        self._watch = watch
        self._tell = tell

    def messages(self, result: SegmentationResult) -> list[DiagnosticStatus]:
        """Return a message for each thing that happened by the next result."""
        return self._told(self._watch.events(result), result.frame)

    def removal(self, frame: Frame) -> list[DiagnosticStatus]:
        """Return the messages of the objects that have left as the stream ended.

        :param frame: the last one.
        """
        return self._told(self._watch.end(), frame)

    def _told(self, events: list[Event], frame: Frame) -> list[DiagnosticStatus]:
        for event in events:
            self._tell(event)
        return [event_message(event, frame.frame_id) for event in events]
