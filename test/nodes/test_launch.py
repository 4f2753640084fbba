"""Launch files and viewer set-ups; the launch package is only there on a ROS machine."""

import json
import os
import re
import subprocess
import sys
import types
from typing import Any

import pytest
import yaml

from support.drawn_bag import write_drawn_bag
from support.node_harness import SECOND
from support.paths import CONFIG, ROOT
from support.result_topics import fresh_outputs
from support.stub_segmenter import StubSegmenter
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli import __main__ as cli
from turbseg_ros.cli import replay
from turbseg_ros.messages.results import views
from turbseg_ros.parameters import Parameters

LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))
# What has no default.
CAMERAS = {"cameras.launch.py": {"cameras": "north"}}


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_files_describe_what_they_start(path):
    pytest.importorskip("launch_ros")
    content: dict[str, Any] = {}
    exec(compile(path.read_text(), path, "exec"), content)
    assert content["generate_launch_description"]().entities


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_files_compile_and_define_the_entry_point(path):
    code = compile(path.read_text(), path, "exec")
    assert "generate_launch_description" in code.co_names


# What a node in its default names publishes.
LIVE = {f"/turbseg/{output.name}" for output in (*fresh_outputs(1), *views())}
LIVE |= {"/diagnostics"}


@pytest.fixture
def replayed(tmp_path, monkeypatch):
    """What gives the topics of a bag that turbseg_replay writes."""
    monkeypatch.setattr(replay, "clip_segmenter", lambda parameters, _: StubSegmenter(parameters))
    bag = write_drawn_bag(tmp_path / "bag", [SECOND, 2 * SECOND])

    def topics(*options):
        out = tmp_path / "-".join(["replayed", *options])
        assert replay.main([str(bag), "-o", str(out), *options]) == 0
        return {name for name, topic in BagReader(out).topics.items() if topic.message_count}

    return topics


def foxglove_panels():
    """Return the topics that each panel shows, by its title."""
    layout = json.loads((CONFIG / "turbseg_foxglove.json").read_text())
    placed = set(re.findall(r'"(\w+![a-z]+)"', json.dumps(layout["layout"])))
    assert placed == set(layout["configById"])
    return {
        panel["foxglovePanelTitle"]: set(re.findall(r'"(/[^"]+)"', json.dumps(panel)))
        for panel in layout["configById"].values()
    }


def rviz_displays():
    """Return the topics that each display shows, by its name."""
    manager = yaml.safe_load((CONFIG / "turbseg.rviz").read_text())["Visualization Manager"]
    return {display["Name"]: {display["Topic"]["Value"]} for display in manager["Displays"]}


@pytest.mark.parametrize("layout", [foxglove_panels, rviz_displays])
def test_layouts_show_what_nodes_publish_and_result_bags_hold(layout, replayed):
    shown = layout()
    assert all(topics and topics <= LIVE for topics in shown.values()), shown
    bag = replayed()
    assert {name for name, topics in shown.items() if not topics <= bag} == {
        name for name in shown if name.endswith("(bags: --views overlay)")
    }
    assert set().union(*shown.values()) <= replayed("--views", "overlay")


class StandIn:
    """A launch argument's value, as the stand-ins for the launch packages have it."""

    def __init__(self, value):
        self.value = value

    def perform(self, _context):
        return self.value

    def __eq__(self, other):
        return self.value == other

    def __hash__(self):
        return hash(self.value)


class Launched:
    """What a launch file declares and starts, of stand-ins for the launch packages."""

    def __init__(self):
        self.arguments: dict[str, object] = {}
        self.descriptions: dict[str, str] = {}
        self.nodes: list[dict[str, object]] = []
        self.included: list[tuple[str, dict[str, str]]] = []


def launched(path, monkeypatch, **arguments):
    """Run a launch file with stand-ins for the launch packages."""
    what = Launched()
    defaults = what.arguments

    def declare(name, default_value="", description=""):
        if isinstance(default_value, list):
            default_value = "".join(getattr(part, "value", part) for part in default_value)
        defaults[name] = arguments.get(name, default_value)
        what.descriptions[name] = description

    def include(source, launch_arguments):
        what.included.append((source, dict(launch_arguments)))

    launch, ros = types.ModuleType("launch"), types.ModuleType("launch_ros")
    modules = {
        "launch": launch,
        "launch.actions": types.SimpleNamespace(
            DeclareLaunchArgument=declare,
            OpaqueFunction=lambda function: function(None),
            IncludeLaunchDescription=include,
        ),
        "launch.launch_description_sources": types.SimpleNamespace(
            PythonLaunchDescriptionSource=lambda parts: "".join(map(str, parts))
        ),
        "launch.substitutions": types.SimpleNamespace(
            LaunchConfiguration=lambda name: StandIn(defaults[name]),
            PathJoinSubstitution="/".join,
            ThisLaunchFileDir=lambda: str(path.parent),
        ),
        "launch_ros": ros,
        "launch_ros.actions": types.SimpleNamespace(Node=lambda **given: what.nodes.append(given)),
        "launch_ros.substitutions": types.SimpleNamespace(FindPackageShare=str),
    }
    launch.__dict__["LaunchDescription"] = list
    launch.__dict__["LaunchContext"] = object
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    content: dict[str, Any] = {}
    exec(compile(path.read_text(), path, "exec"), content)
    content["generate_launch_description"]()
    assert set(arguments) <= set(defaults)
    return what


def launched_node(path, monkeypatch, **arguments):
    """Return the node that a launch file starts."""
    (node,) = launched(path, monkeypatch, **arguments).nodes
    return node


def test_launch_files_name_what_there_is(monkeypatch):
    what = launched(ROOT / "launch" / "turbseg.launch.py", monkeypatch, transport="x", regions="y")
    (node,) = what.nodes
    assert node["package"] == "turbseg_ros"
    assert callable(getattr(cli, str(node["executable"]).removeprefix("turbseg_")))
    _, given = node["parameters"]
    assert set(given) - {"use_sim_time"} <= set(Parameters().as_mapping())
    presets = what.descriptions["preset"].partition(": ")[2].rstrip(".").split(", ")
    assert len(presets) > 2
    assert all((CONFIG / f"{name}.yaml").is_file() for name in [*presets, "live"])


def test_each_camera_gets_a_node_in_its_namespace(monkeypatch):
    launch_file = ROOT / "launch" / "cameras.launch.py"
    what = launched(launch_file, monkeypatch, cameras="north, south,")
    one = str(ROOT / "launch" / "turbseg.launch.py")
    assert what.included == [(one, {"namespace": "north"}), (one, {"namespace": "south"})]
    declared = launched(ROOT / "launch" / "turbseg.launch.py", monkeypatch).arguments
    assert "namespace" in declared


def test_documents_launch_with_arguments_that_there_are(monkeypatch):
    documents = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    lines = "\n".join(path.read_text() for path in documents).replace("\\\n", " ")
    commands = re.findall(r"^ros2 launch turbseg_ros (\S+)(.*)$", lines, re.M)
    assert len(commands) > 2
    for name, rest in commands:
        declared = launched(ROOT / "launch" / name, monkeypatch, **CAMERAS.get(name, {})).arguments
        assert set(re.findall(r"(\w+):=", rest)) <= set(declared), rest


def test_the_launch_file_remaps_no_camera_info_by_default(monkeypatch):
    node = launched_node(ROOT / "launch" / "turbseg.launch.py", monkeypatch)
    # A name remapped to itself leaves it to the node, which looks beside the image topic.
    assert ("camera_info", "camera_info") in node["remappings"]
    assert {name for name, _ in node["remappings"]} == {"image_raw", "camera_info"}


def test_the_launch_file_takes_a_preset_by_name_and_sets_what_is_given(monkeypatch):
    path = ROOT / "launch" / "turbseg.launch.py"
    live, others = launched_node(path, monkeypatch)["parameters"]
    assert live == "turbseg_ros/config/live.yaml"
    assert others == {"use_sim_time": "false"}
    node = launched_node(
        path, monkeypatch, preset="severe", transport="compressed", regions="/r.yaml"
    )
    severe, others = node["parameters"]
    assert severe == "turbseg_ros/config/severe.yaml"
    assert others.keys() == {"use_sim_time", "image_transport", "regions.file"}
    assert (others["image_transport"], others["regions.file"]) == ("compressed", "/r.yaml")
    assert node["ros_arguments"] == ["--log-level", "info"]
    own = launched_node(path, monkeypatch, params_file="/own.yaml")
    assert own["parameters"][0] == "/own.yaml"


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
