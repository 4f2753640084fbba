"""The method itself through turbseg_replay, on a bag that is drawn."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import LABELS_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli import evaluate, replay
from turbseg_ros.evaluation.labels import read_labels
from turbseg_ros.ros.image_conversion import message_from_image

FRAMES = 20
SIZE = (120, 208)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dark square that moves by 3 pixels a frame over a textured ground."""
    random = np.random.default_rng(1)
    ground = cv2.GaussianBlur(random.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 2.0)
    ground = cv2.normalize(ground, None, 90, 220, cv2.NORM_MINMAX).astype(np.uint8)
    path = tmp_path_factory.mktemp("drawn") / "bag"
    with BagWriter(path) as writer:
        for number in range(FRAMES):
            stamp = number * 33_000_000
            image, truth = ground.copy(), np.zeros(SIZE, np.uint8)
            window = (slice(50, 75), slice(20 + 3 * number, 60 + 3 * number))
            image[window], truth[window] = 20, 1
            writer.write("/lens/image_raw", message_from_image(image, "mono8", stamp), stamp)
            writer.write(TRUTH_TOPIC, message_from_image(truth, "mono8", stamp), stamp)
    return path


def replayed(bag: Path, out: Path) -> list[tuple[int, bytes]]:
    assert replay.main([str(bag), "-o", str(out)]) == 0
    labels = read_labels(BagReader(out), LABELS_TOPIC)
    return [(item.stamp, item.labels.tobytes()) for item in labels]


def test_two_replays_give_the_same_labels(bag: Path, tmp_path: Path) -> None:
    first, second = replayed(bag, tmp_path / "first"), replayed(bag, tmp_path / "second")
    assert [stamp for stamp, _ in first] == [number * 33_000_000 for number in range(FRAMES)]
    assert any(any(labels) for _, labels in first)
    assert first == second


def test_replayed_labels_score_as_the_evaluation_says(bag: Path, tmp_path: Path) -> None:
    replayed(bag, tmp_path / "out")
    direct, recorded = tmp_path / "direct.json", tmp_path / "recorded.json"
    evaluate.main([str(bag), "--json", str(direct)])
    arguments = ["--predictions", str(tmp_path / "out"), "--json", str(recorded)]
    evaluate.main([str(bag), *arguments])
    assert quality(direct) == quality(recorded)


def quality(file: Path) -> dict[str, object]:
    (scores,) = json.loads(file.read_text())["bags"]
    return {name: scores[name] for name in ("frames", "j", "dice", "boundary_f", "id_switches")}
