"""Comparisons: with baselines, with parts of the method left out, in ever harder conditions.

An experiment is a list of runs with names; once they have been run, their scores are looked up.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from turbseg_ros.evaluation.baselines import Method, TurbsegMethod
from turbseg_ros.evaluation.disturbance import AddedShake, AddedTurbulence, Disturbance
from turbseg_ros.evaluation.run import Run, RunResult
from turbseg_ros.evaluation.scores import BagScores, Table, mean_scores
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
    "motion not averaged over measurements": {"motion.averaging": False},
    "similar magnitude (eq. 3)": {"growing.similarity": "magnitude"},
    "regions of one velocity alone": {"growing.expansion": False},
    "growing only": {"outline.method": "none"},
    "seeds not held against the pictures": {"seed.evidence": 0.0},
    "seeds that know no clutter": {"seed.clutter": 0.0},
    "nothing but motion": {"seed.standing_out": False},
    "no small targets": {"seed.small_targets": False},
    "static overlays are scene": {"regions.static_overlays": False},
    # So many false alarms are allowed that chance would take anything as far as it must go.
    "no test of significance": {"tracking.false_alarms_per_hour": 1e6},
    "what stops is not kept": {"tracking.stopped": 0.0},
    "look-ahead 15": {"latency.look_ahead": 15},
}
"""What the ablation changes, one thing at a time: names of variants and their parameters."""

# Groups of parameters that say nothing of the method; so are all in no group.
_GROUPS_OF_THE_NODE = ("qos", "diagnostics")


@dataclass(frozen=True)
class Row:
    """One method on all bags: a line of a table, or a point of a curve at some `strength`.

    `parameters` are those that are changed for it, where that is what the rows are about.
    """

    name: str
    runs: tuple[Run, ...]
    strength: float | None = None
    parameters: Mapping[str, Value] | None = None


@dataclass(frozen=True)
class Experiment:
    """Rows that belong together.

    `key` is its name in JSON, `rows_are` what the rows' names are, `strength_name` the name of
    their strength in JSON, where they have one. `idle` names the variants that are not run, for
    they change nothing as the parameters stand, each with a line that says why.
    """

    key: str
    rows_are: str
    rows: tuple[Row, ...]
    strength_name: str = ""
    idle: Mapping[str, str] = field(default_factory=dict)

    @property
    def runs(self) -> tuple[Run, ...]:
        """All runs that it needs, none twice."""
        return tuple(dict.fromkeys(run for row in self.rows for run in row.runs))


def against_baselines(runs: Sequence[Run], baselines: Sequence[Method]) -> Experiment:
    """Hold the method of `runs`, one a bag, against baselines on the same frames."""
    methods = [run.method for run in runs[:1]] + list(baselines)
    rows = (
        Row(method.name, tuple(replace(run, method=method) for run in runs)) for method in methods
    )
    return Experiment("baselines", "segmenter", tuple(rows))


def ablation(runs: Sequence[Run], parameters: Parameters) -> Experiment:
    """Change one thing at a time in the method's parameters, on the bags of `runs`."""
    return _of_variants("ablation", runs, parameters, VARIANTS)


def comparison(
    runs: Sequence[Run], parameters: Parameters, changes: Sequence[Mapping[str, object]]
) -> Experiment:
    """Hold the method of `runs` against itself with parameters changed, each change by itself.

    :raises ParameterError: when a parameter doesn't exist or its value is refused.
    """
    variants: dict[str, Mapping[str, Value]] = {"as configured": {}}
    for change in changes:
        values = parameters.replace(change).as_mapping()
        name = ", ".join(f"{each} {values[each]}" for each in change)
        variants[name] = {each: values[each] for each in change}
    return _of_variants("comparison", runs, parameters, variants)


def sensitivity(runs: Sequence[Run], parameters: Parameters) -> Experiment:
    """Halve and double each number among the method's parameters, on the bags of `runs`.

    Whole numbers are rounded, all are kept within their range; what that leaves as it is, is
    left out. What has no effect while a bag is replayed is named as idle.
    """
    values = parameters.as_mapping()
    variants: dict[str, dict[str, Value]] = {"as configured": {}}
    for declared in declarations():
        group, _, name = declared.name.partition(".")
        number = values[declared.name]
        if name and group not in _GROUPS_OF_THE_NODE and type(number) in (int, float):
            for changed in _halved_and_doubled(declared, float(number)):
                variants[f"{declared.name} {changed}"] = {declared.name: changed}
    return _of_variants("sensitivity", runs, parameters, variants)


def _halved_and_doubled(declared: Declaration, value: float) -> Iterable[Value]:
    low = -math.inf if declared.minimum is None else declared.minimum
    high = math.inf if declared.maximum is None else declared.maximum
    for changed in (value / 2, value * 2):
        within = min(max(changed, low), high)
        given = round(within) if declared.type is int else within
        if given != value:
            yield given


def _of_variants(
    key: str,
    runs: Sequence[Run],
    parameters: Parameters,
    variants: Mapping[str, Mapping[str, Value]],
) -> Experiment:
    """Return an experiment with a row for each variant of the parameters that is not idle."""
    before = parameters.idle(replayed=True)
    rows, idle = [], {}
    for name, changed in variants.items():
        varied = parameters.replace(changed)
        after = varied.idle(replayed=True)
        # Idle under both values: one that is used at a certain value only changes something.
        if changed and all(each in before and each in after for each in changed):
            idle[name] = "; ".join(after[each] for each in changed)
            continue
        method = TurbsegMethod(name, varied)
        own = (replace(run, method=method, illustrated=False) for run in runs)
        rows.append(Row(name, tuple(own), parameters=changed))
    return Experiment(key, "variant", tuple(rows), idle=idle)


def tilt_curve(
    runs: Sequence[Run], methods: Sequence[Method], strengths: Sequence[float], seed: int
) -> Experiment:
    """Add turbulence of several strengths, rms tilt an axis in pixels, to the bags."""

    def disturbance(tilt_px: float) -> Disturbance | None:
        return AddedTurbulence(tilt_px, seed) if tilt_px else None

    rows = _curve(runs, methods, strengths, disturbance)
    return Experiment("tilt_curve", "segmenter", rows, strength_name="added_tilt_px")


def shake_curve(
    runs: Sequence[Run], methods: Sequence[Method], strengths: Sequence[float], seed: int
) -> Experiment:
    """Shake the bags' pictures by several strengths, rms step an axis in pixels a frame.

    All strengths show the same part of the scene, so also none at all is not as recorded.
    """
    widest = max(strengths)
    rows = _curve(runs, methods, strengths, lambda step_px: AddedShake(step_px, widest, seed))
    return Experiment("shake_curve", "segmenter", rows, strength_name="added_shake_px")


def _curve(
    runs: Sequence[Run],
    methods: Sequence[Method],
    strengths: Sequence[float],
    disturbance: Callable[[float], Disturbance | None],
) -> tuple[Row, ...]:
    return tuple(
        Row(
            method.name,
            tuple(
                replace(
                    run,
                    method=method,
                    disturbance=disturbance(strength),
                    illustrated=False,
                )
                for run in runs
            ),
            strength,
        )
        for method in methods
        for strength in strengths
    )


@dataclass(frozen=True)
class ScoredRow:
    """What a row's runs came to; bags whose run failed are missing."""

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
    def of(cls, experiment: Experiment, results: Mapping[Run, RunResult]) -> ScoredExperiment:
        """Look up the results of an experiment's runs, as far as there are any."""
        rows = (
            ScoredRow(row.name, row.strength, row.parameters, tuple(_scores(row.runs, results)))
            for row in experiment.rows
        )
        return cls(experiment, tuple(rows))

    def complete(self, finished: Collection[Run]) -> ScoredExperiment:
        """Leave out rows of which a run was not done: means over other bags mislead."""
        kept = [
            scored
            for row, scored in zip(self.experiment.rows, self.rows, strict=True)
            if set(finished).issuperset(row.runs)
        ]
        return replace(self, rows=tuple(kept))

    def by_effect(self) -> ScoredExperiment:
        """Put what changes the mean J most first, behind the row that all are held against."""
        reference = self.rows[0].mean["j"] if self.rows else None

        def effect(row: ScoredRow) -> float:
            j = row.mean["j"]
            return 0.0 if j is None or reference is None else abs(j - reference)

        return replace(
            self, rows=(*self.rows[:1], *sorted(self.rows[1:], key=effect, reverse=True))
        )

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

    @property
    def idle_reasons(self) -> list[str]:
        """Why variants were not run, each reason once."""
        return list(dict.fromkeys(self.experiment.idle.values()))

    def as_json(self) -> list[dict[str, Any]]:
        """Return the rows as JSON has them."""
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
    """Return the means over the bags as lines of text: all figures, or of a curve J."""
    if scored.strengths:
        return _curve_table(scored)
    whole = Table.of([row.name for row in scored.rows], scored.experiment.rows_are)
    lines: list[str] = []
    for table in whole.fitted():
        gap = [""] if lines else []
        lines += [*gap, table.head, *(table.mean(row.bags, row.name) for row in scored.rows)]
    return [*lines, *(f"not run: {line}" for line in scored.idle_reasons)]


def _curve_table(scored: ScoredExperiment) -> list[str]:
    """Return a line for each strength, a column for each segmenter."""
    columns = [[scored.experiment.strength_name, *(f"{s:g}" for s in scored.strengths)]]
    for name, rows in scored.curves.items():
        means = (row.mean["j"] for row in rows)
        columns.append([f"J {name}", *("-" if j is None else f"{j:.3f}" for j in means)])
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in zip(*columns, strict=True)
    ]


def _scores(runs: Iterable[Run], results: Mapping[Run, RunResult]) -> Iterable[BagScores]:
    return (results[run].scores for run in runs if run in results)
