"""What a viewer knows of a node, as plain values; no ROS, no web."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Value = bool | int | float | str | list[str]
Polygon = tuple[tuple[float, float], ...]
"""Corners (x, y) in pixels of the image; a pixel's centre lies at a whole number."""

# Figures of the diagnostics that are drawn over time.
DRAWN = (
    "input rate (Hz)",
    "output rate (Hz)",
    "latency from arrival p50 (ms)",
    "latency from arrival p95 (ms)",
    "turbulence (px)",
)
# Once a second: ten minutes.
_POINTS = 600
# Diagnostics come once a second; without any for so long, in seconds, the node counts as gone.
_TIMEOUT = 3.5
_NANOSECONDS = 1e9
# Beyond, whole numbers fit no message; NaN isn't below it either.
_LARGEST = 2.0**63


@dataclass(frozen=True)
class ShownObject:
    """One object of a result: `outlines` closed, `trail` oldest first.

    `colour` is "#rrggbb"; `speed` pixels a second, None while it is not known.
    """

    id: int
    colour: str
    outlines: tuple[Polygon, ...]
    trail: Polygon = ()
    speed: float | None = None

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the box around it in pixels, None without outlines."""
        corners = [corner for outline in self.outlines for corner in outline]
        if not corners:
            return None
        width, height = (max(along) - min(along) for along in zip(*corners, strict=True))
        return round(width) + 1, round(height) + 1


@dataclass(frozen=True)
class Result:
    """What was found in the image of a `stamp`, in nanoseconds."""

    stamp: int
    objects: tuple[ShownObject, ...]


@dataclass(frozen=True)
class Picture:
    """An image as JPEG, with the result that belongs to it.

    `width` and `height` are those of the camera's image. `number` counts pictures. One that is
    `drawn` shows the outlines already.
    """

    number: int
    jpeg: bytes
    width: int
    height: int
    result: Result
    drawn: bool


@dataclass(frozen=True)
class Status:
    """What a node's last diagnostics say: `level` is ok, warn or error."""

    name: str
    level: str
    message: str
    figures: Mapping[str, str]


@dataclass(frozen=True)
class LiveParameter:
    """A parameter that may change while the node runs; `kind` is bool, int, float, str or list."""

    name: str
    kind: str
    value: Value
    description: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()

    def checked(self, value: object) -> Value:
        """Return a value from the page as this parameter's type.

        :raises ValueError: when it can't be one.
        """
        if isinstance(value, bool):
            if self.kind == "bool":
                return value
        elif isinstance(value, (int, float)):
            if self.kind == "float" and abs(value) < _LARGEST:
                return float(value)
            if self.kind == "int" and abs(value) < _LARGEST and value == int(value):
                return int(value)
        elif isinstance(value, str):
            if self.kind == "str" and _is_text(value):
                return value
        elif isinstance(value, list) and self.kind == "list" and all(map(_is_text, value)):
            return value
        raise ValueError(f"{self.name} can't be {value!r:.100}")


@dataclass
class _Sighting:
    """When an object was seen first; `whole` where it was seen to appear."""

    stamp: int
    whole: bool


@dataclass
class ViewState:
    """All that is shown; any thread may tell it or ask.

    `on_change` is called, in the teller's thread, after each change.
    """

    clock: Callable[[], float] = time.monotonic
    on_change: Callable[[], None] = lambda: None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _status: Status | None = None
    _heard: float = -math.inf
    _others: set[str] = field(default_factory=set)
    _points: deque[tuple[float | None, ...]] = field(default_factory=lambda: deque(maxlen=_POINTS))
    _point_count: int = 0
    _result: Result | None = None
    _sightings: dict[int, _Sighting] = field(default_factory=dict)
    _picture: Picture | None = None
    _picture_problem: str = ""
    _parameters: tuple[LiveParameter, ...] = ()
    _parameter_version: int = 0

    def tell_status(self, status: Status) -> None:
        """Take the node's newest diagnostics."""
        with self._lock:
            self._status = status
            self._heard = self.clock()
            self._points.append(tuple(_number(status.figures.get(key)) for key in DRAWN))
            self._point_count += 1
        self.on_change()

    def tell_other(self, name: str) -> None:
        """Take note of another node of the kind, which is not the one looked at."""
        with self._lock:
            self._others.add(name)

    def tell_result(self, result: Result) -> None:
        """Take the newest result, with a picture or without."""
        with self._lock:
            # Who begins to look in the middle has not seen how these appeared.
            whole = self._result is not None
            self._sightings = {
                each.id: self._sightings.get(each.id, _Sighting(result.stamp, whole))
                for each in result.objects
            }
            self._result = result

    def tell_picture(
        self, jpeg: bytes, size: tuple[int, int], result: Result, drawn: bool
    ) -> None:
        """Take the newest picture; `size` is the width and height of the camera's image."""
        with self._lock:
            number = self._picture.number + 1 if self._picture else 1
            self._picture = Picture(number, jpeg, *size, result, drawn)
            self._picture_problem = ""
        self.on_change()

    def tell_picture_problem(self, problem: str) -> None:
        """Say in a line why there is no picture."""
        with self._lock:
            self._picture_problem = problem
        self.on_change()

    def end_results(self) -> None:
        """Forget the objects: the node has taken them away."""
        with self._lock:
            self._sightings = {}
            if self._result is not None:
                self._result = Result(self._result.stamp, ())
        self.on_change()

    def tell_parameters(self, parameters: Sequence[LiveParameter]) -> None:
        """Take the parameters that may change; none while the node is away."""
        with self._lock:
            if self._parameters == tuple(parameters):
                return
            self._parameters = tuple(parameters)
            self._parameter_version += 1
        self.on_change()

    @property
    def picture(self) -> Picture | None:
        """The newest picture."""
        with self._lock:
            return self._picture

    @property
    def parameters(self) -> tuple[int, tuple[LiveParameter, ...]]:
        """A number that changes with them, and the parameters that may change."""
        with self._lock:
            return self._parameter_version, self._parameters

    @property
    def is_there(self) -> bool:
        """Whether the node was heard lately."""
        with self._lock:
            return self._is_there()

    def _is_there(self) -> bool:
        return self.clock() - self._heard <= _TIMEOUT

    def points_since(self, seen: int) -> tuple[int, list[tuple[float | None, ...]]]:
        """Return how many points there were so far, and those after the first `seen`.

        A point holds the figures `DRAWN`, one a second; None where there was none.
        """
        with self._lock:
            new = min(self._point_count - seen, len(self._points))
            return self._point_count, list(self._points)[len(self._points) - new :]

    def summary(self) -> dict[str, Any]:
        """Return what the page shows beside picture, curves and parameters, ready for JSON."""
        with self._lock:
            there, status = self._is_there(), self._status
            return {
                "there": there,
                "silent": None if status is None else round(self.clock() - self._heard, 1),
                "node": status.name if status else "",
                "level": status.level if status else "",
                "message": status.message if status else "",
                "figures": dict(status.figures) if status else {},
                "others": sorted(self._others),
                "problem": self._picture_problem,
                "objects": self._objects() if there else [],
            }

    def _objects(self) -> list[dict[str, Any]]:
        if self._result is None:
            return []
        return [
            {
                "id": each.id,
                "colour": each.colour,
                "size": each.size,
                "speed": each.speed,
                "seen": (self._result.stamp - sighting.stamp) / _NANOSECONDS,
                "whole": sighting.whole,
            }
            for each in self._result.objects
            if (sighting := self._sightings.get(each.id))
        ]


def _number(text: str | None) -> float | None:
    """Return a figure of the diagnostics, None where it is none (nan, too)."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _is_text(value: object) -> bool:
    """Whether a message can hold it: half a surrogate pair is no text."""
    try:
        return isinstance(value, str) and bool(value.encode() or True)
    except UnicodeEncodeError:
        return False
