"""Parameters of another node: those that may change while it runs, and changing them."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent, ParameterValue
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from turbseg_ros.parameters import belongs_to_middleware
from turbseg_ros.view.state import LiveParameter, Value

_KINDS = {
    Parameter.Type.BOOL.value: "bool",
    Parameter.Type.INTEGER.value: "int",
    Parameter.Type.DOUBLE.value: "float",
    Parameter.Type.STRING.value: "str",
    Parameter.Type.STRING_ARRAY.value: "list",
}
_TYPES = {kind: Parameter.Type(number) for number, kind in _KINDS.items()}
_CHOICES = re.compile(r"One of ([^.]+)\.$")
# Seconds after which an answer that has not come never will: its node has gone.
_TIMEOUT = 5.0
# Ends of a range that stand for none.
_OPEN = 2.0**62


class LiveParameters:
    """Follows the parameters of the node called `name`; all calls come from `node`'s executor.

    `on_change` gets them whenever they have changed, none once the node has gone.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        on_change: Callable[[Sequence[LiveParameter]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._name = node, name
        self._on_change = on_change
        self._clock = clock
        self._client = AsyncParameterClient(node, name)
        self._events = node.create_subscription(
            ParameterEvent, "/parameter_events", self._take_event, 100
        )
        self._known: dict[str, LiveParameter] = {}
        self._asked: float | None = None

    def destroy(self) -> None:
        """Stop following."""
        self._node.destroy_subscription(self._events)
        self._on_change(())

    def look(self) -> None:
        """Ask for the parameters where the node is there and has not told them yet."""
        if not self._client.services_are_ready():
            self._asked = None
            self._known = {}
            self._on_change(())
            return
        if self._known or (self._asked and self._clock() - self._asked < _TIMEOUT):
            return
        self._asked = self._clock()
        self._client.list_parameters(callback=self._describe)

    def set(self, name: str, value: object) -> Future[str]:
        """Change a parameter; the future gives the reason why not, "" when it has changed."""
        answer: Future[str] = Future()
        try:
            known = self._known[name]
            parameter = Parameter(name, _TYPES[known.kind], known.checked(value))
        except KeyError:
            answer.set_result(f"{name} can't be changed while the node runs")
            return answer
        except ValueError as error:
            answer.set_result(str(error))
            return answer

        def take(future: Any) -> None:
            if not answer.set_running_or_notify_cancel():
                return
            result = future.result().result
            answer.set_result("" if result.successful else result.reason or "refused")

        self._client.set_parameters_atomically([parameter], callback=take)
        return answer

    def _describe(self, future: Any) -> None:
        names = [n for n in future.result().result.names if not belongs_to_middleware(n)]
        self._client.describe_parameters(names, callback=self._get)

    def _get(self, future: Any) -> None:
        descriptors = [d for d in future.result().descriptors if not d.read_only]
        names = [descriptor.name for descriptor in descriptors]

        def take(answer: Any) -> None:
            values = answer.result().values
            found = map(live_parameter, descriptors, values)
            self._known = {each.name: each for each in found if each is not None}
            self._on_change(tuple(self._known.values()))

        self._client.get_parameters(names, callback=take)

    def _take_event(self, event: ParameterEvent) -> None:
        if event.node != self._name or not self._known:
            return
        for changed in event.changed_parameters:
            known = self._known.get(changed.name)
            value = parameter_value_to_python(changed.value)
            if known is not None and value is not None:
                self._known[changed.name] = LiveParameter(
                    **{**vars(known), "value": _plain(value)}
                )
        self._on_change(tuple(self._known.values()))


def live_parameter(descriptor: ParameterDescriptor, value: ParameterValue) -> LiveParameter | None:
    """Return a parameter as the page shows it, None where its type is none that it can show."""
    kind = _KINDS.get(value.type)
    if kind is None:
        return None
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    low, high = (ranges[0].from_value, ranges[0].to_value) if ranges else (None, None)
    choices = _CHOICES.search(descriptor.additional_constraints)
    return LiveParameter(
        name=descriptor.name,
        kind=kind,
        value=_plain(parameter_value_to_python(value)),
        description=descriptor.description,
        minimum=_end(low),
        maximum=_end(high),
        choices=tuple(choices[1].split(", ")) if choices else (),
    )


def _end(value: float | None) -> float | None:
    """Return an end of a range, None where it is open."""
    return None if value is None or not math.isfinite(value) or abs(value) > _OPEN else value


def _plain(value: Any) -> Value:
    return value if isinstance(value, (bool, int, float, str)) else [str(each) for each in value]
