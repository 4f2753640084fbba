"""Tables as CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from turbseg_ros.evaluation.scores import BagScores, Measurements, Scorer
from turbseg_ros.evaluation.table_files import as_csv, as_latex, tables_of, write_tables

OBJECT = np.zeros((40, 50), np.uint16)
OBJECT[10:20, 10:20] = 1


def scored(bag: str, truth: np.ndarray) -> BagScores:
    scorer = Scorer()
    scorer.add(OBJECT, truth)
    return scorer.scores(bag, 1, Measurements())


BAGS = [scored("a_b & c", OBJECT), scored("100%", np.zeros_like(OBJECT))]


def test_csv_has_every_figure_in_full_under_the_names_of_the_json() -> None:
    (table,) = tables_of(BAGS, [])
    rows = list(csv.DictReader(io.StringIO(as_csv(table))))
    assert [row["bag"] for row in rows] == ["a_b & c", "100%", "mean"]
    assert [row["j"] for row in rows] == ["1.0", "", "1.0"]
    assert [float(row["false_objects"]) for row in rows] == [0.0, 1.0, 0.5]
    assert float(rows[1]["false_alarm_area"]) == 0.05


def test_latex_escapes_names_and_leaves_out_empty_columns() -> None:
    (table,) = tables_of(BAGS, [])
    lines = as_latex(table).splitlines()
    assert lines[0].startswith(r"\begin{tabular}{lr")
    assert lines[-1] == r"\end{tabular}"
    head, *rows = [line.removesuffix(r" \\").split(" & ") for line in lines if " & " in line]
    assert "bound F" in head and "fps" not in head
    assert rows[1][0] == r"100\%"
    assert rows[1][head.index("area")] == r"5.000\%"
    assert lines[4].startswith(r"a\_b \& c & 1 & 1 & 1.000")
    assert len(lines[0].partition("{tabular}")[2]) == len(head) + 2


def test_tables_are_files_of_their_names(tmp_path: Path) -> None:
    written = list(write_tables(tables_of(BAGS, []), tmp_path, tmp_path))
    assert [path.name for path in written] == ["bags.csv", "bags.tex"]
    assert all(path.read_text() for path in written)
    assert list(write_tables(tables_of(BAGS, []), None, None)) == []
