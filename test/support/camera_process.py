"""Cameras as a process: `camera_process.py --size W H --rate HZ --images N [--jpeg Q] TOPIC...`.

All of them show a bag's frames in colour, forward and backward, as JPEG of a quality if they are
told so. Once every topic is heard, each
camera sends its first image; the others follow, at the rate, when a line comes on standard input.
A second line ends the process.
"""

from __future__ import annotations

import argparse
import itertools
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.memory import keep_large_buffers
from turbseg_ros.messages.images import message_from_image

BAG = Path(__file__).parents[2] / "bags" / "normal"
FIRST, ALL = "first images sent", "all images sent"
# A serialised image begins with four bytes about the format, the stamp's seconds and nanoseconds.
_STAMP = struct.Struct("<iI")
_STAMP_END = 4 + _STAMP.size


def serialised_pictures(size: tuple[int, int], jpeg: int | None) -> list[bytes]:
    """Return a bag's frames as serialised images of a size (width, height): bgr8, or JPEG."""
    reader = BagReader(BAG)
    pictures = [
        cv2.cvtColor(cv2.resize(frame.image, size), cv2.COLOR_GRAY2BGR)
        for frame in BagFrames(reader, reader.find_image_topic(None))
    ]
    if jpeg is None:
        return [serialize_message(message_from_image(p, "bgr8", 0, "camera")) for p in pictures]
    return [serialize_message(compressed(picture, jpeg)) for picture in pictures]


def compressed(picture: npt.NDArray[np.uint8], quality: int) -> CompressedImage:
    message = CompressedImage(format="bgr8; jpeg compressed bgr8")
    message.header.frame_id = "camera"
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    message.data.frombytes(data.tobytes())
    return message


def forward_and_backward(pictures: Sequence[bytes]) -> Iterator[bytes]:
    return itertools.cycle([*pictures, *pictures[-2:0:-1]])


def stamped(picture: bytes, stamp: int) -> bytes:
    """Return a serialised image another stamp, in nanoseconds."""
    return b"".join(
        (picture[:4], _STAMP.pack(*divmod(stamp, 10**9)), memoryview(picture)[_STAMP_END:])
    )


def run() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, nargs=2, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--images", type=int, required=True)
    parser.add_argument("--jpeg", type=int)
    parser.add_argument("topics", nargs="+")
    options = parser.parse_args()

    keep_large_buffers()
    images = forward_and_backward(serialised_pictures(options.size, options.jpeg))
    rclpy.init()
    node = Node("cameras")
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
    kind = Image if options.jpeg is None else CompressedImage
    publishers = [node.create_publisher(kind, topic, qos) for topic in options.topics]

    def send() -> None:
        for publisher in publishers:
            publisher.publish(stamped(next(images), time.time_ns()))

    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.05)
    send()
    print(FIRST, flush=True)
    sys.stdin.readline()
    step, due = 1.0 / options.rate, time.monotonic()
    begun = time.process_time()
    for _ in range(options.images - 1):
        time.sleep(max(due - time.monotonic(), 0.0))
        # A hold-up is not made up for by a burst.
        due = max(due + step, time.monotonic() - 5 * step)
        send()
    cost = 1000.0 * (time.process_time() - begun) / max(options.images - 1, 1)
    print(f"{ALL}, for {cost:.1f} ms of processor time a frame", flush=True)
    # What is on its way goes with its publisher.
    sys.stdin.readline()
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    run()
