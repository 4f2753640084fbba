"""Message types by name: their Python classes and the definitions that a bag carries along."""

from __future__ import annotations

import functools
import importlib
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turbseg_ros.bag.errors import BagError
from turbseg_ros.messages import detections, image_annotations

# Types that are known whether their packages are installed or not: the definitions of each and
# of what it is made of, what these need of other packages, and its hash.
_CARRIED = {
    module.TYPE_NAME: (module.DEFINITIONS, module.DEPENDENCIES, module.TYPE_HASH)
    for module in (detections, image_annotations)
}
# How a definition's dependencies are set apart in the ros2msg schema encoding,
# https://mcap.dev/spec/registry#ros2msg
_DEPENDENCY_HEADING = "=" * 80 + "\nMSG: "

_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
# The same as ROS 1, IDL (of DDS too) and Python write it.
_OTHER_NAME = re.compile(
    r"/?(?P<package>[a-z][a-z0-9_]*)(?:/|::|\.)"
    r"(?:msg(?:/|::|\.)(?P<dds>dds_(?:/|::|\.))?)?(?P<name>[A-Z][A-Za-z0-9]*)(?(dds)_)"
)


@dataclass(frozen=True)
class MessageDefinition:
    """What makes a recorded message readable without its package.

    `text` is the type's .msg followed by those of all types it is made of (`ros2msg`); `type_hash`
    is its REP 2016 hash, `RIHS01_...`.
    """

    text: str
    type_hash: str


@functools.cache
def message_definition(type_name: str) -> MessageDefinition:
    """Return the definition of `type_name`, such as `sensor_msgs/msg/Image`.

    Those of `detections` and `image_annotations` are known without their packages.

    :raises BagError: when no installed package has that type.
    """
    if type_name in _CARRIED and not is_installed(type_name):
        definitions, needed, type_hash = _CARRIED[type_name]
        others = {name: _interface_file(name, "msg") for name in needed}
        return MessageDefinition(_joined({**definitions, **others}), type_hash)
    description = json.loads(_interface_file(type_name, "json"))
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    dependencies = [
        entry["type_name"]
        for entry in description["type_description_msg"]["referenced_type_descriptions"]
    ]
    texts = {name: _interface_file(name, "msg") for name in (type_name, *dependencies)}
    return MessageDefinition(_joined(texts), type_hash=hashes[type_name])


def _joined(texts: Mapping[str, str]) -> str:
    """Return the definitions of a type, the first, and of those that it is made of, as one."""
    first, *others = texts
    parts = [f"{_DEPENDENCY_HEADING}{_short_name(name)}\n{texts[name]}" for name in others]
    return "\n".join([texts[first], *parts])


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Return the Python class of `type_name`, such as `sensor_msgs/msg/Image`.

    :raises BagError: when no installed package has that type.
    """
    # A bag must not name any module to be imported: only those that hold messages.
    _interface_file(type_name, "msg")
    package, _, name = type_name.partition("/msg/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise _not_installed(type_name) from error
    return found


def canonical_type_name(name: str) -> str:
    """Return a type's name as ROS 2 writes it: `sensor_msgs/msg/Image`.

    It may be written as elsewhere: `sensor_msgs/Image`, `sensor_msgs::msg::Image`,
    `sensor_msgs::msg::dds_::Image_`, with a slash ahead. What is none of these stays as it is.
    """
    match = _OTHER_NAME.fullmatch(name.strip())
    return f"{match['package']}/msg/{match['name']}" if match else name


def type_name_of(message: object) -> str:
    """Return the name of a message's type, such as `sensor_msgs/msg/Image`."""
    kind = type(message)
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def is_installed(type_name: str) -> bool:
    """Whether some installed package has a type, such as `sensor_msgs/msg/Image`."""
    return any((prefix / "share" / f"{type_name}.json").is_file() for prefix in _prefixes())


def _interface_file(type_name: str, suffix: str) -> str:
    if not _TYPE_NAME.fullmatch(type_name):
        raise _not_installed(type_name)
    for prefix in _prefixes():
        path = prefix / "share" / f"{type_name}.{suffix}"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise _not_installed(type_name)


def _prefixes() -> list[Path]:
    """Return the roots that packages are installed under: of ROS, and of Python for wheels."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(prefix) for prefix in [*sourced, sys.prefix] if prefix]


def _short_name(type_name: str) -> str:
    return type_name.replace("/msg/", "/")


def _not_installed(type_name: str) -> BagError:
    return BagError(f"message type {type_name} is not installed; install its package")
