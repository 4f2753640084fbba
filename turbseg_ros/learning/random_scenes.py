"""Scenes drawn at random, to train on: none is like another, and none is a named one."""

from __future__ import annotations

import math

import numpy as np

from turbseg_ros.simulation.camera import CameraMotion, Sensor
from turbseg_ros.simulation.objects import KINDS, Colour, Path, SceneObject
from turbseg_ros.simulation.painters import PAINTERS
from turbseg_ros.simulation.scenes import Scene
from turbseg_ros.simulation.turbulence import Turbulence

_WIDTHS = (384, 432, 512, 640, 864)
_WIDTH_ODDS = (0.25, 0.25, 0.25, 0.15, 0.1)
_MAX_OBJECTS = 4
# Sizes of objects and lengths of their ways a frame, as fractions of the width; rms tilt in
# pixels of a picture 432 wide.
_SIZES = 0.018, 0.4
_MAX_PERSON = 0.25
_SPEEDS = 0.0006, 0.02
_TILTS = 0.08, 2.0
_EMPTY = 0.08
# Landscapes and objects that are like nothing known, lest the network learn how ours look.
_COLLAGE = 0.4
_PATCHWORK = 0.4
_THERMAL = 0.2


def random_scene(rng: np.random.Generator, frames: int) -> Scene:
    """Draw a scene: any landscape, objects, air and camera, in likely proportions."""
    width = int(rng.choice(_WIDTHS, p=_WIDTH_ODDS))
    height = width * 9 // 16 // 2 * 2
    thermal = bool(rng.random() < _THERMAL)
    count = 0 if rng.random() < _EMPTY else int(rng.integers(1, _MAX_OBJECTS + 1))
    return Scene(
        name="random",
        summary="drawn at random",
        landscape="collage" if rng.random() < _COLLAGE else str(rng.choice(list(PAINTERS))),
        turbulence=Turbulence.typical(log_uniform(rng, *_TILTS) * width / 432, width),
        objects=tuple(
            random_object(rng, number, width, height, frames) for number in range(1, count + 1)
        ),
        camera=random_camera(rng, width),
        sensor=_random_sensor(rng, thermal),
        width=width,
        height=height,
        frames=frames,
        thermal=thermal,
    )


def random_object(
    rng: np.random.Generator, number: int, width: int, height: int, frames: int
) -> SceneObject:
    """Draw an object of any kind, and its way through a picture of a size within some frames."""
    kind = "patchwork" if rng.random() < _PATCHWORK else str(rng.choice(list(KINDS)))
    size = log_uniform(rng, *_SIZES) * width
    if kind == "person":
        size = min(size, _MAX_PERSON * width)
    level = bool(KINDS[kind].footprint)
    speed = log_uniform(rng, *_SPEEDS) * width
    angle = rng.normal(0.0, 0.05 if level else 0.5) + math.pi * rng.integers(0, 2)
    middle = np.array([rng.uniform(0.1, 0.9) * width, rng.uniform(0.2, 0.95) * height])
    way = speed * frames * np.array([math.cos(angle), math.sin(angle)])
    # Some brake to a stop halfway.
    last = 0.0 if rng.random() < 0.15 else 0.5
    stations = ((0, -0.5), (frames / 2, 0.0), (frames, last))
    waypoints = tuple(
        (float(frame), float(middle[0] + share * way[0]), float(middle[1] + share * way[1]))
        for frame, share in stations
    )
    return SceneObject(number, kind, size, Path(waypoints), _random_paint(rng))


def _random_paint(rng: np.random.Generator) -> Colour:
    brightness = rng.uniform(0.08, 0.8)
    blue, green, red = np.clip(brightness * rng.normal(1.0, 0.25, 3), 0.03, 0.95)
    return float(blue), float(green), float(red)


def random_camera(rng: np.random.Generator, width: int) -> CameraMotion:
    """Draw how a camera moves whose picture has a width."""
    scale = width / 864
    motion = rng.choice(["still", "shaking", "panning", "vibrating"], p=[0.4, 0.3, 0.2, 0.1])
    if motion == "shaking":
        return CameraMotion(shake=log_uniform(rng, 0.3, 6.0) * scale, roll=rng.uniform(0, 0.003))
    if motion == "panning":
        pan = float(rng.uniform(-3, 3) * scale), float(rng.uniform(-0.5, 0.5) * scale)
        return CameraMotion(pan=pan, shake=0.5 * scale)
    if motion == "vibrating":
        return CameraMotion(vibration=rng.uniform(0.3, 1.5) * scale)
    return CameraMotion()


def _random_sensor(rng: np.random.Generator, thermal: bool) -> Sensor:
    full_well = log_uniform(rng, 3_000, 300_000)
    encoding = "mono16" if thermal else str(rng.choice(["bgr8", "mono8"]))
    return Sensor(
        encoding,
        full_well=full_well,
        read_noise=full_well * 5e-4,
        lens_blur=rng.uniform(0.4, 1.3),
        column_noise=0.002 if thermal else 0.0,
    )


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is as likely to be anywhere between those of two others."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))
