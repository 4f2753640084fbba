"""ROS 2 parameter files, read without ROS, for tools that run no node."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from turbseg_ros.parameters import ParameterError, Parameters, belongs_to_middleware

_NODE = "turbseg"
_VALUES = "ros__parameters"


def load_parameters(path: Path, node: str | None = None) -> Parameters:
    """Read what a ROS 2 parameter file (``/**: ros__parameters: ...``) sets for a node.

    As in ROS, sections may be nested or hold wildcards (`*` for one token of the name, `**` for
    any), and where several speak to the node a later one goes before an earlier. Names that belong
    to the middleware are passed over.

    :param node: full name of the node, as `/north/turbseg`; by default, that of the one node
        called turbseg that the file names, or `/turbseg`.
    :raises ParameterError: when the file can't be read as one, says nothing to the node, or holds
        an unknown name or a refused value; the text names the file.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ParameterError(f"{path}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, IndexError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ParameterError(f"{path}: not a YAML file ({reason})") from error
    try:
        return Parameters.from_mapping(_values_for(node, content))
    except RecursionError:
        raise ParameterError(f"{path}: a group holds itself") from None
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error


def _values_for(node: str | None, content: object) -> dict[str, object]:
    if not isinstance(content, dict):
        raise ParameterError(f"no ROS parameter file: expected '/**: {_VALUES}: ...'")
    sections = list(_sections(content))
    node = _absolute(node) if node else _only_node(pattern for pattern, _ in sections)
    values: dict[str, object] = {}
    spoken_to = False
    for pattern, section in sections:
        if _matches(pattern, node):
            values.update(_flattened(section))
            spoken_to = True
    if not spoken_to:
        raise ParameterError(f"no section for node {node}")
    return {name: value for name, value in values.items() if not belongs_to_middleware(name)}


def _sections(
    tree: Mapping[Any, object], prefix: str = ""
) -> Iterator[tuple[str, Mapping[Any, object]]]:
    """Return the patterns of node names, in the file's order, and what is set under each."""
    for key, value in tree.items():
        pattern = prefix + _absolute(str(key))
        if not isinstance(value, dict):
            raise ParameterError(f"section {pattern} has no mapping under '{_VALUES}'")
        inner = dict(value)
        values = inner.pop(_VALUES, None if not inner else {})
        if not isinstance(values, dict):
            raise ParameterError(f"section {pattern} has no mapping under '{_VALUES}'")
        if _VALUES in value:
            yield pattern, values
        yield from _sections(inner, pattern)


def _only_node(patterns: Iterator[str]) -> str:
    """Return the node of ours that a file speaks of, whatever its namespace."""
    named = {
        pattern for pattern in patterns if pattern.endswith(f"/{_NODE}") and "*" not in pattern
    }
    if len(named) > 1:
        raise ParameterError(f"it is for several nodes, choose one: {', '.join(sorted(named))}")
    return next(iter(named), f"/{_NODE}")


def _absolute(name: str) -> str:
    return "/" + name.lstrip("/")


def _matches(pattern: str, node: str) -> bool:
    """Whether a name pattern holds for a node, by the rules of rcl's parameter files."""
    tokens = {"*": "/[^/]+", "**": "(/[^/]+)*"}
    parts = (tokens.get(token, "/" + re.escape(token)) for token in pattern.split("/")[1:])
    return re.fullmatch("".join(parts), node) is not None


def _flattened(tree: Mapping[Any, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flattened(value, f"{name}."))
        else:
            flat[name] = value
    return flat
