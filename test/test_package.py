"""What the package says of itself, in each of the files that say it, is the same."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from email import message_from_string

import pytest
import yaml

from support.paths import ROOT
from turbseg_ros import __version__

# What extras of setup.py bring, each told in one line where it is missing.
EXTRAS = {
    *("av", "distributed", "jinja2", "lz4", "mcap", "pyarrow", "rosbags", "zstandard"),
    *("onnx", "onnxscript", "safetensors", "torch", "torchvision", "vision_msgs"),
    "foxglove_msgs",
}
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())


@pytest.fixture(scope="module")
def metadata(tmp_path_factory):
    """What pip would be told, by `setup.py` with no package but setuptools to import."""
    folder = tmp_path_factory.mktemp("metadata")
    only_setuptools = (
        "import sys, setuptools; sys.modules.update(numpy=None, cv2=None, rclpy=None);"
        "sys.argv = ['setup.py', '-q', 'egg_info', '--egg-base', sys.argv[1]];"
        "exec(compile(open('setup.py').read(), 'setup.py', 'exec'))"
    )
    subprocess.run(
        [sys.executable, "-c", only_setuptools, str(folder)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": ""},
        timeout=60,
        check=True,
    )
    return message_from_string((folder / "turbseg_ros.egg-info" / "PKG-INFO").read_text())


def test_the_version_is_the_same_everywhere(metadata):
    assert metadata["Version"] == __version__
    assert MANIFEST.findtext("version") == __version__
    assert CITATION["version"] == __version__
    heads = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert heads[0] == __version__


def test_the_version_is_one_that_ros_takes():
    assert re.fullmatch(r"\d+\.\d+\.\d+", __version__)


def test_the_maintainer_can_be_written_to_at_one_address(metadata):
    maintainer = MANIFEST.find("maintainer")
    assert maintainer is not None
    address = maintainer.get("email", "")
    # What bloom and rosdep read: catkin_pkg's pattern. No mail goes to names under .invalid.
    assert re.fullmatch(
        r"[-a-zA-Z0-9_%+]+(\.[-a-zA-Z0-9_%+]+)*@[-a-zA-Z0-9%]+(\.[-a-zA-Z0-9%]+)*\.[a-zA-Z]{2,}",
        address,
    )
    assert not address.endswith(".invalid")
    assert metadata["Maintainer-email"] == address
    assert CITATION["authors"][0]["email"] == address


def test_addresses_of_the_project_are_of_every_kind_and_the_same(metadata):
    urls = {url.get("type"): url.text for url in MANIFEST.iter("url")}
    assert set(urls) == {"website", "repository", "bugtracker"}
    told = {metadata["Home-page"], *(p.split(", ")[1] for p in metadata.get_all("Project-URL"))}
    assert told == set(urls.values())
    assert CITATION["url"] == urls["website"]
    assert CITATION["repository-code"] == urls["repository"]


def test_the_long_description_is_the_readme(metadata):
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload().strip() == (ROOT / "README.md").read_text().strip()


def test_reading_a_bag_brings_nothing_but_mcap(metadata):
    extras: dict[str, set[str]] = {}
    for requirement in metadata.get_all("Requires-Dist"):
        found = re.match(r"([\w-]+).*extra == [\"'](\w+)[\"']", requirement)
        if found:
            extras.setdefault(found[2], set()).add(found[1])
    assert extras["bags"] == {"mcap"}
    assert extras["evaluation"] == {"jinja2"}
    assert extras["cluster"] == {"distributed"}


def test_bloom_finds_a_changelog_that_it_can_read() -> None:
    changelog = pytest.importorskip("catkin_pkg.changelog", reason="colcon is not installed")
    read = changelog.get_changelog_from_path(str(ROOT / "CHANGELOG.rst"), "turbseg_ros")
    heads = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert [version for version, *_ in read.foreach_version()] == heads[1:]
    assert "\nForthcoming\n" in (ROOT / "CHANGELOG.rst").read_text()


def test_rosdep_installs_all_that_is_imported_but_for_extras() -> None:
    keys = {element.text for element in MANIFEST.iter("exec_depend")}
    names = {"cv2": "python3-opencv", "yaml": "python3-yaml"}
    imported = set()
    for path in [*(ROOT / "turbseg_ros").rglob("*.py"), *(ROOT / "launch").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.partition(".")[0])
    others = imported - set(sys.stdlib_module_names) - {"turbseg_ros"}
    missing = {name for name in others if not {name, names.get(name, f"python3-{name}")} & keys}
    assert missing <= EXTRAS
    assert "rclpy" in others and "rclpy" not in missing


def test_the_paper_is_cited():
    (paper,) = CITATION["references"]
    assert paper["title"] == "Unsupervised Moving Object Segmentation with Atmospheric Turbulence"
    assert paper["authors"][0]["family-names"] == "Qin"
    assert paper["year"] == 2024 and "ECCV" in paper["conference"]["name"]
