"""Fuzz calibrations: whatever a camera_info says, markers have places, or it is refused.

An input says in what a camera_info differs from a sound one, and the size of the images.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["turbseg_ros"]):
    from turbseg_ros.messages.results import CentroidMarkers, UnitDepthPlane
    from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

import numpy as np
from sensor_msgs.msg import CameraInfo, RegionOfInterest

MODELS = ["", "plumb_bob", "rational_polynomial", "equidistant", "fisheye", "thin_prism"]
LARGEST = 2**32 - 1


def number_of(provider: atheris.FuzzedDataProvider) -> float:
    """Return any number at all, or, more often, one that stands in calibrations."""
    if provider.ConsumeProbability() < 0.2:
        return float(provider.ConsumeFloat())
    return float(provider.ConsumeIntInRange(-4000, 4000)) / provider.PickValueInList([1, 10, 1000])


def side_of(provider: atheris.FuzzedDataProvider) -> int:
    largest = LARGEST if provider.ConsumeProbability() < 0.1 else 128
    return int(provider.ConsumeIntInRange(0, largest))


def message_of(provider: atheris.FuzzedDataProvider) -> CameraInfo:
    named = provider.ConsumeProbability() < 0.9
    matrix = [100.0, 0.0, 32.0, 0.0, 100.0, 24.0, 0.0, 0.0, 1.0]
    for _ in range(provider.ConsumeIntInRange(0, 3)):
        matrix[provider.ConsumeIntInRange(0, 8)] = number_of(provider)
    sound_size = provider.ConsumeBool()
    return CameraInfo(
        width=64 if sound_size else side_of(provider),
        height=48 if sound_size else side_of(provider),
        binning_x=side_of(provider),
        binning_y=side_of(provider),
        roi=RegionOfInterest(
            x_offset=side_of(provider),
            y_offset=side_of(provider),
            width=side_of(provider),
            height=side_of(provider),
        ),
        distortion_model=(
            provider.PickValueInList(MODELS) if named else provider.ConsumeUnicodeNoSurrogates(12)
        ),
        k=matrix,
        d=[number_of(provider) for _ in range(provider.ConsumeIntInRange(0, 15))],
    )


def result_of(width: int, height: int) -> SegmentationResult:
    labels = np.zeros((height, width), np.uint16)
    labels[height // 2 :, width // 2 :] = 1
    found = MovingObject.from_mask(labels > 0, 1, 0, velocity=(3.0, -4.0))
    frame = Frame(0, np.zeros((height, width), np.uint8), "camera")
    return SegmentationResult(frame, labels, (found,), np.zeros((2, 2), np.float32), 0.1, "none")


def try_one(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    info = message_of(provider)
    width, height = (32, 24) if provider.ConsumeBool() else (provider.ConsumeIntInRange(1, 128), 9)
    try:
        plane = UnitDepthPlane.from_camera_info(info, (width, height))
    except ValueError as error:
        assert str(error).isprintable()
    else:
        assert 0.0 < plane.pixel_size < np.inf
        corners = [(0.0, 0.0), (width - 1.0, 0.0), (width - 1.0, height - 1.0), (0.4, 0.6)]
        placed = plane.place(corners)
        assert placed.shape == (4, 3)
        assert np.isfinite(placed).all()
        assert (placed[:, 2] == 1.0).all()
    told: list[str] = []
    markers = CentroidMarkers(on_misfit=told.append)
    markers.calibrate(info)
    for marker in markers.message(result_of(width, height)).markers:
        where, size = marker.pose.position, marker.scale
        numbers = [where.x, where.y, where.z, size.x, size.y, size.z]
        numbers += [each for point in marker.points for each in (point.x, point.y, point.z)]
        assert np.isfinite(numbers).all()
    assert all(reason.isprintable() for reason in told)


if __name__ == "__main__":
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
