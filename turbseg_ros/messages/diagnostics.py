"""What a result tells of the air, the camera and what was found, for /diagnostics."""

from __future__ import annotations

from collections.abc import Iterator

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from turbseg_ros.messages.results import header_of
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.frame import SegmentationResult

_REMARKS = {
    CameraState.SLEWING: "the camera slews: nothing new is taken for an object",
    CameraState.LOST: "nothing tells the camera's motion",
}
# Nanoseconds from one message to the next.
_PERIOD = 10**9


def status_name(node: str) -> str:
    """Return the name of the status of a node that segments."""
    return f"{node}: segmentation"


def remarks(result: SegmentationResult) -> Iterator[str]:
    """Yield in words what of a result people should know, though nothing is wrong."""
    if result.camera in _REMARKS:
        yield _REMARKS[result.camera]


def figures(result: SegmentationResult) -> Iterator[tuple[str, str]]:
    """Yield what is measured in a frame, by name."""
    yield "turbulence (px)", f"{result.tilt:.2f}"
    yield "ego-motion model", result.ego_motion_model
    yield "camera", result.camera.value
    yield "objects", str(len(result.objects))


class ResultDiagnostics:
    """Diagnostics of recorded results: once a second, and where the camera's state changes."""

    def __init__(self, node: str) -> None:
        """Begin before the first result.

        :param node: full name of the node whose results these would be.
        """
        self._name = status_name(node)
        self._told: tuple[int, CameraState] | None = None

    def message(self, result: SegmentationResult) -> DiagnosticArray | None:
        """Return what there is to tell with the next result, None where that was told lately."""
        if self._told is not None:
            stamp, camera = self._told
            if abs(result.frame.stamp - stamp) < _PERIOD and camera is result.camera:
                return None
        self._told = result.frame.stamp, result.camera
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=self._name,
            message="; ".join(remarks(result)) or "segmenting",
            hardware_id=result.frame.frame_id,
            values=[KeyValue(key=key, value=value) for key, value in figures(result)],
        )
        return DiagnosticArray(header=header_of(result.frame), status=[status])
