"""The launch files; the launch package itself is only there on a ROS machine."""

from pathlib import Path

import pytest

LAUNCH_FILES = sorted((Path(__file__).parents[1] / "launch").glob("*.launch.py"))


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_files_describe_what_they_start(path):
    pytest.importorskip("launch_ros")
    content: dict[str, object] = {}
    exec(compile(path.read_text(), path, "exec"), content)
    assert content["generate_launch_description"]().entities


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_files_compile_and_define_the_entry_point(path):
    code = compile(path.read_text(), path, "exec")
    assert "generate_launch_description" in code.co_names
