"""The method as a library, as README shows it."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

import turbseg_ros
from support.paths import ROOT
from turbseg_ros import MotionSegmenter, ParameterError, Parameters


def images(count: int = 40) -> list[np.ndarray]:
    """A textured scene with a bright square that moves by 3 pixels a frame."""
    rng = np.random.default_rng(0)
    scene = rng.integers(60, 120, (120, 160), np.uint8).repeat(2, 0).repeat(2, 1)
    made = []
    for number in range(count):
        image = scene.copy()
        image[100:124, 40 + 3 * number : 72 + 3 * number] = 230
        made.append(image)
    return made


def test_every_image_has_a_result_and_what_moves_is_found() -> None:
    with MotionSegmenter() as segmenter:
        results = list(segmenter.results(images(), rate=25.0))
    assert [result.frame.stamp for result in results] == [n * 40_000_000 for n in range(40)]
    found = [moving for result in results[8:32] for moving in result.objects]
    assert len(found) >= 20
    assert {moving.id for moving in found} == {found[0].id}
    velocity = found[-1].velocity_per_second
    assert velocity is not None
    assert velocity[0] == pytest.approx(75, abs=15)


def test_parameters_are_taken_as_a_mapping_or_as_they_are() -> None:
    for parameters in (
        {"latency.mode": "causal"},
        Parameters().replace({"latency.mode": "causal"}),
    ):
        with MotionSegmenter(parameters) as segmenter:
            assert segmenter.look_ahead == 0


def test_a_wrong_parameter_is_told() -> None:
    with pytest.raises(ParameterError, match=r"latency\.mood"):
        MotionSegmenter({"latency.mood": "causal"})


def test_all_that_is_public_is_there() -> None:
    for name in turbseg_ros.__all__:
        assert getattr(turbseg_ros, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Sorcerer'"):
        turbseg_ros.Sorcerer  # noqa: B018


def test_the_package_itself_loads_nothing_slow() -> None:
    loaded = "import sys, turbseg_ros; print('numpy' in sys.modules, 'cv2' in sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", loaded], capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.split() == ["False", "False"]


def test_the_lines_in_the_documents_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for document in (ROOT / "README.md", ROOT / "docs" / "library.md"):
        blocks = re.findall(r"```python\n(.*?)```", document.read_text(), re.S)
        assert blocks
        for block in blocks:
            exec(compile(block, str(document), "exec"), {"images": images(30)})
