"""What the documents say is what the code does."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import turbseg_ros
from turbseg_ros.factory import strategies
from turbseg_ros.parameters import Parameters, declarations, markdown_table

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
# What was is named as it was.
PRESENT = [path for path in DOCUMENTS if path.name != "CHANGELOG.md"]
CONFIGS = sorted((ROOT / "config").glob("*.yaml"))
ROOMS = sorted(path.parent.name for path in (ROOT / "turbseg_ros").glob("*/__init__.py"))

each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
each_present = pytest.mark.parametrize("document", PRESENT, ids=lambda path: path.name)


def prose(document: Path) -> str:
    """Return a document without its blocks of code, which hold what commands print."""
    text = re.sub(r"^ *```.*?^ *```$", "", document.read_text(), flags=re.M | re.S)
    return re.sub(r"^    .*$", "", text, flags=re.M)


def test_the_readme_is_one_that_is_read() -> None:
    assert len(README.read_text().splitlines()) <= 120


@each_document
def test_lines_fit_a_window(document: Path) -> None:
    lines = prose(document).splitlines()
    assert [line for line in lines if len(line) > 120 and not line.startswith("|")] == []


@each_document
def test_figures_have_a_digit_before_the_point(document: Path) -> None:
    assert re.findall(r"(?<![\w./)\]])\.\d+.*", document.read_text()) == []


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.name)
def test_figures_in_presets_have_a_digit_before_the_point(config: Path) -> None:
    assert re.findall(r"(?<![\w./])\.\d+.*", config.read_text()) == []


def test_every_parameter_is_listed_as_declared() -> None:
    assert markdown_table() in (ROOT / "docs/parameters.md").read_text()


@each_present
def test_only_parameters_that_exist_are_named(document: Path) -> None:
    known = {declaration.name for declaration in declarations()}
    groups = {name.split(".")[0] for name in known if "." in name}
    named = set(re.findall(r"`([a-z_]+\.[a-z_0-9]+)(?=[`: ])", document.read_text()))
    named = {name for name in named if not name.endswith((".py", ".md", ".yaml", ".rviz"))}
    assert {name for name in named if name.split(".")[0] in groups} - known == set()


def anchors(document: Path) -> set[str]:
    """Return the anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(), re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each_document
def test_links_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\(((?!https?:)[^)]+)\)", document.read_text())
    broken = []
    for link in links:
        path, _, anchor = link.partition("#")
        target = document.parent / path if path else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def test_the_readme_leads_to_every_document() -> None:
    linked = set(re.findall(r"\]\(([^)#]+\.md)", README.read_text()))
    others = {str(path.relative_to(ROOT)) for path in DOCUMENTS} - {"README.md"}
    assert others - linked == set()


def test_the_readmes_results_are_those_of_the_accuracys_page() -> None:
    rows = re.findall(
        r"^\| (?:real|rendered|the same)\b.*\(([^()]+)\) \| (.+) \|$", README.read_text(), re.M
    )
    assert len(rows) > 3
    lines = [line.strip() for line in (ROOT / "docs" / "accuracy.md").read_text().splitlines()]
    for names, cells in rows:
        columns = [cell.split("; ") for cell in cells.split(" | ") if cell != "-"]
        for number, name in enumerate(names.split("; ")):
            values = {column[number] for column in columns}
            known = [set(line.split()) for line in lines if line.startswith(f"{name}  ")]
            assert any(values <= row for row in known), (name, values)


# A file as a path of this repository, or by its last part alone.
FILE = re.compile(
    r"(?<![\w./~$})<>-])(?:[\w.-]+/)*[\w-]+\.(?:py|md|yaml|xml|rviz|onnx|safetensors)\b"
)
# What commands write, and what belongs to the reader, a bag or rosbag2.
OTHERS = {
    *("cameras.yaml", "regions.yaml", "metadata.yaml", "policy.xml"),
    *("mine/__init__.py", "mine/scorers.py"),
}


@functools.cache
def files() -> frozenset[str]:
    """Return all files of the repository's folders, by their paths and every end of these."""
    tops = ("turbseg_ros", "test", "docs", "config", "launch", "bags")
    paths = [path for top in tops for path in (ROOT / top).rglob("*")] + list(ROOT.iterdir())
    ends = set()
    for path in paths:
        parts = path.relative_to(ROOT).parts
        ends |= {"/".join(parts[start:]) for start in range(len(parts))}
    return frozenset(ends)


@each_present
def test_files_that_are_named_exist(document: Path) -> None:
    text = re.sub(r"\]\([^)]*\)", "]", document.read_text())
    named = {name for name in FILE.findall(text) if not name.startswith("out/")} - OTHERS
    assert named - files() == set()


def module_names(module: Path) -> set[str]:
    """Return what a module defines, methods as `Class.method`; it need not be importable here."""
    names = set()
    for node in ast.parse(module.read_text()).body:
        if isinstance(node, ast.ClassDef):
            methods = [part for part in node.body if isinstance(part, ast.FunctionDef)]
            names |= {f"{node.name}.{method.name}" for method in methods}
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


CODE = re.compile(rf"`((?:{'|'.join(ROOMS)})\.[a-z_]+)(?:\.([A-Za-z_.]+))?`")


@each_present
def test_code_that_is_named_is_there(document: Path) -> None:
    missing = []
    for module, name in CODE.findall(document.read_text()):
        path = (ROOT / "turbseg_ros" / module.replace(".", "/")).with_suffix(".py")
        if not path.is_file() or (name and name not in module_names(path)):
            missing.append(f"{module}.{name}")
    assert missing == []


def test_the_papers_equations_all_have_their_code() -> None:
    text = (ROOT / "docs/method.md").read_text()
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("| eq. ")]
    found = {
        int(n)
        for paper, code in rows
        if CODE.search(code)
        for n in re.findall(r"\b\d\b", paper.split(":")[0])
    }
    assert found == set(range(1, 10))


def test_the_reference_is_built_without_a_warning(tmp_path: Path) -> None:
    command = ["-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    run = subprocess.run(
        [sys.executable, *command, str(ROOT / "docs" / "api"), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=180,
    )
    assert (run.returncode, run.stderr) == (0, "")
    page = (tmp_path / "index.html").read_text()
    for name in turbseg_ros.__all__:
        assert f"turbseg_ros.{name}" in page


def test_the_threads_that_are_drawn_are_those_that_the_code_starts() -> None:
    drawn = set(re.findall(r"┌─ (\w+) ", (ROOT / "CONTRIBUTING.md").read_text()))
    sources = "".join(
        (ROOT / "turbseg_ros" / room / name).read_text()
        for room, name in (
            ("nodes", "subscription.py"),
            ("nodes", "worker.py"),
            ("segmentation", "motion_segmenter.py"),
            ("segmentation", "flow.py"),
            ("cli", "node.py"),
        )
    )
    started = set(re.findall(r'(?:\bname|thread_name_prefix)="(\w+)"', sources))
    assert drawn == started | {"main"}


def test_the_example_of_an_own_strategy_can_be_had(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = re.findall(
        r"^ *```python\n(.*?)^ *```$", (ROOT / "CONTRIBUTING.md").read_text(), re.M | re.S
    )
    (tmp_path / "documented_scorers.py").write_text(textwrap.dedent(example))
    monkeypatch.syspath_prepend(str(tmp_path))
    name = "documented_scorers:Saliency"
    chosen = strategies(Parameters().replace({"motion.measure": name, "refine.mode": "none"}))
    assert type(chosen.measure).__name__ == "Saliency"
    chosen.flow.close()


# A path that is looked for where a command runs.
RELATIVE = re.compile(r"(?<![\w/)])(?:bags|config|docs)/[\w./]*")


def commands(document: Path) -> list[str]:
    text = document.read_text().replace("\\\n", " ")
    code = re.findall(r"^ *((?:turbseg_|python -m |ros2 |rviz2 ).*)$", text, re.M)
    return code + re.findall(r"`((?:turbseg_|python -m |ros2 |rviz2 )[^`]*)`", text)


@each_present
def test_commands_find_their_files_where_the_readme_says_they_run(document: Path) -> None:
    code = commands(document)
    workspace = [line for line in code if line.startswith(("ros2", "rviz2"))]
    named = [path for line in code if line not in workspace for path in RELATIVE.findall(line)]
    assert [path for path in named if not list(ROOT.glob(path)) and path != "bags/"] == []
    # These run in any folder.
    assert [line for line in workspace if RELATIVE.search(line)] == []


def test_readme_says_where_commands_run_before_the_first_that_needs_it() -> None:
    text = " ".join(README.read_text().split())
    rule = text.index("run in the folder of this clone, after `. .venv/bin/activate`")
    assert rule < text.index("ros2 run turbseg_ros turbseg_node") < text.index("turbseg_play")


def test_nothing_is_installed_by_a_command_that_system_pythons_refuse() -> None:
    installing = [
        command
        for document in DOCUMENTS
        for command in re.findall(r"pip install[^\n`]*", document.read_text())
        if command.strip() != "pip install"
    ]
    assert installing
    assert [
        c for c in installing if "--user --break-system-packages" not in c and "(PEP" not in c
    ] == []


@each_document
def test_executables_that_are_named_are_installed(document: Path) -> None:
    named = set(re.findall(r"\bturbseg_([a-z]+)\b(?!\.)", document.read_text()))
    parsers = {path.stem.rstrip("_") for path in (ROOT / "turbseg_ros/cli/parsers").glob("*.py")}
    assert named - parsers <= {"ros", "foxglove"}
