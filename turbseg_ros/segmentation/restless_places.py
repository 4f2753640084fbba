"""Where things keep standing out that go nowhere: foam, leaves, edges that shimmer.

A target that is told by what has changed is believed only on ground that is calm otherwise.
"""

from __future__ import annotations

import cv2
import numpy as np

from turbseg_ros.arrays import Map, Matrix
from turbseg_ros.segmentation.blobs import Points
from turbseg_ros.segmentation.clutter import CELL, at_points, in_cells

# Share of what is remembered that is left a frame later.
_KEPT = 0.98
# Cells by which the camera's motion moves a corner, below which the memory stays where it is.
_STAYS = 0.02


class RestlessPlaces:
    """Remembers, in cells that follow the scene, what stood out there and went nowhere."""

    def __init__(self, cells: tuple[int, ...]) -> None:
        """Set up a memory of nothing.

        :param cells: rows and columns of cells that the pictures have.
        """
        self._seen: Map = np.zeros(cells, np.float32)

    def propagate(self, ego_motion: Matrix) -> None:
        """Follow the camera to the next frame, and forget a little."""
        self._seen *= np.float32(_KEPT)
        motion = in_cells(ego_motion)
        if np.abs(motion - np.eye(3)).max() >= _STAYS:
            self._seen = cv2.warpAffine(self._seen, motion[:2], self._seen.shape[::-1])

    def remember(self, places: Points) -> None:
        """Remember where something stood out, Nx2 (x, y), that has gone nowhere."""
        column, row = (places.T // CELL).astype(int)
        rows, columns = self._seen.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        np.add.at(self._seen, (row[inside], column[inside]), 1.0)

    def sightings(self, places: Points) -> float:
        """Return how often, of late, something stood out around places, Nx2, on average."""
        around = cv2.boxFilter(self._seen, -1, (3, 3), normalize=False)
        return float(at_points(around, places).mean())
