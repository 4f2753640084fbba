"""What the camera does, told by how frames lie to one another: still, following, slewing, lost.

A hand shakes about one place, a camera that is moved on purpose comes from one place to another:
it is the displacement over several frames that tells them apart, against the path length.
"""

from __future__ import annotations

import enum
import functools
from dataclasses import dataclass, field, replace

import numpy as np

from turbseg_ros.arrays import Matrix
from turbseg_ros.segmentation.registration import EgoMotionModel, Registration

# Frames over which a slew shows, and over which a slower motion shows to be steady.
_SLEW_SPAN, _STEADY_SPAN = 3, 12
# Displacement a frame, in widths of the picture: from the first on the camera moves, from the
# second on what lies within the window's reach has little in common.
_MOVES, _SLEWS = 0.001, 0.025
# Displacement from one frame to the next, in widths, that the shimmer of a picture at rest makes.
_STANDS = 0.005
# Frames in a row for which what is burnt into a picture may pass for a scene at rest.
_MAX_OUTVOTED = 30
# Displacement over path length, from which the motion is one on purpose.
_STEADY = 0.7
# Where points of the picture are asked for their path, in widths and heights.
_PLACES = np.array([[x, y] for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)])


class CameraState(enum.Enum):
    """What the camera does; the values are what is published."""

    STILL = "still"
    """It stands, whether or not it shakes."""
    FOLLOWING = "following"
    """It pans or zooms steadily, slowly enough for frames to be compared."""
    SLEWING = "slewing"
    """It moves too fast for that: nothing that goes with the scene becomes an object."""
    LOST = "lost"
    """Its motion can't be told: the frame has nothing to hold on to, or shows no scene."""


@dataclass(frozen=True)
class CameraTrack:
    """What is known of the camera's motion up to a frame of a stream.

    `state` and `model`, that of its registration to the frame before, are the frame's; `expected`
    takes its pixels to where the next frame should show them; `view` counts the slews that have
    ended: frames of two views aren't compared. `motions` are the latest, None where not known.
    For `outvoted` frames it has been taken to stand though most of the picture moved.
    """

    state: CameraState = CameraState.STILL
    model: EgoMotionModel = EgoMotionModel.NONE
    expected: Matrix = field(default_factory=lambda: np.eye(3))
    view: int = 0
    motions: tuple[Matrix | None, ...] = ()
    outvoted: int = 0

    @property
    def slews(self) -> bool:
        """Whether it moves too fast for frames to be compared."""
        return self.state is CameraState.SLEWING

    def has_stood(self, size: tuple[int, int]) -> bool:
        """Whether it stood in its latest frames, and hasn't been taken to for too long.

        :param size: the frames' width and height.
        """
        known = [motion for motion in self.motions if motion is not None]
        if len(known) <= _STEADY_SPAN // 2 or self.outvoted >= _MAX_OUTVOTED:
            return False
        places = _places(size)
        x, y, _ = (np.stack(known) @ places - places).swapaxes(0, 1)
        return bool((np.hypot(x, y).mean(axis=1) < _STANDS * size[0]).all())

    def lost(self) -> CameraTrack:
        """Return what is known in a frame that shows nothing."""
        return replace(self, state=CameraState.LOST, model=EgoMotionModel.NONE)

    def model_beside(self, measured: str) -> str:
        """Return what tells the camera's motion: the registration's model, if the poorer one.

        :param measured: the model by which motion is measured in registered frames.
        """
        rich = EgoMotionModel.NONE, EgoMotionModel.AFFINE
        return measured if self.model in rich else self.model.value

    def after(self, registration: Registration | None, size: tuple[int, int]) -> CameraTrack:
        """Return what is known one frame later.

        :param registration: of the frame before to that one; None where they have nothing in
            common.
        :param size: the frames' width and height.
        """
        known = registration is not None and registration.is_supported
        motion = registration.motion if registration is not None and known else None
        motions = (*self.motions, motion)[-_STEADY_SPAN:]
        moves = _state(motions, size)
        # Within a slew, one frame more or less that can't be told changes nothing.
        state = moves if known or moves is CameraState.SLEWING else CameraState.LOST
        outvoted = registration is not None and registration.outvoted
        ended = self.slews and state is not CameraState.SLEWING
        return CameraTrack(
            state=state,
            model=EgoMotionModel.NONE if registration is None else registration.model,
            expected=_expected(motions, moves),
            view=self.view + int(ended),
            # What it did in a slew tells nothing of what it does after it.
            motions=motions[-1:] if ended else motions,
            outvoted=self.outvoted + 1 if outvoted else 0,
        )


def _expected(motions: tuple[Matrix | None, ...], moves: CameraState) -> Matrix:
    """Return the motion that comes next: what was steady goes on, else nothing moves."""
    known = [motion for motion in motions if motion is not None]
    return np.eye(3) if moves is CameraState.STILL else known[-1]


def _state(motions: tuple[Matrix | None, ...], size: tuple[int, int]) -> CameraState:
    """Return what the camera does as its latest motions tell, those that are known."""
    displacement, ratio = _displacement(motions[-_SLEW_SPAN:], size)
    if displacement > _SLEWS * _SLEW_SPAN and ratio > _STEADY:
        return CameraState.SLEWING
    displacement, ratio = _displacement(motions, size)
    enough = sum(motion is not None for motion in motions) > _STEADY_SPAN // 2
    if enough and displacement > _MOVES * _STEADY_SPAN and ratio > _STEADY:
        return CameraState.FOLLOWING
    return CameraState.STILL


def _displacement(
    motions: tuple[Matrix | None, ...], size: tuple[int, int]
) -> tuple[float, float]:
    """Return how far points of the picture travel, in its widths, and that over their path length.

    Both are means over the picture, so that a zoom counts as well as a pan.
    """
    known = [motion for motion in motions if motion is not None]
    if not known:
        return 0.0, 0.0
    places = np.empty((len(known) + 1, 3, len(_PLACES)))
    places[0] = _places(size)
    for number, motion in enumerate(known):
        places[number + 1] = motion @ places[number]
    step, whole = places[1:, :2] - places[:-1, :2], places[-1, :2] - places[0, :2]
    path_length = np.hypot(step[:, 0], step[:, 1]).mean(axis=1).sum()
    displacement = float(np.hypot(*whole).mean())
    return displacement / size[0], displacement / max(float(path_length), 1e-9)


@functools.lru_cache(maxsize=8)
def _places(size: tuple[int, int]) -> Matrix:
    """Return points of the picture in pixels, 3xP (x, y, 1)."""
    return np.column_stack([_PLACES * size, np.ones(len(_PLACES))]).T
