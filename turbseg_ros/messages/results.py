"""Segmentation results as ROS messages; needs the message packages, no running middleware.

Every message carries the stamp and frame id of the frame that it belongs to.
"""

from __future__ import annotations

import functools
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import ImageMarker, Marker, MarkerArray

from turbseg_ros.messages.images import message_from_image, ns_to_stamp
from turbseg_ros.overlay import colour_of, draw_overlay, outlines
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult
from turbseg_ros.segmentation.tone import ToneMap

# The velocity arrow ends where the object will be after so many frames.
_ARROW_FRAMES = 10.0
# Outlines for viewers are let off corners that stand out less than this, in pixels.
_OUTLINE_TOLERANCE = 0.5
# Subscribers learn that they missed a message after some amount of data (images: at once), or by
# Fast DDS' heartbeat every three seconds. Small messages have to be kept for so long at 30 Hz.
_SMALL_DEPTH = 100
# Whoever records may stall for a second; and when a stream pauses, all frames that wait for later
# ones are answered at once.
_IMAGE_DEPTH = 30


def header_of(frame: Frame) -> Header:
    """Return the header that all messages about a frame share."""
    return Header(stamp=ns_to_stamp(frame.stamp), frame_id=frame.frame_id)


def labels_message(result: SegmentationResult) -> Image:
    """Return the labels as mono16 at the frame's size: 0 background, k the object with id k."""
    return _image(result, result.labels, "mono16")


def mask_message(result: SegmentationResult) -> Image:
    """Return all objects together as mono8, 0 or 255."""
    return _image(result, _white(result.labels > 0), "mono8")


def slot_mask_message(result: SegmentationResult, slot: int) -> Image:
    """Return the object that holds `slot` as mono8, 0 or 255; all 0 while the slot is free."""
    mask = np.zeros(result.labels.shape, np.uint8)
    for moving_object in result.objects:
        if moving_object.slot == slot:
            mask = _white(result.labels == moving_object.label)
    return _image(result, mask, "mono8")


def _white(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    # OpenCV's comparisons take a number for a row of them when the array is as narrow.
    return mask.view(np.uint8) * np.uint8(255)


class OverlayView:
    """The frame with outlines, ids and trails drawn on it, as bgr8.

    16-bit and float images are stretched steadily from one message to the next, which is why an
    instance belongs to one stream of results.
    """

    def __init__(self) -> None:
        self._tones: defaultdict[str, ToneMap] = defaultdict(ToneMap)

    def message(self, result: SegmentationResult) -> Image:
        """Return the picture of the next result."""
        # What a sensor's 16 bits span tells nothing of its floats.
        tone = self._tones[result.frame.image.dtype.name]
        return _image(result, draw_overlay(result, tone=tone).image, "bgr8")


def motion_message(result: SegmentationResult) -> Image:
    """Return the motion map as 32FC1, pixels a frame, at processing resolution."""
    return _image(result, result.motion_map, "32FC1")


def annotations_message(result: SegmentationResult) -> ImageMarker:
    """Return the outlines of all objects as one line list, a colour for each line.

    One marker holds them all, so that each frame's replaces the one before.
    """
    marker = ImageMarker(
        header=header_of(result.frame),
        ns="outlines",
        type=ImageMarker.LINE_LIST,
        action=ImageMarker.ADD,
        scale=1.0,
    )
    points: list[Point] = []
    colours: list[ColorRGBA] = []
    for moving_object in result.objects:
        colour = _colour(moving_object.id)
        for contour in outlines(result.labels, moving_object):
            corners = [
                _point(x, y)
                for x, y in cv2.approxPolyDP(contour, _OUTLINE_TOLERANCE, True)[:, 0].tolist()
            ]
            for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
                points += (start, end)
                colours.append(colour)
    marker.points = points
    marker.outline_colors = colours
    return marker


class MarkerPlane(Protocol):
    """Where markers are drawn: pixel positions go in, positions in the camera's frame come out."""

    @property
    def pixel_size(self) -> float:
        """Side of a pixel on the plane, in the plane's unit."""

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y)."""


@dataclass(frozen=True)
class PixelPlane:
    """Pixel coordinates as they are: x right, y down, z 0."""

    pixel_size: float = 1.0

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y)."""
        return np.pad(np.asarray(pixels, dtype=np.float64), ((0, 0), (0, 1)))


@dataclass(frozen=True)
class UnitDepthPlane:
    """The plane one metre before the camera, in its optical frame (z forward, REP 103).

    `camera_matrix` is 3x3 and `distortion` OpenCV's coefficients, both of the full sensor;
    an image pixel is `binning` sensor pixels and starts at `offset` (x, y) on the sensor.
    """

    camera_matrix: npt.NDArray[np.float64]
    distortion: npt.NDArray[np.float64]
    binning: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def from_camera_info(cls, camera_info: CameraInfo) -> UnitDepthPlane:
        """Take the calibration of a camera.

        :raises ValueError: when it is not calibrated or its distortion model is not one of
            plumb_bob and rational_polynomial.
        """
        matrix = np.asarray(camera_info.k, dtype=np.float64).reshape(3, 3)
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
            raise ValueError("camera_info holds no calibration (K is zero)")
        if camera_info.distortion_model not in ("", "plumb_bob", "rational_polynomial"):
            raise ValueError(
                f"camera_info has distortion model {camera_info.distortion_model}; "
                "markers take plumb_bob or rational_polynomial"
            )
        return cls(
            camera_matrix=matrix,
            distortion=np.asarray(camera_info.d, dtype=np.float64),
            # 0 means the same as 1 in CameraInfo.
            binning=(max(camera_info.binning_x, 1), max(camera_info.binning_y, 1)),
            offset=(camera_info.roi.x_offset, camera_info.roi.y_offset),
        )

    @property
    def pixel_size(self) -> float:
        """Side of a pixel on the plane, in metres."""
        return self.binning[0] / float(self.camera_matrix[0, 0])

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y)."""
        on_sensor = np.asarray(pixels, dtype=np.float64) * self.binning + self.offset
        rays = cv2.undistortPoints(
            on_sensor.reshape(-1, 1, 2), self.camera_matrix, self.distortion
        )
        return np.pad(rays[:, 0].astype(np.float64), ((0, 0), (0, 1)), constant_values=1.0)


class CentroidMarkers:
    """Markers for each object's centroid, id, velocity and trail, on `plane`.

    The object's id is the marker's id, and each kind has a namespace. Objects that were shown
    before and are gone are deleted, which is why an instance belongs to one stream of results.
    """

    _NAMESPACES = ("centroid", "id", "velocity", "trail")

    def __init__(self, plane: MarkerPlane | None = None) -> None:
        self.plane: MarkerPlane = plane or PixelPlane()
        self._shown: frozenset[int] = frozenset()

    def message(self, result: SegmentationResult) -> MarkerArray:
        """Return the markers of the next result."""
        brush = _MarkerBrush(header_of(result.frame), self.plane, result.labels.shape)
        present = frozenset(moving_object.id for moving_object in result.objects)
        markers = [
            brush.deletion(namespace, object_id)
            for object_id in sorted(self._shown - present)
            for namespace in self._NAMESPACES
        ]
        for moving_object in result.objects:
            markers += brush.markers(moving_object)
        self._shown = present
        return MarkerArray(markers=markers)


@dataclass(frozen=True)
class _MarkerBrush:
    """Draws the markers of one frame."""

    header: Header
    plane: MarkerPlane
    image_shape: tuple[int, ...]

    def markers(self, moving_object: MovingObject) -> list[Marker]:
        (u, v), (du, dv) = moving_object.centroid, moving_object.velocity
        above = (u, v - 2 * self._mark_diameter)
        ahead = (u + _ARROW_FRAMES * du, v + _ARROW_FRAMES * dv)
        path = (*moving_object.trail, moving_object.centroid)
        centroid, text_position, tip, *trail = self._points(((u, v), above, ahead, *path))

        size = self._mark_diameter * self.plane.pixel_size
        ball = self._marker("centroid", moving_object.id, Marker.SPHERE, (size, size, size))
        ball.pose.position = centroid
        text = self._marker("id", moving_object.id, Marker.TEXT_VIEW_FACING, (0.0, 0.0, 2 * size))
        text.pose.position = text_position
        text.text = str(moving_object.id)
        arrow = self._marker("velocity", moving_object.id, Marker.ARROW, (size / 4, size / 2, 0.0))
        arrow.points = [centroid, tip]
        line = self._marker("trail", moving_object.id, Marker.LINE_STRIP, (size / 4, 0.0, 0.0))
        # A line needs two points; a new object's has no length.
        line.points = trail if len(trail) > 1 else [centroid, centroid]
        return [ball, text, arrow, line]

    def deletion(self, namespace: str, object_id: int) -> Marker:
        return Marker(header=self.header, ns=namespace, id=object_id, action=Marker.DELETE)

    @property
    def _mark_diameter(self) -> float:
        """Pixels: a hundredth of the image's diagonal, at least three."""
        return max(0.01 * math.hypot(*self.image_shape), 3.0)

    def _marker(
        self, namespace: str, object_id: int, kind: int, scale: tuple[float, float, float]
    ) -> Marker:
        marker = Marker(header=self.header, ns=namespace, id=object_id, type=kind)
        marker.action = Marker.ADD
        marker.pose.orientation.w = 1.0
        x, y, z = map(float, scale)
        marker.scale = Vector3(x=x, y=y, z=z)
        marker.color = _colour(object_id)
        return marker

    def _points(self, pixels: npt.ArrayLike) -> list[Point]:
        return [_point(x, y, z) for x, y, z in self.plane.place(pixels).tolist()]


@dataclass(frozen=True)
class Output:
    """One topic of results: its name below the node's, its type and how a message is built.

    A `stateful` output's messages tell what changed since the one before, so that every one has to
    be built; of the others, only those that someone wants. One that `shows_image` can be built
    only of results whose frame kept its image. `depth` is how many messages a publisher keeps for
    subscribers that missed one.
    """

    name: str
    type: type[Any]
    build: Callable[[SegmentationResult], Any]
    stateful: bool = False
    shows_image: bool = False
    depth: int = _IMAGE_DEPTH


def outputs(max_objects: int, markers: CentroidMarkers) -> tuple[Output, ...]:
    """Return the topics that hold what was found; `markers` are those of this stream."""
    return (
        Output("labels", Image, labels_message),
        Output("mask", Image, mask_message),
        Output("centroids", MarkerArray, markers.message, stateful=True, depth=_SMALL_DEPTH),
        Output("annotations", ImageMarker, annotations_message, depth=_SMALL_DEPTH),
        *map(slot_output, range(max_objects)),
    )


def slot_output(slot: int) -> Output:
    """Return the topic of the mask of the object that holds a slot."""
    build = functools.partial(slot_mask_message, slot=slot)
    return Output(f"objects/slot_{slot}/mask", Image, build)


def views() -> tuple[Output, ...]:
    """Return the topics for people to look at."""
    return (
        Output("overlay", Image, OverlayView().message, shows_image=True),
        Output("motion", Image, motion_message),
    )


def _image(result: SegmentationResult, array: npt.NDArray[Any], encoding: str) -> Image:
    return message_from_image(array, encoding, result.frame.stamp, result.frame.frame_id)


def _colour(object_id: int) -> ColorRGBA:
    blue, green, red = colour_of(object_id)
    return ColorRGBA(r=red / 255.0, g=green / 255.0, b=blue / 255.0, a=1.0)


def _point(x: float, y: float, z: float = 0.0) -> Point:
    # rclpy takes an int's memory for that of a double, unchecked.
    return Point(x=float(x), y=float(y), z=float(z))
