"""Messages of packages that may be installed in one version or another, or not at all.

A layout says which fields a message has, of which types, in their order. That of an installed
package tells how its version serialises what is given by names; fields that nobody gave a value
are zero, or empty.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

from turbseg_ros.messages.cdr import FieldWriter

Layout = Mapping[str, Mapping[str, str]]
"""The fields of each type, by the type's name: name and type, as definitions write it."""

_NUMBERS = {
    **{"bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b"},
    **{"uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q"},
    **{"float32": "f", "float64": "d"},
}
# What classes call differently than definitions do.
_IN_CLASSES = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}


def layout_of_definitions(definitions: Mapping[str, str]) -> Layout:
    """Return the layout that definitions give, by type, without comments, defaults and constants.

    :param definitions: lines of a type and a name.
    """
    return {
        type_name: {name: kind for kind, name in map(str.split, text.strip().splitlines())}
        for type_name, text in definitions.items()
    }


def installed_layout(type_name: str) -> Layout | None:
    """Return the layout of a type whose package can be imported, None where it can't."""
    layout: dict[str, dict[str, str]] = {}
    try:
        _add_installed(type_name, layout)
    except (ImportError, AttributeError):
        return None
    return layout


def _add_installed(type_name: str, layout: dict[str, dict[str, str]]) -> None:
    if type_name in layout:
        return
    package, _, name = type_name.partition("/msg/")
    kinds = getattr(importlib.import_module(f"{package}.msg"), name).get_fields_and_field_types()
    layout[type_name] = {field: _as_defined(kind) for field, kind in kinds.items()}
    for kind in layout[type_name].values():
        if "/" in kind:
            _add_installed(_full_name(kind.removesuffix("[]")), layout)


def _as_defined(kind: str) -> str:
    """Return a field's type as definitions write it: `sequence<double>` is `float64[]`."""
    item = kind.removeprefix("sequence<").removesuffix(">")
    return _IN_CLASSES.get(item, item) + ("[]" if item != kind else "")


def _full_name(kind: str) -> str:
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"


def serialised_fields(type_name: str, values: Mapping[str, Any], layout: Layout) -> bytes:
    """Return a serialised message.

    :param values: those of its fields, by name; messages as mappings, sequences as lists. What
        the layout doesn't have is left out.
    """
    fields = FieldWriter()
    _write(fields, type_name, values, layout)
    return fields.serialised()


def _write(fields: FieldWriter, type_name: str, values: Mapping[str, Any], layout: Layout) -> None:
    for name, kind in layout[type_name].items():
        item = kind.removesuffix("[]")
        given = values.get(name)
        if item != kind:
            given = given or ()
            fields.number("I", len(given))
        for value in _items(given, several=item != kind):
            if item in _NUMBERS:
                fields.number(_NUMBERS[item], value or 0)
            elif item == "string":
                fields.text(value or "")
            else:
                _write(fields, _full_name(item), value or {}, layout)


def _items(given: Any, several: bool) -> Iterator[Any]:
    if several:
        yield from given
    else:
        yield given
