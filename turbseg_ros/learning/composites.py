"""Composites, to train on: real movers before real scenery, through drawn air and cameras.

Some clips show a footage as it is, with its own movers; others put cut-outs and drawn objects
before a picture or a video, in which leaves, water, smoke and light stir that are no objects. Nor
are the shadows that movers cast, and the dust that they raise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from turbseg_ros.arrays import Image, Labels, Matrix
from turbseg_ros.learning.random_scenes import log_uniform, random_camera, random_object
from turbseg_ros.segmentation.frame import Frame
from turbseg_ros.simulation.camera import Sensor
from turbseg_ros.simulation.companions import Plume, Sun, random_plume, random_sun
from turbseg_ros.simulation.footage import Crop, Cutout, CutoutLook, Footage
from turbseg_ros.simulation.objects import KINDS, Path, PlacedSprite, Pose, Sprite
from turbseg_ros.simulation.render import FIRST_STAMP_NS
from turbseg_ros.simulation.stirring import Stir, random_stir
from turbseg_ros.simulation.textures import fractal_noise
from turbseg_ros.simulation.transmission import random_transmission
from turbseg_ros.simulation.turbulence import BlurField, Field, TiltField, Turbulence, blur, warp

_SHAPES = ((180, 320), (240, 320), (216, 384), (288, 384), (256, 320), (270, 480), (360, 640))
_SHAPE_ODDS = (0.2, 0.2, 0.2, 0.1, 0.1, 0.15, 0.05)
# Clips that show a footage with its own movers as they are, and those without any mover.
_AS_IT_IS = 0.4
_EMPTY = 0.12
_DRAWN_OBJECT = 0.25
_MAX_OBJECTS = 4
# Sizes in pixels, and ways a frame as fractions of the width; rms tilt in pixels of 432 columns.
_SIZES = 6.0, 200.0
_SPEEDS = 0.0006, 0.02
_TILTS = 0.05, 2.0
_CALM = 0.15
# Clips in sunlight, and movers that raise dust or spray.
_SUNNY, _DUSTY = 0.6, 0.2
_THERMAL = 0.25
_RATE_HZ = 30.0
# Pixels composed beyond the frame, which the tilt draws in.
_MARGIN = 16
# Footage must have so many frames to be shown as it is.
_FEWEST = 8
# Tells these random numbers from those of drawn scenes.
_PURPOSE = 77


@dataclass(frozen=True)
class Material:
    """What composites are made of.

    `backgrounds` are pictures and videos in which nothing counts as an object; `objects` have
    masks.
    """

    backgrounds: Sequence[Footage]
    objects: Sequence[Footage]


class _Scenery(Protocol):
    def at(self, frame: int) -> tuple[Field, Field | None]:
        """Return the painting, float32 HxWx3 from 0 to 1, and the coverage of its movers."""


class _Actor(Protocol):
    """What moves: where its foot is in the scene, frame by frame, and its size, in pixels."""

    positions: Matrix
    size: float

    def place(self, frame: int, to_picture: Matrix, behind: Field) -> list[PlacedSprite]:
        """Return itself as placed in a picture, then what is drawn with it but not it."""


@dataclass(frozen=True)
class _Composite:
    picture: Field
    coverages: list[Field]


def composite_clip(seed: int, frames: int, material: Material) -> Iterator[tuple[Frame, Labels]]:
    """Return a clip drawn at random, with its labels; the same for the same seed and material.

    Frames are HxW or HxWx3, uint8 or uint16, no wider than 640 pixels; there are fewer than asked
    for where the footage that is shown has fewer.

    :raises ValueError: when the material has neither backgrounds nor objects.
    """
    if not (material.backgrounds or material.objects):
        raise ValueError("there are neither backgrounds nor objects to make composites of")
    rng = np.random.default_rng([_PURPOSE, seed])
    shape = _SHAPES[int(rng.choice(len(_SHAPES), p=_SHAPE_ODDS))]
    stage = _Stage(shape, frames, material, rng)
    width = shape[1]
    tilt_px = 0.02 if rng.random() < _CALM else log_uniform(rng, *_TILTS)
    turbulence = Turbulence.typical(tilt_px * width / 432, width)
    tilts, blurs = TiltField(shape, turbulence, rng), BlurField(shape, turbulence, rng)
    sensor = _random_sensor(rng, stage.thermal)
    pattern = sensor.pattern(width, rng)
    receiver = random_transmission(rng).receiver()
    darkest, range_ = _random_contrast(rng)
    for number in range(stage.frames):
        composite = stage.composite(number)
        tilt = tilts.next()
        seen = warp(composite.picture, tilt, _MARGIN)
        seen = blur(cv2.GaussianBlur(seen, (0, 0), sensor.lens_blur), blurs.next())
        image: Image = sensor.expose(darkest + range_ * seen, pattern, rng)
        if image.dtype == np.uint8:
            image = receiver.received(image, number)
        labels = np.zeros(shape, np.uint16)
        for identity, coverage in enumerate(composite.coverages, start=1):
            labels[warp(coverage, tilt, _MARGIN, cv2.INTER_LINEAR) > 0.5] = identity
        yield Frame(FIRST_STAMP_NS + round(number * 1e9 / _RATE_HZ), image), labels


class _Stage:
    """Scenery, actors and camera of a composite, before the air comes in."""

    def __init__(
        self, shape: tuple[int, int], frames: int, material: Material, rng: np.random.Generator
    ) -> None:
        self._shape = shape
        height, width = shape
        shown = _footage_with(material.objects, _FEWEST, rng)
        as_it_is = shown is not None and rng.random() < _AS_IT_IS
        self.thermal = bool(rng.random() < _THERMAL)
        # A footage that is shown as it is has a camera of its own.
        camera = random_camera(rng, width)
        trajectory = camera.trajectory(frames, (width / 2, height / 2), rng)
        if as_it_is and rng.random() < 0.7:
            trajectory = np.repeat(np.eye(2, 3)[None], frames, axis=0)
        self._to_frame = trajectory
        corners = np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]])
        reach = np.abs(trajectory @ corners - corners[:2]).max(axis=(0, 2))
        self._beyond = tuple(math.ceil(each) + _MARGIN + 2 for each in reach)
        painted = height + 2 * self._beyond[1], width + 2 * self._beyond[0]
        self._scenery: _Scenery
        if as_it_is and shown is not None:
            self._scenery = _Shown(shown, painted, frames, rng)
            self.frames = self._scenery.frames
        else:
            self._scenery = _still(material, painted, rng)
            self.frames = frames
        odds = 0.35 if as_it_is else 0.6
        self._stirs: list[Stir] = []
        while rng.random() < odds and len(self._stirs) < 3:
            self._stirs.append(random_stir(painted, rng))
        count = 0 if rng.random() < _EMPTY else int(rng.integers(1, _MAX_OBJECTS + 1))
        if as_it_is and rng.random() < 0.6:
            count = 0
        sun = random_sun(rng) if not self.thermal and rng.random() < _SUNNY else None
        self._actors = [
            _accompanied(self._actor(number, material, rng), sun, rng) for number in range(count)
        ]
        self._screen = _random_screen(painted, rng) if rng.random() < 0.2 else None
        self._is_grey_inverted = self.thermal and rng.random() < 0.4

    def _actor(self, number: int, material: Material, rng: np.random.Generator) -> _Actor:
        height, width = self._shape
        footage = _footage_with(material.objects, 1, rng)
        if footage is not None and rng.random() > _DRAWN_OBJECT:
            cutout = _random_cutout(footage, self._shape, self.frames, self.thermal, rng)
            if cutout is not None:
                path = _random_path(rng, width, height, self.frames)
                pitch = float(rng.normal(0, 0.08))
                return _CutoutActor(cutout, path.positions(self.frames), pitch, rng.random() < 0.5)
        return _DrawnActor(number, self._shape, self.frames, self.thermal, rng)

    def composite(self, frame: int) -> _Composite:
        """Return what there is at a frame, larger than that by `_MARGIN` on every side."""
        painting, movers = self._scenery.at(frame)
        for stir in self._stirs:
            painting = stir.at(painting, frame)
        to_picture = self._to_frame[frame] + np.array([[0, 0, _MARGIN], [0, 0, _MARGIN]])
        picture = self._projected(painting, to_picture)
        scenery = picture.copy() if self._screen is not None else picture
        coverages = [] if movers is None else [self._projected(movers, to_picture)]
        for actor in self._actors:
            drawn = actor.place(frame, to_picture, picture)
            for placed in reversed(drawn):
                placed.lay_over(picture)
            if drawn:
                coverages.append(_coverage(drawn[0], picture.shape[:2]))
        if self._screen is not None:
            screen = self._projected(self._screen, to_picture)
            picture += screen[..., None] * (scenery - picture)
            coverages = [each * (1 - screen) for each in coverages]
        if self._is_grey_inverted:
            picture = 1 - picture
        return _Composite(np.clip(picture, 0, 1), coverages)

    def _projected(self, painting: Field, to_picture: Matrix) -> Field:
        to_painting = np.array([[1, 0, self._beyond[0]], [0, 1, self._beyond[1]], [0, 0, 1]])
        matrix = (np.vstack((to_picture, [0, 0, 1])) @ np.linalg.inv(to_painting))[:2]
        height, width = self._shape
        size = (width + 2 * _MARGIN, height + 2 * _MARGIN)
        return np.asarray(
            cv2.warpAffine(
                painting, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
            )
        )


@dataclass(frozen=True)
class _Still:
    painting: Field

    def at(self, frame: int) -> tuple[Field, Field | None]:
        return self.painting, None


class _Shown:
    """A footage as it is, with its own movers and its own camera."""

    def __init__(
        self, footage: Footage, shape: tuple[int, int], frames: int, rng: np.random.Generator
    ) -> None:
        step = 2 if footage.length >= 2 * frames and rng.random() < 0.3 else 1
        wanted = min(footage.length, frames * step)
        first = int(rng.integers(0, footage.length - wanted + 1))
        self._pictures = footage.pictures(first, wanted)[::step]
        self._masks = (footage.masks(first, wanted) or [])[::step]
        if rng.random() < 0.3:
            self._pictures, self._masks = self._pictures[::-1], self._masks[::-1]
        self._crop = Crop.drawn(self._pictures[0].shape, shape, least=0.4, rng=rng)
        self.frames = len(self._pictures)

    def at(self, frame: int) -> tuple[Field, Field | None]:
        painting: Field = np.clip(self._crop.of(self._pictures[frame]) / 255, 0, 1)
        movers = self._crop.of(self._masks[frame].astype(np.float32)) if self._masks else None
        return painting, movers


class _CutoutActor:
    def __init__(self, cutout: Cutout, positions: Matrix, pitch: float, mirrored: bool) -> None:
        self.positions = positions
        self.size = cutout.size
        self._cutout = cutout
        self._pitch = pitch
        self._mirrored = mirrored

    def place(self, frame: int, to_picture: Matrix, behind: Field) -> list[PlacedSprite]:
        x, y = self.positions[frame]
        pose = Pose(float(x), float(y), self._pitch, self._mirrored)
        return self._cutout.place(frame, pose, to_picture, behind.mean(axis=(0, 1)))


class _DrawnActor:
    def __init__(
        self,
        number: int,
        shape: tuple[int, int],
        frames: int,
        thermal: bool,
        rng: np.random.Generator,
    ) -> None:
        height, width = shape
        drawn = random_object(rng, number + 1, width, height, frames)
        self.positions = drawn.path.positions(frames)
        self.size = drawn.size
        self._kind = KINDS[drawn.kind]
        self._mirrored = bool(self.positions[-1, 0] < self.positions[0, 0])
        self._sprite = Sprite(drawn, thermal, rng)

    def place(self, frame: int, to_picture: Matrix, behind: Field) -> list[PlacedSprite]:
        x, y = self.positions[frame]
        phase = (frame / self._kind.cycle_frames) % 1.0
        pose = Pose(float(x), float(y), mirrored=self._mirrored)
        return [self._sprite.place(phase, pose, to_picture)]


@dataclass(frozen=True)
class _Accompanied:
    """An actor with its shadow, and with the dust that it raises, if there are any."""

    actor: _Actor
    sun: Sun | None
    plume: Plume | None

    def place(self, frame: int, to_picture: Matrix, behind: Field) -> list[PlacedSprite]:
        drawn = self.actor.place(frame, to_picture, behind)
        if not drawn:
            return []
        shadow = self.sun.shadow_of(drawn[0]) if self.sun is not None else None
        if self.plume is not None:
            drawn.append(self.plume.at(frame, to_picture, (behind.shape[0], behind.shape[1])))
        return drawn if shadow is None else [*drawn, shadow]


def _accompanied(actor: _Actor, sun: Sun | None, rng: np.random.Generator) -> _Accompanied:
    is_dusty = rng.random() < _DUSTY
    plume = Plume(actor.positions, actor.size, random_plume(rng), rng) if is_dusty else None
    return _Accompanied(actor, sun, plume)


def _footage_with(
    footage: Sequence[Footage], length: int, rng: np.random.Generator
) -> Footage | None:
    """Choose among what is long enough; None if nothing is."""
    enough = [each for each in footage if each.length >= length]
    return enough[int(rng.integers(len(enough)))] if enough else None


def _still(material: Material, shape: tuple[int, int], rng: np.random.Generator) -> _Still:
    """Draw a picture of something that stands still: in a frame of a video, too, all does."""
    sources = [*material.backgrounds, *material.objects]
    if rng.random() < 0.15:
        return _Still(_random_sky(shape, rng))
    footage = sources[int(rng.integers(len(sources)))]
    (picture,) = footage.pictures(int(rng.integers(footage.length)), 1)
    crop = Crop.drawn(picture.shape, shape, least=0.25, rng=rng)
    return _Still(np.clip(crop.of(picture) / 255, 0, 1))


def _random_sky(shape: tuple[int, int], rng: np.random.Generator) -> Field:
    """Draw a plain sky, or a cloudy one."""
    top, bottom = rng.uniform(0.3, 0.95, (2, 1, 3))
    down = np.linspace(0, 1, shape[0])[:, None, None]
    clouds = fractal_noise(shape, rng, exponent=rng.uniform(1.2, 2.0))
    cloudy = rng.uniform(0.0, 0.1) * clouds[..., None]
    return np.asarray(np.clip(top + (bottom - top) * down + cloudy, 0, 1), np.float32)


def _random_screen(shape: tuple[int, int], rng: np.random.Generator) -> Field:
    """Draw poles before the objects, HxW: strips in which the scenery itself is in front."""
    screen = np.zeros(shape, np.float32)
    for _ in range(rng.integers(1, 4)):
        left = int(rng.integers(shape[1]))
        screen[:, left : left + int(rng.integers(2, max(shape[1] // 16, 3)))] = 1.0
    return screen


def _random_cutout(
    footage: Footage,
    shape: tuple[int, int],
    frames: int,
    thermal: bool,
    rng: np.random.Generator,
) -> Cutout | None:
    """Cut something out of a footage; None where its frames show nothing to cut out."""
    wanted = min(frames, footage.length)
    first = int(rng.integers(0, footage.length - wanted + 1))
    size = min(log_uniform(rng, *_SIZES), 0.6 * shape[0])
    brightness, tints = rng.uniform(0.5, 1.5), rng.normal(1.0, 0.1, 3)
    sunk = float(rng.uniform(0.1, 0.5)) if rng.random() < 0.15 else 0.0
    look = CutoutLook(
        gain=tuple((brightness * tints).tolist()),
        inverted=bool(rng.random() < (0.5 if thermal else 0.1)),
        haze=float(rng.uniform(0.0, 0.8)) if rng.random() < 0.4 else 0.0,
        sunk=sunk,
        mirage=float(rng.uniform(0.3, 0.9)) if sunk and rng.random() < 0.6 else 0.0,
        growth=float(rng.normal(1.0, 0.01)) if rng.random() < 0.5 else 1.0,
    )
    masks = footage.masks(first, wanted) or []
    try:
        return Cutout(footage.pictures(first, wanted), masks, size, look)
    except ValueError:
        return None


def _random_path(rng: np.random.Generator, width: int, height: int, frames: int) -> Path:
    speed = log_uniform(rng, *_SPEEDS) * width
    angle = rng.normal(0.0, 0.4) + math.pi * rng.integers(0, 2)
    middle = np.array([rng.uniform(0.1, 0.9) * width, rng.uniform(0.2, 0.95) * height])
    way = speed * frames * np.array([math.cos(angle), math.sin(angle)])
    last = 0.0 if rng.random() < 0.15 else 0.5
    stations = ((0, -0.5), (frames / 2, 0.0), (frames, last))
    return Path(tuple((float(t), *(middle + share * way).tolist()) for t, share in stations))


def _random_sensor(rng: np.random.Generator, thermal: bool) -> Sensor:
    full_well = log_uniform(rng, 2_000, 300_000)
    encoding = str(rng.choice(["mono8", "mono16"] if thermal else ["bgr8", "bgr8", "mono8"]))
    return Sensor(
        encoding,
        full_well=full_well,
        read_noise=full_well * 5e-4,
        lens_blur=float(rng.uniform(0.3, 1.3)),
        column_noise=0.002 if thermal else 0.0,
    )


def _random_contrast(rng: np.random.Generator) -> tuple[float, float]:
    """Draw the darkest value of a picture, and the range from that to the brightest; 0 to 1."""
    range_ = float(rng.uniform(0.7, 1.0) if rng.random() < 0.6 else rng.uniform(0.2, 0.7))
    return float(rng.uniform(0.0, 1.0 - range_)), range_


def _coverage(placed: PlacedSprite, shape: tuple[int, ...]) -> Field:
    coverage = np.zeros(shape, np.float32)
    inside = placed.clip(shape)
    if inside is not None:
        region, layer = inside
        coverage[region] = layer.coverage
    return coverage
