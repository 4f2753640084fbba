"""The method put together: strategies by name, and classes of the user's own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.drawn_bag import write_drawn_bag
from support.drawn_clip import CLIP, PARAMETERS, frames
from turbseg_ros.factory import motion_segmenter, strategies
from turbseg_ros.learning.pretrained import SHIPPED
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.kmeans_ids import KMeansIds
from turbseg_ros.segmentation.motion import SampsonMotion
from turbseg_ros.segmentation.outliner import GrownRegions, RefinedDifference
from turbseg_ros.segmentation.region_growing import similar_magnitude

# A measure and a tracker as a researcher would write them, in a file of theirs.
OWN = '''
from turbseg_ros.segmentation.average import SlopeAverage
from turbseg_ros.segmentation.kalman_tracker import KalmanTracker
from turbseg_ros.segmentation.motion import AffineMotion


class Saliency(AffineMotion):
    """The affine motion, as seen by one who says so."""

    def __init__(self, parameters):
        super().__init__(SlopeAverage())

    def motions(self, flows, valid, interval):
        from dataclasses import replace

        found = super().motions(flows, valid, interval)
        return [replace(motion, ego_motion_model="saliency") for motion in found]


class FromHundred(KalmanTracker):
    def __init__(self, parameters):
        tracking = parameters.tracking
        super().__init__(
            tracking.min_hits,
            tracking.false_alarms_per_hour,
            tracking.max_age,
            parameters.max_objects,
            4,
        )
        self._next_id = 100


class Unwilling:
    pass
'''


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    package = tmp_path / "mine"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "scorers.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    monkeypatch.delitem(sys.modules, "mine.scorers", raising=False)
    return tmp_path


def test_the_defaults_are_the_methods_own() -> None:
    chosen = strategies(Parameters())
    assert isinstance(chosen.outlines, RefinedDifference)
    chosen.flow.close()


def test_the_papers_strategies_are_six_objects() -> None:
    paper = {
        "motion.measure": "sampson",
        "growing.similarity": "magnitude",
        "outline.method": "none",
        "tracking.mode": "kmeans",
    }
    chosen = strategies(Parameters().replace(paper))
    assert isinstance(chosen.measure, SampsonMotion)
    assert isinstance(chosen.outlines, GrownRegions)
    assert isinstance(chosen.tracker, KMeansIds)
    assert chosen.similarity is similar_magnitude
    chosen.flow.close()


def test_a_measure_and_a_tracker_of_ones_own_are_run(own: Path) -> None:
    parameters = PARAMETERS.replace(
        {
            "motion.measure": "mine.scorers:Saliency",
            "tracking.mode": "mine.scorers:FromHundred",
            "refine.mode": "none",
        }
    )
    with motion_segmenter(parameters) as segmenter:
        results = [result for frame in frames(CLIP) for result in segmenter.push(frame)]
        results += segmenter.flush()
    assert {result.ego_motion_model for result in results[8:]} == {"saliency"}
    assert {found.id for result in results for found in result.objects} == {100}


def test_replay_runs_them_by_command_line(own: Path) -> None:
    bag = write_drawn_bag(own / "bag", [n * 33_000_000 for n in range(1, 13)])
    command = [
        *(sys.executable, "-m", "turbseg_ros.cli", "replay", str(bag), "-o", str(own / "out")),
        *("-p", "motion.measure:=mine.scorers:Saliency"),
    ]
    # Own classes are found where Python looks for modules: the working folder, PYTHONPATH.
    subprocess.run(command, cwd=own, check=True, timeout=100)
    assert (own / "out" / "metadata.yaml").is_file()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("mine.missing:Saliency", "No module named 'mine.missing'"),
        ("nowhere.at:All", "is its folder in PYTHONPATH?"),
        ("mine.scorers:Salience", "mine.scorers has no class Salience"),
        ("mine.scorers:Unwilling", "can't be made with the parameters"),
    ],
)
def test_a_class_that_cannot_be_had_is_one_line(own: Path, name: str, text: str) -> None:
    parameters = Parameters().replace({"motion.measure": name})
    with pytest.raises(ParameterError) as error:
        strategies(parameters)
    assert str(error.value).startswith(f"parameter motion.measure is {name}")
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_a_network_of_ones_own_draws_the_outlines(tmp_path: Path) -> None:
    own = tmp_path / "own.onnx"
    shutil.copy(SHIPPED, own)
    with motion_segmenter(Parameters().replace({"refine.weights": str(own)})):
        own.unlink()
    with pytest.raises(ParameterError) as error:
        strategies(Parameters().replace({"refine.weights": str(own)}))
    assert str(error.value) == f"refine.weights {own}: no such file; turbseg_train makes one"
    strategies(
        Parameters().replace({"refine.weights": str(own), "refine.mode": "none"})
    ).flow.close()
