"""What parameters do to the method: those said to be idle nothing, and none of them ruins it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from support.paths import ROOT
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.evaluation.labels import LabelsByStamp, read_labels
from turbseg_ros.evaluation.metrics import jaccard
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.parameters import Declaration, Parameters, Value, declarations
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, segment

BAG = ROOT / "bags" / "normal"
FRAMES = 30
# Small pictures, for the sake of time.
QUICK: dict[str, Value] = {"resolution.processing": 320, "resolution.detail": 432}
# Groups of what the method does, as opposed to how it is run.
METHOD = ("latency", "flow", "motion", "seed", "growing", "outline", "refine", "tracking")
DECLARED = {declaration.name: declaration for declaration in declarations()}


@pytest.fixture(scope="module")
def clip() -> tuple[list[Frame], list[np.ndarray]]:
    """The first frames of a bag, and their truth."""
    reader = BagReader(Path(BAG))
    frames = list(itertools.islice(BagFrames(reader, reader.find_image_topic()), FRAMES))
    truth = LabelsByStamp(read_labels(reader, TRUTH_TOPIC))
    return frames, [np.asarray(truth.at(frame.stamp)) for frame in frames]


def segmented(frames: Sequence[Frame], values: dict[str, Value]) -> list[SegmentationResult]:
    parameters = Parameters.from_mapping({**QUICK, **values})
    return list(segment(frames, motion_segmenter(parameters)))


def another(declared: Declaration, value: Value) -> Value:
    """A value that is not `value`, and far from it."""
    if declared.choices:
        return next(choice for choice in declared.choices if choice != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return f"{value}/nowhere"
    assert declared.maximum is not None
    assert declared.minimum is not None
    wanted = declared.maximum if value < declared.maximum else declared.minimum
    return declared.type(wanted)


@pytest.mark.parametrize(
    "mode",
    [
        {},
        {"latency.mode": "causal"},
        {"motion.measure": "sampson"},
        {"outline.method": "none"},
        {"refine.mode": "none"},
        {"tracking.mode": "kmeans"},
    ],
    ids=str,
)
def test_what_is_idle_changes_nothing(
    mode: dict[str, Value], clip: tuple[list[Frame], list[np.ndarray]]
) -> None:
    frames, _ = clip
    values = Parameters.from_mapping(mode).as_mapping()
    idle = [
        name
        for name in Parameters.from_mapping(mode).idle(replayed=True)
        if name.split(".")[0] in METHOD
    ]
    assert idle
    changed = {name: another(DECLARED[name], values[name]) for name in idle}
    before, after = segmented(frames, mode), segmented(frames, {**mode, **changed})
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.labels, other.labels)


@pytest.mark.parametrize(
    ("name", "value", "mode"),
    [
        ("outline.threshold", 10.0, {"refine.mode": "none"}),
        ("outline.key_step", 20, {}),
        ("flow.average", "mean", {}),
        ("flow.variational_iterations", 5, {}),
        ("latency.warm_up", 0, {}),
        ("seed.clutter", 0.0, {}),
        ("tracking.min_hits", 30, {}),
        ("latency.coast_from", 0, {}),
        ("latency.sparse_from", 0, {}),
    ],
)
def test_what_is_used_changes_something(
    name: str,
    value: Value,
    mode: dict[str, Value],
    clip: tuple[list[Frame], list[np.ndarray]],
) -> None:
    frames, _ = clip
    given = Parameters.from_mapping({**mode, name: value})
    assert name not in given.idle(replayed=True)
    before, after = segmented(frames, mode), segmented(frames, {**mode, name: value})
    assert any(
        (one.labels != other.labels).any() for one, other in zip(before, after, strict=True)
    )


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("resolution.processing", "minimum"),
        ("resolution.detail", "minimum"),
        ("seed.size", "minimum"),
        ("seed.size", "maximum"),
        ("seed.delta1", "minimum"),
        ("seed.delta1", "maximum"),
        ("seed.delta2", "minimum"),
        ("seed.delta2", "maximum"),
        ("growing.delta", "minimum"),
        ("growing.delta", "maximum"),
        ("flow.interval", "minimum"),
        ("flow.interval", "maximum"),
        ("flow.every", "maximum"),
        ("outline.memory", "minimum"),
        ("outline.key_step", "maximum"),
        ("tracking.min_hits", "minimum"),
        ("tracking.max_age", "minimum"),
    ],
)
def test_no_end_of_a_range_ruins_everything(
    name: str, end: str, clip: tuple[list[Frame], list[np.ndarray]]
) -> None:
    frames, truth = clip
    value = DECLARED[name].type(getattr(DECLARED[name], end))
    results = segmented(frames, {name: value})
    scores = [
        jaccard(result.labels, true)
        for result, true in zip(results, truth, strict=True)
        if true.any()
    ]
    assert np.mean(scores) > 0.5
