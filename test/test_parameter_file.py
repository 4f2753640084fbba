"""Parameter files, as ROS takes them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rclpy.context import Context
from rclpy.node import Node

from support.parameter_values import MAPPINGS
from turbseg_ros.parameter_file import load_parameters, parsed
from turbseg_ros.parameters import ParameterError, Parameters, belongs_to_middleware

CONFIG = Path(__file__).parent.parent / "config"
PRESETS = sorted(CONFIG.glob("*.yaml"))


def write(path: Path, text: str) -> Path:
    file = path / "parameters.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def section(values: object, name: str = "/**") -> str:
    return yaml.safe_dump({name: {"ros__parameters": values}})


def test_a_file_names_parameters_in_groups_or_with_dots(tmp_path: Path) -> None:
    file = write(tmp_path, section({"flow": {"interval": 6}, "seed.size": 5, "max_objects": 3}))
    expected = {"flow.interval": 6, "seed.size": 5, "max_objects": 3}
    assert load_parameters(file) == Parameters.from_mapping(expected)


@settings(deadline=None)
@given(values=MAPPINGS)
def test_a_file_goes_round(tmp_path_factory: pytest.TempPathFactory, values: dict) -> None:
    file = write(tmp_path_factory.getbasetemp(), section(values))
    assert load_parameters(file) == Parameters.from_mapping(values)


@pytest.mark.parametrize("name", ["/**", "/*", "turbseg", "/turbseg", "/**/turbseg"])
def test_a_section_that_speaks_to_the_node_is_read(tmp_path: Path, name: str) -> None:
    file = write(tmp_path, section({"flow.interval": 6}, name))
    assert load_parameters(file).flow.interval == 6


def test_sections_may_be_nested(tmp_path: Path) -> None:
    inner = "  turbseg: {ros__parameters: {flow.interval: 6}}\n"
    file = write(tmp_path, f"north:\n{inner}/**:\n{inner}")
    assert load_parameters(file).flow.interval == 6
    assert load_parameters(file, "/south/turbseg").flow.interval == 6


def test_of_two_sections_the_later_one_holds(tmp_path: Path) -> None:
    text = section({"seed.size": 5, "flow.interval": 6}, "turbseg") + section(
        {"seed.size": 7, "max_objects": 3}
    )
    parameters = load_parameters(write(tmp_path, text))
    assert (parameters.seed.size, parameters.flow.interval, parameters.max_objects) == (7, 6, 3)


def test_the_only_node_that_a_file_names_is_meant(tmp_path: Path) -> None:
    text = section({"seed.size": 5}, "/north/turbseg") + section({"seed.size": 7}, "/east/camera")
    assert load_parameters(write(tmp_path, text)).seed.size == 5


def test_of_several_nodes_one_has_to_be_chosen(tmp_path: Path) -> None:
    text = section({"seed.size": 5}, "/north/turbseg") + section({"seed.size": 7}, "south/turbseg")
    file = write(tmp_path, text)
    with pytest.raises(ParameterError, match="choose one: /north/turbseg, /south/turbseg"):
        load_parameters(file)
    assert load_parameters(file, "/south/turbseg").seed.size == 7
    with pytest.raises(ParameterError, match="no section for node /west/turbseg"):
        load_parameters(file, "west/turbseg")


PATTERNS = st.lists(
    st.sampled_from(["north", "turbseg", "roof", "*", "**"]), min_size=1, max_size=3
).map("/".join)


@settings(max_examples=60, deadline=None)
@given(
    patterns=st.lists(st.tuples(PATTERNS, st.booleans()), min_size=1, max_size=4),
    namespace=st.sampled_from(["", "/north", "/north/roof"]),
)
def test_sections_speak_to_the_nodes_that_ros_gives_them_to(
    tmp_path_factory: pytest.TempPathFactory,
    context: Context,
    patterns: list[tuple[str, bool]],
    namespace: str,
) -> None:
    sizes = {
        f"/{pattern}" if rooted or pattern.startswith("*") else pattern: 3 + 2 * number
        for number, (pattern, rooted) in enumerate(patterns)
    }
    text = "".join(section({"seed.size": size}, name) for name, size in sizes.items())
    file = write(tmp_path_factory.getbasetemp(), text)
    node = Node(
        "turbseg",
        context=context,
        namespace=namespace,
        cli_args=["--ros-args", "--params-file", str(file)],
        automatically_declare_parameters_from_overrides=True,
    )
    given_by_ros = node.get_parameter_or("seed.size").value
    node.destroy_node()
    try:
        read = load_parameters(file, f"{namespace}/turbseg").seed.size
    except ParameterError:
        read = None
    assert read == given_by_ros


def test_patterns_of_many_wildcards_are_matched_at_once(tmp_path: Path) -> None:
    name = "a/" * 30 + "turbseg"
    text = section({"seed.size": 5}, name) + section({"seed.size": 7}, "/**" * 30 + "/b")
    assert load_parameters(write(tmp_path, text)).seed.size == 5
    text += section({"seed.size": 9}, "/**" * 30 + "/turbseg")
    assert load_parameters(write(tmp_path, text)).seed.size == 9


def test_a_number_of_many_digits_is_too_large(tmp_path: Path) -> None:
    file = write(tmp_path, f"/**: {{ros__parameters: {{max_objects: {'9' * 5000}}}}}")
    with pytest.raises(ParameterError, match="max_objects takes a whole number"):
        load_parameters(file)


def values_of_ros(file: Path, context: Context) -> dict[str, object]:
    """Return what ROS itself makes of a parameter file, for a node /turbseg."""
    node = Node(
        "turbseg",
        context=context,
        cli_args=["--ros-args", "--params-file", str(file)],
        automatically_declare_parameters_from_overrides=True,
    )
    values = {name: given.value for name, given in node.get_parameters_by_prefix("").items()}
    node.destroy_node()
    return {name: value for name, value in values.items() if not belongs_to_middleware(name)}


# What YAML libraries read otherwise than ROS does.
SCALARS = [
    *("25e-1", "1e0", "1E5", "2e+2", "+.5", "5.", "-0.0", "0x1F", "010", "08", "-0", "0x1.8p3"),
    *("1_000", "1:30", "2001-01-01", "0b11", "0o17", "null", "~", "1e400", "1e-320", "0e9"),
    *("y", "N", "on", "Off", "YES", "tRue", ".nan", "-.inf", ".iNf", "inf", "Infinity", "NaN"),
    *("9223372036854775807", "9223372036854775808", "-9223372036854775809", "1.0.0", "0x", "1e"),
    *("'3'", '"on"', "!!str 3", "!!str 25e-1", "!!int 3.5", "!!float 3", "!!bool yes", "!own 3"),
]
WRITTEN = st.sampled_from(SCALARS) | st.from_regex(
    r"[+-]?(0[xX])?[0-9]{0,4}\.?[0-9]{0,3}([eE][+-]?[0-9]{1,2})?", fullmatch=True
).filter(lambda text: text not in ("", "-"))


@settings(max_examples=100, deadline=None)
@given(written=st.lists(WRITTEN, min_size=1, max_size=8))
@example(written=SCALARS)
def test_values_are_what_ros_makes_of_them(
    tmp_path_factory: pytest.TempPathFactory, context: Context, written: list[str]
) -> None:
    lines = "".join(f"    p{number}: {text}\n" for number, text in enumerate(written))
    file = write(tmp_path_factory.getbasetemp(), f"/**:\n  ros__parameters:\n{lines}")
    mine = parsed(file.read_text())["/**"]["ros__parameters"]
    # As texts: 1, 1.0 and True are equal, NaN is not.
    assert {name: repr(value) for name, value in mine.items()} == {
        name: repr(value) for name, value in values_of_ros(file, context).items()
    }


def test_keys_that_come_twice_mean_what_they_mean_to_ros(tmp_path: Path, context: Context) -> None:
    text = (
        section({"seed.size": 5, "flow": {"interval": 2}})
        + section({"seed.size": 7}, "/turbseg")
        + section({"seed.size": 9, "flow": {"every": 2}})
    )
    file = write(tmp_path, text)
    assert load_parameters(file) == Parameters.from_mapping(values_of_ros(file, context))


@pytest.mark.parametrize(
    "text",
    [
        "north: &n {ros__parameters: {seed.size: 5}}\n/**: *n\n",
        "/**: {ros__parameters: {seed.size: }}\n",
    ],
    ids=["alias", "no value"],
)
def test_what_ros_refuses_is_refused(tmp_path: Path, context: Context, text: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(RuntimeError):
        values_of_ros(file, context)
    with pytest.raises(ParameterError, match=r"line \d: "):
        load_parameters(file)


def test_what_ros2_param_dump_writes_is_read(tmp_path: Path, context: Context) -> None:
    """It writes what the node has, in groups, as PyYAML writes it."""
    parameters = Parameters().replace(
        {"outline.threshold": 2.5, "diagnostics.min_rate": 1e-05, "flow.interval": 6}
    )
    dumped: dict = {"use_sim_time": False, "start_type_description_service": True}
    dumped["qos_overrides"] = {"/parameter_events": {"publisher": {"depth": 1000}}}
    for name, value in parameters.as_mapping().items():
        *groups, last = name.split(".")
        group = dumped
        for part in groups:
            group = group.setdefault(part, {})
        group[last] = value
    file = write(tmp_path, section(dumped, "/turbseg"))
    assert load_parameters(file) == parameters
    assert Parameters.from_mapping(values_of_ros(file, context)) == parameters


def test_other_nodes_sections_and_the_middlewares_names_are_passed_over(tmp_path: Path) -> None:
    own = {"flow.interval": 6, "use_sim_time": True, "qos_overrides": {"/x": {"depth": 1}}}
    text = section({"exposure": 3}, "/camera_driver") + section(own)
    assert load_parameters(write(tmp_path, text)) == Parameters.from_mapping({"flow.interval": 6})


def test_an_empty_group_changes_nothing(tmp_path: Path) -> None:
    assert load_parameters(write(tmp_path, section({"flow": {}}))) == Parameters()


MALFORMED = {
    "empty": "",
    "text": "flow.interval",
    "list": "- 1\n- 2\n",
    "unclosed": "/**: {ros__parameters: {seed.size: 3",
    "colons": "a: b: c",
    "tab": "/**:\n\tros__parameters: {}",
    "alias": "/**: *nothing",
    "object": "/**: !!python/object/apply:os.getcwd []",
    "nul": "/**: \0",
    "no parameters": "/**: {}",
    "parameters that are none": "/**:\n  ros__parameters: 3\n",
    "another node only": section({"exposure": 3}, "/camera_driver"),
    "unknown name": section({"flow": {"intervall": 3}}),
    "group for a value": section({"max_objects": {"many": 3}}),
    "value for a group": section({"flow": 3}),
    "nothing for a value": section({"flow": {"interval": None}}),
    "list for a value": section({"flow": {"interval": [1, 2]}}),
    "out of range": section({"flow": {"interval": 99}}),
    "a name that is no text": section({1: 2}),
}


@pytest.mark.parametrize("text", MALFORMED.values(), ids=MALFORMED.keys())
def test_a_malformed_file_is_an_error_of_one_line_that_names_it(tmp_path: Path, text: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(ParameterError) as error:
        load_parameters(file)
    assert str(error.value).startswith(f"{file}: ")
    assert "\n" not in str(error.value)


# Malformed too, but the YAML library or a conversion raises what is not caught.
ESCAPING = {
    "no such day": "/**:\n  ros__parameters: {seed.size: 2001-13-45}",
    "no such float": "/**:\n  ros__parameters: {seed.delta1: !!float x}",
    "no such int": "/**:\n  ros__parameters: {seed.size: !!int ''}",
    "beyond any float": "/**:\n  ros__parameters: {seed.delta1: 1" + 400 * "0" + "}",
    "a group within itself": "/**:\n  ros__parameters: &own\n    flow: *own\n",
}


@pytest.mark.parametrize("text", ESCAPING.values(), ids=ESCAPING.keys())
def test_any_malformed_file_is_an_error_of_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ParameterError, match=r"^[^\n]*$"):
        load_parameters(write(tmp_path, text))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"/**: \xc3\x28"])
def test_a_file_that_is_no_text_is_an_error_of_one_line(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_bytes(content)
    with pytest.raises(ParameterError, match=r"not a YAML file.*$"):
        load_parameters(file)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"missing\.yaml: No such file"):
        load_parameters(tmp_path / "missing.yaml")
    with pytest.raises(ParameterError, match="Is a directory"):
        load_parameters(tmp_path)


def test_there_are_presets_for_live_use_and_for_the_paper() -> None:
    assert {"live.yaml", "paper.yaml"} <= {file.name for file in PRESETS}


@pytest.mark.parametrize("file", PRESETS, ids=lambda file: file.name)
def test_every_preset_loads_and_sets_nothing_without_effect(file: Path) -> None:
    assert load_parameters(file).idle_changes(Parameters()) == []


def test_the_live_preset_is_the_default() -> None:
    assert load_parameters(CONFIG / "live.yaml") == Parameters()


def test_the_papers_preset_is_the_papers_method() -> None:
    paper = load_parameters(CONFIG / "paper.yaml")
    assert paper.motion.measure == "sampson"
    assert paper.growing.similarity == "magnitude"
    assert paper.outline.method == "none"
    assert paper.tracking.mode == "kmeans"
    full = load_parameters(CONFIG / "paper_full.yaml")
    networks = {
        **{"flow.backend": "dis", "refine.mode": "none"},
        "refine.grouping": paper.refine.grouping,
    }
    assert full.flow.backend == "raft_large"
    assert full.refine.mode == "optimise"
    assert full.replace(networks) == paper
