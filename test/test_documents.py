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


# A path that is looked for where a command runs.
RELATIVE = re.compile(r"(?<![\w/)])(?:bags|config|docs)/[\w./]*")


def test_readme_commands_find_their_files_where_it_says_they_run() -> None:
    text = (ROOT / "README.md").read_text().replace("\\\n", " ")
    code = re.findall(r"^ *((?:turbseg_|python -m |ros2 |rviz2 ).*)$", text, re.M)
    code += re.findall(r"`((?:turbseg_|python -m |ros2 )[^`]*)`", text)
    workspace = [line for line in code if line.startswith("ros2") or line.startswith("rviz2")]
    named = [path for line in code if line not in workspace for path in RELATIVE.findall(line)]
    assert workspace and named
    assert [path for path in named if not (ROOT / path).exists()] == []
    assert [line for line in workspace if RELATIVE.search(line)] == []


def test_readme_says_where_commands_run_before_the_first_that_needs_it() -> None:
    text = (ROOT / "README.md").read_text()
    rule = text.index("run in the folder of this clone, after `. .venv/bin/activate`")
    assert rule < text.index("ros2 run") and rule < text.index("turbseg_play")


def test_readme_installs_nothing_by_a_command_that_system_pythons_refuse() -> None:
    installing = re.findall(r"pip install[^\n`]*", (ROOT / "README.md").read_text())
    assert [command for command in installing if command.strip() != "pip install"]
    for command in installing:
        assert "--user --break-system-packages" in command or command.strip() == "pip install"


def test_executables_that_the_readme_names_are_installed() -> None:
    named = set(re.findall(r"\bturbseg_([a-z]+)\b", (ROOT / "README.md").read_text()))
    parsers = {path.stem.rstrip("_") for path in (ROOT / "turbseg_ros/cli/parsers").glob("*.py")}
    assert named - parsers == {"ros", "foxglove"}
