"""What moved in a recording: a row for each object, with its best picture where asked for."""

from __future__ import annotations

import csv
import importlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from turbseg_ros.arrays import ByteImage
from turbseg_ros.overlay import to_bgr8, write_picture
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

SUFFIXES = (".csv", ".parquet")
COLUMNS = (
    "id",
    "from_s",
    "to_s",
    "from_stamp",
    "to_stamp",
    "frames",
    "from_x",
    "from_y",
    "to_x",
    "to_y",
    "way_px",
    "speed_px_s",
    "width",
    "height",
    "area",
    "picture",
)
# Room around an object in its picture: as a share of its size, and at least in pixels.
_MARGIN, _LEAST_MARGIN = 0.5, 8


@dataclass
class _Story:
    """What is known of one object."""

    first: tuple[int, MovingObject]
    last: tuple[int, MovingObject]
    areas: list[int] = field(default_factory=list)
    # Against the scene, in pixels: steps from frame to frame, and speeds a second.
    way: float = 0.0
    speeds: list[float] = field(default_factory=list)
    largest: MovingObject | None = None
    picture: ByteImage | None = None


class ObjectTable:
    """Collects what each object did, result by result.

    :param pictures: keep of each object the picture in which it is largest.
    """

    def __init__(self, pictures: bool = False) -> None:
        self._pictures = pictures
        self._stories: dict[int, _Story] = {}
        self._start: int | None = None
        self._end = 0

    def __len__(self) -> int:
        """How many objects there were."""
        return len(self._stories)

    def add(self, result: SegmentationResult) -> None:
        """Take the next result."""
        stamp = result.frame.stamp
        self._start = stamp if self._start is None else self._start
        self._end = stamp
        for moving_object in result.objects:
            self._take(result.frame, moving_object)

    def _take(self, frame: Frame, seen: MovingObject) -> None:
        story = self._stories.setdefault(seen.id, _Story((frame.stamp, seen), (frame.stamp, seen)))
        if story.areas:
            story.way += math.hypot(*seen.velocity)
        story.last = (frame.stamp, seen)
        story.areas.append(seen.area)
        velocity = seen.velocity_per_second
        if velocity is not None:
            story.speeds.append(math.hypot(*velocity))
        if story.largest is None or seen.area > story.largest.area:
            story.largest = seen
            if self._pictures:
                story.picture = _cut_out(frame, seen)

    def summary(self) -> str:
        """Return one line: how many objects, and when the first and the last were seen."""
        if not self._stories:
            return "nothing moved"
        first = min(story.first[0] for story in self._stories.values())
        last = max(story.last[0] for story in self._stories.values())
        count = len(self._stories)
        return (
            f"{count} object{'s' * (count > 1)} moved, seen from {self._seconds(first):.1f} s to "
            f"{self._seconds(last):.1f} s of {self._seconds(self._end):.1f} s"
        )

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each object, by its id; `COLUMNS` are its keys.

        Times are seconds from the first frame, stamps nanoseconds; places, ways, width, height and
        area are pixels of the image, the last three medians or those of the largest sight, and
        speeds pixels a second against the scene, None where the frames' rate isn't known.
        """
        return [self._row(id, story) for id, story in sorted(self._stories.items())]

    def _row(self, id: int, story: _Story) -> dict[str, object]:
        (first_stamp, first), (last_stamp, last) = story.first, story.last
        assert story.largest is not None  # it was seen once at least
        return {
            "id": id,
            "from_s": round(self._seconds(first_stamp), 3),
            "to_s": round(self._seconds(last_stamp), 3),
            "from_stamp": first_stamp,
            "to_stamp": last_stamp,
            "frames": len(story.areas),
            "from_x": round(first.centroid[0], 1),
            "from_y": round(first.centroid[1], 1),
            "to_x": round(last.centroid[0], 1),
            "to_y": round(last.centroid[1], 1),
            "way_px": round(story.way, 1),
            "speed_px_s": round(float(np.median(story.speeds)), 1) if story.speeds else None,
            "width": story.largest.box[2],
            "height": story.largest.box[3],
            "area": int(np.median(story.areas)),
            "picture": _picture_name(id) if story.picture is not None else "",
        }

    def _seconds(self, stamp: int) -> float:
        return (stamp - (self._start or 0)) * 1e-9

    def write(self, path: Path) -> None:
        """Write the rows as CSV or Parquet, as the name ends.

        :raises ImportError: when it is Parquet and PyArrow isn't installed.
        :raises OSError: when it can't be written.
        """
        rows = self.rows()
        content = _parquet(rows) if path.suffix.lower() == ".parquet" else _csv(rows)
        partial = path.with_name(f".{path.name}.partial")
        try:
            partial.write_bytes(content)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)

    def write_pictures(self, folder: Path) -> None:
        """Write each object's picture, as the rows name it, into a folder that is there.

        :raises OSError: when one can't be written.
        """
        for id, story in self._stories.items():
            if story.picture is not None:
                write_picture(folder / _picture_name(id), story.picture)


def _picture_name(id: int) -> str:
    return f"object_{id}.jpg"


def _cut_out(frame: Frame, seen: MovingObject) -> ByteImage:
    x, y, width, height = seen.box
    margin = max(_LEAST_MARGIN, round(_MARGIN * max(width, height)))
    rows = slice(max(y - margin, 0), y + height + margin)
    columns = slice(max(x - margin, 0), x + width + margin)
    return to_bgr8(frame.image[rows, columns])


def _csv(rows: Sequence[Mapping[str, object]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(rows: Sequence[Mapping[str, object]]) -> bytes:
    arrow: Any = importlib.import_module("pyarrow")
    parquet: Any = importlib.import_module("pyarrow.parquet")
    kinds = {
        "id": arrow.int64(),
        **dict.fromkeys(("from_stamp", "to_stamp", "frames"), arrow.int64()),
        **dict.fromkeys(("width", "height", "area"), arrow.int64()),
        "picture": arrow.string(),
    }
    schema = arrow.schema([(name, kinds.get(name, arrow.float64())) for name in COLUMNS])
    sink = io.BytesIO()
    parquet.write_table(arrow.Table.from_pylist([dict(row) for row in rows], schema), sink)
    return sink.getvalue()
