"""Tables of scores as files: CSV for programs, LaTeX for papers."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turbseg_ros.evaluation.experiments import ScoredExperiment
from turbseg_ros.evaluation.scores import (
    COLUMNS,
    OBJECT_COLUMNS,
    BagScores,
    mean_scores,
    write_whole,
)

# Both tables of the terminal as one; what both have stands once.
_COLUMNS = tuple({column.name: column for column in (*COLUMNS, *OBJECT_COLUMNS)}.values())
_LATEX = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "\\": r"\textbackslash{}",
}


@dataclass(frozen=True)
class NamedTable:
    """A table of scores: its name, what its rows are, and their figures by their names."""

    name: str
    rows_are: str
    rows: Sequence[tuple[str, Mapping[str, Any]]]


def tables_of(
    bags: Sequence[BagScores], experiments: Sequence[ScoredExperiment]
) -> list[NamedTable]:
    """Return the table of the bags, with their mean, and one for each experiment.

    Rows of a curve are named by their segmenter and strength.
    """
    rows: list[tuple[str, Mapping[str, Any]]] = [(b.bag, dataclasses.asdict(b)) for b in bags]
    tables = [NamedTable("bags", "bag", [*rows, ("mean", mean_scores(bags))])]
    for each in experiments:
        named = [
            (row.name if row.strength is None else f"{row.name} {row.strength:g} px", row.mean)
            for row in each.rows
        ]
        tables.append(NamedTable(each.experiment.key, each.experiment.rows_are, named))
    return tables


def as_csv(table: NamedTable) -> str:
    """Return a table as CSV: names as in the JSON, figures in full, empty where there is none."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([table.rows_are, *(column.name for column in _COLUMNS)])
    for name, figures in table.rows:
        values = (figures[column.name] for column in _COLUMNS)
        writer.writerow([name, *("" if value is None else value for value in values)])
    return text.getvalue()


def as_latex(table: NamedTable) -> str:
    """Return a table as a LaTeX `tabular`, of those columns in which some row has a figure."""
    columns = [
        column
        for column in _COLUMNS
        if any(figures[column.name] is not None for _, figures in table.rows)
    ]
    lines = [
        rf"\begin{{tabular}}{{l{'r' * len(columns)}}}",
        r"\hline",
        _latex_row([table.rows_are, *(column.title for column in columns)]),
        r"\hline",
        *(_latex_row([name, *(c.text(figures) for c in columns)]) for name, figures in table.rows),
        r"\hline",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def write_tables(
    tables: Sequence[NamedTable], csv_folder: Path | None, latex_folder: Path | None
) -> Iterator[Path]:
    """Write each table into the folders that are given; return the files' paths.

    :raises OSError: when one can't be written; an older one then stays as it was.
    """
    for table in tables:
        for folder, suffix, made in ((csv_folder, "csv", as_csv), (latex_folder, "tex", as_latex)):
            if folder is not None:
                path = folder / f"{table.name}.{suffix}"
                write_whole(path, made(table))
                yield path


def _latex_row(cells: Sequence[str]) -> str:
    escaped = ("".join(_LATEX.get(character, character) for character in cell) for cell in cells)
    return " & ".join(escaped) + r" \\"
