"""The method as a library: NumPy arrays in, results out, without ROS and without files.

`from turbseg_ros import MotionSegmenter` gives what is here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.factory import strategies
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation import motion_segmenter
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, segment
from turbseg_ros.segmentation.observer import StageObserver


class MotionSegmenter(motion_segmenter.MotionSegmenter):
    """Segments what really moves, image by image.

    Frames are pushed one by one (`push`, `flush`), or a whole sequence is handed to `results`.
    Used in a `with`, its threads end with it.

    :param parameters: `Parameters`, or a mapping of those that are not the defaults, by the names
        in docs/parameters.md.
    :param observer: looks at what the stages make of each frame.
    :raises turbseg_ros.ParameterError: when a parameter is refused, or what it names can't be had.
    """

    def __init__(
        self,
        parameters: Parameters | Mapping[str, object] | None = None,
        observer: StageObserver | None = None,
    ) -> None:
        if not isinstance(parameters, Parameters):
            parameters = Parameters().replace(parameters or {})
        # Its own threads fill the cores; OpenCV's would only wait for them.
        cv2.setNumThreads(1)
        super().__init__(parameters, strategies, observer)

    def results(
        self, images: Iterable[npt.NDArray[np.generic]], rate: float = 30.0
    ) -> Iterator[SegmentationResult]:
        """Yield one result for each image, in order.

        :param images: HxW (grey) or HxWx3 (blue, green, red), uint8, uint16 or float32, all of
            one size; each is read until the next is asked for.
        :param rate: of the images, in Hz.
        """
        frames = (
            Frame(stamp=round(number * 1e9 / rate), image=np.asarray(image), period=1 / rate)
            for number, image in enumerate(images)
        )
        yield from segment(frames, self)
