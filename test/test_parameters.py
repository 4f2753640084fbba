"""Parameters: their names, ranges and files."""

from __future__ import annotations

import math

import pytest
from hypothesis import given

from support.parameter_values import DECLARED, FREE_TEXTS, MAPPINGS
from turbseg_ros.parameters import (
    Declaration,
    ParameterError,
    Parameters,
    UnknownParameterError,
    belongs_to_middleware,
    declarations,
)


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
    if declaration.type is str and declaration.name not in FREE_TEXTS:
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
        if declaration.minimum is not None and declaration.maximum is not None
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
        ParameterError,
        match=r"tracking\.mode is one of kalman, kmeans, or package.module:Class, not 'sort'",
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
        ("tracking.patients", "tracking.max_age"),
        ("max_object", "max_objects"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(name: str, meant: str) -> None:
    with pytest.raises(UnknownParameterError) as error:
        Parameters.from_mapping({name: 1})
    assert str(error.value) == f"unknown parameter {name}; did you mean {meant}?"


@pytest.mark.parametrize("name", ["zzz", "", "flow", "flow.interval.widest", "Flow.interval"])
def test_no_other_name_is_known(name: str) -> None:
    with pytest.raises(UnknownParameterError, match=f"unknown parameter {name}".rstrip()):
        Parameters.from_mapping({name: 1})


def test_names_of_every_ros_node_belong_to_the_middleware() -> None:
    assert belongs_to_middleware("use_sim_time")
    assert belongs_to_middleware("qos_overrides./image_raw.subscription.depth")
    assert not any(belongs_to_middleware(name) for name in DECLARED)


def test_conditions_name_parameters_and_values_that_there_are() -> None:
    for declared in declarations():
        for name, values in declared.used_when.items():
            assert name != declared.name
            assert all(DECLARED[name].check(value) == value for value in values)
            assert set(values) < set(DECLARED[name].choices)


def test_nothing_is_idle_that_was_changed_for_its_mode() -> None:
    changed = Parameters.from_mapping({"refine.mode": "none", "outline.threshold": 3.0})
    assert changed.idle_changes(Parameters()) == []
    assert "outline.threshold" not in changed.idle(replayed=True)


def test_every_unmet_condition_is_named() -> None:
    values = {"outline.method": "none", "outline.threshold": 3.0}
    assert Parameters.from_mapping(values).idle_changes(Parameters()) == [
        "outline.threshold has no effect while outline.method is none and refine.mode is "
        "pretrained; it is used with outline.method background and refine.mode none or optimise"
    ]


def test_what_only_the_node_reads_is_idle_in_a_replay() -> None:
    assert "queue_size" not in Parameters().idle()
    assert Parameters().idle(replayed=True)["latency.coast_from"] == (
        "latency.coast_from has no effect here; it is used by the live node, and at 0"
    )
    always = Parameters.from_mapping({"latency.coast_from": 0})
    assert "latency.coast_from" not in always.idle(replayed=True)


FORMER = {former: d.name for d in declarations() for former in d.former_names}


def test_the_names_of_the_first_release_are_kept() -> None:
    assert FORMER == {
        "latency.haste_from": "latency.coast_from",
        "tracking.confirmation": "tracking.min_hits",
        "tracking.patience": "tracking.max_age",
    }


@pytest.mark.parametrize("former", FORMER)
def test_a_former_name_is_taken_with_one_warning(
    former: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turbseg_ros.parameters._warned_of", set())
    for value in (10, 12):
        values = Parameters().replace({former: value}).as_mapping()
        assert values[FORMER[former]] == value
        assert former not in values
    (record,) = caplog.records
    assert f"{former} is called {FORMER[former]} now" in record.getMessage()


def test_a_parameter_that_is_gone_is_left_out_with_one_warning_that_names_its_heir(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("turbseg_ros.parameters._warned_of", set())
    for _ in range(2):
        assert Parameters().replace({"tracking.travel": 2.0}) == Parameters()
    (record,) = caplog.records
    assert "tracking.false_alarms_per_hour has taken its place" in record.getMessage()
