"""What stands in a file can't take a terminal over by an error's text, nor fill it."""

from __future__ import annotations

from pathlib import Path

import pytest

from turbseg_ros.one_line import printable
from turbseg_ros.parameter_file import load_parameters
from turbseg_ros.parameters import ParameterError


def test_what_a_terminal_would_obey_is_written_out() -> None:
    assert printable("a\x1b[31m\n b\u202e\ud800", 99) == r"a\x1b[31m b\u202e\ud800"
    assert printable("abcdef", 3) == "abc..."


@pytest.mark.parametrize(
    "text",
    [
        '/**: {ros__parameters: {"\\x1b[2J": 3}}',
        '/**: {ros__parameters: {image_transport: "\\x1b[2J"}}',
        f"/**: {{ros__parameters: {{{'a' * 9999}: 3}}}}",
        f"/**: {{ros__parameters: {{max_objects: {'a' * 9999}}}}}",
        "/**: {ros__parameters: {max_objects: " + "[1, " * 200,
        "/**: {ros__parameters: {max_objects: [" + "1, " * 999 + "]}}",
        '"\\x07": {ros__parameters: 3}',
    ],
)
def test_a_bad_parameter_file_is_one_short_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        load_parameters(file)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1100
