"""Parameters of a node as the page shows them."""

from __future__ import annotations

import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterType, ParameterValue

from turbseg_ros.nodes.parameters import descriptor_of
from turbseg_ros.parameters import Declaration, declarations
from turbseg_ros.view.live_parameters import live_parameter

DECLARED = {declaration.name: declaration for declaration in declarations()}


def test_ranges_and_descriptions_are_those_declared() -> None:
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=5.0)
    shown = live_parameter(descriptor_of(DECLARED["seed.delta1"]), value)
    assert shown is not None
    assert (shown.name, shown.kind, shown.value) == ("seed.delta1", "float", 5.0)
    assert (shown.minimum, shown.maximum) == (1.0, 50.0)
    assert shown.description.startswith(DECLARED["seed.delta1"].description)


def test_choices_are_those_declared() -> None:
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="auto")
    shown = live_parameter(descriptor_of(DECLARED["qos.reliability"]), value)
    assert shown is not None
    assert shown.choices == ("auto", "reliable", "best_effort")


@pytest.mark.parametrize("kind", [int, float])
def test_open_ends_are_none(kind: type[int | float]) -> None:
    value = (
        ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=3)
        if kind is int
        else ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=3.0)
    )
    shown = live_parameter(descriptor_of(Declaration("a", kind(3), "", minimum=1)), value)
    assert shown is not None
    assert (shown.minimum, shown.maximum) == (1, None)


def test_lists_are_shown_and_what_else_there_may_be_is_not() -> None:
    texts = ParameterValue(
        type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["a", "b"]
    )
    shown = live_parameter(ParameterDescriptor(name="names"), texts)
    assert shown is not None and shown.value == ["a", "b"]
    numbers = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[1.0])
    assert live_parameter(ParameterDescriptor(name="k"), numbers) is None
    unset = ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
    assert live_parameter(ParameterDescriptor(name="k"), unset) is None
