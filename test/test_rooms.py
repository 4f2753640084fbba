"""The house: which room may know which, and that the method stays on one page."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.paths import ROOT

PACKAGE = ROOT / "turbseg_ros"
ROOMS = sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file())
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")
}
# What each room may import of the others; the modules beside the rooms may be imported by all.
KNOWS: dict[str, set[str]] = {
    "segmentation": set(),
    "simulation": set(),
    "messages": {"segmentation"},
    "bag": {"messages", "segmentation"},
    "exports": {"segmentation"},
    "datasets": {"bag", "messages", "segmentation"},
    "learning": {"segmentation", "simulation"},
    "nodes": {"messages", "segmentation", "bag"},
    "view": {"messages", "segmentation"},
    "evaluation": {"bag", "datasets", "messages", "segmentation", "simulation"},
    "cli": set(ROOMS),
}


def imported(path: Path, at_run_time_of_module: bool = False) -> Iterator[str]:
    """Return the package's modules that a file imports, by their full names.

    :param at_run_time_of_module: leave out what functions import, and what only types need.
    """
    tree = ast.parse(path.read_text())
    nodes = tree.body if at_run_time_of_module else ast.walk(tree)
    here = ".".join(path.relative_to(ROOT).parent.parts)
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            module = f"{here}.{node.module}" if node.level else node.module or ""
            if module.startswith("turbseg_ros"):
                names = [f"{module}.{alias.name}" for alias in node.names]
                yield from (name if name in MODULES else module for name in names)


def room(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else None


def test_every_room_has_its_rule() -> None:
    assert set(ROOMS) == set(KNOWS)


@pytest.mark.parametrize("module", sorted(MODULES))
def test_a_module_imports_only_rooms_that_its_own_may_know(module: str) -> None:
    here = room(module)
    if here is None:
        pytest.skip("lies beside the rooms")
    known = {room(other) for other in imported(MODULES[module])} - {None, here}
    assert known <= KNOWS[here]


def test_modules_import_one_another_in_no_circle() -> None:
    imports = {
        module: {other for other in imported(path, at_run_time_of_module=True) if other != module}
        for module, path in MODULES.items()
    }
    while leaves := {module for module, others in imports.items() if not others & set(imports)}:
        imports = {m: others for m, others in imports.items() if m not in leaves}
    assert not imports


def test_the_method_is_one_page() -> None:
    assert len((PACKAGE / "segmentation" / "pipeline.py").read_text().splitlines()) <= 200


@pytest.mark.parametrize("equation", range(1, 10))
def test_each_equation_of_the_paper_is_named_where_it_is_computed(equation: int) -> None:
    docstrings = [
        ast.get_docstring(node) or ""
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    ]
    assert any(f"eq. {equation}" in docstring for docstring in docstrings)
