"""A bag with something that moves, drawn, with its exact truth."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from turbseg_ros.bag.topics import TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.messages.images import message_from_image

SIZE = (120, 208)


def write_drawn_bag(path: Path, stamps: Iterable[int]) -> Path:
    """Write a frame at each stamp: a dark patch goes 3 pixels a frame over a textured ground."""
    random = np.random.default_rng(1)
    ground = cv2.GaussianBlur(random.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 2.0)
    ground = cv2.normalize(ground, None, 90, 220, cv2.NORM_MINMAX).astype(np.uint8)
    with BagWriter(path) as writer:
        for number, stamp in enumerate(stamps):
            image, truth = ground.copy(), np.zeros(SIZE, np.uint8)
            patch = (slice(50, 75), slice(20 + 3 * number, 60 + 3 * number))
            image[patch], truth[patch] = 20, 1
            writer.write("/lens/image_raw", message_from_image(image, "mono8", stamp), stamp)
            writer.write(TRUTH_TOPIC, message_from_image(truth, "mono8", stamp), stamp)
    return path
