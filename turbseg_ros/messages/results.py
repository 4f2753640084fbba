"""Segmentation results as ROS messages; needs the message packages, no running middleware.

Every message carries the stamp and frame id of the frame that it belongs to.
"""

from __future__ import annotations

import functools
import math
import reprlib
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import ImageMarker, Marker, MarkerArray

from turbseg_ros.messages.detections import TYPE_NAME as DETECTIONS_TYPE
from turbseg_ros.messages.detections import Detection, serialised_detections
from turbseg_ros.messages.events import EventMessages
from turbseg_ros.messages.image_annotations import TYPE_NAME as IMAGE_ANNOTATIONS_TYPE
from turbseg_ros.messages.image_annotations import image_annotations, no_annotations
from turbseg_ros.messages.images import message_from_image, ns_to_stamp
from turbseg_ros.messages.stream_monitor import pause_timeout_for
from turbseg_ros.overlay import colour_of, draw_overlay, simplified_outlines
from turbseg_ros.segmentation.clutter import cells_of
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult
from turbseg_ros.segmentation.tone import ToneMap

# The velocity arrow ends where the object will be after so many frames.
_ARROW_FRAMES = 10.0
# What a detection is an instance of.
OBJECT = "object"
IMAGE_TYPE = "sensor_msgs/msg/Image"
# Seconds that markers outlive a pause, so that it is the node that deletes them.
_GRACE = 1.0
# Subscribers learn that they missed a message after some amount of data (images: at once), or by
# Fast DDS' heartbeat every three seconds. Small messages have to be kept for so long at 30 Hz.
_SMALL_DEPTH = 100
# Whoever records may stall for a second; and when a stream pauses, all frames that wait for later
# ones are answered at once.
_IMAGE_DEPTH = 30


def header_of(frame: Frame) -> Header:
    """Return the header that all messages about a frame share."""
    return Header(stamp=ns_to_stamp(frame.stamp), frame_id=frame.frame_id)


def _lifetime(frame: Frame) -> Duration:
    """Return how long markers stay where nobody deletes them: as long as a stream may pause."""
    seconds = pause_timeout_for(frame.period or 0.0) + _GRACE
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return Duration(sec=whole, nanosec=rest)


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


def clutter_message(result: SegmentationResult) -> Image:
    """Return what each cell of the scene is known to move by anyway, as 32FC1, pixels a frame.

    A cell is four by four pixels at processing resolution; 0 where nothing is known.
    """
    if result.clutter is None:
        unknown = np.zeros(cells_of(result.motion_map.shape), np.float32)
        return _image(result, unknown, "32FC1")
    return _image(result, result.clutter, "32FC1")


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
        lifetime=_lifetime(result.frame),
    )
    points: list[Point] = []
    colours: list[ColorRGBA] = []
    for moving_object in result.objects:
        colour = _colour(moving_object.id)
        for contour in simplified_outlines(result.labels, moving_object):
            corners = [_point(x, y) for x, y in contour.tolist()]
            for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
                points += (start, end)
                colours.append(colour)
    marker.points = points
    marker.outline_colors = colours
    return marker


def detections_message(result: SegmentationResult) -> bytes:
    """Return each object's box, id and score as a serialised vision_msgs/Detection2DArray."""
    found = [Detection(each.box, str(each.id), OBJECT, each.score) for each in result.objects]
    return serialised_detections(found, result.frame.stamp, result.frame.frame_id)


def annotations_removal(frame: Frame) -> ImageMarker:
    """Return what takes the outlines away when no more frames come after this one."""
    return ImageMarker(header=header_of(frame), ns="outlines", action=ImageMarker.REMOVE)


class MarkerPlane(Protocol):
    """Where markers are drawn: pixel positions go in, positions in the camera's frame come out."""

    @property
    def is_calibrated(self) -> bool:
        """Whether positions are in the camera's optical frame."""

    @property
    def pixel_size(self) -> float:
        """Side of a pixel on the plane, in the plane's unit."""

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y)."""


@dataclass(frozen=True)
class PixelPlane:
    """Pixel coordinates as they are: x right, y down, z 0."""

    pixel_size: float = 1.0
    is_calibrated: bool = False

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y)."""
        return np.pad(np.asarray(pixels, dtype=np.float64), ((0, 0), (0, 1)))


@dataclass(frozen=True)
class UnitDepthPlane:
    """The plane one metre before the camera, in its optical frame (z forward, REP 103).

    `camera_matrix` is 3x3 and `distortion` OpenCV's coefficients, both of the full sensor, those
    of its fisheye model where the camera is a `fisheye`; an image pixel is `binning` sensor
    pixels and starts at `offset` (x, y) on the sensor.
    """

    camera_matrix: npt.NDArray[np.float64]
    distortion: npt.NDArray[np.float64]
    binning: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    fisheye: bool = False
    is_calibrated: bool = True

    @classmethod
    def from_camera_info(
        cls, camera_info: CameraInfo, image_size: tuple[int, int] | None = None
    ) -> UnitDepthPlane:
        """Take the calibration of a camera.

        Coefficients that are 0 may be too many or too few. An image of another size than
        camera_info says is the same view scaled, or the whole sensor.

        :param image_size: width and height of the images; by default, those that it says.
        :raises ValueError: when it is not calibrated, its distortion is of another model or
            number of coefficients than can be undone, or the image can't be the same view.
        """
        matrix = np.asarray(camera_info.k, dtype=np.float64).reshape(3, 3)
        if not np.isfinite(matrix).all():
            raise ValueError("camera_info holds no calibration (K is not finite)")
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
            raise ValueError("camera_info holds no calibration (K is zero)")
        if min(matrix[0, 0], matrix[1, 1]) < _MIN_FOCAL or np.abs(matrix).max() > _MAX_PIXELS:
            raise ValueError("camera_info holds no calibration (K is that of no camera)")
        model = camera_info.distortion_model
        if model not in _MODELS:
            raise ValueError(
                f"camera_info has distortion model {reprlib.repr(model)}; "
                "markers take plumb_bob, rational_polynomial or equidistant"
            )
        binning, offset = _view(camera_info, image_size)
        return cls(
            camera_matrix=matrix,
            distortion=_coefficients(camera_info),
            binning=binning,
            offset=offset,
            fisheye=model in _FISHEYE_MODELS,
        )

    @property
    def pixel_size(self) -> float:
        """Side of a pixel on the plane, in metres."""
        return self.binning[0] / float(self.camera_matrix[0, 0])

    def place(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the Nx3 positions of Nx2 pixel positions (x, y).

        Where the distortion can't be undone, outside of the lens' picture, it is left out.
        """
        # Centres of pixels are at whole numbers, on the sensor as in the image.
        binning = np.asarray(self.binning, dtype=np.float64)
        on_sensor = np.asarray(pixels, dtype=np.float64) * binning + self.offset
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        rays = undistort(on_sensor.reshape(-1, 1, 2), self.camera_matrix, self.distortion)
        focal_lengths, centre = self.camera_matrix[[0, 1], [0, 1]], self.camera_matrix[:2, 2]
        straight = (on_sensor - centre) / focal_lengths
        possible = (np.isfinite(rays[:, 0]) & (np.abs(rays[:, 0]) < _MAX_RAY)).all(
            axis=1, keepdims=True
        )
        placed = np.where(possible, rays[:, 0], straight)
        return np.pad(placed, ((0, 0), (0, 1)), constant_values=1.0)


_FISHEYE_MODELS = ("equidistant", "fisheye")
_MODELS = ("", "plumb_bob", "rational_polynomial", *_FISHEYE_MODELS)
# How many coefficients OpenCV takes; rational_polynomial goes on where plumb_bob ends.
_COUNTS = (0, 4, 5, 8, 12, 14)
_FISHEYE_COUNT = 4
# Pixels; beyond these, what is computed may be infinite.
_MIN_FOCAL, _MAX_PIXELS = 1e-3, 1e9
# Metres aside at one metre's distance: 89.9 degrees.
_MAX_RAY = 600.0
# Share by which the sides' proportions may differ in an image that is the same view, scaled.
_MAX_STRETCH = 0.02


def _coefficients(camera_info: CameraInfo) -> npt.NDArray[np.float64]:
    """Return the distortion in a number of coefficients that OpenCV takes."""
    given = np.asarray(camera_info.d, dtype=np.float64)
    if not np.isfinite(given).all():
        raise ValueError("camera_info holds coefficients that are not finite")
    used = int(np.max(np.nonzero(given)[0], initial=-1)) + 1
    model = camera_info.distortion_model
    fisheye = model in _FISHEYE_MODELS
    counts = (_FISHEYE_COUNT,) if fisheye else _COUNTS
    if len(given) in counts:
        return given
    if not used and not fisheye:
        return np.zeros(_COUNTS[1])
    # What is 0 may be left out, but not put in: nobody knows what those there stand for.
    fitting = [count for count in counts if 0 < used <= count <= len(given)]
    if not fitting:
        raise ValueError(
            f"camera_info has {len(given)} coefficients, "
            f"which are not those of {model or 'plumb_bob'}"
        )
    return given[: fitting[0]]


def _view(
    camera_info: CameraInfo, image_size: tuple[int, int] | None
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return how many sensor pixels an image's pixel is (x, y), and where it begins."""
    # 0 means the same as 1 in CameraInfo.
    binning = float(max(camera_info.binning_x, 1)), float(max(camera_info.binning_y, 1))
    sensor = camera_info.width, camera_info.height
    roi = camera_info.roi
    offset = float(roi.x_offset), float(roi.y_offset)
    # 0 stands for the whole sensor here, too.
    part = roi.width or sensor[0], roi.height or sensor[1]
    if image_size is None or not all(sensor):
        return binning, offset
    whole = (0.0, 0.0)
    for view, pixel, begin in (
        (part, binning, offset),
        (sensor, (1.0, 1.0), whole),
        (part, (1.0, 1.0), offset),
        (sensor, binning, whole),
    ):
        sides = (int(side / each) for side, each in zip(view, pixel, strict=True))
        if all(abs(a - b) <= 1 for a, b in zip(sides, image_size, strict=True)):
            return pixel, begin
    for view, begin in ((part, offset), (sensor, whole)):
        scale = view[0] / image_size[0], view[1] / image_size[1]
        if abs(scale[0] / scale[1] - 1.0) <= _MAX_STRETCH:
            return scale, begin
    raise ValueError(
        f"camera_info is of {sensor[0]}x{sensor[1]} pixels, which {image_size[0]}x{image_size[1]} "
        "of the images can't be, scaled or not"
    )


_NAMESPACES = ("centroid", "id", "velocity", "trail")


def _deletions(header: Header, ids: Collection[int]) -> list[Marker]:
    return [
        Marker(header=header, ns=namespace, id=object_id, action=Marker.DELETE)
        for object_id in sorted(ids)
        for namespace in _NAMESPACES
    ]


class CentroidMarkers:
    """Markers for each object's centroid, id, velocity and trail, on `plane`.

    The object's id is the marker's id, and each kind has a namespace. Objects that were shown
    before and are gone are deleted, which is why an instance belongs to one stream of results.

    :param on_misfit: told, once for each reason, why a camera's calibration is of no use.
    """

    def __init__(
        self, plane: MarkerPlane | None = None, on_misfit: Callable[[str], None] = lambda _: None
    ) -> None:
        self.plane: MarkerPlane = plane or PixelPlane()
        self._on_misfit = on_misfit
        self._told: set[str] = set()
        self._shown: frozenset[int] = frozenset()
        self._camera_info: CameraInfo | None = None
        # What the plane was made of, and for.
        self._fitted: tuple[Hashable, ...] | None = None

    def calibrate(self, camera_info: CameraInfo) -> None:
        """Take a camera's calibration, which holds from the next result on; any thread may."""
        self._camera_info = camera_info

    def removal(self, frame: Frame) -> list[MarkerArray]:
        """Return what deletes all markers that are shown, nothing when none are.

        :param frame: the last one.
        """
        if not self._shown:
            return []
        markers = _deletions(header_of(frame), self._shown)
        self._shown = frozenset()
        return [MarkerArray(markers=markers)]

    def _fit_plane(self, image_shape: tuple[int, ...]) -> None:
        info = self._camera_info
        if info is None:
            return
        key = (
            *image_shape,
            *(info.width, info.height, info.binning_x, info.binning_y, info.distortion_model),
            *(info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height),
            *(np.asarray(info.k).tobytes(), np.asarray(info.d).tobytes()),
        )
        if key == self._fitted:
            return
        self._fitted = key
        try:
            plane = UnitDepthPlane.from_camera_info(info, (image_shape[1], image_shape[0]))
            # What OpenCV makes of it shows when it is used.
            plane.place([(0.0, 0.0)])
        except (ValueError, cv2.error) as error:
            self.plane = PixelPlane()
            reason = str(error)
            if reason not in self._told:
                self._told.add(reason)
                self._on_misfit(reason)
        else:
            self.plane = plane

    def message(self, result: SegmentationResult) -> MarkerArray:
        """Return the markers of the next result."""
        self._fit_plane(result.labels.shape)
        brush = _MarkerBrush(
            header_of(result.frame), self.plane, result.labels.shape, _lifetime(result.frame)
        )
        present = frozenset(moving_object.id for moving_object in result.objects)
        markers = _deletions(brush.header, self._shown - present)
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
    lifetime: Duration

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
        if (velocity := moving_object.velocity_per_second) is not None:
            text.text += f"\n{math.hypot(*velocity):.0f} px/s"
        width, height = moving_object.box[2:]
        text.text += f"\n{width}x{height} px"
        if self.plane.is_calibrated:
            azimuth, elevation = _angles(centroid)
            text.text += f"\naz {azimuth:+.2f}° el {elevation:+.2f}°"
        arrow = self._marker("velocity", moving_object.id, Marker.ARROW, (size / 4, size / 2, 0.0))
        arrow.points = [centroid, tip]
        line = self._marker("trail", moving_object.id, Marker.LINE_STRIP, (size / 4, 0.0, 0.0))
        # A line needs two points; a new object's has no length.
        line.points = trail if len(trail) > 1 else [centroid, centroid]
        return [ball, text, arrow, line]

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
        marker.lifetime = self.lifetime
        return marker

    def _points(self, pixels: npt.ArrayLike) -> list[Point]:
        return [_point(x, y, z) for x, y, z in self.plane.place(pixels).tolist()]


@dataclass(frozen=True)
class Output:
    """One topic of results: its name below the node's, that of its type, how messages are built.

    `build` returns the messages of a result, serialised or not: one, or none or several where it
    is not of `every_frame`. A `stateful` output's messages tell what changed since those before,
    so that every one has to be built; of the others, only those that someone wants. One that
    `shows_image` can be built only of results whose frame kept its image. `depth` is how many
    messages a publisher keeps for subscribers that missed one. `remove` returns the messages that
    take the marks of the last frame away when no more come.
    """

    name: str
    type_name: str
    build: Callable[[SegmentationResult], Sequence[Any]]
    stateful: bool = False
    every_frame: bool = True
    shows_image: bool = False
    depth: int = _IMAGE_DEPTH
    remove: Callable[[Frame], Sequence[Any]] = lambda _: ()


def one(build: Callable[[SegmentationResult], Any]) -> Callable[[SegmentationResult], list[Any]]:
    """Return what builds a list of the one message that `build` makes of a result."""
    return lambda result: [build(result)]


def outputs(
    max_objects: int, markers: CentroidMarkers, events: EventMessages
) -> tuple[Output, ...]:
    """Return the topics that hold what was found; `markers` and `events` are of this stream."""
    return (
        Output("labels", IMAGE_TYPE, one(labels_message)),
        Output("mask", IMAGE_TYPE, one(mask_message)),
        Output(
            "centroids",
            "visualization_msgs/msg/MarkerArray",
            one(markers.message),
            stateful=True,
            depth=_SMALL_DEPTH,
            remove=markers.removal,
        ),
        Output(
            "annotations",
            "visualization_msgs/msg/ImageMarker",
            one(annotations_message),
            depth=_SMALL_DEPTH,
            remove=lambda frame: [annotations_removal(frame)],
        ),
        Output(
            "image_annotations",
            IMAGE_ANNOTATIONS_TYPE,
            one(image_annotations),
            depth=_SMALL_DEPTH,
            remove=lambda frame: [no_annotations(frame)],
        ),
        Output(
            "events",
            "diagnostic_msgs/msg/DiagnosticStatus",
            events.messages,
            stateful=True,
            every_frame=False,
            depth=_SMALL_DEPTH,
            remove=events.removal,
        ),
        Output("detections", DETECTIONS_TYPE, one(detections_message), depth=_SMALL_DEPTH),
        *map(slot_output, range(max_objects)),
    )


def slot_output(slot: int) -> Output:
    """Return the topic of the mask of the object that holds a slot."""
    build = functools.partial(slot_mask_message, slot=slot)
    return Output(f"objects/slot_{slot}/mask", IMAGE_TYPE, one(build))


def views() -> tuple[Output, ...]:
    """Return the topics for people to look at."""
    return (
        Output("overlay", IMAGE_TYPE, one(OverlayView().message), shows_image=True),
        Output("motion", IMAGE_TYPE, one(motion_message)),
        Output("clutter", IMAGE_TYPE, one(clutter_message)),
    )


def _image(result: SegmentationResult, array: npt.NDArray[Any], encoding: str) -> Image:
    return message_from_image(array, encoding, result.frame.stamp, result.frame.frame_id)


def _colour(object_id: int) -> ColorRGBA:
    blue, green, red = colour_of(object_id)
    return ColorRGBA(r=red / 255.0, g=green / 255.0, b=blue / 255.0, a=1.0)


def _angles(point: Point) -> tuple[float, float]:
    """Return how far right of the optical axis a point lies, and how far above, in degrees."""
    azimuth = math.atan2(point.x, point.z)
    elevation = math.atan2(-point.y, math.hypot(point.x, point.z))
    return math.degrees(azimuth), math.degrees(elevation)


def _point(x: float, y: float, z: float = 0.0) -> Point:
    # rclpy takes an int's memory for that of a double, unchecked.
    return Point(x=float(x), y=float(y), z=float(z))
