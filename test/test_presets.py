"""Parameter files of the package by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.paths import CONFIG
from turbseg_ros import presets
from turbseg_ros.parameters import ParameterError
from turbseg_ros.presets import config_path, preset_path


def test_files_are_found_in_the_source_tree_and_where_they_are_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert config_path("turbseg.rviz") == CONFIG / "turbseg.rviz"
    installed = tmp_path / "share/turbseg_ros/config/own.yaml"
    installed.parent.mkdir(parents=True)
    installed.write_text("")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert config_path("own.yaml") == installed
    assert config_path("missing.yaml").parent.name == "config"
    assert preset_path("own") == installed


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_parameter_file_is_a_preset(path: Path) -> None:
    assert preset_path(path.stem) == path


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("sever", "did you mean severe?"),
        ("", "there are live, low_latency"),
        ("../bags/x", "there are live"),
        ("../config/live", "no preset '../config/live'"),
    ],
)
def test_another_name_is_answered_with_those_there_are(name: str, told: str) -> None:
    with pytest.raises(ParameterError, match="no preset") as refused:
        presets.preset_path(name)
    assert told in str(refused.value)
