"""What stands still in the picture while the scene moves: clocks, cross-hairs, text, bars, dirt.

Between two frames that the camera's motion sets apart, the scene fits once it is aligned, and what
is burnt in fits as it is. A target that the camera follows stands nearly still as well, but never
to the grey value all along its edges: it jitters, turns and is seen through air.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.clutter import CELL, cells_of, enlarged
from turbseg_ros.segmentation.evidence import local_range
from turbseg_ros.segmentation.geometry import pixel_grid

# Pixels by which the camera must have moved for a comparison to tell anything.
_MIN_MOTION = 2.0
# Range of grey values around a pixel from which it would betray the least jitter, and the share
# of it that it may differ by and still be the same.
_EDGE, _SAME = 12, 1 / 32
# Grey values by which the scene must differ where it is known to have moved, or be.
_DIFFERENT = 10
# Comparisons that must speak for a pixel, and how many count at most: for, and against.
_CONVINCED, _FOR, _AGAINST = 3.0, 15.0, -3.0
# Share of a cell's pixels that make it one: of edges, and of plain pixels.
_EDGES, _PLAIN = 0.12, 0.5
# Share of the cells of a plain patch that must be edges, for the patch to go with them.
_BORDERED = 0.15
# Share of the pixels at edges in and around a patch that must stand still of those that tell: a
# plain, saturated part of a target that the camera follows has but a few that happen to.
_EXACT = 0.1
# Share of a bar's cells that are plain, and of its length along which its edge must stand still.
_WHOLE, _ALONG = 0.95, 0.5


class OverlayMemory:
    """Which cells of the picture don't belong to the scene, learned while the camera moves."""

    def __init__(self) -> None:
        # For pixels at edges, and for all.
        self._votes: tuple[Map, Map] | None = None
        self._still: Mask | None = None

    def take(
        self,
        grey: ByteImage,
        neighbours: Mapping[int, ByteImage],
        aligned: Mapping[int, ByteImage],
        transforms: Mapping[int, Matrix],
    ) -> Mask:
        """Compare a frame with its neighbours; return the cells that stand still, hxw.

        :param neighbours: {k: HxW grey image of frame t+k as it came}.
        :param aligned: {k: the same, as frame t would show it}.
        :param transforms: {k: what takes the frame's pixels to the neighbour's}.
        """
        moved = {k: _moved(transform, grey.shape) for k, transform in transforms.items()}
        telling = [k for k in moved if moved[k].any()]
        if self._still is None:
            self._still = np.zeros(cells_of(grey.shape), bool)
        if not telling:
            return self._still
        if self._votes is None:
            self._votes = np.zeros(grey.shape, np.float32), np.zeros(grey.shape, np.float32)
        at_edges, anywhere = self._votes
        edge = local_range(grey)
        same = cv2.convertScaleAbs(edge, alpha=_SAME) + np.uint8(1)
        for k in telling:
            as_it_is, in_scene = (cv2.absdiff(grey, each[k]) for each in (neighbours, aligned))
            if in_scene.mean() > as_it_is.mean():
                # The scene doesn't fit: its light or the camera's motion isn't known well.
                continue
            told = moved[k] & (cv2.max(as_it_is, in_scene) >= _DIFFERENT)
            exact = as_it_is <= same
            burnt_in = (told & exact).astype(np.float32)
            # What the camera follows is exact now and then, but not each time.
            anywhere += burnt_in - (told & ~exact)
            at_edges += burnt_in * (edge >= _EDGE) - (told & ~exact)
        for votes in self._votes:
            np.clip(votes, _AGAINST, _FOR, out=votes)
        edges, all_over = at_edges >= _CONVINCED, anywhere >= _CONVINCED
        still = _exact(_still(edges, all_over), edges, (edge >= _EDGE) & (at_edges <= 0.0))
        # A straight edge from one side of the picture to the other needs fewer comparisons.
        self._still = still | _bars(at_edges >= 1.0, edge >= _EDGE)
        return self._still


def _still(edges: Mask, anywhere: Mask) -> Mask:
    """Return the cells that stand still, hxw: those at edges, and plain patches that they border.

    :param edges: HxW, pixels at edges that stand still.
    :param anywhere: HxW, all pixels that do.
    """
    height, width = cells_of(edges.shape)
    if not edges.any():
        return np.zeros((height, width), bool)
    bordering = _in_cells(edges, (height, width)) >= _EDGES
    plain = _in_cells(anywhere, (height, width)) >= _PLAIN
    # What lies between letters tells nothing by itself.
    square = np.ones((5, 5), np.uint8)
    still = cv2.morphologyEx(bordering.astype(np.uint8), cv2.MORPH_CLOSE, square) > 0
    count, patches = cv2.connectedComponents((plain | bordering).astype(np.uint8))
    sizes = np.bincount(patches.ravel(), minlength=count)
    at_edges = np.bincount(patches[bordering], minlength=count)
    kept = at_edges > _BORDERED * sizes
    kept[0] = False
    result: Mask = still | kept[patches]
    return result


def _exact(still: Mask, edges: Mask, against: Mask) -> Mask:
    """Return the patches of cells, hxw, that a fair part of the edges in and around them are for.

    :param edges: HxW, pixels at edges that stand still; `against`, those that don't.
    """
    if not still.any():
        return still
    patches = cv2.dilate(still.view(np.uint8), np.ones((3, 3), np.uint8))
    count, patches = cv2.connectedComponents(patches)
    votes_for, votes_against = (
        np.bincount(patches.ravel(), _in_cells(votes, still.shape).ravel(), count)
        for votes in (edges, against)
    )
    kept = votes_for >= _EXACT * (votes_for + votes_against)
    result: Mask = still & kept[patches]
    return result


def _bars(edges: Mask, contrast: Mask) -> Mask:
    """Return the cells of bars, hxw: plain from a side of the picture to an edge that stays.

    :param edges: HxW, pixels at edges that stand still.
    :param contrast: HxW, where the picture has edges at all.
    """
    shape = cells_of(edges.shape)
    if not edges.any():
        return np.zeros(shape, bool)
    bordering, plain = _in_cells(edges, shape) >= _EDGES, _in_cells(contrast, shape) < _EDGES
    bars = np.zeros(plain.shape, bool)
    for turns in range(4):
        side, edge = (np.rot90(each, turns) for each in (plain, bordering))
        broken = side.mean(axis=0) < _WHOLE
        width = int(np.argmax(broken)) if broken.any() else 0
        if width and edge[:, width - 1 : width + 2].any(axis=1).mean() > _ALONG:
            np.rot90(bars, turns)[:, :width] = True
    return bars


def _in_cells(pixels: Mask, shape: tuple[int, ...]) -> Map:
    """Return the share of each cell's pixels, hxw."""
    share: Map = cv2.resize(
        pixels.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_AREA
    )
    return share


def _moved(transform: Matrix, shape: tuple[int, ...]) -> Mask:
    """Return which pixels the camera's motion has set apart, HxW."""
    height, width = cells_of(shape)
    middles = pixel_grid((height * CELL, width * CELL), CELL)
    displacement = cv2.transform(middles, transform[:2]) - middles
    apart = np.square(displacement).sum(axis=-1) > _MIN_MOTION**2
    return enlarged(apart, shape)
