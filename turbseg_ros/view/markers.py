"""A result put together again from the messages in which a node publishes it."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import ImageMarker, Marker, MarkerArray

from turbseg_ros.messages.images import stamp_to_ns
from turbseg_ros.view.state import Polygon, Result, ShownObject

_SPEED = re.compile(r"(\d+(?:\.\d+)?) px/s")
# Frames of which one of the two messages may be late.
_WAITING = 30


@dataclass
class _Track:
    """What the markers of one object say."""

    id: int
    colour: str = ""
    trail: Polygon = ()
    speed: float | None = None


@dataclass
class ResultJoiner:
    """Joins centroid markers and annotations of the same stamp to results."""

    _tracks: dict[int, list[_Track]] = field(default_factory=dict)
    _outlines: dict[int, list[tuple[str, Polygon]]] = field(default_factory=dict)

    def add_markers(self, message: MarkerArray) -> Result | None:
        """Take centroid markers; return the result, if that completes it."""
        added = [marker for marker in message.markers if marker.action == Marker.ADD]
        if not added:
            return None
        stamp = stamp_to_ns(added[0].header.stamp)
        self._tracks[stamp] = _tracks(added)
        return self._joined(stamp)

    def add_annotations(self, message: ImageMarker) -> Result | None:
        """Take annotations; return the result, if that completes it."""
        stamp = stamp_to_ns(message.header.stamp)
        outlines = list(_outlines(message.points, message.outline_colors))
        if not outlines:
            return Result(stamp, ())
        self._outlines[stamp] = outlines
        return self._joined(stamp)

    def clear(self) -> None:
        """Forget what waits."""
        self._tracks.clear()
        self._outlines.clear()

    def _joined(self, stamp: int) -> Result | None:
        if stamp in self._tracks and stamp in self._outlines:
            tracks, outlines = self._tracks.pop(stamp), self._outlines.pop(stamp)
            return Result(stamp, tuple(_shown(tracks, outlines)))
        for waiting in (self._tracks, self._outlines):
            while len(waiting) > _WAITING:
                del waiting[next(iter(waiting))]
        return None


def _tracks(markers: Iterable[Marker]) -> list[_Track]:
    """Return the objects in the order in which they were published."""
    tracks: dict[int, _Track] = {}
    for marker in markers:
        track = tracks.setdefault(marker.id, _Track(marker.id))
        track.colour = _hex(marker.color)
        if marker.ns == "id" and (found := _SPEED.search(marker.text)):
            track.speed = float(found[1])
        # On the unit-depth plane of a calibrated camera z is 1: these are no pixels.
        if marker.ns == "trail" and all(p.z == 0.0 and _is_place(p) for p in marker.points):
            track.trail = tuple((point.x, point.y) for point in marker.points)
    return list(tracks.values())


def _outlines(
    points: Iterable[Point], colours: Iterable[ColorRGBA]
) -> Iterator[tuple[str, Polygon]]:
    """Yield closed outlines with their colours; in the message they are single lines."""
    ends = iter(points)
    corners: list[tuple[float, float]] = []
    current = ""
    for (start, end), colour in zip(zip(ends, ends, strict=False), colours, strict=False):
        if corners and _hex(colour) != current:
            yield current, tuple(corners)
            corners = []
        current = _hex(colour)
        if _is_place(start):
            corners.append((start.x, start.y))
        if corners and (end.x, end.y) == corners[0]:
            yield current, tuple(corners)
            corners = []
    if corners:
        yield current, tuple(corners)


def _shown(tracks: list[_Track], outlines: list[tuple[str, Polygon]]) -> Iterator[ShownObject]:
    """Give each object its outlines: both come in the same order, and in the same colours."""
    of_object: defaultdict[int, list[Polygon]] = defaultdict(list)
    index = 0
    for colour, outline in outlines:
        while index < len(tracks) and tracks[index].colour != colour:
            index += 1
        if index == len(tracks):
            break
        of_object[index].append(outline)
    for number, track in enumerate(tracks):
        yield ShownObject(
            track.id, track.colour, tuple(of_object[number]), track.trail, track.speed
        )


def _is_place(point: Point) -> bool:
    """Whether its numbers are such as JSON can hold."""
    return math.isfinite(point.x) and math.isfinite(point.y)


def _hex(colour: ColorRGBA) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in (colour.r, colour.g, colour.b))
