"""The sliding window: frames made ready, how they lie to one another, and what to compare."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.segmentation.background import MaskedImage, unmasked, with_objects_masked
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.exposure import exposure_between
from turbseg_ros.segmentation.geometry import scaling
from turbseg_ros.segmentation.registration import align, register_affine

Mask = npt.NDArray[np.bool_]
Matrix = npt.NDArray[np.float64]
ByteImage = npt.NDArray[np.uint8]

# Flow needs so many pixels each way.
_MIN_SIDE = 16
# With fewer views of it, the median of the background is a matter of chance.
_ENOUGH_KEY_FRAMES = 6


@dataclass(frozen=True)
class Resolution:
    """The sizes (width, height) a frame is worked on: as it came, for flow, for outlines."""

    input: tuple[int, int]
    processing: tuple[int, int]
    detail: tuple[int, int]

    @classmethod
    def of(cls, shape: tuple[int, ...], processing_width: int, detail_width: int) -> Resolution:
        """Choose the sizes for an image of `shape`.

        Both widths are those of a 16:9 picture; others get the same number of pixels. Flow is
        always computed at that size, a small image is enlarged for it; outlines are drawn at the
        detail size or, when that is smaller, at the input's.
        """
        height, width = shape[:2]

        def scaled(pixels: float) -> tuple[int, int]:
            scale = np.sqrt(pixels / (width * height))
            # A strip is widened for flow to fit in, at the cost of its length.
            longest = round(pixels) // _MIN_SIDE
            x, y = (
                min(max(round(side * scale), _MIN_SIDE), max(longest, _MIN_SIDE))
                for side in (width, height)
            )
            return x, y

        return cls(
            input=(width, height),
            processing=scaled(processing_width**2 * 9 / 16),
            detail=scaled(min(detail_width**2 * 9 / 16, width * height)),
        )

    @property
    def detail_from_processing(self) -> tuple[float, float]:
        """Factors in x and y from processing to detail pixels."""
        return (
            self.detail[0] / self.processing[0],
            self.detail[1] / self.processing[1],
        )

    def to_detail(self, transform: Matrix) -> Matrix:
        """Return a transform between processing images as one between detail images."""
        scale = scaling(*self.detail_from_processing)
        result: Matrix = scale @ transform @ np.linalg.inv(scale)
        return result


@dataclass(frozen=True)
class PreparedFrame:
    """A frame as the stages need it.

    `grey` is at processing resolution, uint8, `scene` is the picture at detail resolution, its
    objects hidden once `objects_known`;
    `from_previous` takes the pixels (of `grey`) of the frame before in the window to this one's;
    `continues` tells whether the two have anything in common.
    """

    index: int
    grey: ByteImage
    scene: MaskedImage
    from_previous: Matrix
    continues: bool = True
    objects_known: bool = False

    @functools.cached_property
    def to_previous(self) -> Matrix:
        """What takes this frame's pixels to those of the frame before."""
        return np.asarray(np.linalg.inv(self.from_previous))

    @property
    def detail(self) -> ByteImage:
        """The picture at detail resolution, HxWxC, uint8."""
        return self.scene.image[..., :-1]


def prepare(
    picture: ByteImage,
    resolution: Resolution,
    index: int,
    previous: PreparedFrame | None,
) -> PreparedFrame:
    """Scale an 8-bit picture, HxW or HxWx3, and register it to the frame before."""
    detail = _shrunk(picture, resolution.detail)
    grey = cv2.cvtColor(detail, cv2.COLOR_BGR2GRAY) if detail.ndim == 3 else detail
    grey = _resized(grey, resolution.processing)
    motion = None if previous is None else register_affine(previous.grey, grey)
    from_previous = np.eye(3) if motion is None else motion
    return PreparedFrame(
        index=index,
        grey=grey,
        scene=unmasked(detail),
        from_previous=from_previous,
        continues=motion is not None,
    )


@dataclass(frozen=True)
class Neighbourhood:
    """A frame and what it is compared with, at processing resolution.

    `neighbours` holds, by interval, the grey images of others as they came; `transforms` take the
    frame's pixels to theirs.
    """

    grey: ByteImage
    neighbours: Mapping[int, ByteImage]
    transforms: Mapping[int, Matrix]

    def aligned(self) -> dict[int, ByteImage]:
        """Return the neighbours as the frame itself would show them, exposed as it is."""
        return {k: self._aligned(grey, self.transforms[k]) for k, grey in self.neighbours.items()}

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

    def append(self, prepared: PreparedFrame) -> None:
        """Take the next frame."""
        self._frames[prepared.index] = prepared
        self._count += 1

    def ready(self, ended: bool = False, at_most: int = 1) -> Iterator[int]:
        """Give, in order, the index of each frame that can be segmented now.

        The first frames lack a past, so they wait for a longer future. What has piled up by then
        is worked off beside what comes, `at_most` so many at once, lest the camera's frames pile
        up instead. When the stream has `ended`, every frame is ready.
        """
        given = 0
        while self._next_centre < self._count:
            late = self._count - self._next_centre > self._look_ahead
            due = late and self._count >= self._warm_up and given < at_most
            if not (ended or due):
                return
            given += 1
            self._next_centre += 1
            yield self._next_centre - 1
            self._forget()

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

    def follows_cut(self, prepared: PreparedFrame) -> bool:
        """Whether a frame, not yet taken, goes on from a newest one that began a new scene.

        After a covered lens or a torn frame the old scene is there again; after a cut it isn't.
        """
        newest = self.newest
        if newest is None or newest.continues or not prepared.continues:
            return False
        before = [k for k in sorted(self._frames) if k < newest.index and self.shows_scene(k)]
        return (
            bool(before) and register_affine(self._frames[before[-1]].grey, prepared.grey) is None
        )

    def _is_use(self, index: int) -> bool:
        """Whether a frame is at hand and shows the scene."""
        return index in self._frames and self.shows_scene(index)

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
        )

    def neighbours(self, centre: int, wanted: Sequence[int]) -> list[int]:
        """Return the intervals to compare a frame over: the wanted ones that exist.

        What is missing on one side, at the ends of the stream, is taken from the other. With all
        on one side, others near are added, for then the frame's own tilt has to be told as well.
        """
        there = {
            k if self._is_use(centre + k) else -k
            for k in wanted
            if self._is_use(centre + k) or self._is_use(centre - k)
        }
        if there and (min(there) > 0 or max(there) < 0):
            nearest = min(there, key=abs)
            there |= {
                k
                for k in (round(nearest * share) for share in (0.25, 0.5, -0.5))
                if k and self._is_use(centre + k)
            }
        return sorted(there)

    def key_frames(self, centre: int) -> list[int]:
        """Return the indices of the frames that show the scene at other times than `centre`."""
        others = sorted(k for k in self._frames if k != centre and self.shows_scene(k))
        keys = [k for k in others if k % self._key_step == 0]
        # Early on there are few: then every frame at hand counts.
        return keys if len(keys) >= _ENOUGH_KEY_FRAMES else others

    def transform(self, source: int, target: int) -> Matrix:
        """Return the transform of processing pixels from frame `source` to frame `target`."""
        return self.transforms_from(source)[target]

    def transforms_from(self, source: int) -> dict[int, Matrix]:
        """Return the transforms of processing pixels from a frame to each of those at hand."""
        indices = sorted(self._frames)
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


def _shrunk(image: ByteImage, size: tuple[int, int]) -> ByteImage:
    """Return an image at a size (width, height) that is not larger; never the caller's own buffer.

    OpenCV averages over whole pixels many times as fast as over fractions of them.
    """
    if (image.shape[1], image.shape[0]) == size:
        return image.copy()
    factor = min(image.shape[1] // size[0], image.shape[0] // size[1])
    if factor > 1:
        whole = (image.shape[1] // factor, image.shape[0] // factor)
        image = cv2.resize(image, whole, interpolation=cv2.INTER_AREA)
    shrunk: ByteImage = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    return shrunk


def _resized(image: ByteImage, size: tuple[int, int]) -> ByteImage:
    """Return an image at a size (width, height)."""
    if (image.shape[1], image.shape[0]) == size:
        return image
    shrinks = size[0] < image.shape[1]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    resized: ByteImage = cv2.resize(image, size, interpolation=interpolation)
    return resized
