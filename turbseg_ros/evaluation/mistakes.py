"""What a segmentation has wrong in one frame: missed, false, and how well it did on the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from turbseg_ros.arrays import Mask
from turbseg_ros.evaluation.boxes import box_overlaps
from turbseg_ros.evaluation.metrics import Labels, jaccard
from turbseg_ros.messages.detections import IGNORED, Box, Detection


@dataclass(frozen=True)
class Mistakes:
    """What is wrong in a frame, and where.

    `missed` and `false` are masks, HxW: where something is that was not found, and where nothing
    is that was. `outlines` are those of the true objects, Nx1x2 (x, y) each; `boxes` the true
    ones, where truth is boxes. `quality` is between 0 and 1, which is no mistake: J for masks, for
    boxes the share of hits among boxes and false objects; `verdict` says it in words.
    """

    missed: Mask
    false: Mask
    outlines: tuple[Labels, ...]
    boxes: tuple[Box, ...]
    quality: float
    verdict: str

    @property
    def anywhere(self) -> Mask:
        """Where anything is wrong, HxW."""
        return self.missed | self.false


def mistakes_in_masks(found: Labels, truth: Labels, ignored: Labels | None = None) -> Mistakes:
    """Compare the labels of a frame, HxW, with true ones, all objects together.

    :param ignored: non-zero where pixels are neither right nor wrong, HxW.
    """
    if ignored is not None:
        found, truth = (np.where(ignored, 0, each) for each in (found, truth))
    is_found, is_true = found != 0, truth != 0
    j = jaccard(found, truth)
    if is_true.any():
        verdict = f"J {j:.2f}"
    else:
        verdict = "nothing there, false alarm" if is_found.any() else "nothing there"
    contours, _ = cv2.findContours(
        is_true.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    return Mistakes(is_true & ~is_found, is_found & ~is_true, tuple(contours), (), j, verdict)


def mistakes_in_boxes(
    found: Labels, truth: Sequence[Detection], ignored: Labels | None = None
) -> Mistakes:
    """Compare the labels of a frame, HxW, with true boxes: missed is one that none touches.

    :param ignored: non-zero where objects beside the boxes are not false, HxW.
    """
    overlaps = box_overlaps(found, truth, ignored)
    boxes = tuple(each.box for each in truth if each.class_id != IGNORED)
    hit: list[bool] = np.any(overlaps.shared, axis=1).tolist()
    missed = np.zeros(found.shape, bool)
    for box, is_hit in zip(boxes, hit, strict=True):
        if not is_hit:
            missed[_within(box)] = True
    touching: list[bool] = np.any(overlaps.shared, axis=0).tolist()
    false = [i for i, ok in zip(overlaps.predicted_ids, touching, strict=True) if not ok]
    wrong = len(boxes) - sum(hit) + len(false)
    in_all = len(boxes) + len(false)
    verdict = f"{sum(hit)} of {len(boxes)} boxes hit" if boxes else "nothing there"
    if false:
        verdict += f", {len(false)} false"
    quality = 1.0 - wrong / in_all if in_all else 1.0
    return Mistakes(missed, np.isin(found, false), (), boxes, quality, verdict)


def _within(box: Box) -> tuple[slice, slice]:
    left, top, width, height = box
    rows = slice(max(round(top), 0), max(round(top + height), 0))
    return rows, slice(max(round(left), 0), max(round(left + width), 0))
