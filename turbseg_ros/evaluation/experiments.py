"""Comparisons: with rivals, with parts of the method left out, in ever harder conditions.

An experiment is a list of trials with names; once they have been run, their scores are looked up.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from turbseg_ros.evaluation.disturbance import AddedShake, AddedTurbulence, Disturbance
from turbseg_ros.evaluation.rivals import Contender, Method
from turbseg_ros.evaluation.scores import BagScores, Table, mean_scores
from turbseg_ros.evaluation.trials import Trial, TrialResult
from turbseg_ros.parameters import Declaration, Parameters, Value, declarations

VARIANTS: Mapping[str, Mapping[str, Value]] = {
    "as configured": {},
    "interval 1: flow not stabilised": {"flow.interval": 1},
    "interval 2": {"flow.interval": 2},
    "interval 3": {"flow.interval": 3},
    "interval 4": {"flow.interval": 4},
    "interval 5": {"flow.interval": 5},
    "motion in every frame": {"flow.every": 1},
    "motion in every second frame": {"flow.every": 2},
    "mean flow (eq. 1)": {"flow.average": "mean"},
    "Sampson distance (eq. 2)": {"motion.measure": "sampson"},
    "no geometric check": {"motion.measure": "none"},
    "similar magnitude (eq. 3)": {"growing.similarity": "magnitude"},
    "growing only": {"outline.method": "none"},
}
"""What the ablation changes, one thing at a time: names of variants and their parameters."""

# Groups of parameters that the node has beside those of the method; so are all in no group.
_GROUPS_OF_THE_NODE = ("qos", "diagnostics")


@dataclass(frozen=True)
class Row:
    """One contender on all bags: a line of a table, or a point of a curve at some `strength`.

    `parameters` are those that are changed for it, where that is what the rows are about.
    """

    name: str
    trials: tuple[Trial, ...]
    strength: float | None = None
    parameters: Mapping[str, Value] | None = None


@dataclass(frozen=True)
class Experiment:
    """Rows that belong together.

    `key` is its name in JSON, `rows_are` what the rows' names are, `strength_name` the name of
    their strength in JSON, where they have one.
    """

    key: str
    rows_are: str
    rows: tuple[Row, ...]
    strength_name: str = ""

    @property
    def trials(self) -> tuple[Trial, ...]:
        """All trials that it needs, none twice."""
        return tuple(dict.fromkeys(trial for row in self.rows for trial in row.trials))


def against_rivals(trials: Sequence[Trial], rivals: Sequence[Contender]) -> Experiment:
    """Hold the contender of `trials`, one a bag, against rivals on the same frames."""
    contenders = [trial.contender for trial in trials[:1]] + list(rivals)
    rows = (
        Row(contender.name, tuple(replace(trial, contender=contender) for trial in trials))
        for contender in contenders
    )
    return Experiment("rivals", "segmenter", tuple(rows))


def ablation(trials: Sequence[Trial], parameters: Parameters) -> Experiment:
    """Change one thing at a time in the method's parameters, on the bags of `trials`."""
    return Experiment("ablation", "variant", _variants(trials, parameters, VARIANTS))


def sensitivity(trials: Sequence[Trial], parameters: Parameters) -> Experiment:
    """Halve and double each number among the method's parameters, on the bags of `trials`.

    Whole numbers are rounded, all are kept within their range; what that leaves as it is, is
    left out.
    """
    values = parameters.as_mapping()
    variants: dict[str, dict[str, Value]] = {"as configured": {}}
    for declared in declarations():
        group, _, name = declared.name.partition(".")
        number = values[declared.name]
        if name and group not in _GROUPS_OF_THE_NODE and type(number) in (int, float):
            for changed in _halved_and_doubled(declared, float(number)):
                variants[f"{declared.name} {changed}"] = {declared.name: changed}
    return Experiment("sensitivity", "variant", _variants(trials, parameters, variants))


def _halved_and_doubled(declared: Declaration, value: float) -> Iterable[Value]:
    low = -math.inf if declared.minimum is None else declared.minimum
    high = math.inf if declared.maximum is None else declared.maximum
    for changed in (value / 2, value * 2):
        within = min(max(changed, low), high)
        given = round(within) if declared.type is int else within
        if given != value:
            yield given


def _variants(
    trials: Sequence[Trial],
    parameters: Parameters,
    variants: Mapping[str, Mapping[str, Value]],
) -> tuple[Row, ...]:
    rows = []
    for name, changed in variants.items():
        method = Method(name, parameters.replace(changed))
        own = (replace(trial, contender=method, illustrated=False) for trial in trials)
        rows.append(Row(name, tuple(own), parameters=changed))
    return tuple(rows)


def tilt_curve(
    trials: Sequence[Trial], contenders: Sequence[Contender], strengths: Sequence[float], seed: int
) -> Experiment:
    """Add turbulence of several strengths, rms tilt an axis in pixels, to the bags."""

    def disturbance(tilt_px: float) -> Disturbance | None:
        return AddedTurbulence(tilt_px, seed) if tilt_px else None

    rows = _curve(trials, contenders, strengths, disturbance)
    return Experiment("tilt_curve", "segmenter", rows, strength_name="added_tilt_px")


def shake_curve(
    trials: Sequence[Trial], contenders: Sequence[Contender], strengths: Sequence[float], seed: int
) -> Experiment:
    """Shake the bags' pictures by several strengths, rms step an axis in pixels a frame.

    All strengths show the same part of the scene, so also none at all is not as recorded.
    """
    widest = max(strengths)
    rows = _curve(trials, contenders, strengths, lambda step_px: AddedShake(step_px, widest, seed))
    return Experiment("shake_curve", "segmenter", rows, strength_name="added_shake_px")


def _curve(
    trials: Sequence[Trial],
    contenders: Sequence[Contender],
    strengths: Sequence[float],
    disturbance: Callable[[float], Disturbance | None],
) -> tuple[Row, ...]:
    return tuple(
        Row(
            contender.name,
            tuple(
                replace(
                    trial,
                    contender=contender,
                    disturbance=disturbance(strength),
                    illustrated=False,
                )
                for trial in trials
            ),
            strength,
        )
        for contender in contenders
        for strength in strengths
    )


@dataclass(frozen=True)
class ScoredRow:
    """What a row's trials came to; bags whose trial failed are missing."""

    name: str
    strength: float | None
    parameters: Mapping[str, Value] | None
    bags: tuple[BagScores, ...]

    @property
    def mean(self) -> dict[str, float | None]:
        """Each figure's mean over the bags."""
        return mean_scores(self.bags)


@dataclass(frozen=True)
class ScoredExperiment:
    """An experiment that has been run."""

    experiment: Experiment
    rows: tuple[ScoredRow, ...]

    @classmethod
    def of(cls, experiment: Experiment, results: Mapping[Trial, TrialResult]) -> ScoredExperiment:
        """Look up the results of an experiment's trials, as far as there are any."""
        rows = (
            ScoredRow(row.name, row.strength, row.parameters, tuple(_scores(row.trials, results)))
            for row in experiment.rows
        )
        return cls(experiment, tuple(rows))

    @property
    def strengths(self) -> list[float]:
        """The strengths of a curve, none of a table."""
        return list(dict.fromkeys(r.strength for r in self.rows if r.strength is not None))

    @property
    def curves(self) -> dict[str, list[ScoredRow]]:
        """The rows by their names, in order."""
        curves: dict[str, list[ScoredRow]] = {}
        for row in self.rows:
            curves.setdefault(row.name, []).append(row)
        return curves

    def as_json(self) -> list[dict[str, Any]]:
        """Give the rows as JSON has them."""
        return [self._row_as_json(row) for row in self.rows]

    def _row_as_json(self, row: ScoredRow) -> dict[str, Any]:
        content: dict[str, Any] = {self.experiment.rows_are: row.name}
        if row.strength is not None:
            content[self.experiment.strength_name] = row.strength
        if row.parameters is not None:
            content["parameters"] = dict(row.parameters)
        content["bags"] = [dataclasses.asdict(bag) for bag in row.bags]
        content["mean"] = row.mean
        return content


def text_table(scored: ScoredExperiment) -> list[str]:
    """Give the means over the bags as lines of text: all figures, or of a curve J."""
    if scored.strengths:
        return _curve_table(scored)
    table = Table.of([row.name for row in scored.rows], scored.experiment.rows_are)
    return [table.head, *(table.mean(row.bags, row.name) for row in scored.rows)]


def _curve_table(scored: ScoredExperiment) -> list[str]:
    """Give a line for each strength, a column for each segmenter."""
    columns = [[scored.experiment.strength_name, *(f"{s:g}" for s in scored.strengths)]]
    for name, rows in scored.curves.items():
        means = (row.mean["j"] for row in rows)
        columns.append([f"J {name}", *("-" if j is None else f"{j:.3f}" for j in means)])
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in zip(*columns, strict=True)
    ]


def _scores(trials: Iterable[Trial], results: Mapping[Trial, TrialResult]) -> Iterable[BagScores]:
    return (results[trial].scores for trial in trials if trial in results)
