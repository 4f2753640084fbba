"""Renders a scene, frame by frame, with exact truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from turbseg_ros.arrays import Labels

from .landscape import DAYLIGHT, THERMAL, Backdrop, Extent
from .objects import KINDS, PlacedSprite, Pose, SceneObject, Sprite
from .painters import PAINTERS
from .scenes import Scene
from .turbulence import BlurField, TiltField, blur, warp

Field = npt.NDArray[np.float32]
FIRST_STAMP_NS = 1_000_000_000
"""Zero would mean "no time" to some readers of ROS bags."""

_MARGIN = 24
"""Pixels composed beyond the frame, which the tilt draws in. It is the same for every strength of
turbulence, so that a seed's landscape is too."""

_MAX_PITCH = 0.3
"""Radians by which a flying object's nose follows its path at most."""


class _Purpose(IntEnum):
    """What random numbers are for: each has its own, so that one change leaves the rest alone."""

    LANDSCAPE = 0
    OBJECT = 1
    CAMERA = 2
    TILT = 3
    BLUR = 4
    SENSOR = 5


def _rng(seed: int, purpose: _Purpose, index: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, purpose, index])


@dataclass(frozen=True)
class RenderedFrame:
    """One frame of a clip with its truth.

    `image` is as the scene's sensor delivers it; `labels` is uint16 HxW, 0 background and k the
    object with id k, which an object keeps through the clip, also while it stands still;
    `tilt_px` is float32 HxWx2 (x, y): the frame and its truth show the undistorted scene at
    p + tilt(p).
    """

    stamp_ns: int
    image: npt.NDArray[Any]
    labels: Labels
    tilt_px: Field


def render(scene: Scene, seed: int = 0) -> Iterator[RenderedFrame]:
    """Render the frames of a scene, in order; the same for the same seed.

    The composite of landscape and objects, and the outline of every object, are warped by one
    tilt field; then the picture alone is blurred and sensed.
    """
    stage = _Stage(scene, seed)
    shape = (scene.height, scene.width)
    tilts = TiltField(shape, scene.turbulence, _rng(seed, _Purpose.TILT))
    blurs = BlurField(shape, scene.turbulence, _rng(seed, _Purpose.BLUR))
    sensor_rng = _rng(seed, _Purpose.SENSOR)
    pattern = scene.sensor.pattern(scene.width, sensor_rng)
    for index in range(scene.frames):
        composite = stage.composite(index)
        tilt = tilts.next()
        seen = warp(composite.picture, tilt, _MARGIN)
        seen = blur(cv2.GaussianBlur(seen, (0, 0), scene.sensor.lens_blur), blurs.next())
        yield RenderedFrame(
            stamp_ns=FIRST_STAMP_NS + round(index * 1e9 / scene.rate_hz),
            image=scene.sensor.expose(seen, pattern, sensor_rng),
            labels=_warped_labels(composite, tilt),
            tilt_px=tilt,
        )


@dataclass(frozen=True)
class _Composite:
    """The undistorted scene, larger than the frame by `_MARGIN` on every side.

    `outlines` are the objects' placed sprites, farthest first; `screen` is the coverage of what
    stands before all of them.
    """

    picture: Field
    outlines: tuple[tuple[int, PlacedSprite], ...]
    screen: Field | None


class _Stage:
    """Landscape, objects and camera of a scene, before the air comes in."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._scene = scene
        centre = (scene.width / 2, scene.height / 2)
        self._to_frame = scene.camera.trajectory(scene.frames, centre, _rng(seed, _Purpose.CAMERA))
        extent = _extent(scene, self._to_frame)
        self._to_painting = np.array([[1, 0, extent.margin_x], [0, 1, extent.margin_y], [0, 0, 1]])
        palette = THERMAL if scene.thermal else DAYLIGHT
        self._backdrop: Backdrop = PAINTERS[scene.landscape](
            extent, palette, _rng(seed, _Purpose.LANDSCAPE)
        )
        self._actors = [
            _Actor(each, scene, _rng(seed, _Purpose.OBJECT, each.id)) for each in scene.objects
        ]

    def composite(self, index: int) -> _Composite:
        """Return the scene as it stands at a frame."""
        to_picture = self._to_frame[index] + np.array([[0, 0, _MARGIN], [0, 0, _MARGIN]])
        picture = self._project(self._backdrop.at(index), to_picture)
        outlines = []
        for actor in self._actors:
            placed = actor.place(index, to_picture)
            placed.lay_over(picture)
            outlines.append((actor.id, placed))
        screen = None
        foreground = self._backdrop.foreground
        if foreground is not None:
            screen = self._project(foreground.coverage, to_picture)
            veiled = picture * (1 - screen[..., None])
            picture = veiled + self._project(foreground.colour, to_picture)
        return _Composite(picture, tuple(outlines), screen)

    def _project(self, painting: Field, to_picture: npt.NDArray[np.float64]) -> Field:
        to_picture = np.vstack((to_picture, [0, 0, 1])) @ np.linalg.inv(self._to_painting)
        size = (self._scene.width + 2 * _MARGIN, self._scene.height + 2 * _MARGIN)
        return cv2.warpAffine(
            painting, to_picture[:2], size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )


class _Actor:
    """One object of a scene with its sprite and its way."""

    def __init__(self, actor: SceneObject, scene: Scene, rng: np.random.Generator) -> None:
        self.id = actor.id
        self._kind = KINDS[actor.kind]
        self._sprite = Sprite(actor, scene.thermal, rng)
        self._positions = actor.path.positions(scene.frames)
        self._scales = actor.path.scale_factors(scene.frames)
        self._velocities = np.gradient(self._positions, axis=0) if scene.frames > 1 else None
        self._offset = float(rng.random())

    def place(self, index: int, to_picture: npt.NDArray[np.float64]) -> PlacedSprite:
        x, y = self._positions[index]
        backward, pitch = self._heading(index)
        phase = (index / self._kind.cycle_frames + self._offset) % 1.0
        scale = float(self._scales[index])
        pose = Pose(float(x), float(y), pitch, backward, scale)
        return self._sprite.place(phase, pose, to_picture)

    def _heading(self, index: int) -> tuple[bool, float]:
        """Whether it faces left, and its pitch: as it last moved."""
        if self._velocities is None:
            return False, 0.0
        past = self._velocities[: index + 1]
        moving = np.nonzero(np.abs(past[:, 0]) > 0.02)[0]
        if not len(moving):
            moving = np.nonzero(np.abs(self._velocities[:, 0]) > 0.02)[0][:1]
        if not len(moving):
            return False, 0.0
        dx, dy = self._velocities[moving[-1]]
        if self._kind.footprint:
            return bool(dx < 0), 0.0
        climb = math.atan2(dy * np.sign(dx), abs(dx))
        return bool(dx < 0), min(max(climb, -_MAX_PITCH), _MAX_PITCH)


def _extent(scene: Scene, to_frame: npt.NDArray[np.float64]) -> Extent:
    """Return what the camera gets to see of the scene in the whole clip."""
    width, height = scene.width, scene.height
    corners = np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]])
    moved = np.abs(to_frame @ corners - corners[:2]).max(axis=(0, 2))
    margin_x, margin_y = (math.ceil(reach) + _MARGIN + 2 for reach in moved)
    return Extent(width, height, margin_x, margin_y)


def _warped_labels(composite: _Composite, tilt: Field) -> Labels:
    """Each object where the warped outline covers half a pixel, nearer ones over farther."""
    shape = composite.picture.shape[:2]
    labels = np.zeros(tilt.shape[:2], np.uint16)
    for identity, placed in composite.outlines:
        inside = placed.clip(shape)
        if inside is None:
            continue
        region, layer = inside
        coverage = np.zeros(shape, np.float32)
        coverage[region] = layer.coverage
        labels[warp(coverage, tilt, _MARGIN, cv2.INTER_LINEAR) > 0.5] = identity
    if composite.screen is not None:
        labels[warp(composite.screen, tilt, _MARGIN, cv2.INTER_LINEAR) > 0.5] = 0
    return labels
