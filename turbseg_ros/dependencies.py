"""What the package needs from elsewhere: how a missing piece is named, and what installs it."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import sysconfig
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_ROS_FOLDER = Path("/opt/ros")


@dataclass(frozen=True)
class _Package:
    """A package as pip and, where Debian and Ubuntu have it, apt call it."""

    purpose: str
    pip: Sequence[str]
    apt: str | None = None


_MCAP = _Package("reads and writes bags", ["mcap"])
_LEARNING = _Package("runs and trains networks", ["torch", "torchvision"])
_EXPORT = _Package("writes trained networks", ["safetensors", "onnx", "onnxscript"])
_ROS = _Package(
    "is part of ROS 2",
    [
        "ros-jazzy-rclpy",
        "ros-jazzy-common-interfaces",
        "ros-jazzy-rmw-fastrtps-cpp",
        "ros-wheels-bootstrapper",
    ],
)
_PACKAGES = {
    "numpy": _Package("holds images", ["numpy"], "python3-numpy"),
    "scipy": _Package("is needed for the method", ["scipy"], "python3-scipy"),
    "cv2": _Package("is OpenCV", ["opencv-python-headless"], "python3-opencv"),
    "cv2.bgsegm": _Package(
        "has OpenCV's contrib modules", ["opencv-contrib-python-headless"], "python3-opencv"
    ),
    "yaml": _Package("reads parameter files", ["PyYAML"], "python3-yaml"),
    "tqdm": _Package("shows progress", ["tqdm"], "python3-tqdm"),
    "mcap": _MCAP,
    "zstandard": _MCAP,
    "lz4": _MCAP,
    "rosbags": _Package("reads bags in SQLite and of ROS 1", ["rosbags"]),
    "av": _Package("decodes and encodes video", ["av"], "python3-av"),
    "pyarrow": _Package("writes Parquet", ["pyarrow"]),
    "jinja2": _Package("writes reports and curves", ["jinja2"], "python3-jinja2"),
    "distributed": _Package("talks to Dask's scheduler", ["distributed"]),
    "aiohttp": _Package("serves the page", ["aiohttp"], "python3-aiohttp"),
    "torch": _LEARNING,
    "torchvision": _LEARNING,
    "safetensors": _EXPORT,
    "onnx": _EXPORT,
    "onnxscript": _EXPORT,
    **dict.fromkeys(
        (
            "builtin_interfaces",
            "diagnostic_msgs",
            "geometry_msgs",
            "rcl_interfaces",
            "rclpy",
            "rosgraph_msgs",
            "rosidl_runtime_py",
            "sensor_msgs",
            "std_msgs",
            "std_srvs",
            "visualization_msgs",
        ),
        _ROS,
    ),
}


def how_to_install(module: str) -> str:
    """Return the command that installs what brings a module along, for the Python at work.

    :raises KeyError: when nothing is known of the module.
    """
    package = _PACKAGES[module]
    if package is _ROS and (command := _ros_command(module)):
        return command
    if package.apt and _is_the_systems() and shutil.which("apt-get"):
        return f"sudo apt install {package.apt}"
    return pip_command(package.pip)


def pip_command(requirements: Sequence[str]) -> str:
    """Return the pip command by which the Python at work gets requirements.

    The Python of Debian 12, Ubuntu 24.04 and later refuses a plain one (PEP 668). A virtual
    environment is no way out for what `ros2 run` starts, which is tied to the Python that built
    it. So what goes there goes to the user's own folder, beside what the system has.
    """
    options = ["--user", "--break-system-packages"] if _is_the_systems() else []
    return shlex.join([sys.executable, "-m", "pip", "install", *options, *requirements])


def what_is_missing(error: ImportError) -> str | None:
    """Return one line on a module that can't be imported: which, what for, what installs it.

    None if it is none that a user would install.
    """
    module = (error.name or "").partition(".")[0]
    if module not in _PACKAGES:
        return None
    what = f"{module}, which {_PACKAGES[module].purpose}"
    if isinstance(error, ModuleNotFoundError) and error.name == module:
        return f"{what}, is missing: {how_to_install(module)}"
    version = ".".join(map(str, sys.version_info[:2]))
    reason = str(error).partition("\n")[0]
    return f"{what}, can't be loaded by Python {version} ({reason}): {how_to_install(module)}"


def _ros_command(module: str) -> str | None:
    """Return how a module of ROS 2 is had where ROS 2 is installed; None where it isn't."""
    distribution = os.environ.get("ROS_DISTRO")
    if distribution and (_ROS_FOLDER / distribution).is_dir():
        return f"sudo apt install ros-{distribution}-{module.replace('_', '-')}"
    installed = sorted(_ROS_FOLDER.glob("*/setup.bash"))
    return f". {installed[0]}" if installed else None


def _is_the_systems() -> bool:
    """Whether the Python at work is the system's, which its package manager looks after."""
    in_environment = sys.prefix != sys.base_prefix
    marker = Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED")
    return not in_environment and marker.exists()
