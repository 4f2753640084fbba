"""The outlines of targets, and which of what is outlined anyway shows one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map, Mask
from turbseg_ros.segmentation.areas import MovingArea
from turbseg_ros.segmentation.blobs import RING, SMALL
from turbseg_ros.segmentation.cropped_mask import EMPTY_MASK, Box, CroppedMask
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.target_tracks import Target
from turbseg_ros.segmentation.track import Detection

# Square, in detail pixels, in which a small target's outline is drawn; of a larger one, in pixels
# of the picture that it was found in, beyond the ring that it ends in.
_CROP, _BEYOND_RING = 14, 2
# Detail pixels from a small target's middle that show it, and pixels of the picture that a larger
# one was found in.
_CORE, _LARGE_CORE = 2, 1.5
# Shares of the contrast at which an outline is drawn: the first that keeps it within the ring.
_EDGES = (0.4, 0.5, 0.6, 0.7, 0.8)
# Area in detail pixels below which an outline is widened by a pixel.
_TINY = 12
# Detail pixels beside a target that it is shown within.
_BESIDE = 2
# An outline more than so many times as large as a small target shows another thing; one as much
# larger than a large target shows more than it.
_MUCH_LARGER, _LARGER = 25, 4
# Times by which an object that shows a target grows at most from one frame to the next.
_GROWN = 2
# Share of the smaller one's pixels that two outlines have in common if they show the same.
_SAME = 0.5
# Frames that a large target must have moved for to be cut out of what is larger: the whole of an
# object is seen by its flow before that.
_PATIENCE = 8


@dataclass(frozen=True)
class OutlinedTarget:
    """A target, and what it looks like: a detection at detail resolution."""

    target: Target
    detection: Detection


def outlined_targets(
    targets: Sequence[Target], image: ByteImage, resolution: Resolution
) -> list[OutlinedTarget]:
    """Return the targets that stand out in a frame, large ones first, each thing once.

    A large thing's parts may be targets, too, in the pictures that are less small.

    :param image: HxWxC at detail resolution.
    """
    outlined: list[OutlinedTarget] = []
    for target in sorted(targets, key=lambda each: -each.scale):
        detection = _detection(target, image, resolution)
        if detection is None:
            continue
        if target.is_small or not any(_is_part(detection, each.detection) for each in outlined):
            outlined.append(OutlinedTarget(target, detection))
    return outlined


def target_areas(
    targets: Sequence[OutlinedTarget], measured: Mask, resolution: Resolution
) -> list[MovingArea]:
    """Return where large targets are that aren't seen to move for the most part anyway.

    :param measured: HxW at detail resolution, where flow shows something to move.
    """
    found = []
    for each in targets:
        outline = each.detection.outline
        if each.target.is_small or outline.intersection_area(measured) >= _SAME * outline.area:
            continue
        beside = round(each.target.scale * resolution.detail_from_processing[0])
        around = outline.dilated(beside, resolution.detail_shape)
        found.append(MovingArea(around, EMPTY_MASK, EMPTY_MASK, each.detection.velocity))
    return found


def with_targets(
    detections: Sequence[Detection],
    targets: Sequence[OutlinedTarget],
    known: Sequence[Detection],
    shape: tuple[int, int],
) -> list[Detection]:
    """Return detections, those that show a target as moving, and the other targets.

    :param known: known objects as they should be.
    :param shape: rows and columns of the frame at detail resolution.
    """
    result = list(detections)
    for target in targets:
        around = target.detection.outline.dilated(_BESIDE, shape)
        there = [
            number
            for number, each in enumerate(result)
            if not each.hidden and around.shares_pixels(each.outline)
        ]
        if not there:
            result.append(target.detection)
        elif target.target.is_small:
            for number in there:
                if result[number].area < _MUCH_LARGER * target.detection.area:
                    result[number] = _showing(result[number], target)
        else:
            _show_large(result, there, target, known)
    return result


def _show_large(
    detections: list[Detection],
    there: Sequence[int],
    target: OutlinedTarget,
    known: Sequence[Detection],
) -> None:
    """Find a large target among the detections beside it, or add what it looks like to them.

    What a known object that is no target shows is left to that one.
    """
    objects = [each for each in known if any(_show_same(each, detections[k]) for k in there)]
    if not all(each.targets for each in objects):
        return
    outline = target.detection.outline
    best = max(there, key=lambda number: outline.common_area(detections[number].outline))
    whole = max([_LARGER * outline.area, *(_GROWN * each.area for each in objects)])
    if detections[best].area < whole:
        detections[best] = _showing(detections[best], target)
    elif objects or target.target.frames >= _PATIENCE:
        # What moves beside it, such as a wave, was outlined with it.
        detections.append(target.detection)


def _showing(detection: Detection, target: OutlinedTarget) -> Detection:
    targets = detection.targets | target.detection.targets
    return replace(detection, moving=True, targets=targets)


def _is_part(detection: Detection, other: Detection) -> bool:
    return detection.outline.common_area(other.outline) > _SAME * detection.area


def _show_same(detection: Detection, other: Detection) -> bool:
    common = detection.outline.common_area(other.outline)
    return common > _SAME * min(detection.area, other.area)


def _detection(target: Target, image: ByteImage, resolution: Resolution) -> Detection | None:
    """Outline a target in its surroundings; None where nothing stands out there."""
    scale_x, scale_y = resolution.detail_from_processing
    x, y = (target.place[0] + 0.5) * scale_x - 0.5, (target.place[1] + 0.5) * scale_y - 0.5
    outline = _outline(target, (x, y), scale_x, image)
    if outline is None:
        return None
    return Detection(
        box=outline.box,
        mask=outline.mask,
        velocity=(target.velocity[0] * scale_x, target.velocity[1] * scale_y),
        moving=True,
        targets=frozenset([target.number]),
    )


def _outline(
    target: Target, middle: tuple[float, float], scale: float, image: ByteImage
) -> CroppedMask | None:
    """Return what stands out around a target's middle (x, y); None if nothing does.

    :param scale: detail pixels to one at processing resolution.
    :param image: HxWxC at detail resolution.
    """
    shape = image.shape[:2]
    pixel = target.scale * scale
    if target.is_small:
        # What has changed may lie before anything, and not end within its crop.
        reach, core, ends = _CROP, _CORE, (RING + 1) * pixel if target.by_change else np.inf
    else:
        reach, core = round((RING + _BEYOND_RING) * pixel), round(_LARGE_CORE * pixel)
        ends = (RING + 1) * pixel
    x, y = middle
    pixel_there = Box(round(x), round(y), round(x) + 1, round(y) + 1)
    box = pixel_there.padded(reach, shape)
    if min(box.shape) < 2 * SMALL:
        return None
    difference = _difference_from_rim(image[box.slices], np.sign(target.contrast), target.scale)
    centre = pixel_there.padded(core, shape).moved(-box.x0, -box.y0).slices
    peak = float(difference[centre].max())
    if peak <= 0.0:
        return None
    row, column = np.unravel_index(int(difference[centre].argmax()), difference[centre].shape)
    top = int(row) + centre[0].start, int(column) + centre[1].start
    rows, columns = np.ogrid[box.y0 : box.y1, box.x0 : box.x1]
    mask = _part_within(difference / peak, top, np.hypot(columns - x, rows - y) <= ends)
    if np.count_nonzero(mask) < _TINY:
        mask = cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return CroppedMask.of(mask, box.x0, box.y0)


def _difference_from_rim(crop: ByteImage, sign: float, scale: int) -> Map:
    """Return by how much pixels are brighter than a crop's rim, or darker where the sign is -1.

    :param scale: of the picture that a target was found in, by which texture is smoothed.
    """
    side = scale // 2 + 1
    values = cv2.blur(crop.astype(np.float32).mean(axis=2) * np.float32(sign), (side, side))
    rim = np.concatenate([values[0], values[-1], values[:, 0], values[:, -1]])
    return np.asarray(values - np.median(rim))


def _part_within(share: Map, top: tuple[int, int], within: Mask) -> Mask:
    """Return the part around the top that ends within a region, at the first edge that does.

    :param share: of the contrast at the top, HxW.
    """
    for edge in _EDGES:
        _, parts = cv2.connectedComponents((share > edge).astype(np.uint8))
        part = parts == parts[top]
        if not (part & ~within).any():
            break
    return np.asarray(part & within)
