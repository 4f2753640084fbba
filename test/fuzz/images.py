"""Fuzz the way from a message to a picture: a frame that the method takes, or a refusal.

An input that begins with S or C is a serialised image or compressed image, any other makes the
fields of a message.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["turbseg_ros"]):
    from turbseg_ros.messages import images
    from turbseg_ros.messages.images import (
        ImageConversionError,
        frame_from_message,
        frame_from_serialised,
    )
    from turbseg_ros.segmentation.tone import ToneMap

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CompressedImage, Image

ENCODINGS = [*images._LAYOUTS, "", "mono12"]


def message_of(provider: atheris.FuzzedDataProvider) -> Image | CompressedImage:
    stamp = Time(
        sec=provider.ConsumeIntInRange(-(2**31), 2**31 - 1),
        nanosec=provider.ConsumeIntInRange(0, 2**32 - 1),
    )
    if provider.ConsumeBool():
        message = CompressedImage(format="png")
    else:
        largest = 2**32 - 1 if provider.ConsumeProbability() < 0.1 else 64
        message = Image(
            encoding=provider.PickValueInList(ENCODINGS),
            height=provider.ConsumeIntInRange(0, largest),
            width=provider.ConsumeIntInRange(0, largest),
            step=provider.ConsumeIntInRange(0, 8 * largest if largest == 64 else largest),
            is_bigendian=provider.ConsumeIntInRange(0, 255),
        )
    message.header.stamp = stamp
    message.data.frombytes(provider.ConsumeBytes(provider.remaining_bytes()))
    return message


def try_one(data: bytes) -> None:
    kind = {b"S": Image, b"C": CompressedImage}.get(data[:1])
    message = None if kind else message_of(atheris.FuzzedDataProvider(data))
    try:
        if kind is None:
            frame = frame_from_message(message)
        else:
            frame = frame_from_serialised(memoryview(data)[1:], kind)
    except ImageConversionError as error:
        assert "\n" not in str(error)
        return
    assert frame.image.ndim == 2 or frame.image.shape[2] == 3
    assert frame.image.dtype in (np.uint8, np.uint16, np.float32)
    if isinstance(message, Image):
        assert frame.image.shape[:2] == (message.height, message.width)
    picture = ToneMap()(frame.image)
    assert picture.dtype == np.uint8
    assert picture.shape == frame.image.shape


if __name__ == "__main__":
    atheris.Setup(sys.argv, try_one)
    atheris.Fuzz()
