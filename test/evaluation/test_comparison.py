"""Two evaluations, compared bag by bag."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from turbseg_ros.cli.evaluate import main
from turbseg_ros.evaluation.comparison import ComparisonError, Difference, compare


def written(path: Path, j: Mapping[str, float | None]) -> Path:
    bags = [{"bag": bag, "frames": 9, "j": value} for bag, value in j.items()]
    path.write_text(json.dumps({"bags": bags}))
    return path


def difference(
    tmp_path: Path, before: Mapping[str, float], after: Mapping[str, float]
) -> Difference:
    (found,) = compare(written(tmp_path / "a", before), written(tmp_path / "b", after))
    return found


def test_only_bags_that_both_have_are_compared(tmp_path: Path) -> None:
    before = written(tmp_path / "a", {"x": 0.5, "y": 0.25, "only": 0.0, "z": None})
    after = written(tmp_path / "b", {"y": 0.75, "x": 0.5, "other": 1.0, "z": 0.5})
    (found,) = compare(before, after)
    assert (found.title, found.bags, found.before, found.after) == ("J", 2, 0.375, 0.625)
    assert found.change == pytest.approx(0.25)


def test_bounds_are_those_of_the_percentile_bootstrap(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    before = random.uniform(0.3, 0.7, 20)
    after = before + random.normal(0.02, 0.05, 20)
    found = difference(
        tmp_path,
        {str(number): value for number, value in enumerate(before.tolist())},
        {str(number): value for number, value in enumerate(after.tolist())},
    )
    other = stats.bootstrap(
        (after - before,), np.mean, n_resamples=20_000, method="percentile", rng=random
    ).confidence_interval
    assert (found.low, found.high) == pytest.approx((other.low, other.high), abs=0.002)


def test_a_change_of_all_bags_is_sure_and_one_of_few_is_not(tmp_path: Path) -> None:
    before = {str(number): 0.5 for number in range(8)}
    assert difference(tmp_path, before, dict.fromkeys(before, 0.6)).is_sure
    assert not difference(tmp_path, before, {**before, "3": 0.9}).is_sure


def test_the_command_line_prints_a_line_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after = written(tmp_path / "a", {"x": 0.5}), written(tmp_path / "b", {"x": 0.75})
    assert main(["--compare", str(before), str(after)]) == 0
    head, line = capsys.readouterr().out.splitlines()
    assert head.split()[:4] == ["bags", "before", "after", "change"]
    assert line.split() == [
        "J",
        "1",
        "0.5000",
        "0.7500",
        "+0.2500",
        "+0.2500",
        "to",
        "+0.2500",
        "*",
    ]
    assert main(["bag", "--compare", str(before), str(after)]) == 2
    assert main([]) == 2


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    one, other = written(tmp_path / "a", {"x": 0.5}), written(tmp_path / "b", {"y": 0.5})
    with pytest.raises(ComparisonError, match="no bag in common"):
        compare(one, other)
    other.write_text("{}")
    with pytest.raises(ComparisonError, match="is no JSON that turbseg_evaluate wrote"):
        compare(one, other)
