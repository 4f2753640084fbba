"""What command lines offer: presets, the node's topics, completion by the shell."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.result_topics import fresh_outputs
from turbseg_ros.cli.options import parameters_from
from turbseg_ros.cli.parsers import replay
from turbseg_ros.cli.parsers.node import OUTPUTS, build_parser
from turbseg_ros.messages.results import views
from turbseg_ros.parameters import ParameterError, Parameters, declarations


def parsed(*arguments: str) -> Parameters:
    return parameters_from(replay.build_parser().parse_args(["bag", "-o", "out", *arguments]))


def test_a_file_goes_before_a_preset_and_the_command_line_before_both(tmp_path: Path) -> None:
    severe = parsed("--preset", "severe")
    assert (severe.flow.interval, severe.tracking.min_hits) == (6, 8)
    own = tmp_path / "own.yaml"
    own.write_text("turbseg: {ros__parameters: {tracking: {min_hits: 5, max_age: 40}}}")
    given = ("--params-file", str(own), "-p", "tracking.max_age:=50", "--preset", "severe")
    mixed = parsed(*given)
    assert (mixed.flow.interval, mixed.tracking.min_hits, mixed.tracking.max_age) == (6, 5, 50)


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(ParameterError, match="did you mean thermal"):
        parsed("--preset", "termal")
    # The node blocks signals in the process that it runs in.
    finished = subprocess.run(
        [sys.executable, "-m", "turbseg_ros.cli", "node", "--preset", "termal"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert finished.returncode == 2
    assert finished.stderr == "turbseg_node: no preset 'termal'; did you mean thermal?\n"


def test_the_nodes_help_names_all_topics_and_parameters() -> None:
    published = {output.name for output in (*fresh_outputs(0), *views())}
    told = {name.removeprefix("~/") for name, _, _ in OUTPUTS}
    assert told == published | {"objects/slot_N/mask", "/diagnostics"}
    text = build_parser().format_help()
    assert all(name in text for name, _, _ in OUTPUTS)
    assert all(f"\n  {declared.name}\n" in text for declared in declarations())
    # Before all that there is to know comes how it is called.
    assert text.index("--preset NAME") < text.index("topics that")


def test_the_shell_completes_options(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete")
    line = "turbseg_replay --obj"
    answer = tmp_path / "answer"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    program = "from turbseg_ros.cli.__main__ import replay; replay()"
    subprocess.run([sys.executable, "-c", program], env=environment, timeout=100, check=True)
    offered = {word.strip() for word in answer.read_text().split("\x0b")}
    assert offered == {"--objects", "--object-pictures"}
