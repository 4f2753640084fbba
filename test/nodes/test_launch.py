"""Launch files and viewer set-ups; the launch package is only there on a ROS machine."""

import json
import os
import re
import subprocess
import sys

import pytest
import yaml

from support.paths import ROOT
from turbseg_ros.messages.results import CentroidMarkers, outputs, views

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


TOPICS = {f"/turbseg/{output.name}" for output in (*outputs(1, CentroidMarkers()), *views())}


def test_the_foxglove_layout_shows_topics_that_exist():
    layout = json.loads((ROOT / "config" / "turbseg_foxglove.json").read_text())
    text = json.dumps(layout["configById"])
    shown = set(re.findall(r'"(/[a-z_/]+)"', text))
    assert shown - TOPICS == {"/image_raw", "/camera_info", "/diagnostics"}
    assert {"/turbseg/overlay", "/turbseg/centroids", "/turbseg/annotations"} <= shown
    placed = set(re.findall(r'"(\w+![a-z]+)"', json.dumps(layout["layout"])))
    assert placed == set(layout["configById"])


def test_fast_dds_takes_the_profile_for_large_images(tmp_path):
    profile = ROOT / "config" / "fastdds_large_images.xml"
    program = "import rclpy; rclpy.init(); rclpy.create_node('n').destroy_node(); rclpy.shutdown()"
    finished = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert "XMLPARSER" not in finished.stdout + finished.stderr


def test_the_rviz_configuration_shows_topics_that_exist():
    configuration = yaml.safe_load((ROOT / "config" / "turbseg.rviz").read_text())
    shown = [display["Topic"] for display in configuration["Visualization Manager"]["Displays"]]
    assert shown
    assert {topic["Value"] for topic in shown} <= TOPICS
