"""What the method is compared with, on the same frames.

OpenCV's background subtraction, each raw and after the camera's motion was taken out: MOG2
(Zivkovic 2004), KNN (Zivkovic and van der Heijden 2006), and of its contrib modules GSOC (Samsonov
2017), LSBP (Guo, Xu and Qiang 2016) and CNT (Zeevi 2016). The method under other parameters, the
paper's among them; segmenters of one's own, and masks that others found.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Protocol

import cv2
import numpy as np

from turbseg_ros.arrays import ByteImage, Mask, Matrix
from turbseg_ros.dependencies import how_to_install
from turbseg_ros.evaluation import BASELINES, CONTRIB_BASELINES
from turbseg_ros.evaluation.recorded_masks import RecordedMasks
from turbseg_ros.factory import clip_segmenter, loaded_class
from turbseg_ros.parameter_file import load_parameters
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.presets import preset_path
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult, Segmenter
from turbseg_ros.segmentation.registration import align, register, visible
from turbseg_ros.segmentation.tone import ToneMap

# The middle of what served the baselines best on the bags that come with the package: without
# shadows, which turbulence feigns, and cleaned by a median and a least area, both in pixels.
_MEDIAN_SIZE = 5
_MIN_OBJECT = 30
# A model that calls more than this share of the picture moving knows no background yet.
_MAX_FOREGROUND = 0.5
# Share of the reference that must be in view; when less is, a frame becomes the new reference.
_MIN_OVERLAP = 0.7
# Share of the width by which a way from frame to frame may have drifted.
_MAX_DRIFT = 0.05
# Pixels along the border of a frame that interpolation spoils.
_BORDER = 2.0

_SUBTRACTORS: dict[str, Callable[[], cv2.BackgroundSubtractor]] = {
    "mog2": lambda: cv2.createBackgroundSubtractorMOG2(detectShadows=False),
    "knn": lambda: cv2.createBackgroundSubtractorKNN(detectShadows=False),
    "gsoc": lambda: cv2.bgsegm.createBackgroundSubtractorGSOC(),  # type: ignore[attr-defined]
    "lsbp": lambda: cv2.bgsegm.createBackgroundSubtractorLSBP(),  # type: ignore[attr-defined]
    "cnt": lambda: cv2.bgsegm.createBackgroundSubtractorCNT(),  # type: ignore[attr-defined]
}


class UnknownBaselineError(ValueError):
    """A baseline was asked for that can't be had; the text says why and what can."""


class Method(Protocol):
    """Something to be evaluated, which makes a new segmenter for every bag.

    It can be sent to another process. `keeps_ids` tells whether its objects keep their ids,
    `recorded` whether it only gives back what was found before: then its time says nothing, and
    frames that are changed beforehand change nothing.
    """

    @property
    def name(self) -> str:
        """What tables call it."""

    @property
    def keeps_ids(self) -> bool:
        """Whether it follows objects from frame to frame."""

    @property
    def recorded(self) -> bool:
        """Whether it gives back what was found before."""

    def segmenter(self, clip: str = "", frames: int = 0) -> Segmenter:
        """Make a segmenter that has seen nothing yet.

        :param clip: the name of the clip that it will see, which has so many `frames`.
        """


@dataclass(frozen=True)
class TurbsegMethod:
    """The method itself under some parameters, which make it what it is, whatever its name."""

    name: str = field(compare=False)
    parameters: Parameters
    keeps_ids: ClassVar[bool] = True
    recorded: ClassVar[bool] = False

    def segmenter(self, clip: str = "", frames: int = 0) -> Segmenter:
        """Make a segmenter that has seen nothing yet."""
        return clip_segmenter(self.parameters)


@dataclass(frozen=True)
class BackgroundSubtraction:
    """One of OpenCV's background subtractors, as `mog2`, raw or on stabilised frames."""

    algorithm: str
    stabilised: bool
    keeps_ids: ClassVar[bool] = False
    recorded: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """What tables call it."""
        return f"{self.algorithm} stabilised" if self.stabilised else self.algorithm

    def segmenter(self, clip: str = "", frames: int = 0) -> Segmenter:
        """Make a segmenter that has seen nothing yet."""
        detector = StabilisedDetector if self.stabilised else ForegroundDetector
        return ComponentSegmenter(detector(self.algorithm))


@dataclass(frozen=True)
class OwnSegmenter:
    """A user's class, `package.module:Class`, which is called with the parameters.

    Its objects keep their ids, unless it has an attribute `keeps_ids` that says otherwise.
    """

    path: str
    parameters: Parameters
    recorded: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """What tables call it."""
        return self.path.rpartition(":")[2]

    @property
    def keeps_ids(self) -> bool:
        """Whether it follows objects from frame to frame."""
        return bool(getattr(loaded_class("baseline", self.path), "keeps_ids", True))

    def segmenter(self, clip: str = "", frames: int = 0) -> Segmenter:
        """Make a segmenter that has seen nothing yet.

        :raises ParameterError: when the class can't be had, or made with the parameters.
        """
        try:
            made: Segmenter = loaded_class("baseline", self.path)(self.parameters)
        except TypeError as error:
            raise ParameterError(
                f"baseline {self.path} can't be made with the parameters: {error}"
            ) from error
        return made


def baselines(names: Sequence[str], parameters: Parameters | None = None) -> tuple[Method, ...]:
    """Return the baselines of these names, those from OpenCV raw and stabilised.

    Beside the names in `BASELINES` there are `package.module:Class`, made with `parameters`;
    `NAME=FOLDER`, masks that something called so has found; and `NAME=FILE`, the method under the
    parameters in a file.

    :raises UnknownBaselineError: for a name that is none of these, or can't be had.
    :raises ParameterError: when a parameter file or a class can't be had.
    :raises ClipError: when masks can't be had.
    """
    methods: list[Method] = []
    for name in names:
        own_name, is_named, path = name.partition("=")
        if is_named and Path(path).is_file():
            methods.append(TurbsegMethod(own_name, load_parameters(Path(path))))
        elif is_named:
            methods.append(RecordedMasks.of(own_name, Path(path)))
        elif ":" in name:
            loaded_class("baseline", name)
            methods.append(OwnSegmenter(name, parameters or Parameters()))
        elif name == "paper":
            methods.append(TurbsegMethod(name, load_parameters(preset_path("paper"))))
        else:
            methods += background_subtractions(name)
    return tuple(methods)


def background_subtractions(name: str) -> list[BackgroundSubtraction]:
    """Return one of OpenCV's background subtractors, raw and stabilised.

    :raises UnknownBaselineError: when there is none of that name, or not in the OpenCV at hand.
    """
    if name not in _SUBTRACTORS:
        near = difflib.get_close_matches(name, BASELINES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(BASELINES)}"
        raise UnknownBaselineError(
            f"no baseline {name!r}; {hint}; or package.module:Class, or NAME=FOLDER of masks"
        )
    if name in CONTRIB_BASELINES and not hasattr(cv2, "bgsegm"):
        raise UnknownBaselineError(
            f"baseline {name} needs OpenCV's contrib modules, which the one installed lacks; one "
            f"that has them, in its place: {how_to_install('cv2.bgsegm')}"
        )
    return [BackgroundSubtraction(name, stabilised) for stabilised in (False, True)]


class ForegroundDetector:
    """A background subtractor on the frames as they come."""

    def __init__(self, algorithm: str) -> None:
        # KNN replaces its samples at random.
        cv2.setRNGSeed(1)
        self._subtractor = _SUBTRACTORS[algorithm]()

    def foreground(self, picture: ByteImage) -> Mask:
        """Return which pixels of the next picture, HxW or HxWx3, are no background."""
        foreground: Mask = self._subtractor.apply(picture) > 0
        if np.count_nonzero(foreground) > _MAX_FOREGROUND * foreground.size:
            foreground[:] = False
        return foreground


class StabilisedDetector:
    """A background subtractor on frames that are brought into the view of a reference frame.

    The reference is the first frame, and a new one whenever too little of it is left in view.
    """

    def __init__(self, algorithm: str) -> None:
        self._algorithm = algorithm
        self._detector = ForegroundDetector(algorithm)
        self._reference: ByteImage | None = None

    def foreground(self, picture: ByteImage) -> Mask:
        """Return which pixels of the next picture, HxW or HxWx3, are no background."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
        to_picture, in_view = self._register(grey)
        found = self._detector.foreground(align(picture, to_picture)) & in_view
        height, width = grey.shape
        returned = cv2.warpAffine(
            found.astype(np.uint8), to_picture[:2], (width, height), flags=cv2.INTER_NEAREST
        )
        return np.asarray(returned > 0)

    def _register(self, grey: ByteImage) -> tuple[Matrix, Mask]:
        """Return the transform from the reference to this frame, and what of it is in view."""
        if self._reference is not None and self._reference.shape == grey.shape:
            self._to_newest = self._transform(self._reference, grey)
            self._newest = grey
            in_view = visible((grey.shape[0], grey.shape[1]), self._to_newest, _BORDER)
            if np.count_nonzero(in_view) >= _MIN_OVERLAP * in_view.size:
                return self._to_newest, in_view
        self._detector = ForegroundDetector(self._algorithm)
        self._reference = self._newest = grey
        self._to_newest = np.eye(3)
        return self._to_newest, np.ones(grey.shape, bool)

    def _transform(self, reference: ByteImage, grey: ByteImage) -> Matrix:
        """Return the transform from the reference to this frame.

        Registered directly it doesn't drift; but where an object was followed instead of the
        scene, it is far from that by way of all frames between, which stands then.
        """
        direct = register(reference, grey)
        step = register(self._newest, grey)
        stepwise = self._to_newest if step is None else step.motion @ self._to_newest
        if direct is None or not direct.is_supported:
            return stepwise
        height, width = grey.shape
        corners = np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]])
        apart = float(np.abs((direct.motion - stepwise) @ corners).max())
        return direct.motion if apart < _MAX_DRIFT * width else stepwise


class ComponentSegmenter:
    """Answers every frame at once: each connected component of the foreground is an object.

    Components are numbered anew in each frame.
    """

    def __init__(self, detector: ForegroundDetector | StabilisedDetector) -> None:
        self._detector = detector
        self._tone = ToneMap()

    def push(self, frame: Frame) -> list[SegmentationResult]:
        """Take the next frame; return its result."""
        foreground = self._detector.foreground(self._tone(frame.image))
        cleaned = cv2.medianBlur(foreground.astype(np.uint8), _MEDIAN_SIZE)
        _, components, statistics, _ = cv2.connectedComponentsWithStats(cleaned)
        large = statistics[:, cv2.CC_STAT_AREA] >= _MIN_OBJECT
        large[0] = False
        ids = np.cumsum(large, dtype=np.uint16) * large
        labels = ids[components]
        # Looked for within their boxes: there may be hundreds of them in a large picture.
        objects = tuple(
            MovingObject.from_mask(
                labels[y : y + height, x : x + width] == number, int(number), origin=(x, y)
            )
            for number, (x, y, width, height) in zip(
                ids[large], statistics[large, : cv2.CC_STAT_AREA].tolist(), strict=True
            )
        )
        return [replace(SegmentationResult.empty(frame), labels=labels, objects=objects)]

    def flush(self) -> list[SegmentationResult]:
        """Return nothing: every frame was answered."""
        return []
