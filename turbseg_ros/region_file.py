"""Files of marked regions: polygons in YAML or JSON, and mask pictures."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from turbseg_ros.encoded_picture import PictureError, decoded
from turbseg_ros.parameter_file import parsed
from turbseg_ros.parameters import ParameterError, RegionsParameters
from turbseg_ros.segmentation.marked_regions import (
    Corners,
    Limits,
    MarkedRegion,
    MarkedRegions,
    MaskPicture,
    Polygon,
    Size,
)

_KINDS = ("ignore", "include")
_FILE_KEYS = ("image_size", "regions")
_LIMITS = ("min_size", "max_size", "min_speed")
_REGION_KEYS = ("name", "kind", "polygon", *_LIMITS)
# More are no drawing of a person's, and take long to check.
_MAX_REGIONS = 100
_MAX_CORNERS = 500
_MAX_NAME = 60
_MAX_SIDE = 100_000
# Of the picture; less is what rounding leaves of none.
_MIN_AREA = 1e-12
# Brightness, of 255, from which a pixel of a mask counts as white.
_WHITE = 128


def marked_regions(parameters: RegionsParameters) -> MarkedRegions:
    """Return what the files and pictures that are named mark.

    :raises ParameterError: when one can't be read or holds what is none; in one line, with its
        name.
    """
    marked: list[MarkedRegion] = []
    if parameters.file:
        source = f"parameter regions.file: {parameters.file}"
        content = _read(parameters.file, source)
        marked += regions_in(content, source, is_json=parameters.file.lower().endswith(".json"))
    for kind, name in (("ignore", parameters.ignore), ("include", parameters.include)):
        if name:
            source = f"parameter regions.{kind}: {name}"
            shape = mask_picture(_read(name, source), source)
            marked.append(MarkedRegion(kind, kind == "ignore", shape, source=source))
    return MarkedRegions(tuple(marked))


def regions_in(content: bytes, source: str, *, is_json: bool = False) -> list[MarkedRegion]:
    """Return the regions of a file's content.

    :param source: what messages call the file.
    :raises ParameterError: when it isn't one; in one line, with the source.
    """
    try:
        return _regions(_tree(content, is_json), source)
    except _RegionError as error:
        raise ParameterError(f"{source}: {error}") from error


def mask_picture(content: bytes, source: str) -> MaskPicture:
    """Return what is white in a picture of any format that OpenCV reads.

    :param source: what messages call the file.
    :raises ParameterError: when it is no picture, or of more pixels than images may have, or
        nothing of it is white; in one line.
    """
    try:
        picture = decoded(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except PictureError as error:
        reason = f" ({error})" if str(error) else ""
        raise ParameterError(
            f"{source}: not a picture{reason}; polygons are named by regions.file"
        ) from error
    white = picture >= _WHITE
    if not white.any():
        raise ParameterError(f"{source}: nothing of the picture is white")
    return MaskPicture(white)


class _RegionError(Exception):
    """What is wrong with a file's content, in one line."""


def _read(name: str, source: str) -> bytes:
    try:
        return Path(name).read_bytes()
    except OSError as error:
        raise ParameterError(f"{source}: {error.strerror or error}") from error
    except ValueError as error:  # a name that can't be one
        raise ParameterError(f"{source}: {error}") from error


def _tree(content: bytes, is_json: bool) -> object:
    kind = "JSON" if is_json else "YAML"
    try:
        text = content.decode("utf-8-sig")
        return json.loads(text) if is_json else parsed(text)
    except (ValueError, RecursionError) as error:
        reason = str(error) if isinstance(error, ParameterError) else f"not {kind} ({error})"
        raise _RegionError(reason) from error


def _regions(tree: object, source: str) -> list[MarkedRegion]:
    if not isinstance(tree, dict) or "regions" not in tree:
        raise _RegionError("no file of regions: expected 'regions: [{name: ..., polygon: ...}]'")
    _check_keys(tree, _FILE_KEYS)
    size = _image_size(tree["image_size"]) if "image_size" in tree else None
    listed = tree["regions"]
    if not isinstance(listed, list):
        raise _RegionError("regions is no list")
    if len(listed) > _MAX_REGIONS:
        raise _RegionError(f"{len(listed)} regions, of which {_MAX_REGIONS} are taken at most")
    return [_titled_region(entry, number, size, source) for number, entry in enumerate(listed, 1)]


def _titled_region(entry: object, number: int, size: Size | None, source: str) -> MarkedRegion:
    """Return one region of the file; what is wrong with it is said with its number and name."""
    try:
        return _region(entry, number, size, source)
    except _RegionError as error:
        raise _RegionError(f"{_titled(entry, number)}: {error}") from error


def _region(entry: object, number: int, size: Size | None, source: str) -> MarkedRegion:
    if not isinstance(entry, dict):
        raise _RegionError("expected name, kind and polygon")
    _check_keys(entry, _REGION_KEYS)
    kind = entry.get("kind", "ignore")
    if kind not in _KINDS:
        raise _RegionError(f"kind is one of {', '.join(_KINDS)}, not {_shown(kind)}")
    if "polygon" not in entry:
        raise _RegionError("it has no polygon")
    given = {name: entry[name] for name in _LIMITS if name in entry}
    if given and kind == "ignore":
        raise _RegionError(f"{next(iter(given))} is for regions of kind include")
    polygon = Polygon(_corners(entry["polygon"], size), size)
    name = _name(entry.get("name"), number)
    return MarkedRegion(name, kind == "ignore", polygon, _limits(given), source)


def _limits(given: Mapping[str, Any]) -> Limits:
    for name, value in given.items():
        if not (_is_number(value) and value >= 0):
            raise _RegionError(f"{name} takes a number from 0 on, not {_shown(value)}")
    limits = Limits(**{name: float(value) for name, value in given.items()})
    if limits.min_size > limits.max_size:
        raise _RegionError("min_size is above max_size")
    return limits


def _corners(polygon: object, size: Size | None) -> Corners:
    """Return the corners of a polygon in fractions of the picture's width and height."""
    if not isinstance(polygon, list) or not all(_is_point(point) for point in polygon):
        raise _RegionError("a polygon is a list of corners, each [x, y]")
    if not 3 <= len(polygon) <= _MAX_CORNERS:
        raise _RegionError(f"a polygon has 3 to {_MAX_CORNERS} corners, not {len(polygon)}")
    given = np.array(polygon, np.float64)
    limits = np.array(size or (1, 1), np.float64)
    beyond = ~((given >= 0.0) & (given <= limits)).all(axis=1)
    if beyond.any():
        x, y = (float(value) for value in given[int(np.argmax(beyond))])
        within = (
            "0 to 1; for corners in pixels the file says image_size: [width, height]"
            if size is None
            else f"the picture of {size[0]}x{size[1]}"
        )
        raise _RegionError(f"corner [{x:g}, {y:g}] lies beyond {within}")
    corners = given / limits
    crossing = _crossing_sides(corners)
    if crossing is not None:
        raise _RegionError(f"sides {crossing[0]} and {crossing[1]} of the polygon cross")
    if _area(corners) == 0.0:
        raise _RegionError("the polygon has no area")
    return corners


def _area(corners: Corners) -> float:
    """Return the area of a polygon whose sides don't cross; 0 where they only go there and back.

    It is that of the shoelace formula, of the whole picture 1.
    """
    x, y = (corners - corners.mean(axis=0)).T
    area = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    return area if area > _MIN_AREA else 0.0


def _crossing_sides(corners: Corners) -> tuple[int, int] | None:
    """Return the numbers, from 1, of two sides that cross, None if none do."""
    ends = np.roll(corners, -1, axis=0)

    def side_of(points: Corners) -> Corners:
        """Return on which side of each line each point lies, lines x points: -1, 0 or 1."""
        way, off = (ends - corners)[:, None], points[None] - corners[:, None]
        return np.asarray(np.sign(way[..., 0] * off[..., 1] - way[..., 1] * off[..., 0]))

    parted = side_of(corners) * side_of(ends) < 0
    first, second = np.nonzero(np.triu(parted & parted.T))
    return (int(first[0]) + 1, int(second[0]) + 1) if len(first) else None


def _image_size(given: object) -> Size:
    if (
        not isinstance(given, list)
        or len(given) != 2
        or not all(type(side) is int and 1 <= side <= _MAX_SIDE for side in given)
    ):
        raise _RegionError(f"image_size takes [width, height] in pixels, not {_shown(given)}")
    return given[0], given[1]


def _name(given: object, number: int) -> str:
    if given is None:
        return f"region {number}"
    name = str(given)
    if not (name.isprintable() and 0 < len(name) <= _MAX_NAME):
        raise _RegionError(f"a name is one line of up to {_MAX_NAME} characters")
    return name


def _titled(entry: object, number: int) -> str:
    name = str(entry.get("name", "")) if isinstance(entry, dict) else ""
    shown = f" ({name})" if name.isprintable() and 0 < len(name) <= _MAX_NAME else ""
    return f"region {number}{shown}"


def _check_keys(given: Mapping[Any, object], known: Iterable[str]) -> None:
    known = list(known)
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(known)}"
            raise _RegionError(f"unknown key {_shown(key)}{hint}")


def _is_point(point: object) -> bool:
    return isinstance(point, list) and len(point) == 2 and all(_is_number(each) for each in point)


def _is_number(value: object) -> bool:
    # A whole number may be too large for a floating-point one.
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) < 1e9
        and math.isfinite(value)
    )


def _shown(value: object) -> str:
    return repr(value)[:60]
