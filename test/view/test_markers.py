"""Results put together from what the node publishes of them."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo
from visualization_msgs.msg import ImageMarker, MarkerArray

from turbseg_ros.messages.results import CentroidMarkers, annotations_message
from turbseg_ros.overlay import colour_of
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult
from turbseg_ros.view.markers import ResultJoiner

STAMP = 1_700_000_000_123_456_789
BOXES = {3: (10, 20, 30, 12), 4: (60, 40, 8, 16)}


def result(stamp: int = STAMP, boxes: dict[int, tuple[int, int, int, int]] = BOXES):
    labels = np.zeros((80, 120), np.uint16)
    objects = []
    for number, (x, y, width, height) in boxes.items():
        labels[y : y + height, x : x + width] = number
        objects.append(
            MovingObject.from_mask(
                labels == number,
                number,
                velocity=(3.0, 4.0),
                trail=((x - 5.0, float(y)), (float(x), float(y))),
                period=0.1,
            )
        )
    return SegmentationResult(
        frame=Frame(stamp, np.zeros(labels.shape, np.uint8)),
        labels=labels,
        objects=tuple(objects),
        motion_map=np.zeros((8, 12), np.float32),
        tilt=0.5,
        ego_motion_model="affine",
    )


def messages(found: SegmentationResult) -> tuple[MarkerArray, ImageMarker]:
    return CentroidMarkers().message(found), annotations_message(found)


@pytest.mark.parametrize("markers_first", [True, False])
def test_both_messages_make_a_result_whichever_comes_first(markers_first: bool) -> None:
    markers, annotations = messages(result())
    joiner = ResultJoiner()
    if markers_first:
        assert joiner.add_markers(markers) is None
        joined = joiner.add_annotations(annotations)
    else:
        assert joiner.add_annotations(annotations) is None
        joined = joiner.add_markers(markers)
    assert joined is not None and joined.stamp == STAMP
    assert [each.id for each in joined.objects] == [3, 4]
    assert [each.size for each in joined.objects] == [box[2:] for box in BOXES.values()]
    assert [each.speed for each in joined.objects] == [50.0, 50.0]
    blue, green, red = colour_of(3)
    assert joined.objects[0].colour == f"#{red:02x}{green:02x}{blue:02x}"
    assert joined.objects[0].trail[:2] == ((5.0, 20.0), (10.0, 20.0))


def test_an_object_in_two_parts_has_two_outlines() -> None:
    found = result()
    found.labels[20:32, 20:25] = 0
    _, annotations = messages(found)
    joiner = ResultJoiner()
    joiner.add_markers(CentroidMarkers().message(found))
    joined = joiner.add_annotations(annotations)
    assert joined is not None
    assert [len(each.outlines) for each in joined.objects] == [2, 1]


def test_no_object_is_a_result_at_once() -> None:
    _, annotations = messages(result(boxes={}))
    joined = ResultJoiner().add_annotations(annotations)
    assert joined is not None and (joined.stamp, joined.objects) == (STAMP, ())


def test_messages_of_two_frames_are_not_mixed_and_lost_ones_forgotten() -> None:
    joiner = ResultJoiner()
    for number in range(100):
        markers, _ = messages(result(STAMP + number))
        assert joiner.add_markers(markers) is None
    _, old = messages(result(STAMP))
    assert joiner.add_annotations(old) is None
    _, new = messages(result(STAMP + 99))
    assert joiner.add_annotations(new) is not None


def test_a_trail_on_a_calibrated_cameras_plane_is_not_taken_for_pixels() -> None:
    markers = CentroidMarkers()
    info = CameraInfo(width=120, height=80, distortion_model="plumb_bob")
    info.k = [100.0, 0.0, 60.0, 0.0, 100.0, 40.0, 0.0, 0.0, 1.0]
    info.d = [0.0] * 5
    markers.calibrate(info)
    found = result()
    joiner = ResultJoiner()
    joiner.add_markers(markers.message(found))
    joined = joiner.add_annotations(annotations_message(found))
    assert joined is not None
    assert joined.objects[0].trail == ()
    assert joined.objects[0].size == BOXES[3][2:]


def test_corners_that_are_nowhere_are_left_out() -> None:
    markers, annotations = messages(result())
    annotations.points[0].x = float("nan")
    joiner = ResultJoiner()
    joiner.add_markers(markers)
    joined = joiner.add_annotations(annotations)
    assert joined is not None
    corners = [c for each in joined.objects for outline in each.outlines for c in outline]
    assert corners and np.isfinite(corners).all()
    assert all(each.size is not None for each in joined.objects)
