"""What is remembered of the scene from one measurement of motion to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.clutter import ClutterMemory, cells_of
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.moving import Moving
from turbseg_ros.segmentation.static_overlay import OverlayMemory
from turbseg_ros.segmentation.usual_change import UsualChange
from turbseg_ros.segmentation.velocity_memory import VelocityMemory
from turbseg_ros.segmentation.window import Neighbourhood

# Frames in a row in which motion may be left unmeasured: what is so slow, or so faint, that the
# pictures don't show it, waits no longer.
_MOST_LEFT_OUT = 3


class SceneMemory:
    """Knows by how much each place moves anyway, and what is no scene but burnt into the picture.

    Short and long baselines have clutter of their own: each has a memory of its own.

    :param static_overlays: whether what is burnt in is looked for; else all is scene.
    :param averaging: whether motion is averaged over measurements.
    """

    def __init__(self, static_overlays: bool, averaging: bool) -> None:
        self._clutter: list[ClutterMemory] = []
        self._overlay = OverlayMemory() if static_overlays else None
        self._change = UsualChange()
        self._velocity = VelocityMemory() if averaging else None
        # Frames since motion was measured, and how many times it was left out.
        self._frames, self._left_out = 0, 0

    def propagate(self, ego_motion: Matrix | None, frames: int) -> None:
        """Take what is known into the frame that is looked at next; None: to another scene.

        :param ego_motion: takes the processing pixels of the frame before, so many frames
            earlier, to its own.
        """
        self._frames += frames
        for memory in self._clutter:
            memory.propagate(ego_motion)
        self._change.propagate(ego_motion)
        if self._velocity is not None:
            self._velocity.propagate(ego_motion)

    def shows_nothing_new(
        self, before: Moving | None, grey: ByteImage, aligned: Mapping[int, ByteImage]
    ) -> bool:
        """Whether a frame needs no measurement: nothing moved before, and it is as usual.

        What is usual is learned from frames in which nothing is followed.

        :param before: what was measured last, if nothing was cut out since.
        :param grey: HxW at processing resolution.
        :param aligned: the neighbours as the frame itself would show them.
        """
        if before is None:
            self._left_out = 0
            return False
        changed = self._change.is_exceeded(grey, aligned) or bool(before.regions)
        self._left_out = 0 if changed or self._left_out == _MOST_LEFT_OUT else self._left_out + 1
        return self._left_out > 0

    def overlay(self, neighbourhood: Neighbourhood, aligned: Mapping[int, ByteImage]) -> Mask:
        """Return which cells, hxw, stand still while the scene moves; see `OverlayMemory`.

        :param aligned: the neighbours as the frame itself would show them.
        """
        if self._overlay is None:
            return np.zeros(cells_of(neighbourhood.grey.shape), bool)
        return self._overlay.take(
            neighbourhood.grey, neighbourhood.neighbours, aligned, neighbourhood.transforms
        )

    def with_memory(
        self, motions: Sequence[MotionEstimate], usable: Mask, objects: Mask, camera_known: bool
    ) -> list[MotionEstimate]:
        """Return estimates with what is known of each place, and learn from them.

        The last one is the average over time of the longest baseline's; it is left out while too
        little is known for one, and where there is no long baseline.

        :param motions: estimates over a short baseline and, if any, longer ones.
        :param usable: HxW, where flow has something to hold on to.
        :param objects: hxw, cells that objects cover: no clutter is learned there.
        :param camera_known: whether the camera's own motion was taken out of them.
        """
        cluttered = self._with_clutter(motions, usable, objects)
        if self._velocity is None:
            return cluttered
        if not camera_known or len(cluttered) < 2:
            self._velocity.forget()
            return cluttered
        average = self._velocity.take(cluttered[-1])
        return cluttered if average is None else [*cluttered, average]

    def _with_clutter(
        self, motions: Sequence[MotionEstimate], usable: Mask, objects: Mask
    ) -> list[MotionEstimate]:
        frames, self._frames = self._frames, 0
        self._clutter += [ClutterMemory() for _ in motions[len(self._clutter) :]]
        return [
            replace(
                motion,
                clutter=memory.take(
                    motion.velocity, motion.noise, motion.visible & usable, objects, frames
                ),
            )
            for motion, memory in zip(motions, self._clutter, strict=False)
        ]
