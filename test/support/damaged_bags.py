"""J of the committed bags with frames damaged, colours out of balance, or hot spots beside them.

`PYTHONPATH=test python -m support.damaged_bags` prints the figures of docs/reliability.md: J over
the frames that are not damaged, and the ids.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from support.paths import ROOT
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.messages.images import image_from_message
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame

Image = npt.NDArray[Any]
Damage = Callable[[Sequence[Image], int], Image]


def clip(name: str) -> tuple[list[Image], list[Image]]:
    """Return the images of a committed bag, and where there are objects in them."""
    by_stamp: dict[int, dict[str, Image]] = {}
    for record in BagReader(ROOT / "bags" / name).messages():
        image = image_from_message(record.message()).copy()
        by_stamp.setdefault(record.stamp_ns, {})[record.topic] = image
    topics = [by_stamp[stamp] for stamp in sorted(by_stamp)]
    images = [each["/camera/image_raw"] for each in topics]
    return images, [each["/ground_truth/labels"] > 0 for each in topics]


def lower_half(fill: Damage) -> Damage:
    """Return a damage that fills the lower half."""

    def damage(images: Sequence[Image], number: int) -> Image:
        damaged, middle = images[number].copy(), images[number].shape[0] // 2
        damaged[middle:] = fill(images, number)
        return damaged

    return damage


def middle_of(image: Image) -> int:
    """Return the row at which the lower half begins."""
    return image.shape[0] // 2


def shutter(images: Sequence[Image], number: int) -> Image:
    """Return a thermal camera's shutter: flat, with columns, a vignette and noise of its own."""
    height, width = images[0].shape
    unit = images[0].std() / 60.0
    y, x = np.mgrid[:height, :width]
    vignette = ((y - height / 2) / height) ** 2 + ((x - width / 2) / width) ** 2
    columns = np.random.default_rng(5).normal(0, 10 * unit, width)
    noise = np.random.default_rng(number).normal(0, 6 * unit, (height, width))
    flat = images[0].mean() + columns + 40 * unit * vignette + noise
    return flat.clip(0, np.iinfo(images[0].dtype).max).astype(images[0].dtype)


def grey(images: Sequence[Image], number: int) -> Image:
    """Return one grey value."""
    return np.array(128 if images[0].dtype == np.uint8 else int(images[0].mean()))


DAMAGES: dict[str, Damage] = {
    "none": lambda images, k: images[k],
    "torn": lower_half(lambda images, k: np.roll(images[k - 6][middle_of(images[k]) :], 45, 1)),
    "rolled": lower_half(
        lambda images, k: np.roll(images[k], len(images[k]) // 4, 0)[middle_of(images[k]) :]
    ),
    "half grey": lower_half(grey),
    "smeared": lower_half(lambda images, k: images[k][middle_of(images[k])]),
    "black": lambda images, k: np.zeros_like(images[k]),
    "shutter": shutter,
    "repeated": lambda images, k: images[k - 1],
}
DAMAGED: list[tuple[str, str, Sequence[int]]] = [
    *(("normal", kind, [24]) for kind in DAMAGES if kind != "shutter"),
    *(("thermal", kind, [16]) for kind in ("none", "half grey", "torn")),
    ("thermal", "shutter", range(12, 15)),
    ("thermal", "shutter", range(12, 20)),
    ("shake", "torn", [24]),
    ("severe", "torn", [24]),
    ("severe", "half grey", [24]),
]


def coloured(image: Image, gains: Sequence[float]) -> Image:
    """Return a grey image in drawn colours, their channels multiplied."""
    random = np.random.default_rng(1)
    shape = image.shape
    tints = [
        cv2.GaussianBlur(random.normal(size=shape).astype(np.float32), (0, 0), 12) for _ in "bgr"
    ]
    colours = [image * (1.0 + 0.15 * tint / tint.std()).clip(0.6, 1.5) for tint in tints]
    return (np.stack(colours, -1).clip(0, 255) * np.array(gains)).clip(0, 255).astype(np.uint8)


EVEN = (1.0, 1.0, 1.0)
BALANCES: dict[str, Callable[[int], Sequence[float]]] = {
    "no change": lambda k: EVEN,
    "a step": lambda k: (0.75, 1.0, 1.25) if k >= 20 else EVEN,
    "blue alone": lambda k: (0.6, 1.0, 1.0) if k >= 20 else EVEN,
    "a drift": lambda k: (1.0 - 0.006 * k, 1.0, 1.0 + 0.006 * k),
}


def with_hot_spot(scene: Image, share: float) -> Image:
    """Return a deep scene with a disc of so large a share of it at 15000 counts."""
    height, width = scene.shape
    disc = np.zeros((height, width), np.float32)
    cv2.circle(disc, (width - 40, 35), int(np.sqrt(share * height * width / np.pi)), 1, -1)
    disc = cv2.GaussianBlur(disc, (0, 0), 1)
    return np.asarray(scene * (1 - disc) + 15000 * disc)


def with_defects(scene: Image, value: int) -> Image:
    """Return a deep scene with one pixel of a hundred at a value."""
    spoilt = scene.copy()
    spoilt[np.random.default_rng(0).random(scene.shape) < 0.01] = value
    return spoilt


def under_a_sky(scene: Image, number: int) -> Image:
    """Return a deep scene with a plain sky 3000 counts below it in its upper 15 %."""
    rows, sky = int(0.15 * len(scene)), scene.copy()
    noise = np.random.default_rng(number).normal(0, 2, (rows, scene.shape[1]))
    sky[:rows] = 4000 + np.linspace(0, 30, rows)[:, None] + noise
    return sky


TONES: dict[str, Callable[[Image, int], Image]] = {
    "nothing": lambda scene, k: scene,
    "a hot spot of 1 %": lambda scene, k: with_hot_spot(scene, 0.01),
    "a hot spot of 3 %": lambda scene, k: with_hot_spot(scene, 0.03),
    "a hot spot of 1 % from frame 12 on": lambda s, k: with_hot_spot(s, 0.01) if k >= 12 else s,
    "1 % of hot pixels": lambda scene, k: with_defects(scene, 16000),
    "1 % of dead pixels": lambda scene, k: with_defects(scene, 0),
    "a sky of 15 %": under_a_sky,
    "another gain from frame 12 on": lambda scene, k: (
        7900 + 0.35 * (scene - 7000) if k >= 12 else scene
    ),
    "both": lambda scene, k: with_hot_spot(under_a_sky(scene, k), 0.01),
}


def banded(image: Image, number: int, depth: float) -> Image:
    """Return a picture under mains light, which a rolling shutter makes bands of that wander."""
    rows = np.arange(len(image))[:, None] / len(image)
    return np.asarray(image * (1 + depth * np.sin(2 * np.pi * (1.7 * rows + 0.23 * number))))


def stretched(image: Image, number: int) -> Image:
    """Return a picture whose range a camera fits to each frame, of which some hold a flash."""
    scene = image.copy()
    if number % 3 == 0:
        scene[5:9, 5:9] = 400
    return np.asarray((scene - scene.min()) / (scene.max() - scene.min()) * 255)


def local_contrast(image: Image, number: int) -> Image:
    """Return a picture as cameras with local contrast enhancement give it."""
    return np.asarray(cv2.createCLAHE(4.0, (8, 8)).apply(image.astype(np.uint8)))


CONTROLS: dict[str, Damage] = {
    "a range fitted to each frame": lambda f, k: stretched(f[k], k),
    "a gain that swings by a third": lambda f, k: f[k] * (1 + 0.35 * np.sin(2 * np.pi * k / 30)),
    "bands of 15 %": lambda f, k: banded(f[k], k, 0.15),
    "two exposures in turn, 1.6 apart": lambda f, k: f[k] * (1.6 if k % 2 else 1.0),
    "two exposures by threes": lambda f, k: f[k] * (1.6 if k // 3 % 2 else 1.0),
    "a dip each second": lambda f, k: f[k] * (0.6 if k % 30 in (14, 15) else 1.0),
    "two exposures by eights": lambda f, k: f[k] * 0.55 + 12 if k // 8 % 2 else f[k],
    "a slow start from the dark": lambda f, k: f[k] * (0.25 + 0.75 * min(1.0, k / 40)),
    "local contrast": lambda f, k: local_contrast(f[k], k),
    "bands of 30 %": lambda f, k: banded(f[k], k, 0.3),
}
"""Automatic controls, of grey frames as floats."""


def controlled(kind: str, images: Sequence[Image]) -> list[Image]:
    """Return grey frames as a camera with an automatic control gives them."""
    scenes = [image.astype(np.float32) for image in images]
    given = (CONTROLS[kind](scenes, number) for number in range(len(scenes)))
    return [np.asarray(image).clip(0, 255).astype(np.uint8) for image in given]


def scored(
    images: Sequence[Image], truth: Sequence[Image], out: Sequence[int] = ()
) -> tuple[float, list[int]]:
    """Segment images; return J without some of them, and the ids."""
    with motion_segmenter(Parameters()) as segmenter:
        results = [r for k, image in enumerate(images) for r in segmenter.push(Frame(k, image))]
        results += segmenter.flush()
    scores = []
    for number, (result, there) in enumerate(zip(results, truth, strict=True)):
        found = result.labels > 0
        union = np.count_nonzero(found | there)
        if number not in out:
            scores.append(np.count_nonzero(found & there) / union if union else 1.0)
    ids = sorted({moving.id for result in results for moving in result.objects})
    return float(np.mean(scores)), ids


def report(
    name: str, images: Sequence[Image], truth: Sequence[Image], out: Sequence[int] = ()
) -> None:
    """Segment images; print J without some of them, and the ids."""
    j, ids = scored(images, truth, out)
    print(f"{name}: J {j:.3f}, ids {ids}", flush=True)


def main() -> int:
    """Run all; return the exit status."""
    for bag, kind, at in DAMAGED:
        images, truth = clip(bag)
        damaged = [DAMAGES[kind](images, k) if k in at else each for k, each in enumerate(images)]
        report(f"{bag}, {kind} in {at[0]} to {at[-1]}", damaged, truth, at)
    images, truth = clip("normal")
    for name, gains in BALANCES.items():
        balanced = [coloured(image, gains(k)) for k, image in enumerate(images)]
        report(f"normal in colours, white balance: {name}", balanced, truth)
    for kind in CONTROLS:
        report(f"normal, {kind}", controlled(kind, images), truth)
    images, truth = clip("thermal")
    low, high = np.percentile(images[0], [0.5, 99.5])
    for name, add in TONES.items():
        deep = []
        for number, image in enumerate(images):
            scene = 7000 + (image.astype(np.float32) - low) / (high - low) * 300
            deep.append(add(scene, number).clip(0, 65535).astype(np.uint16))
        report(f"thermal, 300 counts, with {name}", deep, truth)
    return 0


if __name__ == "__main__":
    sys.exit(main())
