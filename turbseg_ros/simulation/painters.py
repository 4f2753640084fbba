"""The landscapes of the scenes, one painter each. Lengths are shares of the view's height."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from .landscape import (
    Backdrop,
    Brush,
    Extent,
    Field,
    Flag,
    Painter,
    Palette,
    Sway,
    Water,
)
from .objects import Colour, Layer
from .textures import fractal_noise

_PARKED_PAINTS: tuple[Colour, ...] = (
    (0.8, 0.8, 0.8), (0.2, 0.2, 0.22), (0.45, 0.3, 0.2), (0.22, 0.2, 0.5), (0.6, 0.6, 0.58),
)  # fmt: skip


def town(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint a street across the view: buildings and trees behind it, desert shrubs before it.

    The lanes run at 0.58 and 0.67 of the height, the pavements at 0.5 and 0.76; poles stand
    behind the street.
    """
    brush = Brush(extent, palette, rng)
    _sky(brush, 0.12)
    _ridge(brush, 0.1, 0.035)
    _ground(brush, 0.12, palette.soil, grain=0.08, stretch=(5, 1.2))
    _buildings(brush, ground=0.34, height=(0.12, 0.26))
    for x in np.arange(brush.left, brush.right, 0.11):
        if rng.random() < 0.75:
            colour = palette.leaves if rng.random() < 0.6 else palette.dry_leaves
            place = float(x + rng.uniform(-0.05, 0.05))
            brush.tree(
                place, float(rng.uniform(0.34, 0.42)), float(rng.uniform(0.14, 0.24)), colour
            )
    brush.haze(((0.0, 0.35), (0.3, 0.22), (0.6, 0.08), (1.0, 0.03)), palette.sky_low)
    for _ in range(round(14 * (brush.right - brush.left))):
        _shrub(brush, (0.4, 0.47), (0.008, 0.022))
    brush.pebbles(0.36, 0.47, round(160 * (brush.right - brush.left)), palette.soil)
    _wall(brush, 0.432)
    _street(brush, 0.52, 0.73)
    _pavement(brush, 0.475, 0.52)
    _pavement(brush, 0.73, 0.775)
    for x in np.arange(brush.left + 0.05, brush.right, 0.27):
        if rng.random() < 0.45:
            kind = ("sedan", "pickup", "van")[int(rng.integers(3))]
            paint = _PARKED_PAINTS[int(rng.integers(len(_PARKED_PAINTS)))]
            brush.park(kind, float(x), 0.468, 0.13, paint)
    for x in np.arange(brush.left + 0.15, brush.right, 0.62):
        _utility_pole(brush, float(x + rng.uniform(-0.05, 0.05)), 0.49, 0.44)
    for x in np.arange(brush.left + 0.4, brush.right, 0.8):
        _sign(brush, float(x + rng.uniform(-0.1, 0.1)), 0.5)
    brush.pebbles(0.785, brush.bottom, round(420 * (brush.right - brush.left)), palette.soil)
    brush.weather(0.12)
    for _ in range(round(26 * (brush.right - brush.left))):
        _shrub(brush, (0.81, brush.bottom), (0.014, 0.06))
    return Backdrop(brush.finish())


def town_behind_poles(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint the street of `town` behind a lamp post, a utility pole and a tree trunk close by."""
    behind = town(extent, palette, rng)
    brush = Brush(extent, palette, rng)
    middle = extent.width / extent.height / 2
    for offset, width, colour in (
        (-0.42, 0.013, palette.metal),
        (0.06, 0.024, palette.wood),
        (0.52, 0.04, palette.wood),
    ):
        x = middle + offset
        brush.rectangle(
            x - width / 2, brush.top, x + width / 2, brush.bottom, colour, 0.14, (0.6, 9)
        )
        brush.rectangle(
            x - width / 2,
            brush.top,
            x - width / 4,
            brush.bottom,
            _tint(colour, 1.2),
            0.1,
            (0.6, 9),
        )
    return Backdrop(behind.painting, brush.finish_layer())


def fields(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint open country: ridges in the haze, tree lines, crops, a farm, and a road at 0.62."""
    brush = Brush(extent, palette, rng)
    _sky(brush, 0.26)
    _ridge(brush, 0.2, 0.06)
    _ridge(brush, 0.25, 0.03, strength=0.85)
    _ground(brush, 0.27, palette.crop, grain=0.06, stretch=(8, 0.8))
    edges = [0.29, 0.33, 0.38, 0.43, 0.49, 0.56]
    for upper, lower in pairwise(edges):
        x = brush.left
        while x < brush.right:
            width = float(rng.uniform(0.5, 1.4))
            base = (palette.crop, palette.grass, palette.soil)[int(rng.integers(3))]
            slant = float(rng.uniform(-0.12, 0.12))
            corners = (
                (x, upper),
                (x + width, upper),
                (x + width + slant, lower),
                (x + slant, lower),
            )
            brush.fill(corners, _tint(base, float(rng.uniform(0.85, 1.12))), 0.09, (6, 0.7))
            x += width
        if rng.random() < 0.75:
            _hedge(brush, upper, float(rng.uniform(0.012, 0.03)))
    _farm(brush, float(rng.uniform(0.3, 1.2)), 0.45)
    brush.haze(((0.0, 0.5), (0.27, 0.45), (0.45, 0.25), (0.7, 0.1), (1.0, 0.03)), palette.sky_low)
    _hedge(brush, 0.565, 0.03)
    brush.rectangle(brush.left, 0.565, brush.right, brush.bottom, palette.grass, 0.12, (4, 1.5))
    _street(brush, 0.585, 0.66, markings=False)
    _fence(brush, 0.7, 0.035)
    for place in np.arange(brush.left + 0.2, brush.right, 0.7):
        _utility_pole(brush, float(place + rng.uniform(-0.05, 0.05)), 0.575, 0.3)
    brush.pebbles(0.68, brush.bottom, round(300 * (brush.right - brush.left)), palette.grass)
    brush.weather(0.27)
    for _ in range(round(45 * (brush.right - brush.left))):
        _shrub(brush, (0.74, brush.bottom), (0.01, 0.045), palette.grass)
    return Backdrop(brush.finish())


def open_sky(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint a plain sky with hardly a cloud above a line of trees and a mast."""
    brush = Brush(extent, palette, rng)
    _sky(brush, 0.93, clouds=0.012)
    _ridge(brush, 0.9, 0.025)
    brush.haze(((0.0, 0.0), (0.8, 0.05), (0.95, 0.3)), palette.sky_low)
    x = brush.left
    while x < brush.right:
        height = float(rng.uniform(0.05, 0.11))
        brush.tree(x, 0.985, height, palette.leaves)
        x += 0.45 * height
    brush.rectangle(brush.left, 0.965, brush.right, brush.bottom, palette.grass, 0.12, (4, 1.2))
    _mast(brush, 0.28, 0.97, 0.3)
    return Backdrop(brush.finish())


def lakeside(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint a lake with ripples, trees in the wind and a flag: much stirs, nothing moves on."""
    brush = Brush(extent, palette, rng)
    _sky(brush, 0.2)
    _ridge(brush, 0.16, 0.05)
    _ground(brush, 0.2, palette.grass, grain=0.1, stretch=(5, 1.0))
    _buildings(brush, ground=0.36, height=(0.08, 0.14), spacing=0.5)
    brush.haze(((0.0, 0.4), (0.3, 0.25), (0.5, 0.1), (1.0, 0.03)), palette.sky_low)
    brush.rectangle(brush.left, 0.36, brush.right, 0.56, palette.grass, 0.12, (4, 1.0))
    _pavement(brush, 0.4, 0.43)
    flag_x, flag_y = 1.3, 0.16
    brush.line([(flag_x, 0.44), (flag_x, flag_y - 0.02)], 0.009, palette.metal)
    for _ in range(round(14 * (brush.right - brush.left))):
        _shrub(brush, (0.45, 0.55), (0.01, 0.03), palette.leaves)
    water = brush.region(brush.left, 0.56, brush.right, 0.86)
    brush.rectangle(brush.left, 0.56, brush.right, 0.572, _tint(palette.soil, 0.7), 0.1)
    brush.rectangle(brush.left, 0.86, brush.right, brush.bottom, palette.soil, 0.12, (3, 1.5))
    for _ in range(round(20 * (brush.right - brush.left))):
        _shrub(brush, (0.88, brush.bottom), (0.015, 0.05))
    painting = brush.finish()

    unit = brush.unit
    ripples = tuple(fractal_noise((256, 512), rng, exponent=0.9) for _ in range(2))
    lake = Water(*water, palette.water, (ripples[0], ripples[1]), 0.1 * palette.relief)
    flag = Flag(
        flag_x * unit + extent.margin_x,
        flag_y * unit + extent.margin_y,
        0.19 * unit,
        0.11 * unit,
        ((0.2, 0.2, 0.72), (0.88, 0.9, 0.9), (0.6, 0.3, 0.16)),
    )
    far = _swaying_trees(brush, [(x, 0.5, 0.2) for x in (0.1, 0.32, 0.5, 0.9, 1.08, 1.62)], 0.004)
    near = _swaying_trees(brush, [(0.2, 0.97, 0.46), (1.66, 1.02, 0.55)], 0.008)
    return Backdrop(painting, animations=(lake, flag, far, near))


def collage(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
    """Paint nothing in particular: patches of every size and tone that hide one another.

    Such "dead leaves" have the statistics of photographs (Lee, Mumford and Huang 2001): as many
    edges at every scale, whatever the subject.
    """
    brush = Brush(extent, palette, rng)
    middle, contrast = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.15, 1.0))
    colourful = 0.06 if palette.relief == 1.0 else 0.0

    def colour() -> Colour:
        tone = middle + contrast * palette.relief * float(rng.uniform(-0.45, 0.45))
        blue, green, red = np.clip(tone + colourful * rng.standard_normal(3), 0.02, 0.98)
        return float(blue), float(green), float(red)

    brush.rectangle(brush.left, brush.top, brush.right, brush.bottom, colour(), 0.1)
    smallest, largest = 0.012, 0.5
    number = round(1500 * (brush.right - brush.left) * (brush.bottom - brush.top) / 2)
    # Areas are so distributed that each octave of sizes covers as much as any other.
    share = 1.0 - (smallest / largest) ** 2
    radii = smallest / np.sqrt(1.0 - share * rng.random(number))
    for radius in np.sort(radii)[::-1] if rng.random() < 0.3 else radii:
        corners = int(rng.choice([3, 4, 5, 12]))
        angles = np.sort(rng.uniform(0.0, 2 * math.pi, corners))
        x = rng.uniform(brush.left, brush.right) + radius * rng.uniform(0.3, 1.5) * np.cos(angles)
        y = rng.uniform(brush.top, brush.bottom) + radius * np.sin(angles)
        points = list(zip(x.tolist(), y.tolist(), strict=True))
        brush.fill(points, colour(), float(rng.uniform(0.0, 0.15)))
    return Backdrop(brush.finish())


PAINTERS: dict[str, Painter] = {
    painter.__name__: painter
    for painter in (town, town_behind_poles, fields, open_sky, lakeside, collage)
}


def _blend(upper: Colour, lower: Colour, share: Field) -> Field:
    return np.array(upper, np.float32) * (1 - share) + np.array(lower, np.float32) * share


def _tint(colour: Colour, factor: float) -> Colour:
    b, g, r = (min(c * factor, 1.0) for c in colour)
    return (b, g, r)


def _sky(brush: Brush, horizon: float, clouds: float = 0.02) -> None:
    brush.rectangle(brush.left, brush.top, brush.right, horizon, (1, 1, 1), clouds, (7, 3))
    rows = np.linspace(0, 1, brush.canvas.shape[0])[:, None] / max(horizon, 0.05)
    blend = np.clip(rows, 0, 1).astype(np.float32)[..., None]
    palette = brush.palette
    brush.canvas[..., :3] *= _blend(palette.sky_top, palette.sky_low, blend)


def _ridge(brush: Brush, level: float, roughness: float, strength: float = 1.0) -> None:
    """Paint a skyline of hills; `strength` darkens it with nearness."""
    xs = np.linspace(brush.left, brush.right, 160)
    walk = fractal_noise((1, 512), brush.rng, exponent=1.4)[0, :160]
    crest = level - roughness * (0.5 + 0.5 * walk)
    outline = list(zip(xs.tolist(), crest.tolist(), strict=True))
    corners = [(brush.right, level + 0.2), (brush.left, level + 0.2)]
    brush.fill(outline + corners, _tint(brush.palette.hill, strength), 0.05, (3, 2))


def _ground(
    brush: Brush, horizon: float, colour: Colour, grain: float, stretch: tuple[float, float]
) -> None:
    brush.rectangle(brush.left, horizon, brush.right, brush.bottom, colour, grain, stretch)


def _buildings(
    brush: Brush, ground: float, height: tuple[float, float], spacing: float = 0.0
) -> None:
    rng, palette = brush.rng, brush.palette
    x = brush.left - 0.1
    while x < brush.right:
        wide = float(rng.uniform(0.18, 0.46))
        tall = float(rng.uniform(*height))
        top = ground - tall
        facade = palette.facades[int(rng.integers(len(palette.facades)))]
        roof = palette.roofs[int(rng.integers(len(palette.roofs)))]
        brush.rectangle(x, top, x + wide, ground, facade, 0.05, (2, 3))
        side = 0.2 * wide
        brush.rectangle(x + wide - side, top, x + wide, ground, _tint(facade, 0.72), 0.05, (2, 3))
        if rng.random() < 0.5:
            rise = 0.34 * tall
            eaves = ((x - 0.012, top), (x + 0.03, top - rise), (x + wide - 0.04, top - rise),
                     (x + wide + 0.012, top))  # fmt: skip
            brush.fill(eaves, roof, 0.12, (0.7, 0.5))
        else:
            brush.rectangle(x - 0.004, top - 0.012, x + wide + 0.004, top, _tint(roof, 1.1))
            unit_x = x + wide * float(rng.uniform(0.15, 0.6))
            brush.rectangle(unit_x, top - 0.03, unit_x + 0.04, top - 0.01, palette.metal, 0.05)
        _windows(brush, x + 0.02, top + 0.02, x + wide - side - 0.01, ground - 0.02)
        brush.rectangle(x - 0.01, ground - 0.004, x + wide + 0.01, ground + 0.006, (0.2, 0.2, 0.2))
        x += wide + spacing + float(rng.uniform(0.01, 0.2))


def _windows(brush: Brush, x0: float, y0: float, x1: float, y1: float) -> None:
    rng, palette = brush.rng, brush.palette
    pitch_x, pitch_y = float(rng.uniform(0.035, 0.06)), float(rng.uniform(0.05, 0.075))
    for y in np.arange(y0, y1 - 0.6 * pitch_y, pitch_y).tolist():
        for x in np.arange(x0, x1 - 0.6 * pitch_x, pitch_x).tolist():
            if rng.random() < 0.12:
                continue
            frame = _tint(palette.facades[0], 1.15)
            brush.rectangle(x, y, x + 0.55 * pitch_x, y + 0.55 * pitch_y, frame)
            glass = _tint(palette.window, float(rng.uniform(0.7, 1.5)))
            brush.rectangle(
                x + 0.003, y + 0.003, x + 0.55 * pitch_x - 0.003, y + 0.55 * pitch_y - 0.002, glass
            )


def _street(brush: Brush, upper: float, lower: float, markings: bool = True) -> None:
    palette, rng = brush.palette, brush.rng
    brush.rectangle(brush.left, upper, brush.right, lower, palette.asphalt, 0.05, (6, 1.0))
    depth = lower - upper
    for share in (0.2, 0.33, 0.66, 0.8):
        wear = upper + share * depth
        tone = _tint(palette.asphalt, 0.93)
        brush.rectangle(brush.left, wear, brush.right, wear + 0.05 * depth, tone, 0.05, (8, 0.7))
    for _ in range(round(4 * (brush.right - brush.left))):
        x, y = float(rng.uniform(brush.left, brush.right)), float(rng.uniform(upper, lower - 0.02))
        wide = float(rng.uniform(0.03, 0.16))
        patch = _tint(palette.asphalt, float(rng.uniform(0.78, 1.12)))
        brush.rectangle(x, y, x + wide, y + float(rng.uniform(0.006, 0.02)), patch, 0.06, (2, 1))
        crack_y = np.clip(y + np.cumsum(rng.uniform(-0.005, 0.005, 9)), upper, lower)
        crack = zip((x + np.linspace(0, 0.1, 9)).tolist(), crack_y.tolist(), strict=True)
        brush.line(list(crack), 0.0015, _tint(palette.asphalt, 0.8))
    if not markings:
        return
    for y, colour in (
        (upper + 0.04 * depth, palette.marking),
        (lower - 0.06 * depth, palette.marking),
    ):
        brush.rectangle(brush.left, y, brush.right, y + 0.005, colour, 0.1, (3, 1))
    middle = upper + 0.5 * depth
    for x in np.arange(brush.left, brush.right, 0.16).tolist():
        brush.rectangle(x, middle, x + 0.08, middle + 0.007, palette.yellow_marking, 0.1, (2, 1))


def _pavement(brush: Brush, upper: float, lower: float) -> None:
    palette, rng = brush.palette, brush.rng
    brush.rectangle(brush.left, upper, brush.right, lower, palette.pavement, 0.05, (2, 1))
    for x in np.arange(brush.left, brush.right, 0.045).tolist():
        brush.line([(x, upper), (x - 0.01, lower)], 0.0018, _tint(palette.pavement, 0.8))
        if rng.random() < 0.12:
            slab = _tint(palette.pavement, float(rng.uniform(0.85, 1.1)))
            brush.fill(
                ((x, upper), (x + 0.045, upper), (x + 0.035, lower), (x - 0.01, lower)), slab
            )
    brush.rectangle(brush.left, lower, brush.right, lower + 0.007, _tint(palette.pavement, 0.6))
    brush.rectangle(brush.left, lower - 0.003, brush.right, lower, _tint(palette.pavement, 1.2))


def _wall(brush: Brush, level: float) -> None:
    """Paint garden walls with gaps, and wheeled bins before them."""
    rng, palette = brush.rng, brush.palette
    x = brush.left
    while x < brush.right:
        wide = float(rng.uniform(0.15, 0.5))
        if rng.random() < 0.7:
            tone = _tint(palette.facades[int(rng.integers(len(palette.facades)))], 0.9)
            brush.rectangle(x, level - 0.035, x + wide, level, tone, 0.06, (1.5, 0.6))
            brush.rectangle(x, level - 0.038, x + wide, level - 0.033, _tint(tone, 1.2))
            brush.rectangle(x, level, x + wide, level + 0.005, _tint(palette.soil, 0.6))
            bin_x = x + wide * float(rng.random())
            brush.rectangle(bin_x, level - 0.02, bin_x + 0.015, level + 0.008, palette.window)
        x += wide + float(rng.uniform(0.02, 0.15))


def _shrub(
    brush: Brush,
    levels: tuple[float, float],
    sizes: tuple[float, float],
    colour: Colour | None = None,
) -> None:
    rng, palette = brush.rng, brush.palette
    x = float(rng.uniform(brush.left, brush.right))
    nearness = float(rng.random())
    y = levels[0] + nearness * (levels[1] - levels[0])
    size = sizes[0] + nearness * (sizes[1] - sizes[0]) * float(rng.uniform(0.5, 1.0))
    tone = colour or (palette.leaves, palette.dry_leaves)[int(rng.integers(2))]
    angles = np.linspace(0, 2 * math.pi, 12).tolist()
    shadow = [
        (x + size * (0.3 + 1.3 * math.cos(a)), y + size * (0.5 + 0.3 * math.sin(a)))
        for a in angles
    ]
    brush.fill(shadow, _tint(palette.soil, 0.55 * brush.palette.shadow + 0.3), 0.08)
    brush.foliage(x, y, size * 1.3, size * 0.75, _tint(tone, float(rng.uniform(0.85, 1.25))))


def _utility_pole(brush: Brush, x: float, ground: float, height: float) -> None:
    palette = brush.palette
    top = ground - height
    brush.line([(x, ground), (x, top)], 0.012, palette.wood)
    brush.line([(x - 0.003, ground), (x - 0.003, top)], 0.003, _tint(palette.wood, 1.5))
    brush.line([(x - 0.05, top + 0.03), (x + 0.05, top + 0.03)], 0.006, palette.wood)
    brush.rectangle(x + 0.008, top + 0.07, x + 0.026, top + 0.11, palette.metal, 0.05)
    for end in (-0.045, 0.045):
        sag = [(x + end + d, top + 0.028 + 0.12 * (d * (0.62 - d)) / 0.62)
               for d in np.linspace(0, 0.62, 9).tolist()]  # fmt: skip
        brush.line(sag, 0.0016, _tint(palette.wood, 0.8))


def _sign(brush: Brush, x: float, ground: float) -> None:
    palette = brush.palette
    brush.line([(x, ground), (x, ground - 0.09)], 0.005, palette.metal)
    brush.rectangle(x - 0.016, ground - 0.12, x + 0.016, ground - 0.08, palette.marking)
    brush.rectangle(x - 0.01, ground - 0.112, x + 0.01, ground - 0.098, palette.window)


def _mast(brush: Brush, x: float, ground: float, height: float) -> None:
    metal = _tint(brush.palette.metal, 0.75)
    top = ground - height
    for offset in (-0.012, 0.012):
        brush.line([(x + offset, ground), (x + offset * 0.2, top)], 0.004, metal)
    for level in np.linspace(ground, top + 0.02, 14).tolist():
        share = 0.2 + 0.8 * (level - top) / height
        brush.line([(x - 0.012 * share, level), (x + 0.012 * share, level - 0.02)], 0.0025, metal)


def _hedge(brush: Brush, level: float, height: float) -> None:
    x = brush.left
    while x < brush.right:
        if brush.rng.random() < 0.85:
            size = height * float(brush.rng.uniform(0.5, 1.3))
            tone = _tint(brush.palette.leaves, float(brush.rng.uniform(0.8, 1.1)))
            brush.foliage(x, level - 0.5 * size, 0.9 * size, 0.6 * size, tone)
        x += height * 0.8


def _farm(brush: Brush, x: float, ground: float) -> None:
    palette = brush.palette
    for offset, wide, tall in ((0.0, 0.2, 0.05), (0.24, 0.1, 0.07)):
        left, top = x + offset, ground - tall
        brush.rectangle(left, top, left + wide, ground, palette.facades[0], 0.05)
        ridge, eaves = top - 0.035, left + wide
        roof = (
            (left - 0.01, top),
            (left + 0.02, ridge),
            (eaves - 0.02, ridge),
            (eaves + 0.01, top),
        )
        brush.fill(roof, palette.roofs[0], 0.08)
        _windows(brush, left + 0.01, top + 0.012, left + wide - 0.01, ground)


def _fence(brush: Brush, level: float, height: float) -> None:
    palette = brush.palette
    for x in np.arange(brush.left, brush.right, 0.085).tolist():
        brush.line([(x, level), (x, level - height)], 0.006, _tint(palette.wood, 1.4))
    for share in (0.35, 0.8):
        y = level - share * height
        brush.rectangle(
            brush.left, y, brush.right, y + 0.0035, _tint(palette.wood, 1.5), 0.1, (3, 1)
        )


def _swaying_trees(
    brush: Brush, trees: list[tuple[float, float, float]], amplitude: float
) -> Sway:
    """Trees at (x, ground, height) as a layer of their own; `amplitude` of their tops."""
    copse = Brush(brush.extent, brush.palette, brush.rng)
    for x, ground, height in trees:
        copse.tree(x, ground, height, brush.palette.leaves)
    layer = copse.finish_layer()
    covered = np.nonzero(layer.coverage.max(axis=1))[0]
    rows, columns = slice(int(covered[0]), int(covered[-1]) + 1), slice(0, layer.coverage.shape[1])
    seed = int(brush.rng.integers(2**32))
    cut = Layer(layer.colour[rows, columns], layer.coverage[rows, columns])
    return Sway(cut, rows, columns, amplitude * brush.unit, seed)
