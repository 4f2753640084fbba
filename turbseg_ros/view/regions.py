"""Files of regions that are drawn on the page, YAML or JSON: read, checked and written.

    image_size: [1920, 1080]
    regions:
    - {name: road, kind: ignore, polygon: [[x, y], ...]}

Corners are pixels of an image of that size; without it, fractions of width and height. On the page
they always are fractions. What else a region has in the file, it keeps.
"""

from __future__ import annotations

import itertools
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from turbseg_ros.parameter_file import parsed

KINDS = ("ignore", "include")
_MAX_REGIONS = 100
_MAX_CORNERS = 500
_MAX_NAME = 60
# What a region may have beside its polygon; numbers.
_LIMITS = ("min_size", "max_size", "min_speed")

Region = dict[str, Any]
"""`name`, `kind`, `polygon` in fractions of the picture, and limits where it has some."""
Size = tuple[int, int]
"""Width and height in pixels."""


class RegionError(ValueError):
    """Regions that can't be; the text is one line saying why."""


class RegionFile:
    """The file at `path`, which need not be there yet."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> list[Region]:
        """Return the regions in the file, none while there is no file.

        :raises RegionError: when it holds something else, or can't be read.
        """
        size, regions = self._content()
        if size is None:
            return checked(regions)
        return checked([{**_fields(each), "polygon": _fractions(each, size)} for each in regions])

    def write(self, regions: object, picture_size: Size | None) -> list[Region]:
        """Write regions in the place of those in the file; return them.

        Where the file names no size of its images, `picture_size` is the one that it gets.

        :raises RegionError: when they can't be; the file then stays as it was.
        :raises OSError: when the file can't be written.
        """
        kept = checked(regions)
        size = self._content()[0] or picture_size
        entries = [{**each, "polygon": _written(each["polygon"], size)} for each in kept]
        tree: dict[str, Any] = {"image_size": list(size)} if size else {}
        tree["regions"] = entries
        _replace(self.path, tree)
        return kept

    def _content(self) -> tuple[Size | None, list[Any]]:
        try:
            tree = parsed(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None, []
        except (OSError, ValueError) as error:
            raise RegionError(f"{self.path}: {' '.join(str(error).split())}") from error
        regions = tree.get("regions") if isinstance(tree, dict) else None
        if not (isinstance(tree, dict) and isinstance(regions, list)):
            raise RegionError(f"{self.path}: no file of regions")
        size = tree.get("image_size")
        if size is None:
            return None, regions
        if not (
            isinstance(size, list)
            and len(size) == 2
            and all(type(side) is int and side > 0 for side in size)
        ):
            raise RegionError(f"{self.path}: image_size takes [width, height]")
        return (size[0], size[1]), regions


def checked(regions: object) -> list[Region]:
    """Return regions whose corners are fractions of the picture.

    :raises RegionError: when they aren't.
    """
    if not isinstance(regions, list) or len(regions) > _MAX_REGIONS:
        raise RegionError(f"regions are a list of up to {_MAX_REGIONS}")
    return [_checked(each, number) for number, each in enumerate(regions, 1)]


def _checked(region: object, number: int) -> Region:
    fields = _fields(region)
    name = str(fields.get("name") or f"region {number}")
    if not (name.isprintable() and len(name) <= _MAX_NAME):
        raise RegionError(f"region {number}: a name is one line of up to {_MAX_NAME} characters")
    kind = fields.get("kind", KINDS[0])
    if kind not in KINDS:
        raise RegionError(f"{name}: kind is one of {', '.join(KINDS)}")
    polygon = fields.get("polygon")
    if not (isinstance(polygon, list) and all(_is_corner(corner) for corner in polygon)):
        raise RegionError(f"{name}: a polygon is a list of corners in the picture")
    if not 3 <= len(polygon) <= _MAX_CORNERS:
        raise RegionError(f"{name}: a polygon has 3 to {_MAX_CORNERS} corners")
    if _crosses_itself(polygon):
        raise RegionError(f"{name}: its sides cross")
    limits = {key: fields[key] for key in _LIMITS if key in fields}
    if not all(_is_number(value) and value >= 0 for value in limits.values()):
        raise RegionError(f"{name}: limits are numbers from 0 on")
    return {"name": name, "kind": kind, "polygon": polygon, **limits}


def _fields(region: object) -> Mapping[str, Any]:
    if not isinstance(region, dict):
        raise RegionError("a region has name, kind and polygon")
    return region


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _is_point(corner: object) -> bool:
    return isinstance(corner, list) and len(corner) == 2 and all(map(_is_number, corner))


def _is_corner(corner: object) -> bool:
    return isinstance(corner, list) and _is_point(corner) and all(0 <= v <= 1 for v in corner)


def _crosses_itself(polygon: Sequence[Sequence[float]]) -> bool:
    sides = list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    return any(_cross(one, other) for one, other in itertools.combinations(sides, 2))


def _cross(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> bool:
    """Whether two sides cross in a point that is an end of neither."""

    def side(line: Sequence[Sequence[float]], point: Sequence[float]) -> float:
        (ax, ay), (bx, by) = line
        return (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax)

    return (
        side(one, other[0]) * side(one, other[1]) < 0
        and side(other, one[0]) * side(other, one[1]) < 0
    )


def _fractions(region: object, size: Size) -> object:
    """Return a polygon of a file in fractions; what is none, as it is."""
    polygon = _fields(region).get("polygon")
    if not (isinstance(polygon, list) and all(map(_is_point, polygon))):
        return polygon
    # A pixel's centre, at whole numbers, lies half a pixel into the picture.
    return [
        [min((value + 0.5) / side, 1.0) for value, side in zip(corner, size, strict=True)]
        for corner in polygon
    ]


def _written(polygon: Sequence[Sequence[float]], size: Size | None) -> list[list[float]]:
    if size is None:
        return [[round(value, 5) for value in corner] for corner in polygon]
    return [
        [max(round(value * side - 0.5, 1), 0.0) for value, side in zip(corner, size, strict=True)]
        for corner in polygon
    ]


def _replace(path: Path, tree: Mapping[str, Any]) -> None:
    """Write a file that is the old one or the new one, whatever happens meanwhile."""
    import yaml

    if path.suffix.lower() == ".json":
        text = json.dumps(tree, ensure_ascii=False, indent=1) + "\n"
    else:
        text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None)
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as partial:
        partial.write(text)
    try:
        Path(partial.name).chmod(0o644)
        Path(partial.name).replace(path)
    except OSError:
        Path(partial.name).unlink(missing_ok=True)
        raise
