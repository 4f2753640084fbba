"""Which object of a frame is which of the others, by the paper: once the whole clip is known."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import ByteImage, Matrix, Point
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.look_ahead import WHOLE_CLIP
from turbseg_ros.segmentation.track import (
    Detection,
    Observation,
    Track,
    Tracker,
)


class KMeansIds:
    """The paper's way: every mask is an object, ids come from K-means once the clip has ended.

    K is the number of masks that frames with any hold most often. Everything waits for the end of
    the clip.
    """

    def __init__(self, slots: int) -> None:
        """Set up without a clip; `slots` is the number of output slots."""
        self._slots = slots
        self._clip: list[list[Track]] = []
        self._next_id = 1

    @property
    def delay(self) -> int:
        """No result before the end of the clip."""
        return WHOLE_CLIP

    @property
    def next_id(self) -> int:
        """The id that the next clip's first object will get."""
        return self._next_id

    def continue_ids(self, other: Tracker) -> None:
        """Go on counting where another one stands."""
        self._next_id = other.next_id

    def reset(self) -> None:
        """Forget the clip; ids go on."""
        self._clip = []

    def expected_objects(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Detection]:
        """Expect nothing: each frame stands for itself."""
        return []

    def travelled_outlines(
        self, ego_motion: Matrix, shape: tuple[int, int], frames: int
    ) -> list[CroppedMask]:
        """Expect nothing: each frame stands for itself."""
        return []

    def update(
        self,
        detections: Sequence[Detection],
        ego_motion: Matrix,
        tilt: float,
        image: ByteImage,
        slewing: bool = False,
    ) -> list[Observation]:
        """Take every detection for an object whose id is still open."""
        return self._take([Track.started(detection, tilt) for detection in detections])

    def _take(self, tracks: list[Track]) -> list[Observation]:
        self._clip.append(tracks)
        return [track.observed(track.detection) for track in tracks]

    def coast(self, ego_motion: Matrix, shape: tuple[int, int]) -> list[Observation]:
        """Take the masks of the frame before, propagated, for those of this one."""
        before = self._clip[-1] if self._clip else []
        carried = [track.expected(ego_motion, shape) for track in before]
        return self._take([Track.started(each, 0.0) for each in carried if each.area])

    def settle(self) -> None:
        """Assign their ids to the clip's masks."""
        counts = [len(tracks) for tracks in self._clip if tracks]
        if not counts:
            return
        clusters = int(np.bincount(counts).argmax())
        tracks = [track for frame in self._clip for track in frame]
        identities = kmeans_ids([track.detection.centroid for track in tracks], clusters)
        for track, cluster in zip(tracks, identities, strict=True):
            track.id = self._next_id + int(cluster) - 1
            track.slot = int(cluster) - 1 if cluster <= self._slots else -1
            track.confirmed = True
        self._next_id += clusters
        self._clip = []


def kmeans_ids(centroids: Sequence[Point], count: int) -> npt.NDArray[np.int64]:
    """Return every mask of a clip an id from 1 to `count` by where its centroid lies.

    The paper's mask ID unification, eq. 4: K-means over the centroids of all frames. It needs the
    whole clip and its number of objects, and it splits an object that crosses the view.

    :param centroids: (x, y) of each mask of all frames.
    """
    if not centroids:
        return np.zeros(0, np.int64)
    points = np.asarray(centroids, np.float32).reshape(-1, 2)
    clusters = min(count, len(np.unique(points, axis=0)))
    if clusters == 1:
        return np.ones(len(points), np.int64)
    # OpenCV draws the first centres from its global generator.
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 0.01)
    _, assigned, _ = cv2.kmeans(points, clusters, None, criteria, 10, cv2.KMEANS_PP_CENTERS)
    return assigned.ravel().astype(np.int64) + 1
