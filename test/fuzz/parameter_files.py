"""Fuzz parameter files: whatever one holds, it gives parameters, or is refused in one line.

An input that begins with N names its node in its first line, any other speaks to the node that
the file itself names.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["turbseg_ros", "yaml"]):
    from turbseg_ros.parameter_file import load_parameters
    from turbseg_ros.parameters import ParameterError, Parameters

FILE = Path(tempfile.mkdtemp(prefix="fuzz_parameters_")) / "parameters.yaml"


def try_one(data: bytes) -> None:
    node = None
    if data[:1] == b"N":
        name, _, data = data[1:].partition(b"\n")
        node = name.decode("utf-8", "replace")
    FILE.write_bytes(data)
    try:
        parameters = load_parameters(FILE, node)
    except ParameterError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 2000
        return
    # What was taken is within its ranges, and may be given again.
    assert Parameters.from_mapping(parameters.as_mapping()) == parameters


if __name__ == "__main__":
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
