"""Which files make up a bag: a single one, or those in a rosbag2 directory.

Directories come as recorders leave them: split, as a ring buffer whose first files are deleted,
compressed file by file, killed before `metadata.yaml` was written, or with an
old one.
"""

from __future__ import annotations

import itertools
import logging
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from turbseg_ros.bag.errors import BagError
from turbseg_ros.bag.mcap_file import MAX_MESSAGES

_LOGGER = logging.getLogger(__name__)

# How recorders name files, the parts that a recording was split into, and those they compressed.
_FILE_NAME = re.compile(
    r"(?P<plain>(?P<stem>.+?)(?:_(?P<number>\d{1,9}))?\.(?P<kind>mcap|db3|bag))"
    r"(?P<compression>\.(?:zstd|zst|lz4|gz|bz2|xz))?"
)
# Of these kinds, the first that a directory has is read.
_KINDS = ("mcap", "db3", "bag")
# "" is what `ros2 bag reindex` left on Humble: the files tell.
_STORAGES = ("mcap", "sqlite3", "")
# A metadata.yaml of a thousand topics is smaller than this, in bytes.
_MAX_METADATA = 2**24
# Names that a warning lists.
_LISTED = 5


@dataclass(frozen=True)
class Layout:
    """The files of a bag in their order.

    `stated` are the messages of each topic that `metadata.yaml` counts; `missing` are the files
    that should be there too; `packed_messages` whether each message is compressed by itself.
    """

    files: Sequence[Path]
    stated: Mapping[str, int]
    missing: Sequence[str] = ()
    packed_messages: bool = False


def find_layout(path: Path) -> Layout:
    """Find the files of the bag at `path`.

    :raises BagError: when there is none, or it can't be told which files belong to it.
    :raises OSError: when the directory can't be read.
    """
    if path.is_file():
        return Layout([path], {})
    if not path.exists():
        raise BagError(f"no such bag: {path}")
    information = _information(path)
    present = _present(path)
    if information is None:
        files = _files_of_one_recording(path, present)
        return Layout([path / part.name for part in files], {}, _gaps(files))
    return _as_metadata_says(path, present, information)


@dataclass(frozen=True)
class _Part:
    """A file of a recording: `plain` is its name before it was compressed."""

    name: str
    plain: str
    stem: str
    number: int | None
    kind: str


def _present(directory: Path) -> list[_Part]:
    """Return the recordings in a directory; of one that lies there compressed too, the plain."""
    parts: dict[str, _Part] = {}
    for name in sorted(entry.name for entry in directory.iterdir()):
        match = _FILE_NAME.fullmatch(name)
        if match is not None:
            number = None if match["number"] is None else int(match["number"])
            part = _Part(name, match["plain"], match["stem"], number, match["kind"])
            parts.setdefault(part.plain, part)  # the shorter name sorts first
    return sorted(parts.values(), key=lambda part: (part.stem, part.number or 0, part.name))


def _files_of_one_recording(path: Path, present: Sequence[_Part]) -> list[_Part]:
    kind = next((k for k in _KINDS if any(part.kind == k for part in present)), _KINDS[0])
    parts = [part for part in present if part.kind == kind]
    numbered = all(part.number is not None for part in parts)
    if len(parts) == 1 or (parts and numbered and len({part.stem for part in parts}) == 1):
        return parts
    raise BagError(
        f"{path} is not a bag: it has no metadata.yaml and {len(parts) or 'no'} .{kind} files"
        + (" of several recordings; name one of them" if parts else "")
    )


def _gaps(parts: Sequence[_Part]) -> list[str]:
    """Return the files that are missing between others; a ring buffer has deleted the first."""
    return [
        f"{before.stem}_{number}.{before.kind}"
        for before, after in itertools.pairwise(parts)
        if before.number is not None and after.number is not None
        # Names from elsewhere may be far apart.
        for number in range(before.number + 1, min(after.number, before.number + 1000))
    ]


def _as_metadata_says(
    path: Path, present: Sequence[_Part], information: Mapping[str, Any]
) -> Layout:
    storage = information.get("storage_identifier") or ""
    if storage not in _STORAGES:
        kind = storage if isinstance(storage, str) else "something unnamed"
        raise BagError(f"{path} is stored as {kind}; only mcap and sqlite3 can be read")
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        names = []
    if not names:
        raise BagError(f"{path / 'metadata.yaml'} names no .mcap file")
    # Early rosbag2 wrote names that begin with the directory's own; nothing else lies outside.
    listed = [Path(name).name for name in names]
    by_plain_name = {part.plain: part.name for part in present}
    files, missing = [], []
    for name in listed:
        match = _FILE_NAME.fullmatch(name)
        found = by_plain_name.get(match["plain"]) if match else None
        if found is None and name and (path / name).is_file():
            found = name
        if found is None:
            missing.append(name)
        else:
            files.append(found)
    files += _not_listed(path, present, listed)
    if not files:
        raise BagError(f"{path} lacks {shortened(missing)}, which its metadata.yaml names")
    mode = information.get("compression_mode")
    return Layout(
        [path / name for name in files],
        _stated_counts(information),
        missing,
        packed_messages=isinstance(mode, str) and mode.upper() == "MESSAGE",
    )


def _not_listed(path: Path, present: Sequence[_Part], listed: Iterable[str]) -> list[str]:
    """Return further parts of the recording, of which its metadata.yaml knows nothing."""
    known = [match for name in listed if (match := _FILE_NAME.fullmatch(name))]
    plain = {match["plain"] for match in known}
    stems = {(match["stem"], match["kind"]) for match in known if match["number"] is not None}
    further = [
        part.name
        for part in present
        if part.plain not in plain and part.number is not None and (part.stem, part.kind) in stems
    ]
    if further:
        _LOGGER.warning(
            "%s: its metadata.yaml is out of date; %s is read too", path, shortened(further)
        )
    return further


def _information(path: Path) -> Mapping[str, Any] | None:
    """Return what a bag's metadata.yaml says, None when it has none."""
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        return None
    try:
        if metadata.stat().st_size > _MAX_METADATA:
            raise BagError(f"{metadata} is too large: {metadata.stat().st_size} bytes")
        information = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise BagError(
            f"{metadata} is damaged; remove it or rebuild it with 'ros2 bag reindex'"
        ) from error
    if not isinstance(information, dict):
        raise BagError(f"{metadata} holds no rosbag2_bagfile_information")
    return information


def _stated_counts(information: Mapping[str, Any]) -> dict[str, int]:
    """Return the messages of each topic that metadata.yaml states; nothing when it is damaged."""
    try:
        counts = {
            str(entry["topic_metadata"]["name"]): int(entry["message_count"])
            for entry in information["topics_with_message_count"]
        }
    except (KeyError, TypeError, ValueError, OverflowError):
        return {}
    return counts if all(0 <= count <= MAX_MESSAGES for count in counts.values()) else {}


def shortened(names: Collection[str]) -> str:
    """Return names as a list for people, the first few of many."""
    more = len(names) - _LISTED
    text = ", ".join(list(names)[:_LISTED]) or "none"
    return f"{text} and {more} more" if more > 0 else text
