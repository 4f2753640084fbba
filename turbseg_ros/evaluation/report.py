"""An evaluation as one HTML page that needs nothing else, and its curves as pictures.

Jinja is imported only when a report is asked for.
"""

from __future__ import annotations

import base64
import dataclasses
import importlib.resources
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation.chart import Chart, Line
from turbseg_ros.evaluation.experiments import ScoredExperiment, ScoredRow
from turbseg_ros.evaluation.origin import Origin
from turbseg_ros.evaluation.pictures import FALSE, MISSED, Illustrations, Picture
from turbseg_ros.evaluation.reliability import EDGES, ScoreBin, pooled
from turbseg_ros.evaluation.run import Run, RunResult
from turbseg_ros.evaluation.scores import (
    COLUMNS,
    OBJECT_COLUMNS,
    BagScores,
    mean_scores,
    short_names,
    write_whole,
)
from turbseg_ros.overlay import Colour
from turbseg_ros.parameters import Parameters, Value

PAGE = "index.html"
"""The name of a report's file."""

# Height of a chart that goes with pictures.
_LOW = 200
# Figures that say more of a bag than of what segmented it.
_OF_THE_BAG = ("frames", "scored_frames", "tilt_px")


class ReportError(Exception):
    """A report that can't be made; the text says why and what to do."""


@dataclass(frozen=True)
class Report:
    """What a report tells of: the method's `runs`, one a bag, what it was compared with.

    `command` holds the words of the line that made it, `results` what came of the runs, the
    experiments' among them; `partial` says how much of it was run, where that is not all.
    """

    command: Sequence[str]
    parameters: Parameters
    runs: Sequence[Run]
    experiments: Sequence[ScoredExperiment]
    results: Mapping[Run, RunResult]
    partial: str = ""


class ReportWriter:
    """Makes the page of a report, and pictures of its curves.

    :raises ReportError: when Jinja is not installed.
    """

    def __init__(self) -> None:
        try:
            import jinja2
        except ImportError as error:
            raise ReportError(f"a report needs Jinja: {how_to_install('jinja2')}") from error
        environment = jinja2.Environment(
            loader=jinja2.FunctionLoader(_template_source),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._page = environment.get_template("report.html.jinja")
        self._picture = environment.get_template("chart.svg.jinja")

    def write(self, directory: Path, report: Report) -> Path:
        """Write the page into a directory; return its path.

        :raises OSError: when it can't be written; an older page then stays as it was.
        """
        path = directory / PAGE
        write_whole(path, self.page(report))
        return path

    def write_curves(
        self, directory: Path, experiments: Sequence[ScoredExperiment]
    ) -> Sequence[Path]:
        """Write each curve among the experiments as an SVG file into a directory.

        :raises OSError: when one can't be written; an older one then stays as it was.
        """
        paths = []
        for scored in experiments:
            if scored.strengths:
                paths.append(directory / f"{scored.experiment.key}.svg")
                write_whole(paths[-1], self._picture.render(chart=_curves(scored)))
        return paths

    def page(self, report: Report) -> str:
        """Return the page as HTML."""
        scores = [report.results[run].scores for run in report.runs]
        return self._page.render(
            command=report.command,
            partial=report.partial,
            columns=COLUMNS,
            object_columns=OBJECT_COLUMNS,
            comparable=[column for column in COLUMNS if column.name not in _OF_THE_BAG],
            scores=[dataclasses.asdict(bag) for bag in scores],
            mean=mean_scores(scores),
            reliability=_reliability(scores),
            reliability_curve=_reliability_curve([each for _, each in _reliability(scores)]),
            summary=_summary(scores),
            short=short_names([bag.bag for bag in scores]),
            experiments=[_view(experiment) for experiment in report.experiments],
            bags=[_bag_view(report, run) for run in report.runs],
            parameters=report.parameters.as_mapping(),
            changed=_changed(report.parameters),
            origin=Origin.here_and_now(),
            colours={"missed": _css(MISSED), "false": _css(FALSE)},
            data_uri=_data_uri,
        )


def _reliability(scores: Sequence[BagScores]) -> list[tuple[str, ScoreBin]]:
    """Return the range of each bin of scores, and what is in it, of all bags that have some."""
    given = [bag.score_bins for bag in scores if bag.score_bins]
    ranges = [f"{low:g} to {high:g}" for low, high in itertools.pairwise(EDGES)]
    bins = pooled(given) if given else ()
    return [(text, each) for text, each in zip(ranges, bins, strict=False) if each.objects]


def _reliability_curve(bins: Sequence[ScoreBin]) -> Chart | None:
    """Return the share of true objects over their scores, None where one bin holds them all."""
    points = [(each.mean_score, each.share_true) for each in bins]
    true = tuple(
        (score, share) for score, share in points if score is not None and share is not None
    )
    if len(true) < 2:
        return None
    ideal = tuple((score, score) for score, _ in (true[0], true[-1]))
    lines = (Line("objects that are true", true), Line("as scores say", ideal))
    return Chart("Whether scores are what they say", "score", "share true", lines)


@dataclass(frozen=True)
class _Figure:
    """A figure at the head of the page."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class _ExperimentView:
    """An experiment as the page shows it.

    `by_bag` holds, row by row, each bag's J (None where it has none), `changes` each row's mean J
    less that of the first row; `chart` is there for curves only, `idle` says what was not run, and
    why.
    """

    key: str
    rows_are: str
    rows: Sequence[ScoredRow]
    bag_names: Sequence[str]
    by_bag: Sequence[Sequence[float | None]]
    changes: Sequence[float | None]
    idle: Sequence[str]
    chart: Chart | None


@dataclass(frozen=True)
class _BagView:
    """A bag as the page shows it: `compared` is a frame as each segmenter answered it."""

    scores: BagScores
    illustrations: Illustrations | None
    chart: Chart | None
    compared: Sequence[tuple[str, Picture]]


def _template_source(name: str) -> str:
    return importlib.resources.files(__package__).joinpath(name).read_text("utf-8")


def _summary(scores: Sequence[BagScores]) -> list[_Figure]:
    mean = mean_scores(scores)
    with_ids = [bag.id_switches for bag in scores if bag.id_switches is not None]
    figures = [
        ("J", mean["j"], ".3f", "mean over the bags that hold an object"),
        ("G", mean["g"], ".3f", "mean of J and Dice"),
        ("Boundary F", mean["boundary_f"], ".3f", "outlines, as in the DAVIS benchmark"),
        ("J object", mean["j_object"], ".3f", "each true object beside its best label"),
        ("False objects", mean["false_objects"], ".2f", "a frame, with true objects or without"),
        ("False alarms", mean["false_alarm_area"], ".3%", "of the picture, where nothing moves"),
        ("Id switches", sum(with_ids) if with_ids else None, "d", "in all bags together"),
        ("Speed", mean["fps"], ".1f", "frames a second; runs share the cores"),
    ]
    return [
        _Figure(name, "-" if value is None else format(value, form), note)
        for name, value, form, note in figures
    ]


def _view(scored: ScoredExperiment) -> _ExperimentView:
    bag_names = list(dict.fromkeys(bag.bag for row in scored.rows for bag in row.bags))
    by_bag = []
    for row in scored.rows:
        j = {bag.bag: bag.j for bag in row.bags}
        by_bag.append([j.get(name) for name in bag_names])
    means = [row.mean["j"] for row in scored.rows]
    first = means[0] if means else None
    return _ExperimentView(
        key=scored.experiment.key,
        rows_are=scored.experiment.rows_are,
        rows=scored.rows,
        bag_names=bag_names,
        by_bag=by_bag,
        changes=[None if j is None or first is None else j - first for j in means],
        idle=scored.idle_reasons,
        chart=_curves(scored) if scored.strengths else None,
    )


def _curves(scored: ScoredExperiment) -> Chart:
    titles = {
        "tilt_curve": ("J against added turbulence", "added tilt, rms an axis in pixels"),
        "shake_curve": (
            "J against added shake",
            "added step from frame to frame, rms an axis in pixels",
        ),
    }
    title, x_label = titles[scored.experiment.key]
    lines = []
    for name, rows in scored.curves.items():
        points = [(row.strength, row.mean["j"]) for row in rows]
        lines.append(
            Line(name, tuple((x, y) for x, y in points if x is not None and y is not None))
        )
    return Chart(title, x_label, "mean J", tuple(lines), tuple(scored.strengths))


def _bag_view(report: Report, run: Run) -> _BagView:
    result = report.results[run]
    illustrations = result.illustrations
    chart = None
    if illustrations is not None and len(illustrations.j) > 1:
        line = Line("J", tuple((float(frame), j) for frame, j in illustrations.j))
        title = f"J in each frame of {run.source.name}"
        chart = Chart(title, "frame", "J", (line,), marked=False, height=_LOW)
    return _BagView(result.scores, illustrations, chart, _compared(report, run))


def _compared(report: Report, run: Run) -> list[tuple[str, Picture]]:
    """Return one frame of a bag as each segmenter answered it, from well into the clip."""
    pictures = []
    for experiment in report.experiments:
        if experiment.experiment.key != "baselines":
            continue
        for row in experiment.experiment.rows:
            for candidate in row.runs:
                result = report.results.get(candidate)
                if candidate.source == run.source and result and result.illustrations:
                    tiles = result.illustrations.tiles
                    pictures.append((row.name, tiles[2 * len(tiles) // 3]))
    return pictures


def _changed(parameters: Parameters) -> dict[str, Value]:
    defaults = Parameters().as_mapping()
    return {
        name: value for name, value in parameters.as_mapping().items() if value != defaults[name]
    }


def _css(colour: Colour) -> str:
    blue, green, red = colour
    return f"rgb({red} {green} {blue})"


def _data_uri(picture: Picture) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(picture.jpeg).decode('ascii')}"
