"""Line charts as positions on a drawing of fixed size, for a page to draw as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

_WIDTH, _HEIGHT = 640, 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 16, 14, 34
_MAX_TICKS = 8


@dataclass(frozen=True)
class Tick:
    """A mark on an axis: where it is on the drawing, and what it says."""

    position: float
    label: str


@dataclass(frozen=True)
class Point:
    """A point of a line: where it is on the drawing, and what it stands for."""

    x: float
    y: float
    label: str


@dataclass(frozen=True)
class Line:
    """A line of a chart: points (x, y) in order of x, y between 0 and 1."""

    name: str
    values: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Chart:
    """A chart of lines over one axis; the y axis goes from 0 to 1.

    `marked` tells whether every point is drawn; `x_values` are the marks of the x axis, chosen
    when there are none.
    """

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    x_values: tuple[float, ...] = ()
    marked: bool = True
    width: int = _WIDTH
    height: int = _HEIGHT

    @property
    def left(self) -> float:
        """Where the y axis is."""
        return _LEFT

    @property
    def right(self) -> float:
        """Where the x axis ends."""
        return self.width - _RIGHT

    @property
    def top(self) -> float:
        """Where the y axis ends."""
        return _TOP

    @property
    def bottom(self) -> float:
        """Where the x axis is."""
        return self.height - _BOTTOM

    @property
    def x_ticks(self) -> list[Tick]:
        """The marks of the x axis."""
        low, high = self._x_range
        values = self.x_values or round_values(low, high)
        return [Tick(self._x(value), f"{value:g}") for value in values]

    @property
    def y_ticks(self) -> list[Tick]:
        """The marks of the y axis."""
        return [Tick(self._y(value), f"{value:g}") for value in (0, 0.2, 0.4, 0.6, 0.8, 1.0)]

    def points(self, line: Line) -> Iterator[Point]:
        """Return the points of a line on the drawing."""
        for x, y in line.values:
            yield Point(self._x(x), self._y(y), f"{line.name}: {y:.3f} at {x:g}")

    def path(self, line: Line) -> str:
        """Return a line as SVG's polyline takes it."""
        return " ".join(f"{point.x:.1f},{point.y:.1f}" for point in self.points(line))

    @property
    def _x_range(self) -> tuple[float, float]:
        values = [x for line in self.lines for x, _ in line.values] + list(self.x_values)
        low, high = min(values, default=0.0), max(values, default=1.0)
        return (low, high) if high > low else (low, low + 1.0)

    def _x(self, value: float) -> float:
        low, high = self._x_range
        return round(self.left + (self.right - self.left) * (value - low) / (high - low), 1)

    def _y(self, value: float) -> float:
        return round(self.bottom - (self.bottom - self.top) * value, 1)


def round_values(low: float, high: float) -> Sequence[float]:
    """Return a few round numbers from `low` to `high`, in steps of 1, 2 or 5 times a power of 10.

    :raises ValueError: when `high` isn't above `low`.
    """
    if not high > low:
        raise ValueError(f"no range from {low} to {high}")
    magnitude = 10.0 ** math.floor(math.log10((high - low) / _MAX_TICKS))
    step = next(s for s in (1, 2, 5, 10) if (high - low) / (s * magnitude) <= _MAX_TICKS)
    step_size = step * magnitude
    first, last = math.ceil(low / step_size), math.floor(high / step_size)
    return [round(index * step_size, 12) for index in range(first, last + 1)]
