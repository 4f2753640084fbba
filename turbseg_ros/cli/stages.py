"""The picture of the stages in README and docs/method.md: `python -m turbseg_ros.cli stages`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map
from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.options import parameters_from, with_progress
from turbseg_ros.cli.outputs import check_picture
from turbseg_ros.cli.parsers.stages import build_parser
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.overlay import (
    WHITE,
    Canvas,
    colour_of,
    draw_overlay,
    grid,
    write_picture,
    write_text,
)
from turbseg_ros.segmentation.frame import SegmentationResult, segment
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.region_growing import Region
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.track import Detection

_TILE_WIDTH = 480
# M in standard deviations of its noise that is shown at full brightness.
_BRIGHTEST = 20.0
# What a place moves by, in the same unit, that is.
_MAX_CLUTTER = 5.0


@dataclass(frozen=True)
class Stages:
    """What the stages made of one frame; `detections` lie in a picture of `detail_width`."""

    motion: MotionEstimate
    regions: Sequence[Region]
    detections: Sequence[Detection]
    detail_width: int


class FrameObserver(StageObserver):
    """Keeps what the stages made of the frame with one stamp."""

    def __init__(self, stamp: int) -> None:
        self.stamp = stamp
        self.stages: Stages | None = None
        self._moving: Moving | None = None

    def motion(self, stamp: int, moving: Moving) -> None:
        """Keep what moves in the frame."""
        if stamp == self.stamp:
            self._moving = moving

    def detections(
        self, stamp: int, detections: Sequence[Detection], resolution: Resolution
    ) -> None:
        """Keep what was cut out of the frame."""
        if stamp == self.stamp and self._moving is not None:
            moving = self._moving
            width = resolution.detail[0]
            self.stages = Stages(moving.motion, moving.regions, detections, width)


@executable("stages")
def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture; return the exit status."""
    options = build_parser().parse_args(arguments)
    check_picture(options.out)
    parameters = parameters_from(options)
    reader = BagReader(options.bag)
    frames = BagFrames(reader, reader.find_image_topic(options.image_topic))
    stamps = [frame.stamp for frame in frames]
    if not 0 <= options.frame < len(stamps):
        raise UsageError(f"--frame {options.frame}: {options.bag} has {len(stamps)} frames")
    observer = FrameObserver(stamps[options.frame])
    with motion_segmenter(parameters, observer) as segmenter:
        results = segment(with_progress(frames, reader.path.name), segmenter)
        (result,) = [result for result in results if result.frame.stamp == observer.stamp]
    if observer.stages is None:
        raise UsageError(f"nothing to compare frame {options.frame} with")
    write_picture(options.out, grid(list(_tiles(result, observer.stages)), columns=4))
    return 0


def _tiles(result: SegmentationResult, stages: Stages) -> Iterator[ByteImage]:
    titles = {
        "1 frame": Canvas.of(result.frame.image, _TILE_WIDTH),
        "2 velocity against the scene": Canvas.of(_velocity(stages.motion), _TILE_WIDTH),
        "3 motion in units of its noise": Canvas.of(_heat(stages.motion), _TILE_WIDTH),
        "4 what places move by anyway": Canvas.of(_clutter(stages.motion), _TILE_WIDTH),
        "5 seeds and regions": Canvas.of(_regions(stages), _TILE_WIDTH),
        "6 outlines against the background": _outlined(result, stages),
        "7 objects, once sure": draw_overlay(result, width=_TILE_WIDTH),
    }
    height = titles["1 frame"].image.shape[0]
    for title, canvas in titles.items():
        write_text(canvas, title, (4, 0), WHITE)
        yield canvas.image[:height]


def _velocity(motion: MotionEstimate) -> ByteImage:
    """Colour velocity as optical flow is: hue for direction, brightness for speed."""
    speed, angle = cv2.cartToPolar(motion.velocity[..., 0], motion.velocity[..., 1])
    hsv = np.full((*speed.shape, 3), 255, np.uint8)
    hsv[..., 0] = angle * (90.0 / np.pi)
    hsv[..., 2] = np.clip(255.0 * speed / max(float(np.percentile(speed, 99.5)), 0.1), 0, 255)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR))


def _heat(motion: MotionEstimate) -> ByteImage:
    return _coloured(motion.motion_map / motion.noise, _BRIGHTEST)


def _coloured(in_noise: Map, brightest: float) -> ByteImage:
    strength = np.clip(in_noise * (255.0 / brightest), 0, 255)
    return np.asarray(cv2.applyColorMap(strength.astype(np.uint8), cv2.COLORMAP_INFERNO))


def _clutter(motion: MotionEstimate) -> ByteImage:
    """Colour what each place is known to move by as the motion map is, in units of its noise."""
    height, width = motion.noise.shape
    clutter = np.zeros((1, 1), np.float32) if motion.clutter is None else motion.clutter
    level = cv2.resize(clutter, (width, height), interpolation=cv2.INTER_NEAREST)
    return _coloured(level / motion.noise, _MAX_CLUTTER)


def _regions(stages: Stages) -> ByteImage:
    picture = np.full((*stages.motion.motion_map.shape, 3), 40, np.uint8)
    for number, region in enumerate(stages.regions):
        within = picture[region.outline.box.slices]
        within[region.outline.mask] = np.array(colour_of(number)) * 0.6
        cv2.circle(picture, (region.seed.x, region.seed.y), 3, WHITE, -1, cv2.LINE_AA)
    return picture


def _outlined(result: SegmentationResult, stages: Stages) -> Canvas:
    canvas = Canvas.of(result.frame.image, _TILE_WIDTH)
    scale = _TILE_WIDTH / stages.detail_width
    for detection in stages.detections:
        contours, _ = cv2.findContours(
            detection.mask.astype(np.uint8),
            cv2.RETR_EXTERNAL,
            cv2.CHAIN_APPROX_NONE,
            offset=(detection.box.x0, detection.box.y0),
        )
        scaled = [np.rint((contour + 0.5) * scale - 0.5).astype(np.int32) for contour in contours]
        cv2.polylines(canvas.image, scaled, True, WHITE, 1, cv2.LINE_AA)
    return canvas
