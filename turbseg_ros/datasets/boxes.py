"""True boxes of data sets: MOTChallenge text, COCO-VID JSON, and JSON with a box a frame."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turbseg_ros.bag.errors import ClipError, reading
from turbseg_ros.messages.detections import IGNORED, Box, Detection, is_box

# The object of files that name none.
_ONLY_OBJECT = "1"
# Columns of a MOTChallenge line up to the box, and that which says whether it counts.
_MOT_COLUMNS, _MOT_COUNTS = 6, 6


@dataclass(frozen=True)
class BoxTruth:
    """The true boxes of a clip by the number of their frame, from 0; frames without are left out.

    `frames` is how many frames the file tells of, the first of the clip, None where it doesn't
    say; then it is all.
    """

    boxes: Mapping[int, tuple[Detection, ...]]
    frames: int | None

    def at(self, number: int) -> tuple[Detection, ...] | None:
        """Return the boxes of a frame; None when the file doesn't tell of it."""
        if self.frames is not None and number >= self.frames:
            return None
        return self.boxes.get(number, ())

    def check_count(self, frames: int) -> None:
        """Check that they belong to a clip of so many frames.

        :raises ClipError: when the file tells of more.
        """
        told = max(self.boxes, default=-1) + 1 if self.frames is None else self.frames
        if told > frames:
            raise ClipError(f"there are boxes for {told} frames, the clip has {frames}")


def read_boxes(path: Path, clip: str) -> BoxTruth:
    """Read the true boxes of a clip.

    `path` is MOTChallenge text (frame from 1, id, left, top, width, height, 0 for one that is to
    be ignored), COCO-VID JSON (images with video_id, annotations with instance_id or track_id), or
    JSON that gives for each clip a box or null a frame.

    :param clip: its name, by which files of several clips tell them apart.
    :raises ClipError: when it is none of these, or has no such clip.
    """
    with reading(path):
        text = path.read_text(encoding="utf-8", errors="replace")
    if path.suffix.lower() != ".json":
        return _from_mot(path, text)
    try:
        content = json.loads(text)
        if "images" in content and "annotations" in content:
            return _from_coco(path, content, clip)
        return _from_lists(path, content, clip)
    except (
        *(ValueError, OverflowError, TypeError),
        *(KeyError, AttributeError, RecursionError),
    ) as error:
        raise ClipError(
            f"{path} holds no boxes: neither COCO-VID nor lists of [left, top, width, height] "
            f"({type(error).__name__}: {error})"
        ) from error


def _from_mot(path: Path, text: str) -> BoxTruth:
    found: list[tuple[int, Detection]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        row = line.split(",")
        if not any(cell.strip() for cell in row):
            continue
        try:
            if len(row) < _MOT_COLUMNS:
                raise ValueError("too few columns")
            values = [float(cell) for cell in row[: _MOT_COUNTS + 1]]
            box = _box(values[2:6])
            if values[0] < 1:
                raise ValueError("frames count from 1")
            frame, counts = int(values[0]) - 1, (values[6:] or [1.0])[0]
        except (ValueError, OverflowError) as error:
            raise ClipError(
                f"{path}, line {number}: {error}; lines of MOTChallenge are "
                "frame, id, left, top, width, height, 1 or 0 to be ignored"
            ) from error
        found.append((frame, Detection(box, f"{values[1]:g}", "" if counts else IGNORED)))
    return BoxTruth(_by_frame(found), None)


def _from_coco(path: Path, content: Mapping[str, Any], clip: str) -> BoxTruth:
    videos = {video["id"]: str(video.get("name", "")) for video in content.get("videos", ())}
    wanted = _one_of({name: number for number, name in videos.items()}, clip, path)
    images = [image for image in content["images"] if not videos or image["video_id"] == wanted]
    images.sort(key=lambda image: (image.get("frame_id", image["id"]), image["id"]))
    numbers = {image["id"]: number for number, image in enumerate(images)}
    classes = {entry["id"]: str(entry["name"]) for entry in content.get("categories", ())}
    found = []
    for annotation in content["annotations"]:
        number = numbers.get(annotation["image_id"])
        if number is None:
            continue
        ignored = annotation.get("iscrowd") or annotation.get("ignore")
        its_class = classes.get(annotation.get("category_id"), "")
        its_id = annotation.get("instance_id", annotation.get("track_id", annotation["id"]))
        box = _box(annotation["bbox"])
        its_class = IGNORED if ignored else its_class
        found.append((number, Detection(box, _text(its_id), _text(its_class))))
    return BoxTruth(_by_frame(found), len(images))


def _from_lists(path: Path, content: Mapping[str, Any], clip: str) -> BoxTruth:
    boxes = _one_of(content, clip, path)
    found = [
        (number, Detection(_box(box), _ONLY_OBJECT)) for number, box in enumerate(boxes) if box
    ]
    return BoxTruth(_by_frame(found), len(boxes))


def _one_of(clips: Mapping[str, Any], clip: str, path: Path) -> Any:
    """Return what belongs to a clip, or to the only one; None where there are none."""
    matching = [name for name in clips if clip in (name, Path(name).stem, Path(name).name)]
    if len(matching) != 1 and len(clips) > 1:
        raise ClipError(
            f"{path} has {len(matching) or 'no'} clips called {clip}; choose with --clip: "
            f"{', '.join(list(clips)[:8])}"
        )
    return next((clips[name] for name in matching or clips), None)


def _box(values: Sequence[float]) -> Box:
    left, top, width, height = map(float, values)
    if not is_box((left, top, width, height)):
        raise ValueError(f"no box: {list(values)}")
    return left, top, width, height


def _text(value: object) -> str:
    """Return what messages can carry: JSON may hold halves of characters."""
    return str(value).encode(errors="replace").decode()


def _by_frame(found: Iterable[tuple[int, Detection]]) -> dict[int, tuple[Detection, ...]]:
    boxes: dict[int, tuple[Detection, ...]] = {}
    for number, detection in found:
        boxes[number] = (*boxes.get(number, ()), detection)
    return boxes
