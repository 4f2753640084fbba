"""From what moves to detections: the scene at other times, crops, outlines, their velocities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Mask, Matrix
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.background import AlignedFrame, MaskedImage, with_objects_masked
from turbseg_ros.segmentation.clutter import CELL, enlarged
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, CroppedMask, union_mask
from turbseg_ros.segmentation.departed import DepartedObjects
from turbseg_ros.segmentation.exposure import (
    AS_IT_IS,
    ColourExposure,
    colour_exposure_between,
    exposure_between,
)
from turbseg_ros.segmentation.foreground import Surroundings, foreground_masks
from turbseg_ros.segmentation.front import Sides
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.refinement import Refiner, refined_masks, whole_crops
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.standing_out import Past, past_in, standing_areas
from turbseg_ros.segmentation.stopped import StoppedObjects
from turbseg_ros.segmentation.target_outlines import (
    outlined_targets,
    target_areas,
    with_targets,
)
from turbseg_ros.segmentation.target_tracks import Target
from turbseg_ros.segmentation.track import Detection, Observation
from turbseg_ros.segmentation.window import FrameWindow

GUARD = 2
"""Detail pixels by which objects are dilated before what is left counts as background."""
# Smallest outline, in detail pixels.
_MIN_OUTLINE = 12
# Pixels at processing resolution within which an outline reaches the border of what is seen.
_BORDER = 8
# Share of an outline that must be scene, not burnt into the picture.
_MIN_SCENE = 0.5
# Share of an outline that must lie where known objects should be, to count as theirs.
_KNOWN = 0.5
# Detail pixels from where a known object should be within which what stands out lies beside it,
# and the share of it that must stand out to show it whole.
_BESIDE, _WHOLE = 4, 0.8
# Frames in which what leaves its place soon covers its own size; what is slow doesn't in those.
_COVERS, _SLOW = 12, 48
# Frames after which the past is seen anew, and how many pixels the camera may move meanwhile: what
# a moving one brings into view is known sooner then.
_RENEWED, _SAME_VIEW = 8, 1.0
# Share of a known object on which something must be seen to move for it not to be looked for
# where it should be: of one that comes closer flow shows a part only.
_PARTLY, _WHOLLY = 0.6, 0.95
# Share of an outline from which on it is what stands out, and no flow tells its velocity.
_STANDING = 0.5

Pixels = npt.NDArray[np.intp]
"""Rows, or columns, of pixels."""
Gather = Callable[[], Surroundings]
"""Gathers what is known of a frame, and the crops to look for objects in: that costs time."""


class OutlineMethod(Protocol):
    """Cuts objects out of a frame where something moves."""

    def outlines(
        self, moving: Moving, gather: Gather, resolution: Resolution
    ) -> list[CroppedMask]:
        """Return the outlines of what may be objects, at detail resolution."""


class GrownRegions:
    """The paper's masks before they are refined: the regions of eq. 3 themselves."""

    def outlines(
        self, moving: Moving, gather: Gather, resolution: Resolution
    ) -> list[CroppedMask]:
        """Return the regions at detail resolution; see `OutlineMethod`."""
        sizes = resolution.detail, resolution.processing
        return [region.outline.resized(*sizes) for region in moving.regions]


@dataclass(frozen=True)
class BackgroundDifference:
    """What stands out from the scene's background by rules, shadows taken off.

    :param threshold: standard deviations by which an object differs from the background.
    """

    threshold: float

    def outlines(
        self, moving: Moving, gather: Gather, resolution: Resolution
    ) -> list[CroppedMask]:
        """Return what stands out; see `OutlineMethod`."""
        return foreground_masks(gather().crops, self.threshold)


@dataclass(frozen=True)
class RefinedDifference:
    """What a network takes for an object, in place of the paper's eq. 5 to 9."""

    refiner: Refiner

    def outlines(
        self, moving: Moving, gather: Gather, resolution: Resolution
    ) -> list[CroppedMask]:
        """Return what is rather object than background; see `OutlineMethod`."""
        return refined_masks(*whole_crops(gather(), self.refiner))


@dataclass
class _Outlook:
    """Cache, valid until motion is measured again.

    By index: other frames with what was predicted of the objects masked out, and their exposure
    relative to frame `index`, in which motion was measured.
    """

    index: int = 0
    images: dict[int, MaskedImage] = field(default_factory=dict)
    exposures: dict[int, ColourExposure] = field(default_factory=dict)


class Outliner:
    """Draws the outlines of one stream's objects against what the scene looked like before.

    The background is taken from the other frames of the window, aligned to this one, without
    their objects; in frames to come, objects are where they are predicted to be.
    """

    def __init__(
        self,
        window: FrameWindow,
        resolution: Resolution,
        method: OutlineMethod,
        observer: StageObserver,
        parameters: Parameters,
    ) -> None:
        """Set up an outliner of a stream that has no frame yet."""
        self._window = window
        self._resolution = resolution
        self._method = method
        self._observer = observer
        self._looks_at_past = parameters.looks_at_past
        self._outlook = _Outlook()
        # What the scene looked like before, as the frame of that index sees it.
        self._past: Past | None = None
        self._past_index = -1
        # The last frame that was looked at and in which nothing was found.
        self._empty_at = -1
        self._stopped = StoppedObjects(window, resolution, parameters.tracking)
        self._departed = DepartedObjects(window, resolution)

    def detections(
        self,
        index: int,
        moving: Moving,
        targets: Sequence[Target],
        expected: Sequence[Detection],
        overlays: Sequence[CroppedMask],
        tilt: float,
        stamp: int,
    ) -> list[Detection]:
        """Return what may be an object in a frame, at detail resolution.

        :param targets: what was followed, and has moved.
        :param expected: known objects as they should be, whether they move or rest.
        :param overlays: what is burnt into the picture, if anything; see `overlay_masks`.
        :param tilt: rms turbulent motion an axis in detail pixels.
        :param stamp: the frame's, for those who observe.
        """
        if moving.measured:
            self._outlook = _Outlook(index)
        self._stopped.follow(index)
        shape = self._resolution.detail_shape
        image = self._window[index].detail
        outlined = outlined_targets(targets, image, self._resolution)
        measured = union_mask([area.search_mask for area in moving.areas], shape)
        followed = target_areas(outlined, measured, self._resolution)
        measured |= union_mask([area.search_mask for area in followed], shape)
        moving = replace(moving, areas=[*moving.areas, *followed])
        # Where nothing was found, moves or is expected, it will do to look again a frame later.
        calm = self._empty_at == index - 1 and not (moving.measured or moving.areas or expected)
        proposed = [] if calm else self._standing_areas(index, moving, measured, tilt)
        proposed = _apart_or_whole(
            proposed, [each.outline for each in expected if not _leaves_soon(each)], shape
        )
        standing = union_mask([area.search_mask for area in proposed], shape) & ~measured
        looked_at = measured | standing
        known = [each.outline for each in expected]

        def gather() -> Surroundings:
            with self._observer.stage("crops"):
                areas = [*moving.areas, *proposed, *_known_areas(expected, looked_at)]
                # With nothing to look at, the scene at other times need not be aligned.
                views = self._aligned_frames(index, moving) if areas else []
                before = self._stopped.views()
                here = Surroundings(image, areas, views, moving.motion, tilt, before)
                crops = here.crops
            self._observer.crops(stamp, crops)
            return here

        with self._observer.stage("outlines"):
            outlines = self._method.outlines(moving, gather, self._resolution)
            outlines = _in_scene(outlines, overlays)
        seen_to_move = looked_at if moving.measured else standing
        found = [
            _detection(outline, seen_to_move, standing, moving.motion, self._resolution)
            for outline in outlines
            if outline.area >= _MIN_OUTLINE
        ]
        completed = self._stopped.completed(found, known, measured, image, tilt, stamp)
        detections = with_targets(completed, outlined, expected, shape)
        if not calm and not detections:
            self._empty_at = index
        return detections

    def remember(
        self, index: int, moving: Moving, observations: Sequence[Observation], stamp: int
    ) -> None:
        """Remember what was there before objects stopped; see `StoppedObjects`.

        :param observations: what the frame shows of objects.
        :param stamp: the frame's, in nanoseconds.
        """

        def views() -> list[AlignedFrame]:
            others = self._window.key_frames(index)
            frames = zip(others, self._aligned_frames(index, moving), strict=True)
            return [frame for other, frame in frames if other < index]

        self._departed.hide(index, observations)
        self._stopped.remember(observations, self._window[index].detail, stamp, views)

    def _standing_areas(
        self, index: int, moving: Moving, looked_at: Mask, tilt: float
    ) -> list[MovingArea]:
        """Return what stands out from the scene's past, outside of what is looked at anyway.

        :param looked_at: HxW at detail resolution.
        """
        if not self._looks_at_past:
            return []
        with self._observer.stage("what stands out"):
            past = self._past_at(index, moving, tilt)
            return (
                [] if past is None else standing_areas(self._window[index].scene, past, looked_at)
            )

    def _past_at(self, index: int, moving: Moving, tilt: float) -> Past | None:
        """Return what the scene looked like before, as a frame sees it; None where not known.

        It is taken anew where motion is measured, every so often or once the camera has moved.
        """
        motion = self._window.transform_if_continuous(self._past_index, index)
        if moving.measured and (
            self._past is None
            or motion is None
            or index - self._past_index >= _RENEWED
            or np.abs(motion - np.eye(3)).max() >= _SAME_VIEW
        ):
            views = self._aligned_frames(index, moving)
            self._past, self._past_index = past_in(views, self._resolution.detail, tilt), index
            return self._past
        if self._past is None or motion is None:
            return None
        to_past = self._window.transform(index, self._past_index)
        return self._past.seen_from(self._resolution.to_detail(to_past))

    def _aligned_frames(self, index: int, moving: Moving) -> list[AlignedFrame]:
        """Return the frames that show the scene at other times, as seen from this one.

        Exposures, and what is predicted, are as when motion was measured last.
        """
        window, outlook = self._window, self._outlook
        transforms = window.transforms_from(index)
        since = self._exposure(outlook.index, index, transforms[outlook.index])
        from_outlook = np.linalg.inv(transforms[outlook.index])
        frames = []
        for other in window.key_frames(index):
            to_image = self._resolution.to_detail(transforms[other])
            if other not in outlook.exposures:
                to_other = transforms[other] @ from_outlook
                outlook.exposures[other] = self._exposure(other, outlook.index, to_other)
            image = window[other].scene
            if not window[other].objects_known:
                if other not in outlook.images:
                    predicted = self._predicted(moving.areas, other - index, to_image)
                    predicted += overlay_masks(moving, self._resolution.detail_shape)
                    outlook.images[other] = with_objects_masked(image, predicted)
                image = outlook.images[other]
            frames.append(AlignedFrame(image, to_image, outlook.exposures[other].then(since)))
        return frames

    def _exposure(self, source: int, target: int, to_source: Matrix) -> ColourExposure:
        """Return what takes the values of one frame to those of another, channel by channel."""
        here, there = self._window[target], self._window[source]
        channels = here.detail.shape[2]
        if source == target:
            return ColourExposure((AS_IT_IS,) * channels)
        if channels == 1:
            return ColourExposure((exposure_between(there.grey, here.grey, to_source),))
        to_source = self._resolution.to_detail(to_source)
        return colour_exposure_between(there.scene.image, here.scene.image, to_source)

    def _predicted(
        self, areas: Sequence[MovingArea], frames: int, to_image: Matrix
    ) -> list[CroppedMask]:
        """Return the probable parts of moving areas so many frames on, in that frame's pixels."""
        return [
            area.probable.resampled(
                to_image @ translation(area.velocity[0] * frames, area.velocity[1] * frames),
                self._resolution.detail_shape,
                cv2.INTER_NEAREST,
            )
            for area in areas
        ]


def overlay_masks(moving: Moving, shape: tuple[int, int]) -> list[CroppedMask]:
    """Return what stands still in the picture while the scene moves, in a frame of some shape."""
    if moving.overlay is None or not moving.overlay.any():
        return []
    return [CroppedMask.of(enlarged(moving.overlay, shape))]


def _in_scene(
    outlines: Sequence[CroppedMask], overlays: Sequence[CroppedMask]
) -> list[CroppedMask]:
    """Return outlines without what is burnt into the picture, those left that it hardly hides."""
    if not overlays:
        return list(outlines)
    (overlay,) = overlays
    left = [
        CroppedMask.of(outline.mask & ~overlay.within(outline.box), outline.box.x0, outline.box.y0)
        for outline in outlines
    ]
    return [
        seen
        for seen, outline in zip(left, outlines, strict=True)
        if seen.area > _MIN_SCENE * outline.area
    ]


def _apart_or_whole(
    areas: Sequence[MovingArea], expected: Sequence[CroppedMask], shape: tuple[int, int]
) -> list[MovingArea]:
    """Return the areas that lie apart from where known objects should be, or show one whole.

    What stands out beside one is what it has left, which hasn't been seen for long; and of one
    that rests, parts are soon like its past.

    :param expected: the objects that this may be so of.
    """
    masks = [area.search_mask for area in areas]
    frames = [mask.in_frame(shape) for mask in masks]
    beside = union_mask([each.dilated(_BESIDE, shape) for each in expected], shape)
    return [
        area
        for area, mask, frame in zip(areas, masks, frames, strict=True)
        if not mask.intersection_area(beside)
        or any(_shows_whole(each, mask, frame) for each in expected)
    ]


def _leaves_soon(expected: Detection, frames: float = _COVERS) -> bool:
    """Whether an object is so fast that the past knows its place without it, all but at once.

    :param frames: those in which it covers its own size.
    """
    return float(np.hypot(*expected.velocity)) * frames > float(np.hypot(*expected.box.shape))


def _shows_whole(expected: CroppedMask, mask: CroppedMask, frame: Mask) -> bool:
    """Whether a mask, HxW in its `frame`, is nearly all of an object and not much more."""
    common = expected.intersection_area(frame)
    return common > max(_KNOWN * mask.area, _WHOLE * expected.area)


def _known_areas(expected: Sequence[Detection], moving: Mask) -> list[MovingArea]:
    """Return where known objects should be on which not all was found to move.

    A part is enough of those that aren't slow, for flow shows them, and what else would be taken
    for a part is what they leave; and of those that others are near.
    """
    around = [each.outline.dilated(GUARD + 1, moving.shape) for each in expected]
    areas = []
    for each, wider in zip(expected, around, strict=True):
        seen = each.outline.intersection_area(moving) / max(each.area, 1)
        partly = _leaves_soon(each, _SLOW) or _is_near(wider, around)
        if seen < (_PARTLY if partly else _WHOLLY):
            areas.append(MovingArea(wider, EMPTY_MASK, EMPTY_MASK, (0.0, 0.0)))
    return areas


def _is_near(mask: CroppedMask, others: Sequence[CroppedMask]) -> bool:
    """Whether a mask has pixels in common with another of some masks, one of which it is."""
    return any(mask.shares_pixels(other) for other in others if other is not mask)


def _detection(
    outline: CroppedMask,
    moving: Mask,
    standing: Mask,
    motion: MotionEstimate,
    resolution: Resolution,
) -> Detection:
    """Describe an outline: its velocity is the median over its pixels, where flow tells one.

    :param moving: HxW, where something was seen to move in this frame.
    :param standing: HxW, where something stands out that flow doesn't show to move.
    """
    y, x = np.nonzero(outline.mask)
    scale_x, scale_y = resolution.detail_from_processing
    height, width = motion.motion_map.shape
    column = np.minimum(((x + outline.box.x0) / scale_x).astype(int), width - 1)
    row = np.minimum(((y + outline.box.y0) / scale_y).astype(int), height - 1)
    flow_known = outline.intersection_area(standing) <= _STANDING * outline.area
    vx, vy = np.median(motion.velocity[row, column], axis=0) if flow_known else (0.0, 0.0)
    clutter = 0.0
    if motion.clutter is not None:
        rows, columns = motion.clutter.shape
        cell = np.minimum(row // CELL, rows - 1), np.minimum(column // CELL, columns - 1)
        clutter = float(motion.clutter[cell].mean()) * max(scale_x, scale_y)
    return Detection(
        box=outline.box,
        mask=outline.mask,
        velocity=(float(vx) * scale_x, float(vy) * scale_y),
        moving=bool((outline.mask & moving[outline.box.slices]).any()),
        clutter=clutter,
        flow_known=flow_known,
        cut_sides=_cut_sides(row, column, motion.visible),
    )


def _cut_sides(row: Pixels, column: Pixels, visible: Mask) -> Sides:
    """Return on which sides pixels reach the border of what neighbours see, HxW."""
    height, width = visible.shape
    top, bottom, left, right = row.min(), row.max(), column.min(), column.max()
    down, across = (
        slice(first, last + 1, _BORDER // 2) for first, last in ((top, bottom), (left, right))
    )
    return Sides(
        left=bool(left < _BORDER or not visible[down, left - _BORDER].all()),
        top=bool(top < _BORDER or not visible[top - _BORDER, across].all()),
        right=bool(right >= width - _BORDER or not visible[down, right + _BORDER].all()),
        bottom=bool(bottom >= height - _BORDER or not visible[bottom + _BORDER, across].all()),
    )
