"""Scenes drawn at random of what comes towards the camera, or goes: hardly any way, all growth."""

from __future__ import annotations

import numpy as np

from .camera import CameraMotion
from .objects import Path, SceneObject
from .scenes import Scene
from .turbulence import Turbulence

ONCOMING = "oncoming"
"""The name of these scenes."""

_FRAMES = 90
_WIDTH = 864
_LANDSCAPES = "town", "fields", "lakeside"
_TILTS = 0.3, 0.7, 1.2, 1.8
_VEHICLES = "car_front", "truck_front"


def oncoming_scene(seed: int) -> Scene:
    """Return a scene of one to three cars, trucks or people that grow or shrink in three seconds.

    Landscape, tilt (0.3 to 1.8 pixels) and whether the camera shakes follow from the seed in turn;
    the objects are drawn: 26 to 90 pixels long, up to 1.6 times as long in the end, or down to
    0.65 times.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    columns = np.linspace(150, 720, count + 2)[1:-1] + rng.uniform(-40, 40, count)
    objects = tuple(
        _oncoming_object(rng, number, float(x), alone=count == 1)
        for number, x in enumerate(columns, start=1)
    )
    return Scene(
        name=ONCOMING,
        summary="vehicles and people drawn at random that come or go, another scene for each seed",
        landscape=_LANDSCAPES[seed % len(_LANDSCAPES)],
        turbulence=Turbulence.typical(_TILTS[seed % len(_TILTS)], _WIDTH),
        objects=objects,
        camera=CameraMotion(shake=0.5 if seed % 2 else 0.0),
        width=_WIDTH,
        frames=_FRAMES,
    )


def _oncoming_object(rng: np.random.Generator, number: int, x: float, alone: bool) -> SceneObject:
    kind = str(rng.choice(_VEHICLES if alone else (*_VEHICLES, "person")))
    length = float(rng.uniform(40, 90) if kind == "person" else rng.uniform(26, 80))
    comes = rng.random() < 0.7
    scale = float(rng.uniform(1.15, 1.6) if comes else rng.uniform(0.65, 0.88))
    y = float(rng.uniform(260, 330))
    end = x + float(rng.uniform(-12, 12)), y + (scale - 1.0) * float(rng.uniform(30, 90))
    blue, green, red = (float(value) for value in rng.uniform(0.1, 0.75, 3))
    path = Path(((0, x, y), (_FRAMES, *end)), ((0, 1.0), (_FRAMES, scale)))
    return SceneObject(number, kind, length, path, (blue, green, red))
