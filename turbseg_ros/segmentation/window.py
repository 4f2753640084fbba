"""The sliding window: frames made ready, how they lie to one another, and what to compare."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Map, Mask, Matrix
from turbseg_ros.segmentation.background import with_objects_masked
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.clutter import enlarged
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.exposure import exposure_between
from turbseg_ros.segmentation.geometry import corner_displacement
from turbseg_ros.segmentation.preparation import PreparedFrame
from turbseg_ros.segmentation.registration import align, visible

# Flow within this many pixels of another frame's border follows the border, not the scene.
_BORDER = 4.0
# The camera stands where its motion takes no corner of the picture further than that, in pixels.
# Where it moves, what a frame further away shows differs by more than things' own motion.
_STANDS = 1.0
# With fewer views of it, the median of the background is a matter of chance.
_ENOUGH_KEY_FRAMES = 6


@dataclass(frozen=True)
class Neighbourhood:
    """A frame and what it is compared with, at processing resolution.

    `neighbours` holds, by interval, the grey images of others as they came; `transforms` take the
    frame's pixels to theirs, which is a guess unless `camera_known`.
    """

    grey: ByteImage
    neighbours: Mapping[int, ByteImage]
    transforms: Mapping[int, Matrix]
    camera_known: bool = True

    def aligned(self) -> dict[int, ByteImage]:
        """Return the neighbours as the frame itself would show them, exposed as it is."""
        return {k: self._aligned(grey, self.transforms[k]) for k, grey in self.neighbours.items()}

    def valid(self, overlay: Mask) -> dict[int, Map]:
        """Return by interval which pixels of the scene the other frame sees, HxW, 1 or 0.

        :param overlay: hxw cells that are no scene; flow smears past them.
        """
        shape = (self.grey.shape[0], self.grey.shape[1])
        valid = {
            k: visible(shape, each, _BORDER).astype(np.float32)
            for k, each in self.transforms.items()
        }
        if not overlay.any():
            return valid
        scene = ~enlarged(cv2.dilate(overlay.view(np.uint8), np.ones((5, 5), np.uint8)) > 0, shape)
        return {k: seen * scene for k, seen in valid.items()}

    def _aligned(self, neighbour: ByteImage, transform: Matrix) -> ByteImage:
        exposure = exposure_between(neighbour, self.grey, transform)
        return exposure.applied_to(align(neighbour, transform), channels=1)


class FrameWindow:
    """The frames at hand: all around those still to be segmented, and key frames of the past."""

    def __init__(
        self, reach: int, look_ahead: int, memory: int, key_step: int, warm_up: int = 0
    ) -> None:
        """Set up an empty window.

        :param reach: the largest interval over which a frame is looked back to.
        :param look_ahead: frames after a frame that must be there before it is segmented.
        :param memory: age in frames up to which key frames are kept.
        :param key_step: every how many frames one is kept as a key frame.
        :param warm_up: frames that must be there before the first is segmented.
        """
        self._reach = reach
        self._look_ahead = look_ahead
        self._warm_up = warm_up
        self._memory = memory
        self._key_step = key_step
        self._frames: dict[int, PreparedFrame] = {}
        self._next_centre = 0
        self._count = 0

    def __getitem__(self, index: int) -> PreparedFrame:
        return self._frames[index]

    @property
    def newest(self) -> PreparedFrame | None:
        """The frame that came last."""
        return self._frames.get(self._count - 1)

    @property
    def count(self) -> int:
        """How many frames have come."""
        return self._count

    @property
    def piled_up(self) -> int:
        """How many frames can be segmented beside the one that the newest makes ready."""
        return max(self._count - self._next_centre - self._look_ahead - 1, 0)

    def append(self, prepared: PreparedFrame) -> None:
        """Take the next frame."""
        self._frames[prepared.index] = prepared
        self._count += 1

    def pop_ready(self, ended: bool = False) -> int | None:
        """Return the index of the next frame that can be segmented now, each once, in order.

        The first frames lack a past, so they wait for a longer future. When the stream has
        `ended`, every frame is ready. Frames that only earlier ones needed are forgotten.
        """
        self._forget()
        is_late = self._count - self._next_centre > self._look_ahead
        is_due = is_late and self._count >= self._warm_up
        if self._next_centre >= self._count or not (ended or is_due):
            return None
        self._next_centre += 1
        return self._next_centre - 1

    def mark_objects(self, index: int, objects: Iterable[CroppedMask]) -> None:
        """Remember which pixels of a frame are objects, not background."""
        if index in self._frames:
            frame = self._frames[index]
            scene = with_objects_masked(frame.scene, objects)
            self._frames[index] = replace(frame, scene=scene, objects_known=True)

    def shows_scene(self, index: int) -> bool:
        """Whether a frame has anything in common with the one before or after it.

        Noise, a covered lens or a torn frame has not.
        """
        after = self._frames.get(index + 1)
        return self._frames[index].continues or (after is not None and after.continues)

    def goes_on(self, source: int, target: int) -> bool:
        """Whether the scene of a frame goes on until a later one."""
        return all(self._frames[k].continues for k in self._frames if source < k <= target)

    def transform_if_continuous(self, source: int, target: int) -> Matrix | None:
        """Return what takes a frame's processing pixels to a later one's; None across a cut.

        None as well where the frame isn't at hand.
        """
        if source not in self._frames or not self.goes_on(source, target):
            return None
        return self.transform(source, target)

    def _is_use(self, index: int, centre: int) -> bool:
        """Whether a frame is at hand, shows the scene, and in the same view as another."""
        if index not in self._frames or not self.shows_scene(index):
            return False
        return self._frames[index].camera.view == self._frames[centre].camera.view

    def neighbourhood(self, centre: int, wanted: Sequence[int]) -> Neighbourhood:
        """Return a frame with its neighbours at those of the wanted intervals that exist.

        See `neighbours` for what stands in for the others.
        """
        intervals = self.neighbours(centre, wanted)
        transforms = self.transforms_from(centre)
        return Neighbourhood(
            self._frames[centre].grey,
            {k: self._frames[centre + k].grey for k in intervals},
            {k: transforms[centre + k] for k in intervals},
            self._frames[centre].camera.state is not CameraState.LOST,
        )

    def neighbours(self, centre: int, wanted: Sequence[int]) -> list[int]:
        """Return the intervals to compare a frame over: the wanted ones that exist.

        What is missing on one side, at the ends of the stream, is taken from the other. With all
        on one side, others near are added, for then the frame's own tilt has to be told as well.
        Where one alone is wanted ahead, one half as far will do. If the camera stands, the one on
        the other side is as much further away: both lie as far apart as they would.
        """
        wanted = self._within_reach(centre, wanted)
        there = {
            k if self._is_use(centre + k, centre) else -k
            for k in wanted
            if self._is_use(centre + k, centre) or self._is_use(centre - k, centre)
        }
        if there and (min(there) > 0 or max(there) < 0):
            nearest = min(there, key=abs)
            there |= {
                k
                for k in (round(nearest * share) for share in (0.25, 0.5, -0.5))
                if k and self._is_use(centre + k, centre)
            }
        return sorted(there)

    def _within_reach(self, centre: int, wanted: Sequence[int]) -> Sequence[int]:
        """Return the intervals wanted, one that lies ahead alone as far as frames have come."""
        ahead = [k for k in wanted if k > 0]
        if len(ahead) != 1:
            return wanted
        (widest,) = ahead
        for k in range(widest, (widest + 1) // 2 - 1, -1):
            if self._is_use(centre + k, centre):
                behind = k - 2 * widest
                if not (self._is_use(centre + behind, centre) and self._stands(centre, behind)):
                    behind = -widest
                return [k, *(behind if each == -widest else each for each in wanted if each < 0)]
        past = (
            k for k in range(widest, (widest + 1) // 2 - 1, -1) if self._is_use(centre - k, centre)
        )
        return [-next(past, widest) if each == -widest else each for each in wanted]

    def _stands(self, centre: int, interval: int) -> bool:
        """Whether the camera stood, or nearly so, from one frame to another."""
        height, width = self._frames[centre].grey.shape
        motion = self.transform(centre, centre + interval)
        return corner_displacement(motion, (width, height)) < _STANDS

    def key_frames(self, centre: int) -> list[int]:
        """Return the indices of the frames that show the scene at other times than `centre`."""
        others = sorted(k for k in self._frames if k != centre and self._is_use(k, centre))
        keys = [k for k in others if k % self._key_step == 0]
        # Early on there are few: then every frame at hand counts.
        return keys if len(keys) >= _ENOUGH_KEY_FRAMES else others

    def earlier(self, index: int, frames: int) -> list[int]:
        """Return the frames at hand that show a frame's view up to so many frames before it."""
        return sorted(
            k
            for k in self._frames
            if index - frames <= k < index and self._is_use(k, index) and self.goes_on(k, index)
        )

    def transform(self, source: int, target: int) -> Matrix:
        """Return the transform of processing pixels from frame `source` to frame `target`."""
        between = range(min(source, target), max(source, target) + 1)
        return self._transforms(source, [k for k in between if k in self._frames])[target]

    def transforms_from(self, source: int) -> dict[int, Matrix]:
        """Return the transforms of processing pixels from a frame to each of those at hand."""
        return self._transforms(source, sorted(self._frames))

    def _transforms(self, source: int, indices: Sequence[int]) -> dict[int, Matrix]:
        """Return the transforms of processing pixels from a frame to each of some, in order.

        :param indices: of frames at hand, that frame among them and all between them.
        """
        here = indices.index(source)
        transforms = {source: np.eye(3)}
        for before, after in itertools.pairwise(indices[here:]):
            transforms[after] = self._frames[after].from_previous @ transforms[before]
        for after, before in itertools.pairwise(indices[here::-1]):
            transforms[before] = self._frames[after].to_previous @ transforms[after]
        return transforms

    def _forget(self) -> None:
        """Drop frames that no later one needs, handing their motion to the next that stays."""
        newest_done = self._next_centre - 1
        for index in sorted(self._frames):
            age = newest_done - index
            key = index % self._key_step == 0 and age <= self._memory
            if age <= self._reach or key:
                continue
            dropped = self._frames.pop(index)
            later = min((k for k in self._frames if k > index), default=None)
            if later is not None:
                heir = self._frames[later]
                self._frames[later] = replace(
                    heir,
                    from_previous=heir.from_previous @ dropped.from_previous,
                )
