"""`turbseg_evaluate`: bags through the method, scored against the truth that they hold."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Iterable, Iterator, Sequence

from tqdm import tqdm

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.section import WHOLE
from turbseg_ros.cli.errors import Interrupted, UsageError, executable, interrupted_after
from turbseg_ros.cli.memory import keep_large_buffers
from turbseg_ros.cli.options import (
    job_progress,
    parameters_from,
    parsed_override,
    section_from,
    with_progress,
)
from turbseg_ros.cli.outputs import check_file, check_folder
from turbseg_ros.cli.parsers.evaluate import build_parser
from turbseg_ros.evaluation.baselines import (
    TurbsegMethod,
    UnknownBaselineError,
    baselines,
)
from turbseg_ros.evaluation.comparison import ComparisonError, compare, comparison_table
from turbseg_ros.evaluation.evaluate import EvaluationError, evaluate_labels
from turbseg_ros.evaluation.experiments import (
    Experiment,
    ScoredExperiment,
    ablation,
    against_baselines,
    comparison,
    sensitivity,
    shake_curve,
    text_table,
    tilt_curve,
)
from turbseg_ros.evaluation.labels import read_labels
from turbseg_ros.evaluation.report import PAGE, Report, ReportError, ReportWriter
from turbseg_ros.evaluation.run import Run, RunResult, Source
from turbseg_ros.evaluation.scores import (
    COLUMNS,
    OBJECT_COLUMNS,
    BagScores,
    Table,
    write_json,
)
from turbseg_ros.evaluation.table_files import tables_of, write_tables
from turbseg_ros.evaluation.truth import read_ignored, read_truth
from turbseg_ros.execution import ClusterError, Failure, Runner, job_runner, usable_workers
from turbseg_ros.parameters import Parameters
from turbseg_ros.region_file import marked_regions
from turbseg_ros.segmentation.marked_regions import MarkedRegions

_METHOD = "turbseg"
_EXPERIMENTS = (
    *("baselines", "variant", "ablation", "sensitivity"),
    *("tilt_curve", "shake_curve"),
)
# With more runs than this, what is ahead is said.
_FEW_RUNS = 2


@executable("turbseg_evaluate")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; return its exit status, 1 when a bag couldn't be scored."""
    options = build_parser().parse_args(arguments)
    if options.compare is not None:
        return _compare(options)
    keep_large_buffers()
    _check(options)
    parameters = parameters_from(options)
    try:
        if options.predictions is not None:
            return _score_recorded(options, marked_regions(parameters.regions))
        return _evaluate(options, parameters, sys.argv[1:] if arguments is None else arguments)
    except (ClusterError, EvaluationError, ReportError, UnknownBaselineError) as error:
        raise UsageError(str(error)) from error


def _compare(options: argparse.Namespace) -> int:
    """Print how two evaluations differ."""
    if options.bags:
        raise UsageError("--compare takes two JSON files and no BAG")
    try:
        print(*comparison_table(compare(*options.compare)), sep="\n")
    except ComparisonError as error:
        raise UsageError(str(error)) from error
    return 0


def _check(options: argparse.Namespace) -> None:
    if not options.bags:
        raise UsageError("name a BAG, or two JSON files with --compare")
    if options.predictions is not None:
        if len(options.bags) > 1:
            raise UsageError("--predictions are those of one BAG; give one")
        for name in (*_EXPERIMENTS, "report", "curves", "start", "duration"):
            if getattr(options, name):
                option = name.replace("_", "-")
                raise UsageError(f"--{option} segments anew; leave out --predictions")
    if len(set(options.bags)) < len(options.bags):
        raise UsageError("a BAG is named twice")
    if options.curves is not None and not (options.tilt_curve or options.shake_curve):
        raise UsageError("--curves draws those of --tilt-curve and --shake-curve; give one")
    if options.json is not None:
        check_file(options.json)
    if options.report is not None:
        check_file(options.report / PAGE)
    for folder in (options.curves, options.csv, options.latex):
        if folder is not None:
            check_folder(folder)


def _score_recorded(options: argparse.Namespace, marked: MarkedRegions) -> int:
    """Score labels that were recorded, against the truth in the bag that they were found in."""
    (bag,) = options.bags
    reader = BagReader(bag)
    truth = read_truth(reader, options.truth_topic)
    predictions = read_labels(BagReader(options.predictions), options.labels_topic)
    scores = evaluate_labels(str(bag), predictions, truth, read_ignored(reader), marked)
    for columns in (COLUMNS, OBJECT_COLUMNS):
        print(*_tables([scores], Table.of_bags([scores.bag], columns).fitted()), sep="\n")
    if options.json is not None:
        # Who made them, and with which parameters, is not known.
        write_json(options.json, [scores], {})
    return 0


def _evaluate(
    options: argparse.Namespace, parameters: Parameters, arguments: Sequence[str]
) -> int:
    """Segment and score the bags, and whatever is to be compared on those that can be scored."""
    writer = ReportWriter() if options.report or options.curves else None
    runs = _trials(options, parameters)
    planned = [run for each in _experiments(options, parameters, runs) for run in each.runs]
    ahead = len({*runs, *planned})
    workers = min(options.workers or usable_workers(), ahead)
    evaluation = _Evaluation(ahead, workers)
    status = 0
    try:
        with job_runner(workers, options.scheduler, job_progress) as doing:
            _run_all(evaluation, doing, options, parameters, runs)
    except Interrupted as interrupted:
        # Signals are ignored from here on: what is done is written.
        status = int(interrupted.code or 0)
    scored = [run for run in runs if run in evaluation.results]
    compared = [
        ScoredExperiment.of(each, evaluation.results).complete(evaluation.finished)
        for each in _experiments(options, parameters, scored)
    ]
    compared = [
        each.by_effect() if each.experiment.key == "sensitivity" else each
        for each in compared
        if each.rows
    ]
    for each in compared:
        print("", *text_table(each), sep="\n")
    partial = interrupted_after(len(evaluation.finished), ahead, "runs") if status else ""
    if partial:
        kept = "what is done is kept" if scored else "nothing to keep"
        print(f"turbseg_evaluate: {partial}; {kept}", file=sys.stderr)
    if scored:
        command = ["turbseg_evaluate", *map(shlex.quote, arguments)]
        report = Report(command, parameters, scored, compared, evaluation.results, partial)
        _write(options, report, writer)
    return status or int(evaluation.failed)


def _run_all(
    evaluation: _Evaluation,
    runner: Runner[RunResult],
    options: argparse.Namespace,
    parameters: Parameters,
    runs: Sequence[Run],
) -> None:
    """Run the method on each bag, and what is to be compared on those that can be scored."""
    _print_scores(evaluation, runner, runs)
    scored = [run for run in runs if run in evaluation.results]
    experiments = _experiments(options, parameters, scored)
    for _ in evaluation.run(runner, [run for each in experiments for run in each.runs]):
        pass


def _write(options: argparse.Namespace, report: Report, writer: ReportWriter | None) -> None:
    """Write the files that were asked for; `writer` is there when it is needed."""
    if options.json is not None:
        scores = [report.results[run].scores for run in report.runs]
        tables: dict[str, object] = {}
        for each in report.experiments:
            tables[each.experiment.key] = each.as_json()
            if each.experiment.idle:
                tables[f"{each.experiment.key}_idle"] = dict(each.experiment.idle)
        if report.partial:
            tables["partial"] = report.partial
        write_json(options.json, scores, report.parameters.as_mapping(), tables)
    scored = [report.results[run].scores for run in report.runs]
    for path in write_tables(tables_of(scored, report.experiments), options.csv, options.latex):
        print(f"\n{path}")
    if writer is not None and options.curves is not None:
        for path in writer.write_curves(options.curves, report.experiments):
            print(f"\n{path}")
    if writer is not None and options.report is not None:
        print(f"\n{writer.write(options.report, report)}")


def _trials(options: argparse.Namespace, parameters: Parameters) -> list[Run]:
    """Return one run of the method for each bag."""
    method = TurbsegMethod(_METHOD, parameters)
    return [
        Run(
            # Another process may have another working directory.
            Source(
                str(bag),
                bag.absolute(),
                options.image_topic,
                options.truth_topic,
                section_from(options),
                parameters.regions,
            ),
            method,
            illustrated=options.report is not None,
        )
        for bag in options.bags
    ]


def _experiments(
    options: argparse.Namespace, parameters: Parameters, runs: Sequence[Run]
) -> list[Experiment]:
    """Plan what was asked for beside the scores of the method in `runs`."""
    if not runs:
        return []
    experiments = []
    chosen = baselines(options.baselines, parameters)
    if any(method.recorded for method in chosen) and section_from(options) != WHOLE:
        raise UsageError("masks of --baselines are of whole clips; leave out --start, --duration")
    if chosen:
        experiments.append(against_baselines(runs, chosen))
    # What others found stays as it is, whatever happens to the frames.
    methods = [runs[0].method, *(method for method in chosen if not method.recorded)]
    if options.tilt_curve:
        experiments.append(tilt_curve(runs, methods, options.tilt_curve, options.seed))
    if options.shake_curve:
        experiments.append(shake_curve(runs, methods, options.shake_curve, options.seed))
    if options.variant:
        changes = [dict([parsed_override(each)]) for each in options.variant]
        experiments.append(comparison(runs, parameters, changes))
    if options.ablation:
        experiments.append(ablation(runs, parameters))
    if options.sensitivity:
        experiments.append(sensitivity(runs, parameters))
    return experiments


class _Evaluation:
    """Does runs, none twice, and keeps their results; says what failed and why, once.

    Where many are ahead, it says how many, and after the first ones about how long they take.
    """

    def __init__(self, ahead: int, workers: int) -> None:
        self._ahead = ahead
        self._workers = workers
        self._reasons: set[str] = set()
        self._began: float | None = None
        self.results: dict[Run, RunResult] = {}
        self.finished: set[Run] = set()

    @property
    def failed(self) -> bool:
        """Whether a run came to nothing."""
        return bool(self._reasons)

    def run(self, runner: Runner[RunResult], runs: Iterable[Run]) -> Iterator[RunResult]:
        """Do the runs that are not done yet; return the results of those that succeed."""
        new = [run for run in dict.fromkeys(runs) if run not in self.results]
        if self._began is None:
            self._began = time.monotonic()
            if self._ahead > _FEW_RUNS:
                _say(f"{self._ahead} runs ahead, {self._workers} at a time")
        outcomes = zip(new, runner(new), strict=True)
        progress = with_progress(outcomes, "evaluation", total=len(new), unit="run")
        for run, outcome in progress:
            # In this order: an interruption in between counts no run whose result isn't kept.
            if isinstance(outcome, Failure):
                self._report(outcome.reason)
            else:
                self.results[run] = outcome
            self.finished.add(run)
            self._estimate(time.monotonic() - self._began)
            if isinstance(outcome, RunResult):
                yield outcome

    def _report(self, reason: str) -> None:
        if reason not in self._reasons:
            self._reasons.add(reason)
            _say(reason)

    def _estimate(self, seconds: float) -> None:
        """Say about how long the rest takes, once each worker has shown what one run does."""
        done = len(self.finished)
        left = self._ahead - done
        if self._ahead > _FEW_RUNS and left and done == max(self._workers, _FEW_RUNS):
            _say(f"{left} runs are left, about {_rough(seconds / done * left)}")


def _say(line: str) -> None:
    tqdm.write(f"turbseg_evaluate: {line}", file=sys.stderr)


def _rough(seconds: float) -> str:
    """Return a duration with no more precision than an estimate has."""
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _print_scores(evaluation: _Evaluation, runner: Runner[RunResult], runs: Sequence[Run]) -> None:
    """Run the method on each bag and print a line of scores as soon as they are there."""
    table, *rest = Table.of_bags([run.source.name for run in runs]).fitted()
    print(table.head, flush=True)
    scored = []
    try:
        for result in evaluation.run(runner, runs):
            scored.append(result.scores)
            tqdm.write(table.row(result.scores))
    finally:
        # Of those that there are, when the rest is given up.
        if len(scored) > 1:
            print(table.mean(scored), flush=True)
        if scored:
            rest += Table.of_bags([scores.bag for scores in scored], OBJECT_COLUMNS).fitted()
            print("", *_tables(scored, rest), sep="\n", flush=True)


def _tables(scored: Sequence[BagScores], tables: Sequence[Table]) -> list[str]:
    """Return the lines of tables, one after another, with their means."""
    lines: list[str] = []
    for table in tables:
        gap = [""] if lines else []
        mean = [table.mean(scored)] if len(scored) > 1 else []
        lines += [*gap, table.head, *map(table.row, scored), *mean]
    return lines
