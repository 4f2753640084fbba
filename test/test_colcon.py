"""The package as colcon builds it, and the executable where `ros2 run` looks for it."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support.node_harness import NodeProcess, Probe

SOURCE = Path(__file__).parents[1]
NOT_SOURCE = shutil.ignore_patterns(
    ".*", "__pycache__", "*.egg-info", "bags", "build", "install", "log", "out", "test"
)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colcon workspace with the package built in it."""
    colcon = Path(sys.executable).with_name("colcon")
    if not colcon.exists():
        pytest.skip("colcon is not in this environment (make venv installs it)")
    workspace = tmp_path_factory.mktemp("workspace")
    shutil.copytree(SOURCE, workspace / "src" / "turbseg_ros", ignore=NOT_SOURCE)
    build = subprocess.run(
        [colcon, "build", "--event-handlers", "console_direct+"],
        cwd=workspace,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert build.returncode == 0, build.stdout + build.stderr
    return workspace


def test_executables_lie_where_ros2_run_looks(workspace):
    installed = workspace / "install" / "turbseg_ros"
    executables = {path.name for path in (installed / "lib" / "turbseg_ros").iterdir()}
    assert {"turbseg_node", "turbseg_play", "turbseg_replay", "turbseg_view"} <= executables
    page = {path.name for path in installed.rglob("view/page/*")}
    assert page == {"index.html", "view.css", "view.js"}
    share = installed / "share"
    assert (share / "ament_index/resource_index/packages/turbseg_ros").exists()
    assert (share / "turbseg_ros" / "package.xml").exists()
    assert (share / "turbseg_ros" / "launch" / "turbseg.launch.py").exists()


def test_colcon_runs_the_tests(workspace):
    colcon = Path(sys.executable).with_name("colcon")
    tests = workspace / "src" / "turbseg_ros" / "test"
    tests.mkdir()
    shutil.copytree(SOURCE / "test" / "support", tests / "support")
    shutil.copy(SOURCE / "test" / "test_throttle.py", tests)
    for words in (["test", "--return-code-on-test-failure"], ["test-result", "--verbose"]):
        done = subprocess.run(
            [colcon, *words],
            cwd=workspace,
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^Summary: [1-9]\d* tests, 0 errors, 0 failures", done.stdout, re.M)


def test_the_workspace_goes_before_other_installations(workspace):
    where = "import turbseg_ros; print(turbseg_ros.__file__)"
    shown = subprocess.run(
        ["bash", "-c", f'. install/setup.bash && "{sys.executable}" -c "{where}"'],
        cwd=workspace,
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    assert (workspace / "install") in Path(shown.stdout.strip()).parents


def test_the_installed_node_runs_and_ends(workspace, tmp_path):
    executable = "install/turbseg_ros/lib/turbseg_ros/turbseg_node"
    command = ["bash", "-c", f'. install/setup.bash && exec {executable} "$@"', executable]
    with NodeProcess(tmp_path / "output", command=command, directory=workspace) as process:
        with Probe() as probe:
            probe.wait_for(lambda: "turbseg" in probe.node.get_node_names(), "the node")
        assert process.stop(signal.SIGINT) == 0
    # At most what it listens to.
    assert all("[INFO]" in line for line in process.output.splitlines()), process.output
