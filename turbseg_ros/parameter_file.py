"""ROS 2 parameter files, read without ROS, for tools that run no node.

What a file says is read by the rules of rcl's own parser (rcl_yaml_param_parser), which are not
those of YAML libraries: `25e-1` is a number, `on` a truth value, `1_000`, `null` and a date are
texts, and quotes make anything a text. So node and tools take the same file alike.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from turbseg_ros.parameters import ParameterError, Parameters, belongs_to_middleware

_NODE = "turbseg"
_VALUES = "ros__parameters"

_TRUE = ("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON")
_FALSE = ("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF")
# What C's strtol takes with base 0: hexadecimal, octal with a zero ahead, decimal.
_INTEGER = re.compile(r"[+-]?(?:0[xX](?P<hex>[0-9a-fA-F]+)|0(?P<octal>[0-7]*)|[1-9][0-9]*)")
_MAX_INTEGER = 2**63 - 1
# Longer ones are too large, unless for zeros ahead; Python refuses to read very long ones.
_MAX_DIGITS = 1000
# What C's strtod takes, and YAML's own spelling of what is not finite.
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(
    r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)(?:[pP][+-]?[0-9]+)?"
)
_NOT_FINITE = re.compile(r"[+-]?(?i:inf(?:inity)?|nan)|[+-]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_QUOTES = ("'", '"')
_TEXT_TAG = "tag:yaml.org,2002:str"


def load_parameters(
    path: Path, node: str | None = None, before: Parameters | None = None
) -> Parameters:
    """Read what a ROS 2 parameter file (``/**: ros__parameters: ...``) sets for a node.

    As in ROS, sections may be nested or hold wildcards (`*` for one token of the name, `**` for
    any), and where several speak to the node a later one goes before an earlier. Names that belong
    to the middleware are passed over.

    :param node: full name of the node, as `/north/turbseg`; by default, that of the one node
        called turbseg that the file names, or `/turbseg`.
    :param before: what holds where the file says nothing; by default, the defaults.
    :raises ParameterError: when the file can't be read as one, says nothing to the node, or holds
        an unknown name or a refused value; the text names the file.
    """
    try:
        return (before or Parameters()).replace(_values_for(node, parsed(path.read_text())))
    except OSError as error:
        raise ParameterError(f"{path}: {error.strerror or error}") from error
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
    except ValueError as error:  # bytes that are no text
        reason = " ".join(str(error).split())
        raise ParameterError(f"{path}: not a YAML file ({reason})") from error


def parsed(text: str) -> Any:
    """Return what a YAML text says by rcl's rules: mappings, lists, and numbers, truth and texts.

    Of keys that come twice the later one's value holds; mappings under them are one.

    :raises ParameterError: when it is no YAML, or holds what rcl refuses: aliases, keys without
        a value.
    """
    try:
        node = _Loader(text).get_single_node()
        return None if node is None else _value(node)
    except (yaml.YAMLError, ValueError, IndexError, RecursionError) as error:
        if isinstance(error, ParameterError):
            raise
        reason = " ".join(str(error).split())
        raise ParameterError(f"not a YAML file ({reason})") from error


class _Loader(yaml.SafeLoader):
    """Composes nodes, and refuses aliases, as rcl does."""

    def resolve(self, kind: type[yaml.Node], value: Any, implicit: Any) -> str:
        """Leave what has no tag without one: rcl guesses by rules of its own."""
        return ""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            line = self.get_event().start_mark.line + 1  # type: ignore[no-untyped-call]
            raise ParameterError(f"line {line}: ROS takes no aliases (*name)")
        return super().compose_node(parent, index)


def _value(node: yaml.Node) -> object:
    if isinstance(node, yaml.MappingNode):
        merged: dict[str, object] = {}
        for key, value in node.value:
            _merge(merged, str(key.value), _value(value))
        return merged
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    assert isinstance(node, yaml.ScalarNode)
    text = str(node.value)
    if node.style in _QUOTES or node.tag == _TEXT_TAG:
        return text
    if not text:
        raise ParameterError(f"line {node.start_mark.line + 1}: no value")
    return scalar(text)


def _merge(into: dict[str, object], key: str, value: object) -> None:
    known = into.get(key)
    if isinstance(known, dict) and isinstance(value, dict):
        for name, inner in value.items():
            _merge(known, name, inner)
    else:
        into[key] = value


def scalar(text: str) -> bool | int | float | str:
    """Return what rcl makes of a value without quotes."""
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    whole = _INTEGER.fullmatch(text)
    if whole is not None and len(text) <= _MAX_DIGITS:
        base = 16 if whole["hex"] else 8 if whole["octal"] else 10
        number = int(text, base)
        if -_MAX_INTEGER - 1 <= number <= _MAX_INTEGER:
            return number
    if _DECIMAL.fullmatch(text) and _is_in_range(text):
        return float(text)
    if _HEXADECIMAL.fullmatch(text):
        with contextlib.suppress(OverflowError):
            return float.fromhex(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    return text


def _is_in_range(decimal: str) -> bool:
    """Whether strtod takes a number without an error: neither too large nor too small for it."""
    number = float(decimal)
    if number == 0.0:
        return not re.search("[1-9]", re.split("[eE]", decimal)[0])
    return sys.float_info.min <= abs(number) <= sys.float_info.max


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
    tokens = node.split("/")[1:]
    # How many tokens of the name what was looked at of the pattern can stand for.
    reached = {0}
    for part in pattern.split("/")[1:]:
        if part == "**":
            reached = set(range(min(reached), len(tokens) + 1))
        else:
            fitting = {count for count in reached if part in ("*", *tokens[count : count + 1])}
            reached = {count + 1 for count in fitting if count < len(tokens)}
        if not reached:
            return False
    return len(tokens) in reached


def _flattened(tree: Mapping[Any, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flattened(value, f"{name}."))
        else:
            flat[name] = value
    return flat
