"""Data sets on disk, imported and scored in halves."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.drawn_scene import DrawnScene
from turbseg_ros.cli.real import main

SCENE = DrawnScene()


def write_clip(folder: Path, frames: int) -> None:
    for name in ("frames", "masks"):
        (folder / name).mkdir(parents=True)
    for number, image in enumerate(SCENE.images(frames)):
        cv2.imwrite(str(folder / "frames" / f"{number:03}.png"), image)
        mask = SCENE.truth(number).astype(np.uint8) * 255
        cv2.imwrite(str(folder / "masks" / f"{number:03}.png"), mask)


def test_halves_are_scored_apart_and_bags_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c"):
        write_clip(tmp_path / "data" / "sbi" / name, 24)
    write_clip(tmp_path / "data" / "static_haze", 6)
    out = tmp_path / "out"
    words = [str(tmp_path / "data"), "-o", str(out), "--workers", "1", "--frames", "20"]
    assert main(words) == 0
    scores = {path.stem: json.loads(path.read_text()) for path in out.glob("*.json")}
    assert {
        name: [Path(bag["bag"]).name for bag in each["bags"]] for name, each in scores.items()
    } == {
        "sbi_even": ["a", "c"],
        "sbi_odd": ["b"],
        "static_haze_even": ["frames"],
    }
    assert scores["sbi_odd"]["bags"][0]["frames"] == 20
    assert scores["sbi_odd"]["bags"][0]["j"] > 0.3
    assert scores["static_haze_even"]["bags"][0]["j"] is None
    printed = capsys.readouterr().out.splitlines()[-3:]
    assert [line.partition("  ")[0] for line in printed] == [
        "sbi, even",
        "sbi, odd",
        "static_haze, even",
    ]
    assert printed[0].split()[2:4] == ["2", "-"]

    written = (out / "bags" / "sbi" / "a" / "metadata.yaml").stat().st_mtime_ns
    assert main([*words, "--sets", "sbi"]) == 0
    assert (out / "bags" / "sbi" / "a" / "metadata.yaml").stat().st_mtime_ns == written


def test_a_folder_without_any_data_set_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "has none of far_targets, sbi" in capsys.readouterr().err
