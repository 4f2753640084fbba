"""All targets: what stands out at each scale of the picture, and in its change."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from turbseg_ros.arrays import Mask, Matrix
from turbseg_ros.segmentation.blobs import SCALES, Blobs
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.change_tracks import ChangeTracks
from turbseg_ros.segmentation.changes import NO_CHANGES, Changes, SceneChanges
from turbseg_ros.segmentation.clutter import cells_of
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.target_tracks import Target, TargetTracks
from turbseg_ros.segmentation.window import FrameWindow


class TargetPyramid:
    """Follows what stands out at each of the `SCALES`, and in what has changed."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        """Set up without targets.

        :param shape: rows and columns of the pictures, at processing resolution.
        """
        numbers = itertools.count(1)
        self._tracks = [TargetTracks(scale, numbers) for scale in SCALES]
        self._changing = ChangeTracks(self._tracks[0], cells_of(shape), numbers)
        self._changes = SceneChanges()

    def follow(
        self, window: FrameWindow, objects: Sequence[CroppedMask], overlay: Mask | None
    ) -> None:
        """Take what stands out in the newest frame of a window.

        :param objects: known objects as they should be in it, at detail resolution.
        :param overlay: hxw cells that are no scene; None where none are known.
        """
        frame = window.newest
        if frame is not None:
            changes = self._changes.newest(window, objects)
            state = frame.camera.state
            self.take(frame.blobs, frame.from_previous, state, overlay, changes)

    def take(
        self,
        blobs: Sequence[Blobs],
        ego_motion: Matrix,
        state: CameraState = CameraState.STILL,
        overlay: Mask | None = None,
        changes: Changes = NO_CHANGES,
    ) -> None:
        """Take what stands out in the next frame at each scale; see `TargetTracks.take`.

        :param blobs: those of each scale; none where they aren't looked for.
        """
        for tracks, found in zip(self._tracks, blobs, strict=False):
            tracks.take(found, ego_motion, state, overlay)
        self._changing.take(changes.blobs, ego_motion, state, overlay, changes.known)

    def moving_at(self, age: int) -> list[Target]:
        """Return the targets that have moved, as seen so many frames before the newest."""
        tracks = [*self._tracks, self._changing]
        return [target for each in tracks for target in each.moving_at(age)]
