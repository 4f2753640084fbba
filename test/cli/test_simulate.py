from __future__ import annotations

import itertools
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli import simulate
from turbseg_ros.cli.simulate import main
from turbseg_ros.messages.images import image_from_message, message_from_image, stamp_to_ns
from turbseg_ros.simulation.objects import Path as Way
from turbseg_ros.simulation.objects import SceneObject
from turbseg_ros.simulation.oncoming import ONCOMING, oncoming_scene
from turbseg_ros.simulation.scenes import SCENES

IMAGES, TRUTH = "/camera/image_raw", "/ground_truth/labels"


@pytest.fixture
def brief_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Instead of the scenes a small grey and a small thermal one, of three frames each."""
    kept = {name: SCENES[name] for name in ("normal", "thermal")}
    for name in list(SCENES):
        monkeypatch.delitem(SCENES, name)
    van = SceneObject(1, "van", 60, Way(((0, 60, 70), (3, 66, 70))))
    for name, entry in kept.items():
        small = replace(
            entry, landscape="open_sky", objects=(van,), width=120, height=96, frames=3
        )
        monkeypatch.setitem(SCENES, name, small)


def contents(path: Path, topic: str) -> list[tuple[int, str, np.ndarray]]:
    messages = [record.message() for record in BagReader(path).messages([topic])]
    return [
        (stamp_to_ns(message.header.stamp), message.encoding, image_from_message(message))
        for message in messages
    ]


@pytest.mark.usefixtures("brief_scenes")
def test_a_rendered_bag_holds_frames_and_their_truth(tmp_path: Path) -> None:
    assert main(["--scene", "normal", "-o", str(tmp_path / "bag")]) == 0
    images = contents(tmp_path / "bag", IMAGES)
    truth = contents(tmp_path / "bag", TRUTH)
    assert [stamp for stamp, _, _ in images] == [stamp for stamp, _, _ in truth]
    assert [encoding for _, encoding, _ in images] == ["mono8"] * 3
    assert [encoding for _, encoding, _ in truth] == ["mono16"] * 3
    assert {image.shape for _, _, image in images + truth} == {(96, 120)}
    assert truth[0][2].any()


def test_a_scene_drawn_by_the_seed_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "turbseg_ros.cli.simulate.oncoming_scene",
        lambda seed: replace(oncoming_scene(seed), landscape="open_sky", height=400, frames=2),
    )
    assert main(["--scene", ONCOMING, "--seed", "4", "-o", str(tmp_path / "bag")]) == 0
    truth = contents(tmp_path / "bag", TRUTH)
    assert len(truth) == 2
    assert truth[0][2].max() == len(oncoming_scene(4).objects)


@pytest.mark.usefixtures("brief_scenes")
def test_all_scenes_go_into_a_folder_of_bags(tmp_path: Path) -> None:
    assert main(["--scene", "all", "-o", str(tmp_path / "bags"), "--seed", "3"]) == 0
    assert sorted(path.name for path in (tmp_path / "bags").iterdir()) == ["normal", "thermal"]
    assert contents(tmp_path / "bags" / "thermal", IMAGES)[0][1] == "mono16"


@pytest.mark.usefixtures("brief_scenes")
def test_the_same_seed_gives_the_same_bag(tmp_path: Path) -> None:
    for name, seed in (("one", "5"), ("two", "5"), ("three", "6")):
        assert main(["--scene", "normal", "--seed", seed, "-o", str(tmp_path / name)]) == 0
    one, two, three = (
        np.stack([image for _, _, image in contents(tmp_path / name, IMAGES)])
        for name in ("one", "two", "three")
    )
    np.testing.assert_array_equal(one, two)
    assert (one != three).any()


@pytest.mark.usefixtures("brief_scenes")
def test_no_tilt_leaves_a_still_landscape(tmp_path: Path) -> None:
    assert main(["--scene", "normal", "--tilt", "0", "-o", str(tmp_path / "bag")]) == 0
    first, second, _ = (image for _, _, image in contents(tmp_path / "bag", IMAGES))
    top = np.s_[:30]  # above the van; only the sensor's noise is left
    assert np.abs(first[top].astype(int) - second[top]).max() <= 4


def own_bag(path: Path, truth: bool = True) -> np.ndarray:
    """A bag of three frames with a bright square, its truth and a camera's calibration."""
    labels = np.zeros((96, 128), np.uint8)
    labels[30:60, 40:80] = 255
    with BagWriter(path) as bag:
        for stamp in (10, 20, 30):
            bag.write("/cam/image", message_from_image(labels // 2, "mono8", stamp, "cam"), stamp)
            bag.write("/cam/camera_info", CameraInfo(width=128, height=96), stamp)
            if truth:
                bag.write(TRUTH, message_from_image(labels, "mono8", stamp, "cam"), stamp)
    return labels


def test_warp_moves_frames_and_truth_and_copies_the_rest(tmp_path: Path) -> None:
    labels = own_bag(tmp_path / "own")
    arguments = ["--warp", str(tmp_path / "own"), "--tilt", "1.5", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    reader = BagReader(tmp_path / "out")
    assert reader.topics["/cam/camera_info"].message_count == 3
    images, truth = contents(tmp_path / "out", "/cam/image"), contents(tmp_path / "out", TRUTH)
    assert [stamp for stamp, _, _ in images] == [stamp for stamp, _, _ in truth] == [10, 20, 30]
    for (_, _, image), (_, _, mask) in zip(images, truth, strict=True):
        assert not np.array_equal(mask, labels)
        agreement = ((image > 63) == (mask > 0)).mean()
        assert agreement > 0.99


def test_warp_does_without_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own_bag(tmp_path / "own", truth=False)
    arguments = ["--warp", str(tmp_path / "own"), "--tilt", "1", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert TRUTH not in BagReader(tmp_path / "out").topics
    assert "0 with truth" in capsys.readouterr().out


def test_list_names_every_scene(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == [*SCENES, ONCOMING]
    assert len(listed) >= 12


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--scene", "croud", "-o", "OUT"], "Did you mean 'crowd'?"),
        (["--scene", "normal", "--tilt", "-1", "-o", "OUT"], "--tilt -1"),
        (["--scene", "normal", "--tilt", "nan", "-o", "OUT"], "--tilt nan"),
        (["--scene", "normal", "--seed", "-1", "-o", "OUT"], "--seed -1"),
        (["--scene", "normal"], "-o OUT"),
        (["--scene", "normal", "-o", "."], "exists already"),
        (["--warp", "nowhere", "--tilt", "1", "-o", "OUT"], "no such bag"),
        (["--warp", "nowhere", "-o", "OUT"], "--tilt PX"),
    ],
)
def test_a_mistake_is_answered_by_one_line(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def interrupted_at(call: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let SIGINT come while the call-th image is made a message."""
    calls = itertools.count(1)

    def interrupting(*arguments: Any) -> Any:
        if next(calls) == call:
            signal.raise_signal(signal.SIGINT)
        return message_from_image(*arguments)

    monkeypatch.setattr(simulate, "message_from_image", interrupting)


def test_an_interrupted_rendering_keeps_the_frames_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted_at(3, monkeypatch)
    out = tmp_path / "scenes"
    assert main(["--scene", "all", "-o", str(out)]) == 130
    (path,) = out.iterdir()
    assert len(contents(path, "/camera/image_raw")) == 2
    assert "interrupted after 2 of" in (path / "metadata.yaml").read_text()
    error = capsys.readouterr().err
    assert f"turbseg_simulate: {path} is partial: interrupted after 2 of" in error
    assert f"{len(SCENES) - 1} of {len(SCENES)} scenes were not begun" in error


def test_an_interrupted_warp_keeps_the_frames_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own_bag(tmp_path / "own", truth=False)
    interrupted_at(2, monkeypatch)
    arguments = ["--warp", str(tmp_path / "own"), "--tilt", "1", "-o", str(tmp_path / "out")]
    assert main(arguments) == 130
    partial = "interrupted after 2 of"
    assert partial in (tmp_path / "out" / "metadata.yaml").read_text()
    assert partial in capsys.readouterr().err
