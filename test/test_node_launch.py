"""Launch files and viewer set-ups; the launch package is only there on a ROS machine."""

from pathlib import Path

import pytest
import yaml

from turbseg_ros.ros.messages import CentroidMarkers, outputs, views

ROOT = Path(__file__).parents[1]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))


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


def test_the_rviz_configuration_shows_topics_that_exist():
    configuration = yaml.safe_load((ROOT / "config" / "turbseg.rviz").read_text())
    topics = {f"/turbseg/{output.name}" for output in (*outputs(0, CentroidMarkers()), *views())}
    shown = [display["Topic"] for display in configuration["Visualization Manager"]["Displays"]]
    assert shown
    assert {topic["Value"] for topic in shown} <= topics
