"""The topics of a stream of results of its own."""

from __future__ import annotations

from turbseg_ros.messages.events import EventMessages, EventWatch
from turbseg_ros.messages.results import CentroidMarkers, MarkerPlane, Output, outputs


def fresh_outputs(max_objects: int, plane: MarkerPlane | None = None) -> tuple[Output, ...]:
    """Return the outputs of a stream that has not begun."""
    events = EventMessages(EventWatch(lambda: 30))
    return outputs(max_objects, CentroidMarkers(plane), events)
