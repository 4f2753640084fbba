"""What the documents say is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

from turbseg_ros.parameters import declarations, markdown_table

ROOT = Path(__file__).resolve().parent.parent


def test_readme_lists_every_parameter_as_declared() -> None:
    assert markdown_table() in (ROOT / "README.md").read_text()


def test_readme_names_only_parameters_that_exist() -> None:
    known = {declaration.name for declaration in declarations()}
    groups = {name.split(".")[0] for name in known if "." in name}
    named = set(re.findall(r"`([a-z_]+\.[a-z_0-9]+)", (ROOT / "README.md").read_text()))
    unknown = {name for name in named if name.split(".")[0] in groups} - known
    assert not unknown


def test_readme_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(((?!https?:)[^)]+)\)", (ROOT / "README.md").read_text())
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
