"""What results tell for /diagnostics where no node runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from turbseg_ros.messages.diagnostics import ResultDiagnostics
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

STEP = 10**9 // 30


def result(number: int, camera: CameraState = CameraState.STILL) -> SegmentationResult:
    frame = Frame(5 * 10**9 + number * STEP, np.zeros((4, 4), np.uint8), "lens")
    empty = SegmentationResult.empty(frame)
    return replace(empty, camera=camera, ego_motion_model="affine", tilt=0.25)


def test_one_message_a_second_tells_of_the_air_and_the_camera() -> None:
    diagnostics = ResultDiagnostics("/turbseg")
    messages = [diagnostics.message(result(number)) for number in range(75)]
    told = [message for message in messages if message is not None]
    assert len(told) == 3
    (status,) = told[0].status
    assert (status.name, status.hardware_id) == ("/turbseg: segmentation", "lens")
    shown = {each.key: each.value for each in status.values}
    assert shown == {
        "turbulence (px)": "0.25",
        "ego-motion model": "affine",
        "camera": "still",
        "objects": "0",
    }
    assert told[0].header.stamp.sec == 5


@pytest.mark.parametrize(
    ("camera", "words"),
    [(CameraState.SLEWING, "slews"), (CameraState.LOST, "nothing tells the camera's motion")],
)
def test_another_state_of_the_camera_is_told_at_once(camera: CameraState, words: str) -> None:
    diagnostics = ResultDiagnostics("/turbseg")
    diagnostics.message(result(0))
    told = diagnostics.message(result(1, camera))
    assert told is not None
    assert words in told.status[0].message
    assert diagnostics.message(result(2, camera)) is None
    assert diagnostics.message(result(3)) is not None
