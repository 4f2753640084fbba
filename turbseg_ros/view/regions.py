"""Regions that are drawn on the page, and their file: that of the node's `regions.file`.

On the page corners are fractions of the picture's width and height; in the file, where the size of
the picture is known, pixels.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from turbseg_ros.parameters import ParameterError
from turbseg_ros.region_file import regions_in
from turbseg_ros.segmentation.marked_regions import (
    Corners,
    Limits,
    MarkedRegion,
    Polygon,
    Size,
)

Region = dict[str, Any]
"""`name`, `kind`, `polygon` in fractions of the picture, and limits where it has some."""


class RegionFile:
    """The file at `path`, YAML or, by its name, JSON, which need not be there yet."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> list[Region]:
        """Return the regions in the file, none while there is no file.

        :raises ParameterError: when it holds something else, or can't be read.
        """
        return [_entry(region, _fractions(_polygon(region).corners)) for region in self._marked()]

    def write(self, drawn: object, picture_size: Size | None) -> list[Region]:
        """Write regions from the page in the place of those in the file; return them.

        Where the file does not say of which size its pictures are, they are of `picture_size`.

        :raises ParameterError: when they can't be; the file then stays as it was.
        :raises OSError: when the file can't be written.
        """
        present = self._marked()
        size = _polygon(present[0]).size if present else None
        size = size or picture_size
        checked = regions_in(json.dumps({"regions": drawn}).encode(), "the page", is_json=True)
        tree: dict[str, Any] = {"image_size": list(size)} if size else {}
        tree["regions"] = [
            _entry(
                region,
                _pixels(_polygon(region).corners, size)
                if size
                else _fractions(_polygon(region).corners),
            )
            for region in checked
        ]
        content = self._text(tree).encode()
        # As it will be read: corners were rounded.
        regions_in(content, "the page", is_json=self._is_json)
        _replace(self.path, content)
        return [_entry(region, _fractions(_polygon(region).corners)) for region in checked]

    @property
    def _is_json(self) -> bool:
        return self.path.suffix.lower() == ".json"

    def _marked(self) -> list[MarkedRegion]:
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise ParameterError(f"{self.path}: {error.strerror or error}") from error
        return regions_in(content, str(self.path), is_json=self._is_json)

    def _text(self, tree: Region) -> str:
        if self._is_json:
            return json.dumps(tree, ensure_ascii=False, indent=1) + "\n"
        text: str = yaml.safe_dump(
            tree, sort_keys=False, allow_unicode=True, default_flow_style=None
        )
        return text


def _polygon(region: MarkedRegion) -> Polygon:
    # Files of regions hold no masks.
    assert isinstance(region.shape, Polygon)
    return region.shape


def _entry(region: MarkedRegion, polygon: Sequence[Sequence[float]]) -> Region:
    kind = "ignore" if region.ignored else "include"
    unlimited = asdict(Limits())
    limits = {
        name: limit for name, limit in asdict(region.limits).items() if limit != unlimited[name]
    }
    return {"name": region.name, "kind": kind, "polygon": polygon, **limits}


def _fractions(corners: Corners) -> list[list[float]]:
    return [[round(value, 5) for value in corner] for corner in corners.tolist()]


def _pixels(corners: Corners, size: Size) -> list[list[float]]:
    # Both kinds of coordinates begin at the picture's edge.
    return [
        [round(value * side, 1) for value, side in zip(corner, size, strict=True)]
        for corner in corners.tolist()
    ]


def _replace(path: Path, content: bytes) -> None:
    """Write a file that is the old one or the new one, whatever happens meanwhile."""
    with tempfile.NamedTemporaryFile(
        dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as partial:
        partial.write(content)
    try:
        Path(partial.name).chmod(0o644)
        Path(partial.name).replace(path)
    except OSError:
        Path(partial.name).unlink(missing_ok=True)
        raise
