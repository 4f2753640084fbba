"""Command-line options that several executables share.

Parsers are made of these where nothing else is installed: the module itself needs only Python.
"""

from __future__ import annotations

import argparse
import math
import sys
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from turbseg_ros import __version__
from turbseg_ros.bag.section import Section
from turbseg_ros.parameters import Declaration, ParameterError, Parameters, declarations
from turbseg_ros.presets import preset_path

if TYPE_CHECKING:
    from turbseg_ros.bag.frames import BagFrames
    from turbseg_ros.execution import Job, Progress
    from turbseg_ros.segmentation.frame import Frame

T = TypeVar("T")


def command_parser(
    prog: str, description: str, epilog: str | None = None
) -> argparse.ArgumentParser:
    """Return a parser for the arguments of the executable `prog`, which tells its version."""
    parser = argparse.ArgumentParser(prog=prog, description=description, epilog=epilog)
    parser.add_argument("--version", action="version", version=f"{prog} {__version__}")
    return parser


def add_parameter_options(parser: argparse.ArgumentParser) -> None:
    """Add `--preset`, `--params-file`, `--node` and `-p`; list the parameters below the help."""
    group = parser.add_argument_group("parameters")
    add_preset_option(group)
    group.add_argument(
        "--params-file",
        type=Path,
        metavar="YAML",
        help="ROS 2 parameter file of the node, after the preset",
    )
    group.add_argument(
        "--node",
        metavar="NAME",
        help="node whose sections of the file are read, where they are for several "
        "(as /north/turbseg)",
    )
    group.add_argument(
        "-p",
        "--param",
        dest="overrides",
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="set one parameter, after the file; may be repeated",
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = parameter_names()


def add_preset_option(group: argparse._ActionsContainer) -> None:
    """Add `--preset`."""
    group.add_argument(
        "--preset", metavar="NAME", help="a parameter file of the package's config folder: severe"
    )


def parameter_names() -> str:
    """Return all parameters, with what they are, for the end of a help text."""
    return "\n".join(["parameter names:", *map(_described, declarations())])


def add_section_options(parser: argparse.ArgumentParser) -> None:
    """Add `--start` and `--duration`, which choose a part of a recording."""
    parser.add_argument(
        "--start",
        type=seconds,
        default=0.0,
        metavar="S",
        help="begin S seconds after the recording's first message (default: 0)",
    )
    parser.add_argument(
        "--duration", type=positive_number, metavar="S", help="take S seconds (default: all)"
    )


def add_cluster_options(parser: argparse.ArgumentParser, note: str) -> None:
    """Add `--workers` and `--scheduler`, which choose who does the work on several bags."""
    group = parser.add_argument_group("processes", note)
    group.add_argument(
        "--workers",
        type=positive_count,
        metavar="N",
        help="processes on this machine (as many as it has cores)",
    )
    group.add_argument(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler to use, as tcp://host:8786"
    )


def section_from(options: argparse.Namespace) -> Section:
    """Return the part of a recording that the options of `add_section_options` ask for."""
    return Section(options.start, options.duration)


def parameters_from(options: argparse.Namespace) -> Parameters:
    """Return the parameters that the options of `add_parameter_options` ask for.

    What was set and has no effect as the others stand is warned about. A file may be the node's,
    so what only the node reads is warned about where the command line sets it.

    :raises ParameterError: when the file or an override is refused.
    """
    parameters = Parameters()
    if options.preset is not None:
        from turbseg_ros.parameter_file import load_parameters

        parameters = load_parameters(preset_path(options.preset))
    if options.params_file is not None:
        from turbseg_ros.parameter_file import load_parameters

        parameters = load_parameters(options.params_file, options.node, parameters)
    overrides = dict(parsed_override(override) for override in options.overrides)
    parameters = parameters.replace(overrides)
    idle = parameters.idle(replayed=True)
    of_node_only = [line for name, line in idle.items() if name in overrides]
    for line in dict.fromkeys([*parameters.idle_changes(Parameters()), *of_node_only]):
        print(line, file=sys.stderr)
    return parameters


def with_progress(
    items: Iterable[T], title: str, total: int | None = None, unit: str = "frame"
) -> Iterator[T]:
    """Show a progress bar while the items are taken, if standard error is a terminal.

    `total` is how many they are, where they don't know it themselves.
    """
    from tqdm import tqdm
    from tqdm.contrib.logging import logging_redirect_tqdm

    with logging_redirect_tqdm():
        yield from tqdm(
            items,
            desc=title,
            total=total,
            unit=unit,
            dynamic_ncols=True,
            leave=False,
            disable=None,
        )


def job_progress(job: Job[Any]) -> Progress:
    """Return what shows a progress bar for a job while the frames of its bag are taken."""

    def shown(frames: BagFrames) -> Iterator[Frame]:
        return with_progress(frames, job.title, len(frames))

    return shown


def parsed_override(override: str) -> tuple[str, object]:
    """Return the parameter's name, and the value, that NAME:=VALUE gives.

    :raises ParameterError: when it isn't one.
    """
    from turbseg_ros.parameter_file import parsed

    name, separator, value = override.partition(":=")
    if not (name and separator):
        raise ParameterError(f"-p takes NAME:=VALUE, not {override!r}")
    try:
        return name, parsed(value)
    except ParameterError as error:
        raise ParameterError(f"-p {override}: the value is not YAML") from error


def _described(declaration: Declaration) -> str:
    unit = f" [{declaration.unit}]" if declaration.unit else ""
    text = f"{declaration.description} Default: {declaration.default}{unit}."
    if declaration.condition:
        text += f" {declaration.condition}"
    body = textwrap.fill(text, width=92, initial_indent=" " * 6, subsequent_indent=" " * 6)
    return f"  {declaration.name}\n{body}"


def seconds(text: str) -> float:
    """Read a finite number that is not below 0."""
    value = float(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"{text} is not 0 or above")
    return value


def positive_number(text: str) -> float:
    """Read a finite number above 0."""
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def positive_count(text: str) -> int:
    """Read a whole number above 0."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value
