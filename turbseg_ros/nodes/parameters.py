"""The package's parameters as ROS parameters of a node."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from turbseg_ros.parameters import (
    Declaration,
    ParameterError,
    Parameters,
    UnknownParameterError,
    belongs_to_middleware,
    declarations,
    is_gone,
    present_name,
)

# A ROS range has two ends; these are the open ones.
_INT64_MIN = -(2**63)
_INT64_MAX = 2**63 - 1


def descriptor_of(declaration: Declaration) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows of a parameter."""
    unit = f" Unit: {declaration.unit}." if declaration.unit else ""
    condition = f" {declaration.condition}" if declaration.condition else ""
    descriptor = ParameterDescriptor(
        name=declaration.name,
        description=declaration.description + unit + condition,
        read_only=declaration.read_only,
    )
    if declaration.choices:
        descriptor.additional_constraints = f"One of {', '.join(declaration.choices)}."
    low, high = declaration.minimum, declaration.maximum
    if low is None and high is None:
        return descriptor
    if declaration.type is int:
        descriptor.integer_range = [
            IntegerRange(
                from_value=_INT64_MIN if low is None else int(low),
                to_value=_INT64_MAX if high is None else int(high),
            )
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-math.inf if low is None else float(low),
                to_value=math.inf if high is None else float(high),
            )
        ]
    return descriptor


class ParameterHandler:
    """Declares the parameters on a node and keeps their typed form, `current`, in step.

    The node has to be made with `automatically_declare_parameters_from_overrides`, the public way
    of rclpy to learn which values were given, names that nobody declares among them. Such names
    are warned about. A change at run time is checked as a whole, refused with the reason or
    taken, and only then told to `on_change`: the parameters before and after it, which are equal
    when one that names a file was set again.

    :param check: refuses parameters by a `ParameterError`, for files that they name.
    :raises ParameterError: when a value that the node was started with is refused.
    """

    def __init__(
        self,
        node: Node,
        on_change: Callable[[Parameters, Parameters], None],
        check: Callable[[Parameters], object] = lambda _: None,
    ) -> None:
        self._declarations = {declaration.name: declaration for declaration in declarations()}
        self._on_change = on_change
        self._check = check
        self._logger = node.get_logger()
        self.current = _given_at_start(node)
        self._declare_on(node)
        self._warn_of_idle(Parameters())
        node.add_pre_set_parameters_callback(self._in_declared_type)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def _declare_on(self, node: Node) -> None:
        for name, value in self.current.as_mapping().items():
            if node.has_parameter(name):
                # As rclpy declared it: without description or range, in the type it came in.
                node.undeclare_parameter(name)
            descriptor = descriptor_of(self._declarations[name])
            node.declare_parameter(name, value, descriptor, ignore_override=True)

    def _in_declared_type(self, changes: list[RosParameter]) -> list[RosParameter]:
        """Let `ros2 param set ... 1` set a floating-point parameter, which rclpy would refuse."""
        return [
            RosParameter(change.name, RosParameter.Type.DOUBLE, float(change.value))
            if self._is_float(change.name) and change.type_ == RosParameter.Type.INTEGER
            else change
            for change in changes
        ]

    def _is_float(self, name: str) -> bool:
        return name in self._declarations and self._declarations[name].type is float

    def _names_file(self, name: str) -> bool:
        return name in self._declarations and self._declarations[name].names_file

    def _validate(self, changes: list[RosParameter]) -> SetParametersResult:
        try:
            self._check(self._changed(changes))
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changes: list[RosParameter]) -> None:
        before, self.current = self.current, self._changed(changes)
        self._warn_of_idle(before)
        if self.current != before or any(self._names_file(change.name) for change in changes):
            self._on_change(before, self.current)

    def _warn_of_idle(self, before: Parameters) -> None:
        """Say which changes since `before` have no effect as the other parameters stand."""
        for line in self.current.idle_changes(before):
            self._logger.warning(line)

    def _changed(self, changes: Iterable[RosParameter]) -> Parameters:
        return self.current.replace(
            {change.name: change.value for change in changes if change.name in self._declarations}
        )


def _given_at_start(node: Node) -> Parameters:
    """Return the parameters as the command line and parameter files set them."""
    parameters = Parameters()
    for name, given in node.get_parameters_by_prefix("").items():
        if belongs_to_middleware(name):
            continue
        try:
            parameters = parameters.replace({name: given.value})
        except UnknownParameterError as error:
            node.get_logger().warning(f"ignored: {error}")
            node.undeclare_parameter(name)
            continue
        if present_name(name) != name or is_gone(name):
            node.undeclare_parameter(name)
    return parameters
