"""What starts the node on somebody's machine: systemd's unit, the container's file and compose."""

from __future__ import annotations

import configparser
import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from support.paths import CONFIG, ROOT
from turbseg_ros import presets
from turbseg_ros.cli.parsers.node import build_parser

UNIT = CONFIG / "turbseg.service"


def assert_taken(words: list[str]) -> None:
    """Check that a command line is one that the node takes."""
    ours, ros = words, []
    if "--ros-args" in words:
        place = words.index("--ros-args")
        ours, ros = words[:place], words[place + 1 :]
    options = build_parser().parse_args(ours)
    assert options.preset is None or presets.config_path(f"{options.preset}.yaml").is_file()
    assert all(re.fullmatch(r"-[rp]|[\w/.]+:=[\w/.]+", word) for word in ros), ros


def test_the_unit_starts_the_node_and_gives_up_at_a_mistake() -> None:
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]  # names keep their case
    unit.read_string(UNIT.read_text().replace("\\\n", " "))
    _, _, started = shlex.split(unit["Service"]["ExecStart"])
    command = shlex.split(started.rpartition("exec ")[2])
    assert command[:4] == ["ros2", "run", "turbseg_ros", "turbseg_node"]
    assert_taken(command[4:])
    assert unit["Service"]["RestartPreventExitStatus"] == "2"
    assert unit["Service"]["KillSignal"] in ("SIGINT", "SIGTERM")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd")
def test_systemd_takes_the_unit() -> None:
    verified = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(UNIT)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert str(UNIT) not in verified.stdout + verified.stderr
    assert verified.returncode == 0


def test_the_container_builds_this_package_and_starts_the_node() -> None:
    lines = (ROOT / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    steps = dict(line.split(" ", 1) for line in lines if re.match("[A-Z]+ ", line))
    assert steps["FROM"] == "ros:jazzy-ros-base"
    source, inside = steps["COPY"].split()
    assert (source, Path(inside).parent) == (".", Path(steps["WORKDIR"]) / "src")
    assert "colcon build --packages-select turbseg_ros" in steps["RUN"]
    shell, flag, script, _ = json.loads(steps["ENTRYPOINT"])
    assert (shell, flag) == ("/bin/bash", "-c")
    # Where colcon puts executables, as setup.cfg says.
    assert "install_scripts=$base/lib/turbseg_ros" in (ROOT / "setup.cfg").read_text()
    assert script.endswith('exec install/turbseg_ros/lib/turbseg_ros/turbseg_node "$@"')


def test_compose_builds_that_container_and_gives_the_node_what_it_takes() -> None:
    (service,) = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"].values()
    assert (ROOT / service["build"] / "Dockerfile").is_file()
    assert_taken(service["command"])
    assert (service["network_mode"], service["ipc"], service["init"]) == ("host", "host", True)


def test_what_was_built_elsewhere_stays_out_of_the_container() -> None:
    left_out = set((ROOT / ".dockerignore").read_text().split())
    assert {".git", ".venv", "out", "build", "install", "log"} <= left_out
