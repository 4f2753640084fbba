"""What moves: silhouettes of vehicles, people and aircraft, and the paths they take.

A shape is drawn from polygons in a frame of its own: x from the tail (0) to the nose (1), y
upwards from the ground, both in units of the object's length (of its height for people).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

from turbseg_ros.arrays import Matrix

Colour = tuple[float, float, float]
"""Blue, green, red, 0 to 1."""
Points = tuple[tuple[float, float], ...]

_DRAWING_SIZE = 600
"""Fine pixels along an object, within the limits of supersampling: OpenCV's polygons come out
half a fine pixel too wide, which matters most to small objects."""
_SUPERSAMPLING_LIMITS = (4, 12)


@dataclass(frozen=True)
class Part:
    """A polygon of one colour; `warmth` (0 to 1) is its brightness to a thermal camera."""

    points: Points
    colour: Colour
    warmth: float


Shape = Callable[[float, Colour], list[Part]]
"""Draws the parts, rear to front, at a phase (0 to 1) of its gait and in a paint."""


def _ellipse(x: float, y: float, rx: float, ry: float, tilt: float = 0.0) -> Points:
    angles = np.linspace(0, 2 * math.pi, 28, endpoint=False)
    c, s = math.cos(tilt), math.sin(tilt)
    u, v = rx * np.cos(angles), ry * np.sin(angles)
    return tuple(zip((x + c * u - s * v).tolist(), (y + s * u + c * v).tolist(), strict=True))


def _limb(x0: float, y0: float, x1: float, y1: float, width: float) -> Points:
    length = math.hypot(x1 - x0, y1 - y0)
    nx, ny = -(y1 - y0) / length * width / 2, (x1 - x0) / length * width / 2
    return ((x0 + nx, y0 + ny), (x1 + nx, y1 + ny), (x1 - nx, y1 - ny), (x0 - nx, y0 - ny))


def _box(x0: float, y0: float, x1: float, y1: float) -> Points:
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def _shade(colour: Colour, factor: float) -> Colour:
    b, g, r = (min(max(c * factor, 0.0), 1.0) for c in colour)
    return (b, g, r)


_GLASS = (0.24, 0.19, 0.16)
_TYRE = (0.07, 0.07, 0.07)
_RIM = (0.52, 0.52, 0.5)
_LAMP = (0.85, 0.92, 0.95)
_TAIL_LAMP = (0.1, 0.1, 0.65)


def _wheel(x: float, r: float) -> list[Part]:
    return [
        Part(_ellipse(x, r, r, r), _TYRE, 0.75),
        Part(_ellipse(x, r, 0.55 * r, 0.55 * r), _RIM, 0.6),
    ]


def _sedan(_phase: float, paint: Colour) -> list[Part]:
    body: Points = (
        (0.0, 0.075), (0.005, 0.165), (0.03, 0.2), (0.16, 0.212), (0.27, 0.29), (0.35, 0.308),
        (0.5, 0.308), (0.58, 0.29), (0.7, 0.212), (0.92, 0.182), (0.985, 0.15), (1.0, 0.1),
        (0.99, 0.055), (0.03, 0.05),
    )  # fmt: skip
    return [
        Part(body, paint, 0.45),
        Part(((0.0, 0.075), (0.01, 0.11), (0.99, 0.1), (0.99, 0.05), (0.03, 0.045)),
             _shade(paint, 0.55), 0.4),
        Part(((0.27, 0.287), (0.35, 0.308), (0.5, 0.308), (0.58, 0.287), (0.5, 0.295),
              (0.35, 0.295)), _shade(paint, 1.5), 0.42),
        Part(((0.7, 0.212), (0.92, 0.182), (0.985, 0.15), (0.9, 0.16), (0.7, 0.19)),
             _shade(paint, 1.35), 0.9),
        Part(((0.205, 0.208), (0.285, 0.275), (0.36, 0.29), (0.43, 0.29), (0.43, 0.205)),
             _GLASS, 0.2),
        Part(((0.45, 0.205), (0.45, 0.29), (0.5, 0.289), (0.565, 0.274), (0.665, 0.205)),
             _GLASS, 0.2),
        Part(_box(0.0, 0.14, 0.03, 0.175), _TAIL_LAMP, 0.4),
        Part(_box(0.955, 0.125, 0.985, 0.155), _LAMP, 0.6),
        *_wheel(0.19, 0.07),
        *_wheel(0.8, 0.07),
    ]  # fmt: skip


def _van(_phase: float, paint: Colour) -> list[Part]:
    body: Points = (
        (0.0, 0.07), (0.0, 0.38), (0.03, 0.4), (0.68, 0.4), (0.75, 0.385), (0.87, 0.25),
        (0.98, 0.2), (1.0, 0.08), (0.98, 0.05), (0.02, 0.05),
    )  # fmt: skip
    return [
        Part(body, paint, 0.42),
        Part(_box(0.01, 0.05, 0.985, 0.1), _shade(paint, 0.6), 0.4),
        Part(_box(0.03, 0.375, 0.68, 0.4), _shade(paint, 1.3), 0.4),
        Part(((0.66, 0.235), (0.66, 0.36), (0.745, 0.36), (0.845, 0.245), (0.84, 0.235)),
             _GLASS, 0.2),
        Part(_box(0.4, 0.24, 0.62, 0.35), _shade(_GLASS, 1.3), 0.22),
        *[Part(_box(x, 0.09, x + 0.008, 0.385), _shade(paint, 0.7), 0.38)
          for x in (0.13, 0.37, 0.64)],
        Part(_box(0.01, 0.16, 0.84, 0.18), _shade(paint, 0.55), 0.4),
        Part(((0.87, 0.25), (0.98, 0.2), (0.98, 0.17), (0.87, 0.2)), _shade(paint, 1.2), 0.9),
        Part(_box(0.0, 0.16, 0.02, 0.25), _TAIL_LAMP, 0.4),
        Part(_box(0.955, 0.15, 0.99, 0.18), _LAMP, 0.6),
        *_wheel(0.2, 0.075),
        *_wheel(0.8, 0.075),
    ]  # fmt: skip


def _pickup(_phase: float, paint: Colour) -> list[Part]:
    body: Points = (
        (0.0, 0.09), (0.0, 0.22), (0.38, 0.22), (0.41, 0.33), (0.44, 0.345), (0.6, 0.345),
        (0.69, 0.23), (0.95, 0.205), (0.995, 0.18), (1.0, 0.08), (0.02, 0.07),
    )  # fmt: skip
    return [
        Part(body, paint, 0.45),
        Part(_box(0.01, 0.065, 0.99, 0.115), _shade(paint, 0.5), 0.4),
        Part(((0.43, 0.225), (0.44, 0.325), (0.59, 0.325), (0.66, 0.225)), _GLASS, 0.2),
        Part(((0.69, 0.23), (0.95, 0.205), (0.995, 0.18), (0.7, 0.2)), _shade(paint, 1.4), 0.9),
        Part(_box(0.0, 0.205, 0.38, 0.22), _shade(paint, 1.3), 0.4),
        Part(_box(0.96, 0.14, 0.995, 0.17), _LAMP, 0.6),
        *_wheel(0.2, 0.08),
        *_wheel(0.81, 0.08),
    ]


def _truck(_phase: float, paint: Colour) -> list[Part]:
    cab: Points = (
        (0.77, 0.07), (0.77, 0.34), (0.8, 0.36), (0.94, 0.355), (0.985, 0.22), (1.0, 0.1),
        (0.99, 0.06),
    )  # fmt: skip
    box = (0.8, 0.82, 0.82)
    return [
        Part(_box(0.0, 0.075, 0.8, 0.13), (0.12, 0.12, 0.13), 0.5),
        Part(_box(0.0, 0.13, 0.755, 0.43), box, 0.35),
        Part(_box(0.0, 0.41, 0.755, 0.43), _shade(box, 1.2), 0.35),
        Part(_box(0.0, 0.13, 0.755, 0.16), _shade(box, 0.6), 0.35),
        Part(_box(0.16, 0.22, 0.6, 0.35), paint, 0.36),
        *[Part(_box(x, 0.16, x + 0.006, 0.41), _shade(box, 0.85), 0.34)
          for x in np.arange(0.1, 0.75, 0.13).tolist()],
        Part(cab, paint, 0.55),
        Part(((0.86, 0.21), (0.86, 0.325), (0.935, 0.325), (0.975, 0.21)), _GLASS, 0.25),
        Part(_box(0.97, 0.1, 0.995, 0.13), _LAMP, 0.7),
        *_wheel(0.09, 0.06),
        *_wheel(0.22, 0.06),
        *_wheel(0.72, 0.06),
        *_wheel(0.9, 0.06),
    ]  # fmt: skip


def _car_front(_phase: float, paint: Colour) -> list[Part]:
    """Draw a car as it comes towards the camera, or goes; x is across it, in its widths."""
    body: Points = (
        (0.03, 0.12), (0.0, 0.3), (0.03, 0.44), (0.14, 0.5), (0.24, 0.78), (0.3, 0.82),
        (0.7, 0.82), (0.76, 0.78), (0.86, 0.5), (0.97, 0.44), (1.0, 0.3), (0.97, 0.12),
    )  # fmt: skip
    return [
        Part(_box(0.06, 0.0, 0.22, 0.2), _TYRE, 0.75),
        Part(_box(0.78, 0.0, 0.94, 0.2), _TYRE, 0.75),
        Part(body, paint, 0.5),
        Part(_box(0.05, 0.1, 0.95, 0.2), _shade(paint, 0.55), 0.5),
        Part(((0.18, 0.5), (0.27, 0.75), (0.73, 0.75), (0.82, 0.5)), _GLASS, 0.2),
        Part(_box(0.3, 0.24, 0.7, 0.36), _shade(_GLASS, 0.8), 0.9),
        Part(_ellipse(0.14, 0.37, 0.09, 0.05), _LAMP, 0.7),
        Part(_ellipse(0.86, 0.37, 0.09, 0.05), _LAMP, 0.7),
    ]


def _truck_front(_phase: float, paint: Colour) -> list[Part]:
    """Draw a truck as it comes towards the camera; x is across it, in its widths."""
    box = (0.8, 0.82, 0.82)
    return [
        Part(_box(0.05, 0.0, 0.25, 0.25), _TYRE, 0.75),
        Part(_box(0.75, 0.0, 0.95, 0.25), _TYRE, 0.75),
        Part(_box(0.0, 0.25, 1.0, 1.5), box, 0.35),
        Part(_box(0.0, 1.46, 1.0, 1.5), _shade(box, 1.2), 0.35),
        Part(_box(0.04, 0.1, 0.96, 1.15), paint, 0.5),
        Part(_box(0.1, 0.62, 0.9, 1.02), _GLASS, 0.22),
        Part(_box(0.2, 0.24, 0.8, 0.52), _shade(paint, 0.5), 0.95),
        Part(_box(0.07, 0.2, 0.2, 0.28), _LAMP, 0.7),
        Part(_box(0.8, 0.2, 0.93, 0.28), _LAMP, 0.7),
    ]


def _bus(_phase: float, paint: Colour) -> list[Part]:
    body: Points = (
        (0.0, 0.05), (0.0, 0.29), (0.02, 0.305), (0.97, 0.305), (0.995, 0.28), (1.0, 0.06),
    )  # fmt: skip
    windows = [
        Part(_box(x, 0.165, x + 0.105, 0.265), _GLASS, 0.25)
        for x in np.arange(0.05, 0.88, 0.118).tolist()
    ]
    return [
        Part(body, paint, 0.4),
        Part(_box(0.0, 0.05, 1.0, 0.085), _shade(paint, 0.55), 0.4),
        Part(_box(0.0, 0.115, 0.99, 0.14), (0.85, 0.87, 0.87), 0.4),
        *windows,
        Part(_box(0.0, 0.09, 0.12, 0.13), _shade(paint, 0.7), 0.95),
        *_wheel(0.24, 0.05),
        *_wheel(0.78, 0.05),
    ]


def _person(phase: float, paint: Colour) -> list[Part]:
    skin, trousers = (0.42, 0.52, 0.7), _shade(paint, 0.45)
    swing = 0.13 * math.sin(2 * math.pi * phase)
    bob = 0.012 * math.cos(4 * math.pi * phase)
    lift = 0.05 * max(math.cos(2 * math.pi * phase), 0.0)
    hip, shoulder = 0.48 + bob, 0.81 + bob

    def leg(reach: float, foot: float) -> list[Part]:
        knee = (0.5 + 0.6 * reach + 0.02, 0.26 + foot / 2)
        return [
            Part(_limb(0.5, hip + 0.03, *knee, 0.105), trousers, 0.7),
            Part(_limb(*knee, 0.5 + reach, 0.03 + foot, 0.085), trousers, 0.65),
            Part(_ellipse(0.53 + reach, 0.025 + foot, 0.06, 0.025), _TYRE, 0.4),
        ]

    return [
        Part(_limb(0.5, shoulder - 0.03, 0.5 + swing, 0.5, 0.07), _shade(paint, 0.8), 0.7),
        *leg(-swing, lift),
        *leg(swing, 0.0),
        Part(((0.42, hip - 0.02), (0.4, shoulder), (0.46, shoulder + 0.035),
              (0.55, shoulder + 0.035), (0.6, shoulder), (0.58, hip - 0.02)), paint, 0.8),
        Part(_limb(0.5, shoulder - 0.03, 0.5 - swing, 0.5, 0.075), _shade(paint, 0.9), 0.7),
        Part(_ellipse(0.51, 0.925 + bob, 0.058, 0.075), skin, 1.0),
        Part(_ellipse(0.495, 0.955 + bob, 0.058, 0.05), (0.1, 0.12, 0.15), 0.8),
    ]  # fmt: skip


def _airliner(_phase: float, paint: Colour) -> list[Part]:
    fuselage: Points = (
        (0.0, 0.19), (0.02, 0.205), (0.2, 0.215), (0.85, 0.215), (0.94, 0.195), (0.99, 0.165),
        (1.0, 0.15), (0.97, 0.132), (0.85, 0.115), (0.3, 0.115), (0.12, 0.15),
    )  # fmt: skip
    return [
        Part(((0.47, 0.2), (0.36, 0.36), (0.31, 0.365), (0.36, 0.2)), _shade(paint, 0.75), 0.3),
        Part(fuselage, paint, 0.4),
        Part(((0.12, 0.15), (0.3, 0.115), (0.85, 0.115), (0.97, 0.132), (0.8, 0.135),
              (0.3, 0.14)), _shade(paint, 0.6), 0.38),
        Part(((0.03, 0.2), (0.0, 0.37), (0.06, 0.37), (0.19, 0.212)), (0.5, 0.25, 0.16), 0.35),
        Part(((0.06, 0.19), (-0.02, 0.135), (0.03, 0.132), (0.16, 0.175)),
             _shade(paint, 0.7), 0.35),
        Part(((0.58, 0.15), (0.36, -0.06), (0.28, -0.065), (0.4, 0.14)),
             _shade(paint, 0.65), 0.35),
        Part(_ellipse(0.5, 0.075, 0.055, 0.028), _shade(paint, 0.8), 1.0),
        Part(_box(0.2, 0.173, 0.86, 0.185), (0.3, 0.25, 0.22), 0.3),
        Part(((0.93, 0.185), (0.965, 0.178), (0.95, 0.165), (0.925, 0.172)), _GLASS, 0.3),
    ]  # fmt: skip


def _light_aircraft(phase: float, paint: Colour) -> list[Part]:
    fuselage: Points = (
        (0.0, 0.2), (0.3, 0.23), (0.5, 0.255), (0.7, 0.25), (0.78, 0.21), (0.93, 0.2),
        (0.97, 0.17), (0.94, 0.13), (0.7, 0.11), (0.5, 0.115), (0.02, 0.18),
    )  # fmt: skip
    blade = 0.12 * math.cos(2 * math.pi * phase)
    return [
        Part(fuselage, paint, 0.5),
        Part(((0.5, 0.115), (0.7, 0.11), (0.94, 0.13), (0.7, 0.14)), _shade(paint, 0.6), 0.5),
        Part(((0.0, 0.2), (-0.03, 0.35), (0.05, 0.35), (0.15, 0.215)), _shade(paint, 0.9), 0.4),
        Part(((0.0, 0.195), (-0.04, 0.15), (0.04, 0.15), (0.12, 0.19)), _shade(paint, 0.7), 0.4),
        Part(((0.55, 0.19), (0.56, 0.245), (0.69, 0.24), (0.76, 0.205)), _GLASS, 0.3),
        Part(((0.72, 0.255), (0.42, 0.43), (0.3, 0.43), (0.48, 0.25)), _shade(paint, 0.85), 0.35),
        Part(((0.72, 0.24), (0.55, 0.02), (0.4, 0.015), (0.48, 0.235)), paint, 0.35),
        Part(_limb(0.975, 0.165 - blade - 0.01, 0.985, 0.165 + blade + 0.01, 0.02),
             _shade(_TYRE, 1.5), 0.5),
        Part(_limb(0.6, 0.12, 0.58, 0.05, 0.02), _TYRE, 0.4),
        Part(_ellipse(0.58, 0.045, 0.03, 0.03), _TYRE, 0.4),
    ]  # fmt: skip


def _helicopter(phase: float, paint: Colour) -> list[Part]:
    rotor = 0.5 * abs(math.cos(math.pi * phase)) + 0.05
    body: Points = (
        (0.42, 0.12), (0.45, 0.24), (0.55, 0.28), (0.8, 0.28), (0.92, 0.2), (0.96, 0.13),
        (0.9, 0.08), (0.55, 0.06),
    )  # fmt: skip
    return [
        Part(((0.0, 0.235), (0.45, 0.235), (0.5, 0.15), (0.02, 0.21)), _shade(paint, 0.8), 0.45),
        Part(((0.03, 0.22), (-0.03, 0.36), (0.03, 0.36), (0.09, 0.23)), _shade(paint, 0.7), 0.4),
        Part(body, paint, 0.5),
        Part(((0.5, 0.06), (0.55, 0.12), (0.9, 0.11), (0.88, 0.075)), _shade(paint, 0.6), 0.5),
        Part(((0.72, 0.16), (0.72, 0.26), (0.8, 0.265), (0.91, 0.19), (0.93, 0.15)), _GLASS, 0.3),
        Part(_box(0.53, 0.28, 0.72, 0.325), _shade(paint, 0.7), 1.0),
        Part(_limb(0.63, 0.32, 0.635, 0.365, 0.03), _TYRE, 0.6),
        Part(_limb(0.635 - rotor, 0.36, 0.635 + rotor, 0.366, 0.016), _TYRE, 0.4),
        Part(_limb(0.48, 0.015, 0.92, 0.015, 0.018), _TYRE, 0.4),
        Part(_limb(0.57, 0.07, 0.57, 0.015, 0.014), _TYRE, 0.4),
        Part(_limb(0.82, 0.075, 0.82, 0.015, 0.014), _TYRE, 0.4),
    ]  # fmt: skip


def _drone(phase: float, paint: Colour) -> list[Part]:
    blur = 0.1 + 0.05 * math.cos(2 * math.pi * phase)
    return [
        Part(_limb(0.1, 0.24, 0.9, 0.24, 0.05), _shade(paint, 0.7), 0.5),
        Part(_ellipse(0.5, 0.22, 0.2, 0.085), paint, 0.6),
        Part(_ellipse(0.55, 0.13, 0.06, 0.05), _TYRE, 0.6),
        *[Part(_box(x - 0.035, 0.22, x + 0.035, 0.31), _shade(paint, 0.5), 0.8)
          for x in (0.1, 0.9)],
        *[Part(_ellipse(x, 0.32, 0.08 + blur, 0.018), _shade(paint, 0.6), 0.4)
          for x in (0.1, 0.9)],
        Part(_limb(0.38, 0.17, 0.3, 0.03, 0.025), _TYRE, 0.4),
        Part(_limb(0.62, 0.17, 0.7, 0.03, 0.025), _TYRE, 0.4),
    ]  # fmt: skip


def _bird(phase: float, paint: Colour) -> list[Part]:
    flap = 0.34 * math.sin(2 * math.pi * phase)
    return [
        Part(((0.62, 0.25), (0.42, 0.27 + flap * 0.9), (0.22, 0.25 + flap), (0.4, 0.22)),
             _shade(paint, 0.8), 0.7),
        Part(_ellipse(0.5, 0.22, 0.3, 0.075), paint, 0.9),
        Part(((0.0, 0.26), (0.3, 0.24), (0.3, 0.2), (0.02, 0.18)), _shade(paint, 0.8), 0.7),
        Part(_ellipse(0.82, 0.25, 0.09, 0.06), paint, 1.0),
        Part(((0.65, 0.23), (0.5, 0.22 + flap), (0.3, 0.17 + flap * 1.1), (0.42, 0.2)),
             _shade(paint, 0.9), 0.7),
    ]  # fmt: skip


def _patchwork(_phase: float, paint: Colour) -> list[Part]:
    """Draw what is like nothing known: an odd outline with patches of other tones.

    The paint decides the shape too.
    """
    rng = np.random.default_rng([round(share * 1e6) for share in paint])
    angles = np.linspace(0.0, 2 * math.pi, 40, endpoint=False)
    radii = np.ones_like(angles)
    for k in (2, 3, 4, 6):
        radii += rng.uniform(-0.25, 0.25) * np.cos(k * angles + rng.uniform(0.0, 2 * math.pi))
    radii /= radii.max()
    height = float(np.exp(rng.uniform(np.log(0.3), np.log(2.2))))
    x, y = 0.5 + 0.5 * radii * np.cos(angles), height * (0.5 + 0.5 * radii * np.sin(angles))
    parts = [Part(tuple(zip(x.tolist(), y.tolist(), strict=True)), paint, 0.8)]
    for _ in range(int(rng.integers(0, 8))):
        place, angle = rng.uniform(0.0, 0.3), rng.uniform(0.0, 2 * math.pi)
        middle = 0.5 + place * np.cos(angle), height * (0.5 + place * np.sin(angle))
        rx, ry = rng.uniform(0.03, 0.18, 2) * (1.0, height)
        parts.append(
            Part(
                _ellipse(*middle, rx, ry, rng.uniform(0.0, math.pi)),
                _shade(paint, float(rng.uniform(0.3, 3.0))),
                float(rng.uniform(0.3, 1.0)),
            )
        )
    return parts


@dataclass(frozen=True)
class Kind:
    """A kind of object: how it is drawn and how it moves.

    `cycle_frames` is how long one cycle of its gait, rotor or wings takes. What stands on the
    ground stays level and throws a contact shadow `footprint` lengths wide; what has none flies
    and pitches along its path.
    """

    shape: Shape
    cycle_frames: float = 1.0
    footprint: float = 0.0


KINDS: dict[str, Kind] = {
    "sedan": Kind(_sedan, footprint=1.0),
    "van": Kind(_van, footprint=1.0),
    "pickup": Kind(_pickup, footprint=1.0),
    "truck": Kind(_truck, footprint=1.0),
    "bus": Kind(_bus, footprint=1.0),
    "car_front": Kind(_car_front, footprint=1.0),
    "truck_front": Kind(_truck_front, footprint=1.0),
    "person": Kind(_person, cycle_frames=30, footprint=0.4),
    "airliner": Kind(_airliner),
    "light_aircraft": Kind(_light_aircraft, cycle_frames=2.7),
    "helicopter": Kind(_helicopter, cycle_frames=2.3),
    "drone": Kind(_drone, cycle_frames=1.7),
    "bird": Kind(_bird, cycle_frames=9),
    "patchwork": Kind(_patchwork),
}


@dataclass(frozen=True)
class Path:
    """Where an object's foot (its tail-to-nose middle on the ground) is at which frame.

    `waypoints` are (frame, x, y) in pixels of the scene; between them the position follows a
    monotone cubic (PCHIP), so that equal neighbours are a stop and uneven spacing an
    acceleration. A path may leave the image and come back. `scales` are (frame, scale): what
    comes towards the camera grows. Without any its size stays.
    """

    waypoints: tuple[tuple[float, float, float], ...]
    scales: tuple[tuple[float, float], ...] = ()

    def positions(self, frames: int) -> npt.NDArray[np.float64]:
        """Return the positions at frames 0 to `frames` - 1, float64 Nx2; held beyond the ends."""
        return _interpolated(self.waypoints, frames)

    def scale_factors(self, frames: int) -> npt.NDArray[np.float64]:
        """Return by how much it is scaled at frames 0 to `frames` - 1, float64 N."""
        return _interpolated(self.scales or ((0.0, 1.0),), frames)[:, 0]


def _interpolated(waypoints: Sequence[tuple[float, ...]], frames: int) -> npt.NDArray[np.float64]:
    """Return values given as (frame, value, ...) at frames 0 to `frames` - 1, held at the ends."""
    table = np.asarray(waypoints, dtype=np.float64)
    if len(table) == 1:
        return np.repeat(table[:, 1:], frames, axis=0)
    times = np.clip(np.arange(frames), table[0, 0], table[-1, 0])
    return np.asarray(PchipInterpolator(table[:, 0], table[:, 1:])(times))


@dataclass(frozen=True)
class SceneObject:
    """One moving object: identity, looks and path.

    `size` is its length (of people the height, of what is seen from before the width) in pixels.
    """

    id: int
    kind: str
    size: float
    path: Path
    paint: Colour = (0.75, 0.75, 0.75)


@dataclass(frozen=True)
class Layer:
    """A premultiplied picture with its coverage: float32 HxWx3 and HxW, values 0 to 1."""

    colour: npt.NDArray[np.float32]
    coverage: npt.NDArray[np.float32]

    def over(self, below: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the layer laid over a picture of the same size."""
        return self.colour + below * (1 - self.coverage[..., None])


@dataclass(frozen=True)
class Pose:
    """Where a shape stands: its foot (x, y), and pitch in radians, clockwise in the image.

    `scale` is by how much it is larger there than its object's size.
    """

    x: float
    y: float
    pitch: float = 0.0
    mirrored: bool = False
    scale: float = 1.0


class Sprite:
    """One object, ready to be drawn into pictures; `thermal` draws its warmth."""

    def __init__(self, scene_object: SceneObject, thermal: bool, rng: np.random.Generator) -> None:
        self._object = scene_object
        self._kind = KINDS[scene_object.kind]
        self._thermal = thermal
        lowest, highest = _SUPERSAMPLING_LIMITS
        self._fineness = min(max(round(_DRAWING_SIZE / scene_object.size), lowest), highest)
        self._texture = _paint_texture(rng)

    def place(self, phase: float, pose: Pose, to_image: Matrix) -> PlacedSprite:
        """Draw the sprite in image coordinates; `to_image` is the camera's 2x3 affine map."""
        to_picture = np.vstack((to_image, [0, 0, 1])) @ self._to_scene(pose)
        parts = self._kind.shape(phase, self._object.paint)
        outlines = [_transformed(to_picture, part.points) for part in parts]
        corners = np.concatenate(outlines)
        left, top = np.floor(corners.min(axis=0)).astype(int) - 1
        width, height = np.ceil(corners.max(axis=0)).astype(int) + 2 - (left, top)

        scale = self._fineness
        shift = (scale - 1) / 2
        to_fine = np.array(
            [[scale, 0, shift - scale * left], [0, scale, shift - scale * top], [0, 0, 1]]
        )
        fine = np.zeros((height * scale, width * scale, 4), np.float32)
        for part, outline in zip(parts, outlines, strict=True):
            fixed = np.rint(_transformed(to_fine, outline) * 16).astype(np.int32)
            colour = (part.warmth,) * 3 if self._thermal else part.colour
            cv2.fillPoly(fine, [fixed], (*colour, 1.0), shift=4)
        fine[..., :3] *= self._relief(to_fine @ to_picture, fine.shape)[..., None]

        drawn = cv2.resize(fine, (int(width), int(height)), interpolation=cv2.INTER_AREA)
        layer = Layer(drawn[..., :3], drawn[..., 3])
        return PlacedSprite(int(left), int(top), layer, self._shadow(pose, to_image))

    def _to_scene(self, pose: Pose) -> Matrix:
        """Return the 3x3 map from the shape's own frame to the scene."""
        size = self._object.size * pose.scale
        c, s = size * math.cos(pose.pitch), size * math.sin(pose.pitch)
        flip = -1 if pose.mirrored else 1
        linear = np.array([[c * flip, s], [s * flip, -c]])
        matrix = np.eye(3)
        matrix[:2, :2] = linear
        matrix[:2, 2] = (pose.x, pose.y) - linear @ (0.5, 0.0)
        return matrix

    def _relief(self, to_fine: Matrix, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
        """Return the relative brightness of the body, which is fixed to it."""
        unit = 1 / (len(self._texture) - 1)
        map_ = (to_fine @ np.diag((unit, unit, 1.0)))[:2]
        relief = cv2.warpAffine(
            self._texture, map_, (shape[1], shape[0]), borderMode=cv2.BORDER_REPLICATE
        )
        return 1 + (0.4 if self._thermal else 1.0) * relief

    def _shadow(self, pose: Pose, to_image: Matrix) -> tuple[float, float, float, float] | None:
        if self._thermal or not self._kind.footprint:
            return None
        x, y = to_image @ (pose.x, pose.y, 1.0)
        half = self._kind.footprint * self._object.size * pose.scale / 2
        depth = max(0.05 * half, 0.7)  # seen at a grazing angle, as a long lens does
        return float(x), float(y) - 0.5 * depth, half, depth


@dataclass(frozen=True)
class PlacedSprite:
    """A sprite in the picture: the corner of its layer, and its shadow's ellipse if it has one.

    `left` and `top` may lie outside the picture. The shadow is (x, y, semi-axis x, semi-axis y).
    """

    left: int
    top: int
    layer: Layer
    shadow: tuple[float, float, float, float] | None

    def lay_over(self, picture: npt.NDArray[np.float32]) -> None:
        """Composite shadow and sprite into a picture, in place."""
        if self.shadow is not None:
            _darken(picture, self.shadow)
        inside = self.clip(picture.shape[:2])
        if inside is not None:
            (rows, columns), layer = inside
            picture[rows, columns] = layer.over(picture[rows, columns])

    def clip(self, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], Layer] | None:
        """Where the sprite lies in a picture of `shape`, and that part of it; None if nowhere."""
        height, width = self.layer.coverage.shape
        x0, y0 = max(self.left, 0), max(self.top, 0)
        x1, y1 = min(self.left + width, shape[1]), min(self.top + height, shape[0])
        if x1 <= x0 or y1 <= y0:
            return None
        rows, columns = slice(y0 - self.top, y1 - self.top), slice(x0 - self.left, x1 - self.left)
        part = Layer(self.layer.colour[rows, columns], self.layer.coverage[rows, columns])
        return (slice(y0, y1), slice(x0, x1)), part


def _darken(picture: npt.NDArray[np.float32], ellipse: tuple[float, float, float, float]) -> None:
    """Throw a soft shadow on a picture, in place."""
    x, y, rx, ry = ellipse
    height, width = picture.shape[:2]
    x0, x1 = max(math.floor(x - 1.3 * rx), 0), min(math.ceil(x + 1.3 * rx), width)
    y0, y1 = max(math.floor(y - 2 * ry), 0), min(math.ceil(y + 2 * ry), height)
    if x1 <= x0 or y1 <= y0:
        return
    rows, columns = np.mgrid[y0:y1, x0:x1].astype(np.float32)
    distance = ((columns - x) / rx) ** 2 + ((rows - y) / ry) ** 2
    shade = 1 - 0.45 * np.clip(1.4 - distance, 0, 1)
    picture[y0:y1, x0:x1] *= shade.astype(np.float32)[..., None]


def _transformed(matrix: Matrix, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Apply a 3x3 affine map to points, Nx2."""
    return np.asarray(points) @ matrix[:2, :2].T + matrix[:2, 2]


def _paint_texture(rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return deviations of brightness over a body, square: reflections, dirt and seams."""
    size = (128, 128)
    coarse = rng.standard_normal((12, 9)).astype(np.float32)
    middle = rng.standard_normal((32, 24)).astype(np.float32)
    texture = 0.09 * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    return texture + 0.05 * cv2.resize(middle, size, interpolation=cv2.INTER_CUBIC)
