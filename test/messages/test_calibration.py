"""Which camera_info places markers before the camera, and which leaves them in pixels."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from visualization_msgs.msg import Marker

from turbseg_ros.messages.results import (
    CentroidMarkers,
    PixelPlane,
    UnitDepthPlane,
    annotations_message,
    annotations_removal,
)
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

SIZE = (64, 48)
POINTS = [(32.0, 24.0), (10.0, 40.0), (60.0, 5.0)]
SIX, TWELVE = [0.1, 0.01, 0.002, 0.001, 0.02, 0.03], [0.01] * 12


def camera_info(
    coefficients: list[float] | None = None,
    scale: int = 1,
    model: str = "plumb_bob",
    **fields: object,
) -> CameraInfo:
    """Return the calibration of a camera, of a sensor `scale` times as wide as the images."""
    width, height = scale * SIZE[0], scale * SIZE[1]
    k = [100.0 * scale, 0.0, width / 2, 0.0, 100.0 * scale, height / 2, 0.0, 0.0, 1.0]
    d = [0.0] * 5 if coefficients is None else coefficients
    return CameraInfo(width=width, height=height, distortion_model=model, d=d, k=k, **fields)


def result(number: int = 0, period: float | None = None) -> SegmentationResult:
    labels = np.zeros(SIZE[::-1], np.uint16)
    labels[10:14, 20:26] = 1
    found = MovingObject.from_mask(labels > 0, 1, 0, velocity=(3.0, -4.0), period=period)
    frame = Frame(number, np.zeros(SIZE[::-1], np.uint8), "camera", period=period)
    return SegmentationResult(frame, labels, (found,), np.zeros((2, 2), np.float32), 0.1, "none")


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ([], 0),
        ([0.0] * 3, 4),
        ([0.0] * 6, 4),
        ([0.0] * 13, 4),
        ([0.1, 0.0, 0.0, 0.0], 4),
        ([0.1, 0.01, 0.0, 0.0, 0.0, 0.0], 4),
        ([*SIX[:5], 0.0], 5),
        ([*TWELVE, 0.0], 12),
        ([0.01] * 8, 8),
        ([0.01] * 14, 14),
    ],
    ids=lambda given: str(len(given)) if isinstance(given, list) else "",
)
def test_coefficients_of_zero_may_be_too_many(given: list[float], kept: int) -> None:
    plane = UnitDepthPlane.from_camera_info(camera_info(given))
    assert len(plane.distortion) == kept
    padded = np.zeros(14)
    padded[: len(given)] = given[:14]
    expected = cv2.undistortPoints(np.array(POINTS)[:, None], plane.camera_matrix, padded)
    np.testing.assert_allclose(plane.place(POINTS)[:, :2], expected[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("given", "model"),
    [
        ([0.1, 0.2, 0.3], "plumb_bob"),
        (SIX, "plumb_bob"),
        ([0.01] * 13, "rational_polynomial"),
        ([0.01] * 15, "rational_polynomial"),
        ([0.1, float("nan"), 0.0, 0.0, 0.0], "plumb_bob"),
        ([0.1] * 5, "equidistant"),
        ([0.0] * 5, "equidistant"),
        ([0.1] * 4, "omnidirectional"),
    ],
)
def test_other_coefficients_leave_markers_in_pixels_and_are_told_once(
    given: list[float], model: str
) -> None:
    told: list[str] = []
    markers = CentroidMarkers(on_misfit=told.append)
    for number in range(5):
        markers.calibrate(camera_info(given, model=model))
        message = markers.message(result(number))
        (centroid,) = (marker for marker in message.markers if marker.ns == "centroid")
        assert (centroid.pose.position.x, centroid.pose.position.y) == (22.5, 11.5)
    assert len(told) == 1
    assert "\n" not in told[0]


@pytest.mark.parametrize("place", [0, 2, 4, 5])
@pytest.mark.parametrize("value", [5e-324, 1e308, -1e308])
def test_a_matrix_of_no_camera_leaves_markers_in_pixels(place: int, value: float) -> None:
    told: list[str] = []
    markers = CentroidMarkers(on_misfit=told.append)
    info = camera_info()
    info.k[place] = value
    markers.calibrate(info)
    for marker in markers.message(result()).markers:
        numbers = (marker.pose.position.x, marker.pose.position.y, marker.scale.x, marker.scale.y)
        assert np.isfinite(numbers).all()
    assert isinstance(markers.plane, PixelPlane) == bool(told)


def test_a_model_that_is_no_text_for_a_terminal_is_written_out() -> None:
    with pytest.raises(ValueError, match=r"model 'a\\x1b\[2J';") as caught:
        UnitDepthPlane.from_camera_info(camera_info(model="a\x1b[2J"))
    assert str(caught.value).isprintable()


def test_a_calibration_that_comes_after_a_bad_one_is_taken() -> None:
    markers = CentroidMarkers()
    markers.calibrate(camera_info(SIX))
    markers.message(result())
    assert isinstance(markers.plane, PixelPlane)
    markers.calibrate(camera_info())
    markers.message(result())
    assert isinstance(markers.plane, UnitDepthPlane)


def test_a_fisheye_lens_is_undone() -> None:
    coefficients = [0.05, -0.01, 0.002, 0.0]
    plane = UnitDepthPlane.from_camera_info(camera_info(coefficients, model="equidistant"))
    rays = plane.place(POINTS)
    seen, _ = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), plane.camera_matrix, np.array(coefficients)
    )
    np.testing.assert_allclose(seen[:, 0], POINTS, atol=1e-3)


@pytest.mark.parametrize(
    "info",
    [
        camera_info(),
        camera_info(scale=2),
        camera_info(scale=5),
        camera_info(scale=2, binning_x=2, binning_y=2),
        camera_info(binning_x=2, binning_y=2),
        camera_info(roi=RegionOfInterest(x_offset=16, y_offset=12, width=32, height=24)),
    ],
    ids=["same", "half", "fifth", "binned", "binning not applied", "region not applied"],
)
def test_images_of_another_resolution_place_markers_alike(info: CameraInfo) -> None:
    expected = UnitDepthPlane.from_camera_info(camera_info()).place(POINTS)
    np.testing.assert_allclose(UnitDepthPlane.from_camera_info(info, SIZE).place(POINTS), expected)


def test_a_region_of_the_sensor_begins_where_it_says() -> None:
    whole = UnitDepthPlane.from_camera_info(camera_info(scale=4))
    region = RegionOfInterest(x_offset=100, y_offset=60, width=128, height=96)
    info = camera_info(scale=4, roi=region, binning_x=2, binning_y=2)
    part = UnitDepthPlane.from_camera_info(info, SIZE)
    np.testing.assert_allclose(part.place([(3, 7)]), whole.place([(106, 74)]))


def test_another_shape_is_another_view() -> None:
    with pytest.raises(
        ValueError, match=r"is of 64x48 pixels, which 64x36 of the images can't be"
    ):
        UnitDepthPlane.from_camera_info(camera_info(), (64, 36))


def test_markers_end_when_told_or_left_alone() -> None:
    markers = CentroidMarkers()
    assert not markers.removal(result().frame)
    shown = markers.message(result(period=0.5)).markers
    assert {marker.lifetime.sec for marker in shown} == {6}
    (removed,) = markers.removal(result().frame)
    assert {m.action for m in removed.markers} == {Marker.DELETE}
    assert {(m.ns, m.id) for m in removed.markers} == {(m.ns, m.id) for m in shown}
    assert not markers.removal(result().frame)
    outlines = annotations_message(result(period=0.01))
    assert outlines.lifetime.sec == 2
    removal = annotations_removal(result().frame)
    assert (removal.ns, removal.id, removal.action) == (outlines.ns, outlines.id, removal.REMOVE)


def test_the_text_tells_angles_where_the_camera_is_calibrated() -> None:
    markers = CentroidMarkers()
    markers.calibrate(camera_info())
    (text,) = [m.text for m in markers.message(result()).markers if m.ns == "id"]
    # The centroid is at (22.5, 11.5), of a focal length of 100 px; up is less than half the rows.
    right = math.degrees(math.atan2(22.5 - SIZE[0] / 2, 100.0))
    up = math.degrees(math.atan2(SIZE[1] / 2 - 11.5, math.hypot(100.0, 22.5 - SIZE[0] / 2)))
    assert text.splitlines() == ["1", "6x4 px", f"az {right:+.2f}° el {up:+.2f}°"]


def test_the_text_tells_the_speed_where_the_rate_is_known() -> None:
    texts = [
        next(m.text for m in CentroidMarkers().message(each).markers if m.ns == "id")
        for each in (result(), result(period=0.1))
    ]
    assert texts == ["1\n6x4 px", "1\n50 px/s\n6x4 px"]
    (found,) = result(period=0.1).objects
    assert found.velocity_per_second == pytest.approx((30.0, -40.0))
