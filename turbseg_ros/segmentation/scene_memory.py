"""What is remembered of the scene from one measurement of motion to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.clutter import ClutterMemory
from turbseg_ros.segmentation.motion import MotionEstimate
from turbseg_ros.segmentation.static_overlay import OverlayMemory
from turbseg_ros.segmentation.window import Neighbourhood


class SceneMemory:
    """Knows by how much each place moves anyway, and what is no scene but burnt into the picture.

    Short and long baselines have clutter of their own: each has a memory of its own.
    """

    def __init__(self) -> None:
        self._clutter: list[ClutterMemory] = []
        self._overlay = OverlayMemory()

    def propagate(self, ego_motion: Matrix | None) -> None:
        """Take what is known into the frame that is measured next; None: to another scene.

        :param ego_motion: takes the processing pixels of the frame measured before to its own.
        """
        for memory in self._clutter:
            memory.propagate(ego_motion)

    def overlay(self, neighbourhood: Neighbourhood, aligned: Mapping[int, ByteImage]) -> Mask:
        """Return which cells, hxw, stand still while the scene moves; see `OverlayMemory`.

        :param aligned: the neighbours as the frame itself would show them.
        """
        return self._overlay.take(
            neighbourhood.grey, neighbourhood.neighbours, aligned, neighbourhood.transforms
        )

    def with_clutter(
        self, motions: Sequence[MotionEstimate], usable: Mask, objects: Mask, frames: int
    ) -> list[MotionEstimate]:
        """Return estimates with what is known of each place, and learn from them.

        :param motions: estimates over a short baseline and, if any, longer ones.
        :param usable: HxW, where flow has something to hold on to.
        :param objects: hxw, cells that objects cover: nothing is learned there.
        :param frames: how many frames ago motion was measured before.
        """
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
