"""Frames made ready: an 8-bit picture at two sizes, registered to the frame before."""

from __future__ import annotations

import copy
import functools
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.segmentation.background import MaskedImage, unmasked
from turbseg_ros.segmentation.blobs import Blobs, blob_pyramid
from turbseg_ros.segmentation.camera_state import CameraTrack
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.damage import Usual, judged
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.registration import register
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.tone import ToneMap


@dataclass(frozen=True)
class PreparedFrame:
    """A frame as the stages need it.

    `grey` is at processing resolution, uint8, `scene` is the picture at detail resolution, its
    objects hidden once `objects_known`;
    `from_previous` takes the pixels (of `grey`) of the frame before in the window to this one's;
    `continues` tells whether the two have anything in common, `condition` whether all of it shows
    what that one showed, and `usual` what is so from frame to frame, None for a scene's first;
    `camera` is what is known of the camera's motion by then, and `stands` whether its registration
    says that it stands; `blobs` are what stands out in it at each scale, if that is looked for.
    """

    index: int
    grey: ByteImage
    scene: MaskedImage
    from_previous: Matrix
    continues: bool = True
    objects_known: bool = False
    condition: Condition = Condition.SOUND
    usual: Usual | None = None
    camera: CameraTrack = field(default_factory=CameraTrack)
    stands: bool = False
    blobs: tuple[Blobs, ...] = ()

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
    observer: StageObserver,
    voteless: Mask | None = None,
    small_targets: bool = True,
) -> PreparedFrame:
    """Scale an 8-bit picture, HxW or HxWx3, register it to the frame before, and judge it by that.

    :param previous: the last frame that joined the window.
    :param voteless: cells of that frame that are no scene and have no say in it, hxw.
    :param small_targets: whether what may be one is looked for.
    """
    with observer.stage("scaling"):
        detail = _shrunk(picture, resolution.detail)
        grey = cv2.cvtColor(detail, cv2.COLOR_BGR2GRAY) if detail.ndim == 3 else detail
        grey = _resized(grey, resolution.processing)
        scene = unmasked(detail)
    with observer.stage("registration"):
        before = CameraTrack() if previous is None else previous.camera
        found = None
        if previous is not None:
            stood = before.has_stood(resolution.processing)
            found = register(previous.grey, grey, voteless, previous.stands, stood)
        camera = before if previous is None else before.after(found, resolution.processing)
        held = found is None or not found.is_supported
        from_previous = before.expected if held or found is None else found.motion
        condition, usual = Condition.SOUND, None
        if previous is not None:
            motion = None if found is None else from_previous
            condition, usual = judged(grey, previous.grey, motion, previous.usual)
    with observer.stage("small targets"):
        blobs = blob_pyramid(grey) if small_targets else ()
    return PreparedFrame(
        index=index,
        grey=grey,
        scene=scene,
        from_previous=from_previous,
        continues=found is not None,
        condition=condition,
        usual=usual,
        camera=camera,
        stands=found is not None and found.stands,
        blobs=blobs,
    )


class FramePreparer:
    """Prepares one frame at a time in a background thread, while earlier ones are segmented."""

    def __init__(
        self,
        resolution: Resolution,
        executor: Executor,
        observer: StageObserver,
        small_targets: bool,
    ) -> None:
        self._resolution = resolution
        self._executor = executor
        self._observer = observer
        self._small_targets = small_targets
        self._tone = ToneMap()
        self._tone_before = copy.copy(self._tone)
        self._under_way: tuple[Frame, Future[PreparedFrame]] | None = None

    def start(
        self,
        frame: Frame,
        index: int,
        previous: PreparedFrame | None,
        voteless: Mask | None = None,
    ) -> None:
        """Begin with a frame, whose image is read until `finish`.

        :param index: its number in the stream.
        :param previous: the frame that it is registered to.
        :param voteless: its cells that have no say in that, hxw.
        """
        self._tone_before = copy.copy(self._tone)
        picture = self._tone(frame.image)
        preparation = self._executor.submit(
            prepare,
            picture,
            self._resolution,
            index,
            previous,
            self._observer,
            voteless,
            self._small_targets,
        )
        self._under_way = (frame, preparation)

    def forget_tone(self) -> None:
        """Let the last frame have no say in how bright those to come are."""
        self._tone = self._tone_before

    def finish(self) -> tuple[Frame, PreparedFrame] | None:
        """Return the frame under way once it is ready; None where there is none.

        :raises RuntimeError: when it can't be prepared.
        """
        if self._under_way is None:
            return None
        (frame, preparation), self._under_way = self._under_way, None
        try:
            return frame, preparation.result()
        except Exception as error:
            raise RuntimeError(f"the frame of {frame.stamp} ns can't be prepared") from error


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
