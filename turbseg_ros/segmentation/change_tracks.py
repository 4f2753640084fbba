"""Targets that are told by the change of the picture, over ground where much else stands out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from turbseg_ros.arrays import Mask, Matrix
from turbseg_ros.segmentation.blobs import MOST, Points
from turbseg_ros.segmentation.restless_places import RestlessPlaces
from turbseg_ros.segmentation.target_motion import CHANGED_STRONG, have_come
from turbseg_ros.segmentation.target_tracks import EVERY, TargetTracks

# Sightings around the places where a change was lately, in so many frames, from which on it is
# one of many that go nowhere.
_RESTLESS, _LATELY = 1.0, 24


class ChangeTracks(TargetTracks):
    """Follows what stands out in the change of the picture, held against what stands in it.

    Places where changes keep going nowhere are remembered, and not believed.
    """

    _by_change = True

    def __init__(
        self, standing: TargetTracks, cells: tuple[int, int], numbers: Iterator[int] | None = None
    ) -> None:
        """Set up tracks of nothing.

        :param standing: those of what stands out in the picture itself.
        :param cells: rows and columns of cells that the pictures have.
        :param numbers: those of the targets to come.
        """
        super().__init__(1, numbers)
        self._standing = standing
        self._restless = RestlessPlaces(cells)

    def _propagate(self, ego_motion: Matrix) -> None:
        """Follow the camera to the next frame, with the places where changes went nowhere."""
        super()._propagate(ego_motion)
        self._restless.propagate(ego_motion)

    def _end(self, ended: Mask) -> None:
        """End some tracks, N, and remember the places of those that have gone nowhere."""
        nowhere = ended & (self._moved_for == 0)
        seen = ~np.isnan(self._raw[nowhere, :, 0])
        self._restless.remember(self._paths[nowhere][seen])
        super()._end(ended)

    def _judge(self) -> None:
        """Tell which tracks have moved significantly, and not where all is restless."""
        known = self.seen_often
        known = known[self._strengths[known] > CHANGED_STRONG]
        moved = np.zeros(len(known), bool)
        if len(known):
            standing = self._standing.followed(self._standing.seen_often)
            moved = have_come(self.followed(known), standing, EVERY, MOST, self._since_lost)
        for k in np.nonzero(moved)[0]:
            recent = self._seen_at(known[k])[-_LATELY:]
            moved[k] = self._restless.sightings(recent) <= _RESTLESS
        self._remember_moved(known, moved)

    def _seen_at(self, number: int) -> Points:
        """Return the places at which one was seen, Tx2, the oldest first."""
        return np.asarray(self._paths[number][~np.isnan(self._raw[number, :, 0])])
