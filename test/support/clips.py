"""What is asked of clips, whoever makes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from turbseg_ros.arrays import Labels
from turbseg_ros.segmentation.frame import Frame


def assert_drawn_by_seed(drawn: Callable[[int], Iterable[tuple[Frame, Labels]]]) -> None:
    """Hold that the same seed gives the same clip, and another seed another."""
    one, again, other = (list(drawn(seed)) for seed in (3, 3, 4))
    for (frame, labels), (frame_again, labels_again) in zip(one, again, strict=True):
        assert frame.stamp == frame_again.stamp
        np.testing.assert_array_equal(frame.image, frame_again.image)
        np.testing.assert_array_equal(labels, labels_again)
    assert one[0][0].image.shape != other[0][0].image.shape or not np.array_equal(
        one[0][0].image, other[0][0].image
    )
