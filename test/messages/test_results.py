"""What each topic's message says of a result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image as ImageMessage
from visualization_msgs.msg import ImageMarker, Marker

from support.result_topics import fresh_outputs
from turbseg_ros.bag.schema import message_class
from turbseg_ros.bag.writer import serialised
from turbseg_ros.messages.cdr import FieldReader
from turbseg_ros.messages.detections import Detection, detections_from
from turbseg_ros.messages.images import image_from_message
from turbseg_ros.messages.results import (
    CentroidMarkers,
    OverlayView,
    UnitDepthPlane,
    annotations_message,
    clutter_message,
    detections_message,
    header_of,
    labels_message,
    mask_message,
    motion_message,
    slot_mask_message,
    views,
)
from turbseg_ros.overlay import outlines
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

STAMP = 1_700_000_000_123_456_789


def drawn_result(*boxes: tuple[int, int, int, int], stamp: int = STAMP) -> SegmentationResult:
    """Rectangles on a 90x60 frame: the first has id 1 and slot 0, and so on."""
    labels = np.zeros((60, 90), np.uint16)
    objects = []
    for number, (x, y, width, height) in enumerate(boxes, 1):
        labels[y : y + height, x : x + width] = number
        centre = (x + (width - 1) / 2, y + (height - 1) / 2)
        objects.append(
            MovingObject(
                id=number,
                slot=number - 1,
                centroid=centre,
                velocity=(2.0, -1.0),
                area=width * height,
                box=(x, y, width, height),
                trail=((centre[0] - 4, centre[1] + 2), (centre[0] - 2, centre[1] + 1)),
            )
        )
    return SegmentationResult(
        frame=Frame(stamp, np.full((60, 90), 100, np.uint8), "camera"),
        labels=labels,
        objects=tuple(objects),
        motion_map=np.linspace(0, 1, 30 * 45, dtype=np.float32).reshape(30, 45),
        tilt=0.3,
        ego_motion_model="affine",
    )


def pixels_of(message: ImageMessage, dtype: type) -> np.ndarray:
    assert message.step == message.width * np.dtype(dtype).itemsize
    return np.frombuffer(message.data, dtype).reshape(message.height, message.width)


@given(stamp=st.integers(0, (2**31 - 1) * 10**9 + 999_999_999))
def test_header_keeps_every_nanosecond(stamp: int) -> None:
    header = header_of(Frame(stamp, np.zeros((1, 1), np.uint8), "camera"))
    assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp
    assert header.frame_id == "camera"


def moving_result(whole_numbers: bool) -> SegmentationResult:
    """Two objects, one at the picture's edge; positions as Python's ints, or between pixels."""
    result = drawn_result((5, 5, 10, 8), (70, 40, 20, 20))
    shift = 0 if whole_numbers else 0.25
    kind = int if whole_numbers else float
    objects = tuple(
        replace(
            found,
            centroid=(kind(found.centroid[0] + shift), kind(found.centroid[1] - shift)),
            velocity=(kind(2), kind(-1)),
            trail=tuple((kind(x), kind(y)) for x, y in found.trail),
        )
        for found in result.objects
    )
    return replace(result, objects=objects)


@pytest.mark.parametrize("whole_numbers", [True, False])
@pytest.mark.parametrize("calibrated", [True, False])
def test_every_message_comes_back_from_serialisation_as_it_went(
    whole_numbers: bool, calibrated: bool
) -> None:
    plane = UnitDepthPlane.from_camera_info(camera_info()) if calibrated else None
    every = (*fresh_outputs(3, plane), *views())
    for result in (moving_result(whole_numbers), drawn_result()):
        for output in every:
            for message in output.build(result):
                if isinstance(message, bytes):
                    continue
                received = deserialize_message(
                    serialize_message(message), message_class(output.type_name)
                )
                assert_alike(received, message, output.name)


def assert_alike(received: Any, sent: Any, name: str) -> None:
    """Compare field by field; 32 bits hold a number less exactly than Python does."""
    if isinstance(sent, float | int):
        assert received == pytest.approx(sent, rel=1e-6, abs=1e-12), name
    elif hasattr(sent, "get_fields_and_field_types"):
        for field in sent.get_fields_and_field_types():
            assert_alike(getattr(received, field), getattr(sent, field), f"{name}.{field}")
    elif isinstance(sent, list):
        assert len(received) == len(sent), name
        for number, (there, here) in enumerate(zip(received, sent, strict=True)):
            assert_alike(there, here, f"{name}[{number}]")
    else:
        assert received == sent, name


def test_all_messages_carry_the_frame_header() -> None:
    result = drawn_result((5, 5, 10, 8))
    for output in (*fresh_outputs(3), *views()):
        messages = output.build(result)
        assert messages, output.name
        for message in messages:
            if output.name == "events":
                assert message.hardware_id == result.frame.frame_id
                continue
            if output.name == "image_annotations":
                stamp = FieldReader(memoryview(message))
                assert (stamp.number("i"), stamp.number("I")) == divmod(STAMP, 10**9)
                continue
            if output.name == "detections":
                header = FieldReader(memoryview(message)).header()
                assert header == header_of(result.frame)
                continue
            headed = message.markers[0] if output.name == "centroids" else message
            assert headed.header == header_of(result.frame), output.name


def test_topics_have_one_message_a_frame_or_say_that_they_may_not() -> None:
    every = (*fresh_outputs(3), *views())
    counts = {output.name: len(output.build(drawn_result())) for output in every}
    assert {name for name, count in counts.items() if count != 1} == {"events"}
    assert {output.name for output in every if not output.every_frame} == {"events"}


def test_detections_have_box_id_and_score() -> None:
    result = drawn_result((5, 5, 10, 8), (70, 40, 20, 20))
    first, second = result.objects
    result = replace(result, objects=(replace(first, score=0.75), second))
    assert detections_from(memoryview(detections_message(result))) == (
        STAMP,
        (
            Detection((5.0, 5.0, 10.0, 8.0), "1", "object", 0.75),
            Detection((70.0, 40.0, 20.0, 20.0), "2", "object", 1.0),
        ),
    )


def test_labels_keep_ids_and_size() -> None:
    result = drawn_result((5, 5, 10, 8), (40, 20, 6, 6))
    result.labels[50:, 80:] = 65535
    message = labels_message(result)
    assert message.encoding == "mono16"
    np.testing.assert_array_equal(pixels_of(message, np.uint16), result.labels)


def test_mask_joins_all_objects() -> None:
    result = drawn_result((5, 5, 10, 8), (40, 20, 6, 6))
    message = mask_message(result)
    assert message.encoding == "mono8"
    np.testing.assert_array_equal(
        pixels_of(message, np.uint8), np.where(result.labels > 0, 255, 0)
    )


@pytest.mark.parametrize("shape", [(1, 1), (4, 1), (1, 4), (2, 4), (300, 1)], ids=str)
def test_the_smallest_pictures_have_masks(shape: tuple[int, int]) -> None:
    # A row of four is what OpenCV takes a number for.
    frame = Frame(1, np.zeros(shape, np.uint8), "camera")
    labels = np.full(shape, 7, np.uint16)
    found = MovingObject(7, 0, (0.0, 0.0), (0.0, 0.0), labels.size, (0, 0, shape[1], shape[0]))
    motion = np.zeros((16, 16), np.float32)
    result = SegmentationResult(frame, labels, (found,), motion, 0.1, "affine")
    for message in (mask_message(result), slot_mask_message(result, 0)):
        assert (pixels_of(message, np.uint8) == 255).all()
    for output in (*fresh_outputs(1), *views()):
        for message in output.build(result):
            serialised(message)


def test_after_65535_objects_masks_and_outlines_follow_the_label() -> None:
    result = drawn_result((5, 5, 10, 8))
    result.labels[result.labels > 0] = 2
    late = replace(result.objects[0], id=65_537)
    result = replace(result, objects=(late,))
    slot = slot_mask_message(result, late.slot)
    np.testing.assert_array_equal(pixels_of(slot, np.uint8), np.where(result.labels == 2, 255, 0))
    assert len(outlines(result.labels, late)) == 1


def test_slot_mask_holds_one_object_and_a_free_slot_none() -> None:
    result = drawn_result((5, 5, 10, 8), (40, 20, 6, 6))
    np.testing.assert_array_equal(
        pixels_of(slot_mask_message(result, 1), np.uint8), np.where(result.labels == 2, 255, 0)
    )
    assert not pixels_of(slot_mask_message(result, 2), np.uint8).any()


def test_motion_is_the_map_at_its_own_size() -> None:
    result = drawn_result()
    message = motion_message(result)
    assert message.encoding == "32FC1"
    np.testing.assert_array_equal(pixels_of(message, np.float32), result.motion_map)


def test_clutter_is_what_each_cell_moves_by() -> None:
    clutter = np.linspace(0, 2, 7 * 11, dtype=np.float32).reshape(7, 11)
    message = clutter_message(replace(drawn_result(), clutter=clutter))
    assert message.encoding == "32FC1"
    np.testing.assert_array_equal(pixels_of(message, np.float32), clutter)


def test_clutter_is_zero_in_a_cell_for_four_by_four_pixels_while_nothing_is_known() -> None:
    unknown = pixels_of(clutter_message(drawn_result()), np.float32)
    assert unknown.shape == (7, 11)
    assert not unknown.any()


def test_the_overlay_of_a_deep_camera_does_not_flicker() -> None:
    view = OverlayView()
    ground = np.linspace(5000, 9000, 60 * 90).reshape(60, 90)
    means = []
    for number in range(10):
        image = ground.copy()
        # A hot patch that comes and goes moves the percentiles, but not the picture.
        image[:6] += 8000 * (number % 2)
        frame = Frame(STAMP + number, image.astype(np.uint16), "camera")
        result = replace(drawn_result(), frame=frame)
        means.append(image_from_message(view.message(result))[10:].mean())
    assert np.abs(np.diff(means)).max() < 8.0
    alone = image_from_message(OverlayView().message(result))
    assert abs(alone[10:].mean() - means[0]) > 40.0


def test_the_overlay_follows_a_camera_that_changes_to_floats() -> None:
    view = OverlayView()
    deep = np.linspace(5000, 9000, 60 * 90).reshape(60, 90)
    for image in (deep.astype(np.uint16), (deep / 9000).astype(np.float32)):
        frame = Frame(STAMP, image, "camera")
        shown = image_from_message(view.message(replace(drawn_result(), frame=frame)))
        assert np.ptp(shown) > 128


def test_overlay_is_the_frame_where_nothing_is_drawn() -> None:
    empty = OverlayView().message(drawn_result())
    assert (empty.encoding, empty.width, empty.height) == ("bgr8", 90, 60)
    assert set(empty.data) == {100}
    assert set(OverlayView().message(drawn_result((5, 5, 10, 8))).data) != {100}


def test_outlines_run_round_the_object() -> None:
    marker = annotations_message(drawn_result((5, 7, 10, 8)))
    assert marker.type == ImageMarker.LINE_LIST
    corners = {(point.x, point.y) for point in marker.points}
    assert corners == {(5.0, 7.0), (14.0, 7.0), (14.0, 14.0), (5.0, 14.0)}
    assert len(marker.outline_colors) == len(marker.points) / 2


def test_outlines_of_an_empty_frame_clear_the_last_ones() -> None:
    shown, cleared = (
        annotations_message(drawn_result((5, 7, 10, 8))),
        annotations_message(drawn_result()),
    )
    assert (shown.ns, shown.id) == (cleared.ns, cleared.id)
    assert not cleared.points


def test_markers_place_the_object_in_pixels() -> None:
    markers = CentroidMarkers().message(drawn_result((10, 20, 11, 5))).markers
    by_kind = {marker.ns: marker for marker in markers}
    assert {marker.id for marker in markers} == {1}
    position = by_kind["centroid"].pose.position
    assert (position.x, position.y, position.z) == (15.0, 22.0, 0.0)
    assert by_kind["id"].text.splitlines()[0] == "1"
    start, end = by_kind["velocity"].points
    assert (end.x - start.x) / (end.y - start.y) == -2.0
    trail = [(point.x, point.y) for point in by_kind["trail"].points]
    assert trail == [(11.0, 24.0), (13.0, 23.0), (15.0, 22.0)]


def test_markers_of_an_ended_object_are_deleted_once() -> None:
    markers = CentroidMarkers()
    added = markers.message(drawn_result((10, 20, 11, 5))).markers
    deleted = markers.message(drawn_result()).markers
    assert {(m.ns, m.id) for m in deleted} == {(m.ns, m.id) for m in added}
    assert {m.action for m in deleted} == {Marker.DELETE}
    assert not markers.message(drawn_result()).markers


def camera_info(**fields: object) -> CameraInfo:
    info = CameraInfo(width=90, height=60, distortion_model="plumb_bob", d=[0.0] * 5, **fields)
    if "k" not in fields:
        info.k = [100.0, 0.0, 45.0, 0.0, 100.0, 30.0, 0.0, 0.0, 1.0]
    return info


def test_markers_lie_on_the_unit_depth_plane_of_a_calibrated_camera() -> None:
    plane = UnitDepthPlane.from_camera_info(camera_info())
    markers = CentroidMarkers(plane).message(drawn_result((60, 40, 11, 11))).markers
    position = markers[0].pose.position
    assert (position.x, position.y, position.z) == pytest.approx((0.20, 0.15, 1.0))
    assert markers[0].scale.x == pytest.approx(3.0 / 100.0)


def test_binned_pixels_are_counted_on_the_sensor() -> None:
    whole = UnitDepthPlane.from_camera_info(camera_info())
    binned = UnitDepthPlane.from_camera_info(camera_info(binning_x=2, binning_y=2))
    np.testing.assert_allclose(binned.place([(20, 10)]), whole.place([(40, 20)]))


def test_distortion_is_undone() -> None:
    info = camera_info()
    info.d = [-0.2, 0.0, 0.0, 0.0, 0.0]
    ((x, y, z),) = UnitDepthPlane.from_camera_info(info).place([(75.0, 30.0)])
    # Forward: x (1 + k1 x²) = 0.3.
    assert x * (1 - 0.2 * x**2) == pytest.approx(0.3, abs=1e-4)
    assert (y, z) == pytest.approx((0.0, 1.0), abs=1e-9)


@pytest.mark.parametrize(
    ("fields", "text"),
    [({"k": [0.0] * 9}, "no calibration"), ({"distortion_model": "fisheye"}, "fisheye")],
)
def test_a_camera_without_usable_calibration_is_refused(
    fields: dict[str, object], text: str
) -> None:
    info = camera_info()
    for name, value in fields.items():
        setattr(info, name, value)
    with pytest.raises(ValueError, match=text):
        UnitDepthPlane.from_camera_info(info)
