"""Executables where something they need is not installed: one line, and help all the same."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from turbseg_ros import __version__, dependencies
from turbseg_ros.dependencies import how_to_install, what_is_missing

TIME_LIMIT = 100

EXECUTABLES = (
    *("node", "play", "replay", "evaluate", "simulate", "import"),
    *("benchmark", "train", "demo", "stages", "real", "view"),
)
# Everything that is not Python's own.
ALL = (
    *("numpy", "scipy", "cv2", "yaml", "tqdm", "mcap", "zstandard", "lz4", "jinja2", "aiohttp"),
    *("distributed", "dask", "torch", "torchvision", "safetensors", "onnx", "onnxscript"),
    *("rclpy", "rosidl_runtime_py", "rosidl_parser", "launch", "launch_ros", "lark"),
    *("builtin_interfaces", "sensor_msgs", "std_msgs", "std_srvs", "visualization_msgs"),
    *("geometry_msgs", "diagnostic_msgs", "rcl_interfaces", "rosgraph_msgs"),
)
# Runs an executable while modules can't be imported: those named, comma-separated, first.
WITHOUT = """
import sys


missing = sys.argv.pop(1).split(",")

class Nowhere:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nowhere())
from turbseg_ros.cli.__main__ import main
sys.exit(main())
"""
METHOD = ("numpy", "cv2", "scipy")
BAGS = ("mcap", "zstandard", "rclpy", "yaml")
NEEDED = {
    ("node",): ("rclpy", "sensor_msgs", "diagnostic_msgs", *METHOD),
    ("play", "x"): BAGS,
    ("replay", "x", "-o", "y"): (*BAGS, *METHOD, "sensor_msgs"),
    ("replay", "x", "-o", "y", "--params-file", "z"): ("yaml",),
    ("evaluate", "x"): (*BAGS, *METHOD, "tqdm"),
    ("evaluate", "x", "--report", "y"): ("jinja2",),
    ("evaluate", "x", "--scheduler", "tcp://127.0.0.1:9"): ("distributed",),
    ("simulate", "--list"): ("numpy", "cv2", "scipy"),
    ("simulate", "--scene", "normal", "-o", "y"): ("mcap", "rclpy", "sensor_msgs"),
    ("import", "x", "y"): ("mcap", "rclpy", "sensor_msgs", "numpy", "cv2"),
    ("benchmark",): (*METHOD, "tqdm"),
    ("train", "-o", "y"): ("torch", "cv2", "numpy"),
    ("demo", "--bag", "x"): (*BAGS, *METHOD, "tqdm"),
    ("stages", "x", "-o", "y.png"): (*BAGS, *METHOD),
    ("view",): (
        "aiohttp",
        "rclpy",
        "sensor_msgs",
        "diagnostic_msgs",
        "rcl_interfaces",
        "yaml",
        "cv2",
    ),
}
CASES = [(call, module) for call, modules in NEEDED.items() for module in dict.fromkeys(modules)]


def run_without(modules: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, modules, *arguments],
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        cwd=folder,
        check=False,
    )


@pytest.mark.parametrize("name", EXECUTABLES)
def test_help_needs_nothing_but_python(name: str, tmp_path: Path) -> None:
    process = run_without(",".join(ALL), name, "--help", folder=tmp_path)
    assert (process.stderr, process.returncode) == ("", 0)
    assert process.stdout.startswith("usage: ")


@pytest.mark.parametrize("name", EXECUTABLES)
def test_every_executable_tells_its_version(name: str, tmp_path: Path) -> None:
    process = run_without(",".join(ALL), name, "--version", folder=tmp_path)
    assert (process.stderr, process.returncode) == ("", 0)
    assert process.stdout.split()[-1] == __version__
    assert process.stdout.count("\n") == 1


@pytest.mark.parametrize(
    ("call", "module"), CASES, ids=[f"{' '.join(call)}-{module}" for call, module in CASES]
)
def test_what_is_missing_is_said_in_one_line(
    call: tuple[str, ...], module: str, tmp_path: Path
) -> None:
    process = run_without(module, *call, folder=tmp_path)
    assert process.returncode == 2, process.stderr
    # Without NumPy, OpenCV speaks up, too.
    assert process.stdout == "" or module == "numpy"
    (line,) = process.stderr.splitlines()
    assert line.split(":")[0] in (f"turbseg_{call[0]}", call[0])
    assert line.endswith(how_to_install(module))


@pytest.fixture
def system_python(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The Python of Debian 12 or Ubuntu 24.04, as far as can be seen from inside."""
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    monkeypatch.setattr(sysconfig, "get_path", lambda _name: str(tmp_path))
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    return tmp_path


def test_a_system_that_looks_after_its_python_gets_a_command_that_it_takes(system_python):
    pip = "/usr/bin/python3 -m pip install --user --break-system-packages"
    assert how_to_install("mcap") == f"{pip} mcap"
    assert how_to_install("torch") == f"{pip} torch torchvision"
    assert how_to_install("cv2") == "sudo apt install python3-opencv"
    assert how_to_install("jinja2") == "sudo apt install python3-jinja2"


def test_elsewhere_a_plain_pip_does(system_python):
    (system_python / "EXTERNALLY-MANAGED").unlink()
    assert how_to_install("cv2") == "/usr/bin/python3 -m pip install opencv-python-headless"


def test_a_virtual_environment_gets_its_own_pip(system_python, monkeypatch):
    monkeypatch.setattr(sys, "prefix", "/home/me/environment with space")
    monkeypatch.setattr(sys, "executable", f"{sys.prefix}/bin/python")
    assert how_to_install("mcap") == f"'{sys.prefix}/bin/python' -m pip install mcap"


def test_ros_is_sourced_where_it_lies_or_completed_where_it_is_sourced(tmp_path, monkeypatch):
    monkeypatch.setattr(dependencies, "_ROS_FOLDER", tmp_path)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert "pip install ros-jazzy-rclpy" in how_to_install("rclpy")
    (tmp_path / "jazzy").mkdir()
    (tmp_path / "jazzy" / "setup.bash").touch()
    assert how_to_install("rclpy") == f". {tmp_path}/jazzy/setup.bash"
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert how_to_install("sensor_msgs") == "sudo apt install ros-jazzy-sensor-msgs"


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (
            ModuleNotFoundError(
                "No module named 'rclpy._rclpy_pybind11'\nThe C extension ...",
                name="rclpy._rclpy_pybind11",
            ),
            "rclpy, which is part of ROS 2, can't be loaded by Python ",
        ),
        (
            ImportError("libGL.so.1: cannot open shared object file", name="cv2"),
            "(libGL.so.1: cannot open shared object file)",
        ),
    ],
    ids=["another Python's", "a library is missing"],
)
def test_what_is_there_but_can_not_be_loaded_is_told_apart(error, reason):
    line = what_is_missing(error)
    assert line is not None
    assert reason in line and "\n" not in line


def test_a_module_of_the_package_itself_that_is_missing_stays_an_exception():
    assert what_is_missing(ModuleNotFoundError("x", name="turbseg_ros.nowhere")) is None
    assert what_is_missing(ImportError("x")) is None
