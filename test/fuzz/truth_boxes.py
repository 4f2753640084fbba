"""Fuzz true boxes: whatever files and messages of them hold, they are read, or refused.

The first byte of an input says what the rest is: D a serialised Detection2DArray, M text of
MOTChallenge, any other JSON of COCO-VID or lists.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["turbseg_ros", "json"]):
    from turbseg_ros.bag.errors import ClipError
    from turbseg_ros.datasets.boxes import read_boxes
    from turbseg_ros.messages.cdr import SerialisedDataError
    from turbseg_ros.messages.detections import (
        Detection,
        detections_from,
        serialised_detections,
    )

import math

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz_boxes_"))
STAMP = 3_000_000_007


def check(detections: tuple[Detection, ...]) -> None:
    for each in detections:
        left, top, width, height = each.box
        assert all(map(math.isfinite, (left + width, top + height, *each.box)))
        assert min(width, height) >= 0
    # What a file says is written into bags, from which it is scored.
    stamp, read = detections_from(memoryview(serialised_detections(detections, STAMP)))
    assert stamp == STAMP
    assert [(each.id, each.class_id) for each in read] == [
        (each.id, each.class_id) for each in detections
    ]


def try_one(data: bytes) -> None:
    kind, rest = data[:1], data[1:]
    if kind == b"D":
        try:
            _, found = detections_from(memoryview(rest))
        except SerialisedDataError as error:
            assert str(error).isprintable()
            return
        check(found)
        return
    path = FOLDER / ("gt.txt" if kind == b"M" else "boxes.json")
    path.write_bytes(rest)
    try:
        truth = read_boxes(path, "near")
    except ClipError as error:
        assert str(error).isprintable()
        return
    for number in sorted(truth.boxes)[:100]:
        check(truth.at(number) or ())
    assert truth.at(0) is not None or truth.frames == 0


if __name__ == "__main__":
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
