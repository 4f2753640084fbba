"""Two evaluations of the same bags, bag by bag: differences, and how sure they are."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from turbseg_ros.evaluation.scores import COLUMNS, OBJECT_COLUMNS

_RESAMPLES = 10_000
_CONFIDENCE = 0.95
# Figures that say nothing of what was found.
_LEFT_OUT = ("frames", "scored_frames", "tilt_px")


class ComparisonError(Exception):
    """Two files that can't be compared; the text says why."""


@dataclass(frozen=True)
class Difference:
    """A figure in two evaluations, over the bags that have it in both.

    `before` and `after` are means, `low` and `high` the bounds within which the mean difference
    lies with a confidence of 95 %: percentiles over bags drawn anew (bootstrap).
    """

    title: str
    bags: int
    before: float
    after: float
    low: float
    high: float

    @property
    def change(self) -> float:
        """The mean difference."""
        return self.after - self.before

    @property
    def is_sure(self) -> bool:
        """Whether chance alone seldom makes such a difference."""
        return self.low > 0.0 or self.high < 0.0


def compare(before: Path, after: Path) -> list[Difference]:
    """Compare two files that `turbseg_evaluate --json` wrote, bag by bag.

    :raises ComparisonError: when one is no such file, or they have no bag in common.
    """
    first, second = _bags(before), _bags(after)
    shared = [name for name in first if name in second]
    if not shared:
        raise ComparisonError(f"{before} and {after} have no bag in common")
    names = {column.name: column.title for column in (*COLUMNS, *OBJECT_COLUMNS)}
    pairs = {
        name: [(first[bag].get(name), second[bag].get(name)) for bag in shared] for name in names
    }
    return list(_differences(names, pairs))


def comparison_table(differences: Sequence[Difference]) -> list[str]:
    """Return the lines of a table; what is sure ends in a star."""
    lines = [f"{'':10}  {'bags':>4}  {'before':>8}  {'after':>8}  {'change':>8}  95 % of chance"]
    for each in differences:
        bounds = f"{each.low:+.4f} to {each.high:+.4f}{' *' if each.is_sure else ''}"
        lines.append(
            f"{each.title:10}  {each.bags:4}  {each.before:8.4f}  {each.after:8.4f}  "
            f"{each.change:+8.4f}  {bounds}"
        )
    return lines


def _bags(path: Path) -> dict[str, Mapping[str, Any]]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {str(bag["bag"]): bag for bag in content["bags"]}
    except (ValueError, KeyError, TypeError) as error:
        raise ComparisonError(f"{path} is no JSON that turbseg_evaluate wrote") from error


def _differences(
    names: Mapping[str, str], pairs: Mapping[str, Sequence[tuple[Any, Any]]]
) -> Iterator[Difference]:
    for name, title in names.items():
        values = np.array([pair for pair in pairs[name] if None not in pair], np.float64)
        if name in _LEFT_OUT or not len(values):
            continue
        before, after = values.mean(axis=0)
        low, high = _bounds(values[:, 1] - values[:, 0])
        yield Difference(title, len(values), float(before), float(after), low, high)


def _bounds(differences: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return the percentiles of the mean over bags that are drawn anew, with repetition."""
    random = np.random.default_rng(0)
    drawn = random.integers(0, differences.size, (_RESAMPLES, differences.size))
    outside = 50.0 * (1.0 - _CONFIDENCE)
    low, high = np.percentile(differences[drawn].mean(axis=1), (outside, 100.0 - outside))
    return float(low), float(high)
