"""Parameters: their names, ranges and files."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from turbseg_ros.parameters import (
    Declaration,
    ParameterError,
    Parameters,
    UnknownParameterError,
    belongs_to_middleware,
    declarations,
    load_parameters,
)

CONFIG = Path(__file__).parent.parent / "config"
PRESETS = sorted(CONFIG.glob("*.yaml"))
DECLARED = {declaration.name: declaration for declaration in declarations()}


def values_of(declaration: Declaration) -> st.SearchStrategy:
    """Any value that a parameter takes."""
    if declaration.choices:
        return st.sampled_from(declaration.choices)
    if declaration.type is bool:
        return st.booleans()
    if declaration.type is int:
        return st.integers(declaration.minimum, declaration.maximum)
    if declaration.type is float:
        return st.floats(declaration.minimum, declaration.maximum)
    return st.text()


MAPPINGS = st.fixed_dictionaries(
    {}, optional={name: values_of(declaration) for name, declaration in DECLARED.items()}
)


def write(path: Path, text: str) -> Path:
    file = path / "parameters.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def section(values: object, name: str = "/**") -> str:
    return yaml.safe_dump({name: {"ros__parameters": values}})


def test_defaults_are_those_declared() -> None:
    assert Parameters().as_mapping() == {name: d.default for name, d in DECLARED.items()}
    assert Parameters.from_mapping({}) == Parameters()


@pytest.mark.parametrize("declaration", declarations(), ids=lambda declaration: declaration.name)
def test_every_parameter_is_described_and_takes_its_default(declaration: Declaration) -> None:
    assert declaration.description.endswith(".")
    assert declaration.check(declaration.default) == declaration.default
    if declaration.type in (int, float):
        assert declaration.minimum is not None
        assert declaration.maximum is not None
    if declaration.type is str:
        assert declaration.default in declaration.choices


def test_a_parameters_name_is_its_path() -> None:
    parameters = Parameters.from_mapping({"flow.interval": 6, "max_objects": 3})
    assert parameters.flow.interval == 6
    assert parameters.max_objects == 3
    assert parameters.flow.average == Parameters().flow.average


@given(values=MAPPINGS)
def test_a_mapping_goes_round(values: dict[str, object]) -> None:
    parameters = Parameters.from_mapping(values)
    assert parameters.as_mapping() == {**Parameters().as_mapping(), **values}
    assert Parameters.from_mapping(parameters.as_mapping()) == parameters


@given(first=MAPPINGS, second=MAPPINGS)
def test_replacing_changes_what_is_named_and_nothing_else(
    first: dict[str, object], second: dict[str, object]
) -> None:
    before = Parameters.from_mapping(first)
    assert before.replace(second) == Parameters.from_mapping({**first, **second})
    assert before == Parameters.from_mapping(first)


@pytest.mark.parametrize(
    "wrong", [{"max_objects": 0}, {"max_objcts": 4}, {"tracking.mode": "magic"}], ids=str
)
def test_on_an_error_nothing_is_replaced(wrong: dict[str, object]) -> None:
    parameters = Parameters()
    with pytest.raises(ParameterError):
        parameters.replace({"flow.interval": 6, **wrong, "seed.size": 5})
    assert parameters == Parameters()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name, declaration in DECLARED.items()
        if declaration.type in (int, float)
        for value in (declaration.minimum - 1, declaration.maximum + 1)
    ],
)
def test_values_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=f"parameter {name} lies between"):
        Parameters.from_mapping({name: DECLARED[name].type(value)})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_finite_number_is_out_of_range(value: float) -> None:
    with pytest.raises(ParameterError, match=r"parameter seed.delta1 lies between"):
        Parameters.from_mapping({"seed.delta1": value})


def test_limits_belong_to_the_range() -> None:
    for value in (1, 16):
        assert Parameters.from_mapping({"flow.interval": value}).flow.interval == value


def test_a_choice_that_is_not_offered_is_refused_with_those_that_are() -> None:
    with pytest.raises(
        ParameterError, match=r"tracking\.mode is one of kalman, kmeans, not 'sort'"
    ):
        Parameters.from_mapping({"tracking.mode": "sort"})


def test_a_whole_number_will_do_for_a_float() -> None:
    value = Parameters.from_mapping({"seed.delta1": 7}).seed.delta1
    assert value == 7.0
    assert type(value) is float


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("flow.interval", True, "takes a whole number, not True"),
        ("flow.interval", 4.0, "takes a whole number, not 4.0"),
        ("flow.interval", "4", "takes a whole number, not '4'"),
        ("seed.delta1", False, "takes a number, not False"),
        ("seed.delta1", "much", "takes a number, not 'much'"),
        ("seed.delta1", None, "takes a number, not None"),
        ("seed.delta1", [1.0], r"takes a number, not \[1.0\]"),
        ("latency.mode", 3, "takes a text, not 3"),
        ("latency.mode", True, "takes a text, not True"),
    ],
)
def test_a_value_of_another_type_is_refused(name: str, value: object, reason: str) -> None:
    with pytest.raises(ParameterError, match=f"parameter {name} {reason}"):
        Parameters.from_mapping({name: value})


def test_a_switch_takes_true_and_false_only() -> None:
    switch = Declaration("a.switch", True, "Whether.")
    assert switch.check(False) is False
    with pytest.raises(ParameterError, match="takes true or false, not 1"):
        switch.check(1)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("flow.intervall", "flow.interval"),
        ("seed.siz", "seed.size"),
        ("tracking.patients", "tracking.patience"),
        ("max_object", "max_objects"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(name: str, meant: str) -> None:
    with pytest.raises(UnknownParameterError) as error:
        Parameters.from_mapping({name: 1})
    assert str(error.value) == f"unknown parameter {name}; did you mean {meant}?"


@pytest.mark.parametrize("name", ["zzz", "", "flow", "flow.interval.widest", "Flow.interval"])
def test_no_other_name_is_known(name: str) -> None:
    with pytest.raises(UnknownParameterError, match=f"unknown parameter {name}"):
        Parameters.from_mapping({name: 1})


def test_names_of_every_ros_node_belong_to_the_middleware() -> None:
    assert belongs_to_middleware("use_sim_time")
    assert belongs_to_middleware("qos_overrides./image_raw.subscription.depth")
    assert not any(belongs_to_middleware(name) for name in DECLARED)


def test_a_file_names_parameters_in_groups_or_with_dots(tmp_path: Path) -> None:
    file = write(tmp_path, section({"flow": {"interval": 6}, "seed.size": 5, "max_objects": 3}))
    expected = {"flow.interval": 6, "seed.size": 5, "max_objects": 3}
    assert load_parameters(file) == Parameters.from_mapping(expected)


@given(values=MAPPINGS)
def test_a_file_goes_round(tmp_path_factory: pytest.TempPathFactory, values: dict) -> None:
    file = write(tmp_path_factory.getbasetemp(), section(values))
    assert load_parameters(file) == Parameters.from_mapping(values)


@pytest.mark.parametrize("name", ["/**", "/*", "turbseg", "/turbseg"])
def test_a_section_that_speaks_to_the_node_is_read(tmp_path: Path, name: str) -> None:
    file = write(tmp_path, section({"flow.interval": 6}, name))
    assert load_parameters(file).flow.interval == 6


def test_the_nodes_own_section_comes_before_everybodys(tmp_path: Path) -> None:
    text = section({"seed.size": 5, "flow.interval": 6}, "turbseg") + section(
        {"seed.size": 7, "max_objects": 3}
    )
    parameters = load_parameters(write(tmp_path, text))
    assert (parameters.seed.size, parameters.flow.interval, parameters.max_objects) == (5, 6, 3)


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
def test_every_preset_loads(file: Path) -> None:
    load_parameters(file)


def test_the_live_preset_is_the_default() -> None:
    assert load_parameters(CONFIG / "live.yaml") == Parameters()


def test_the_papers_preset_is_the_papers_method() -> None:
    paper = load_parameters(CONFIG / "paper.yaml")
    assert paper.flow.average == "mean"
    assert paper.motion.measure == "sampson"
    assert paper.growing.similarity == "magnitude"
    assert paper.outline.method == "none"
    assert paper.tracking.mode == "kmeans"
