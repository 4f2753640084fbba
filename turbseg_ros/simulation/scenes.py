"""The named scenes: what is where, how it moves, and through what air and camera it is seen."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from .camera import CameraMotion, Sensor
from .objects import Colour, Path, SceneObject
from .turbulence import Optics, Turbulence, fried_parameter


@dataclass(frozen=True)
class Scene:
    """Everything that a clip is rendered from, but the seed. Lengths are pixels of the image.

    `landscape` names a painter; objects are listed from the farthest to the nearest, and hide
    one another in that order.
    """

    name: str
    summary: str
    landscape: str
    turbulence: Turbulence
    objects: tuple[SceneObject, ...] = ()
    camera: CameraMotion = field(default_factory=CameraMotion)
    sensor: Sensor = field(default_factory=Sensor)
    width: int = 864
    height: int = 480
    frames: int = 75
    rate_hz: float = 30.0
    thermal: bool = False

    def with_tilt(self, tilt_px: float) -> Scene:
        """Return the scene in stronger or weaker turbulence: rms tilt an axis in its pixels."""
        return replace(self, turbulence=self.turbulence.with_tilt(tilt_px))


class UnknownSceneError(ValueError):
    """A scene was asked for that does not exist; the message names those that do."""


def scene(name: str, others: Sequence[str] = ()) -> Scene:
    """Return the scene of that name.

    :param others: further names that a caller has something for, and a user may have meant.
    :raises UnknownSceneError: when there is none.
    """
    if name in SCENES:
        return SCENES[name]
    names = [*SCENES, *others]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    raise UnknownSceneError(f"There is no scene '{name}'.{hint} Scenes: {', '.join(names)}.")


def _drive(x: float, y: float, velocity: float, frames: int = 75) -> Path:
    """Go straight along the picture's rows at a constant velocity in pixels a frame."""
    return Path(((0, x, y), (frames, x + velocity * frames, y)))


def _late(x: float, y: float, velocity: float, start: int, frames: int = 75) -> Path:
    """Wait out of sight until a frame, then drive on from there."""
    return Path(((start, x, y), (frames, x + velocity * (frames - start), y)))


_WHITE: Colour = (0.7, 0.71, 0.71)
_BLACK: Colour = (0.13, 0.12, 0.12)
_BLUE: Colour = (0.55, 0.3, 0.16)
_RED: Colour = (0.16, 0.15, 0.58)
_SILVER: Colour = (0.63, 0.62, 0.6)
_GREEN: Colour = (0.25, 0.36, 0.2)
_SAND: Colour = (0.42, 0.54, 0.6)

# Small scenes are those whose bags are kept with the code: grey, clean and 512 pixels wide.
_SMALL_SENSOR = Sensor("mono8", full_well=250_000, read_noise=20)
_HAZE = Turbulence.typical(0.5, 512)
_WIDE_HAZE = Turbulence.typical(0.7, 864)

# A compact camera at full zoom, 67 mm of aperture, looking along two kilometres of hot ground.
_SUPERZOOM = Optics(
    aperture=0.067,
    r0=fried_parameter(cn2=3e-15, path_length=2_000, wavelength=550e-9),
    ifov=13e-6,
    turbulence_distance=220,
)

_SMALL: tuple[Scene, ...] = (
    Scene(
        "normal",
        "a sedan and a van on a street, moderate turbulence",
        "town",
        _HAZE,
        (
            SceneObject(2, "van", 70, _drive(425, 169, -2.8), _WHITE),
            SceneObject(1, "sedan", 66, _drive(75, 197, 3.2), _BLACK),
        ),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=52,
    ),
    Scene(
        "severe",
        "a sedan and a truck through severe turbulence",
        "town",
        _HAZE.with_tilt(2.0),
        (
            SceneObject(2, "truck", 108, _drive(420, 169, -2.6), _RED),
            SceneObject(1, "sedan", 66, _drive(70, 197, 3.6), _BLACK),
        ),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=48,
    ),
    Scene(
        "shake",
        "a hand-held camera: the picture jumps by several pixels a frame",
        "town",
        _HAZE,
        (
            SceneObject(2, "pickup", 68, _drive(400, 169, -2.5), _RED),
            SceneObject(1, "person", 40, _drive(150, 219, 0.9)),
        ),
        CameraMotion(shake=5.0, roll=0.003),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=44,
    ),
    Scene(
        "empty",
        "a street in the heat with nobody on it: whatever is found is a false alarm",
        "town",
        _HAZE.with_tilt(0.9),
        camera=CameraMotion(shake=0.4),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=40,
    ),
    Scene(
        "thermal",
        "people and a pickup at dusk, seen by a 16-bit thermal camera",
        "town",
        Turbulence.typical(0.4, 384),
        (
            SceneObject(3, "person", 26, _drive(225, 110, -0.6)),
            SceneObject(2, "pickup", 51, _drive(68, 146, 1.8)),
            SceneObject(1, "person", 32, _drive(247, 165, 0.8)),
        ),
        sensor=Sensor("mono16", full_well=400_000, read_noise=200, lens_blur=0.9,
                      column_noise=0.002),
        width=384, height=216, frames=32, thermal=True,
    ),
)  # fmt: skip

_LARGE: tuple[Scene, ...] = (
    Scene(
        "superzoom",
        "a sedan and a walker, turbulence computed from aperture, range and Cn²",
        "town",
        Turbulence.from_optics(_SUPERZOOM),
        (
            SceneObject(1, "person", 50, _drive(560, 366, -1.1), _RED),
            SceneObject(2, "sedan", 104, _drive(90, 330, 4.1), _WHITE),
        ),
    ),
    Scene(
        "tiny",
        "objects of 8 to 14 pixels in open country",
        "fields",
        _WIDE_HAZE.with_tilt(0.5),
        (
            SceneObject(1, "bird", 8, Path(((0, 120, 60), (40, 300, 95), (75, 420, 70))), _BLACK),
            SceneObject(2, "drone", 12, Path(((0, 700, 150), (75, 560, 110))), _BLACK),
            SceneObject(3, "sedan", 14, _drive(760, 298, -1.8), _WHITE),
            SceneObject(4, "person", 12, _drive(300, 316, 0.5), _RED),
        ),
    ),
    Scene(
        "small",
        "a sedan, a van and walkers of 18 to 24 pixels' height, far down a country road",
        "fields",
        _WIDE_HAZE,
        (
            SceneObject(1, "van", 48, _drive(640, 300, -1.9), _WHITE),
            SceneObject(2, "sedan", 66, _drive(130, 314, 2.6), _RED),
            SceneObject(3, "person", 21, _drive(330, 330, 1.1), _BLACK),
            SceneObject(4, "person", 23, _drive(560, 334, -1.3), _BLUE),
        ),
    ),
    Scene(
        "slow",
        "people and a van that move by 0.2 to 0.5 pixels a frame",
        "town",
        _WIDE_HAZE.with_tilt(0.5),
        (
            SceneObject(1, "person", 40, _drive(250, 246, 0.2), _BLUE),
            SceneObject(2, "van", 110, _drive(610, 284, -0.5), _WHITE),
            SceneObject(3, "person", 56, _drive(420, 368, -0.4), _RED),
        ),
        frames=90,
    ),
    Scene(
        "strolling",
        "people and a pickup that move by 0.6 to 0.9 pixels a frame",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(1, "person", 42, _drive(620, 247, -0.6), _WHITE),
            SceneObject(2, "pickup", 104, _drive(180, 284, 0.9), _BLUE),
            SceneObject(3, "person", 60, _drive(520, 370, 0.75), _RED),
        ),
        frames=90,
    ),
    Scene(
        "handheld",
        "a camera in the hand: steps of 3 pixels rms a frame",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(1, "van", 112, _drive(690, 284, -3.2), _SILVER),
            SceneObject(2, "person", 58, _drive(260, 368, 1.3), _BLUE),
        ),
        CameraMotion(shake=3.0, roll=0.002),
    ),
    Scene(
        "pole",
        "a sedan and a walker pass behind a post, a pole and a tree trunk",
        "town_behind_poles",
        _WIDE_HAZE,
        (
            SceneObject(1, "sedan", 100, _drive(120, 330, 6.5), _BLACK),
            SceneObject(2, "person", 58, _drive(520, 368, -1.4), _RED),
        ),
    ),
    Scene(
        "crossing",
        "vehicles and people that pass before one another",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(1, "bus", 190, _drive(700, 284, -3.6), _GREEN),
            SceneObject(2, "sedan", 98, _drive(100, 328, 5.2), _SILVER),
            SceneObject(3, "person", 56, _drive(380, 366, 1.2), _BLUE),
            SceneObject(4, "person", 58, _drive(480, 370, -1.2), _RED),
        ),
    ),
    Scene(
        "stopping",
        "vehicles that brake, stand, start again and turn back",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(
                1, "truck", 180,
                Path(((0, 760, 284), (25, 610, 284), (38, 580, 284), (60, 580, 284),
                      (75, 530, 284), (90, 420, 284))), _BLUE,
            ),
            SceneObject(
                2, "sedan", 100,
                Path(((0, 80, 330), (30, 340, 330), (45, 380, 330), (55, 380, 330),
                      (90, 160, 330))), _WHITE,
            ),
        ),
        frames=90,
    ),
    Scene(
        "approaching",
        "a truck and a car that come down a road towards the camera, another that goes",
        "fields",
        _WIDE_HAZE,
        (
            SceneObject(
                1, "car_front", 40, Path(((0, 520, 268), (90, 505, 258)), ((0, 1.0), (90, 0.75))),
                _RED,
            ),
            SceneObject(
                2, "car_front", 44, Path(((0, 300, 262), (90, 290, 284)), ((0, 1.0), (90, 1.5))),
                _SILVER,
            ),
            SceneObject(
                3, "truck_front", 70,
                Path(((0, 420, 300), (90, 400, 330)), ((0, 1.0), (90, 1.3))), _BLUE,
            ),
        ),
        frames=90,
    ),
    Scene(
        "waiting",
        "a van waits for four seconds, a walker passes before it; a parked car drives off",
        "town",
        _HAZE,
        (
            SceneObject(
                1, "sedan", 60,
                Path(((0, 390, 169), (70, 390, 169), (85, 360, 169), (220, -180, 169))), _RED,
            ),
            SceneObject(
                2, "van", 76,
                Path(((0, 20, 197), (25, 140, 197), (38, 170, 197), (168, 170, 197),
                      (183, 200, 197), (220, 360, 197))), _WHITE,
            ),
            SceneObject(3, "person", 40, _drive(330, 219, -1.4, 220), _BLACK),
        ),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=220,
    ),
    Scene(
        "entering",
        "a walker, a van and a sedan that come into an empty street, one after the other",
        "town",
        _HAZE,
        (
            SceneObject(2, "van", 70, _late(550, 169, -2.8, 30), _WHITE),
            SceneObject(1, "sedan", 66, _late(-40, 197, 3.2, 42), _RED),
            SceneObject(3, "person", 40, _late(-12, 219, 1.1, 22), _BLUE),
        ),
        sensor=_SMALL_SENSOR, width=512, height=288, frames=70,
    ),
    Scene(
        "comeback",
        "a pickup and a bird that leave the picture and come back",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(
                1, "pickup", 104,
                Path(((0, 560, 330), (30, 900, 330), (38, 960, 330), (44, 960, 330),
                      (52, 900, 330), (90, 430, 330))), _RED,
            ),
            SceneObject(
                2, "bird", 26,
                Path(((0, 160, 120), (22, -50, 80), (34, -60, 70), (48, 20, 90), (90, 420, 60))),
                _BLACK,
            ),
        ),
        frames=90,
    ),
    Scene(
        "sky",
        "an airliner, a light aircraft and a drone over a plain sky",
        "open_sky",
        _WIDE_HAZE,
        (
            SceneObject(1, "airliner", 120, Path(((0, 90, 190), (75, 440, 110))), _WHITE),
            SceneObject(2, "light_aircraft", 56, _drive(800, 300, -4.5), _SILVER),
            SceneObject(3, "drone", 22, Path(((0, 560, 90), (75, 720, 120))), _BLACK),
        ),
    ),
    Scene(
        "helicopter",
        "a helicopter hovers, turns away and climbs; the camera shivers with an engine",
        "open_sky",
        _WIDE_HAZE,
        (
            SceneObject(
                1, "helicopter", 130,
                Path(((0, 330, 300), (20, 350, 292), (35, 352, 290), (75, 640, 170))), _GREEN,
            ),
        ),
        CameraMotion(vibration=1.2, shake=0.5),
    ),
    Scene(
        "sway",
        "trees, water and a flag in the wind, and nothing that goes anywhere",
        "lakeside",
        _WIDE_HAZE,
    ),
    Scene(
        "lake",
        "a walker and a drone before trees, water and a flag in the wind",
        "lakeside",
        _WIDE_HAZE,
        (
            SceneObject(1, "person", 46, _drive(250, 205, 1.6), _RED),
            SceneObject(2, "drone", 30, Path(((0, 760, 330), (75, 420, 300))), _BLACK),
        ),
    ),
    Scene(
        "pan",
        "the camera pans slowly after a sedan on a country road",
        "fields",
        _WIDE_HAZE,
        (
            SceneObject(1, "truck", 120, _drive(900, 296, -1.5), _WHITE),
            SceneObject(2, "sedan", 74, _drive(300, 312, 4.4), _RED),
        ),
        CameraMotion(pan=(2.5, 0.0), shake=0.6),
    ),
    Scene(
        "fast",
        "a bus and a sedan close by, up to 12 pixels a frame",
        "town",
        _WIDE_HAZE,
        (
            SceneObject(1, "bus", 200, _drive(870, 286, -8.0), _SAND),
            SceneObject(2, "sedan", 150, _drive(-60, 336, 12.0), _BLACK),
        ),
    ),
    Scene(
        "crowd",
        "a dozen people on two pavements and traffic between them",
        "town",
        _WIDE_HAZE,
        (
            *(
                SceneObject(index + 1, "person", 38 + index % 3, _drive(x, 247, velocity), paint)
                for index, (x, velocity, paint) in enumerate((
                    (110, 0.9, _RED), (230, -0.8, _WHITE), (390, 1.1, _BLACK),
                    (520, -1.0, _BLUE), (640, 0.7, _SAND), (760, -1.2, _GREEN),
                ))
            ),
            SceneObject(7, "van", 104, _drive(720, 284, -3.4), _SILVER),
            SceneObject(8, "sedan", 98, _drive(60, 330, 4.4), _RED),
            *(
                SceneObject(index + 9, "person", 56 + index % 4, _drive(x, y, velocity), paint)
                for index, (x, y, velocity, paint) in enumerate((
                    (140, 364, 1.3, _BLUE), (330, 366, -1.1, _BLACK), (480, 370, 1.5, _WHITE),
                    (620, 372, -1.4, _RED), (740, 372, -0.9, _SAND),
                ))
            ),
        ),
    ),
    Scene(
        "night",
        "a thermal camera on a mast: people and a truck, severe turbulence, vibration",
        "town",
        _WIDE_HAZE.with_tilt(1.8),
        (
            SceneObject(1, "person", 42, _drive(200, 247, 0.9)),
            SceneObject(2, "truck", 180, _drive(740, 286, -3.0)),
            SceneObject(3, "person", 60, _drive(560, 370, -1.3)),
        ),
        CameraMotion(vibration=0.6),
        Sensor("mono16", full_well=30_000, read_noise=90, lens_blur=1.1, column_noise=0.003),
        thermal=True,
    ),
)  # fmt: skip

SCENES: dict[str, Scene] = {entry.name: entry for entry in _SMALL + _LARGE}
"""All scenes by name."""
