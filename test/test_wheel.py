"""The package as a wheel, installed into an environment that has only its dependencies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from support.drawn_bag import write_drawn_bag
from support.paths import ROOT
from turbseg_ros import __version__
from turbseg_ros.bag.reader import BagReader

pytestmark = pytest.mark.timeout(240)

LIMIT = 100
NOT_SOURCE = shutil.ignore_patterns(
    ".*", "__pycache__", "*.egg-info", "bags", "build", "install", "log", "out", "test"
)


def run(*command: object, folder: Path) -> str:
    """Run a command that knows nothing of the source tree; return what it prints."""
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # Where messages' definitions are: those of ROS from wheels, and of one that is sourced.
    alone["AMENT_PREFIX_PATH"] = os.pathsep.join(
        filter(None, (alone.get("AMENT_PREFIX_PATH"), sys.prefix))
    )
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=alone,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=NOT_SOURCE)
    words = ["--no-deps", "--no-build-isolation", "--disable-pip-version-check", "-q"]
    run(sys.executable, "-m", "pip", "wheel", source, *words, "-w", folder, folder=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the executables of a new environment, with the wheel installed in it."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    # What the package depends on is taken from here; the environment's own folder comes before.
    others = sorted({sysconfig.get_path(kind) for kind in ("purelib", "platlib")})
    lines = (f"import site; site.addsitedir({other!r})\n" for other in others)
    (site / "dependencies.pth").write_text("".join(lines))
    pip = [sys.executable, "-m", "pip", "--python", folder / "bin" / "python"]
    run(*pip, "install", "-q", "--no-deps", "--no-index", wheel, folder=folder)
    return folder / "bin"


def test_the_wheel_has_all_files_of_the_package_and_its_presets(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    package = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "turbseg_ros").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in names if name.startswith("turbseg_ros/")} == package
    shared = f"turbseg_ros-{__version__}.data/data/share/turbseg_ros"
    for path in [*(ROOT / "config").iterdir(), *(ROOT / "launch").glob("*.py")]:
        assert f"{shared}/{path.parent.name}/{path.name}" in names
    assert f"{shared}/package.xml" in names


def test_an_installed_executable_replays_a_bag(installed: Path, tmp_path: Path) -> None:
    where = "import turbseg_ros; print(turbseg_ros.__file__)"
    shown = run(installed / "python", "-c", where, folder=tmp_path)
    assert installed.parent in Path(shown.strip()).parents
    told = run(installed / "turbseg_replay", "--help", folder=tmp_path)
    assert told.startswith("usage: turbseg_replay")
    assert run(installed / "turbseg_node", "--version", folder=tmp_path).split()[1] == __version__
    bag = write_drawn_bag(tmp_path / "bag", [n * 33_000_000 for n in range(4)])
    run(installed / "turbseg_replay", bag, "-o", "out", folder=tmp_path)
    assert BagReader(tmp_path / "out").topics["/turbseg/labels"].message_count == 4
