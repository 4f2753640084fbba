"""Whose pixels are whose where drawn objects touch or hide one another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pytest

from support.drawn_scene import ByteImage, Mask, jaccard, rectangle, texture
from support.segmenters import ObservingRefiner, segmenter_refined_by
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.foreground import ObjectCrop
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.occlusion import AppearanceModel, DepthOrder, divided_among

SHAPE = (96, 160)
TILT = 0.3
NEAR, FAR = rectangle(40, 30, 70, 60), rectangle(58, 24, 98, 50)


def picture_of(parts: Sequence[tuple[Mask, ByteImage]]) -> ByteImage:
    """Paint textures into their masks, those behind first, HxWx1."""
    image = texture(SHAPE, seed=1)
    for mask, inside in parts:
        image[mask] = inside[mask]
    return image[..., None]


def centroid(mask: Mask) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def appearance_of(mask: Mask, inside: ByteImage) -> AppearanceModel:
    return AppearanceModel.of(CroppedMask.of(mask), picture_of([(mask, inside)]), centroid(mask))


def divide(
    image: ByteImage,
    appearances: Mapping[str, AppearanceModel],
    order: DepthOrder[str] | None = None,
) -> dict[str, Mask]:
    found = CroppedMask.of(NEAR | FAR)
    parts = divided_among(found, appearances, image, TILT, order or DepthOrder())
    return {name: part.in_frame(SHAPE) for name, part in parts.items()}


DARK, BRIGHT = (texture(SHAPE, seed, low=low, high=low + 60) for seed, low in ((2, 10), (3, 160)))


@pytest.mark.parametrize("names", [("near", "far"), ("far", "near")])
def test_what_two_objects_share_goes_to_the_one_that_it_looks_like(names: Sequence[str]) -> None:
    appearances = {"near": appearance_of(NEAR, DARK), "far": appearance_of(FAR, BRIGHT)}
    image = picture_of([(FAR, BRIGHT), (NEAR, DARK)])
    parts = divide(image, {name: appearances[name] for name in names})
    assert jaccard(parts["near"], NEAR) > 0.95
    assert jaccard(parts["far"], FAR & ~NEAR) > 0.95


def test_every_pixel_goes_to_one_object_and_none_is_lost() -> None:
    appearances = {"near": appearance_of(NEAR, DARK), "far": appearance_of(FAR, BRIGHT)}
    parts = divide(picture_of([(FAR, BRIGHT), (NEAR, DARK)]), appearances)
    assert not (parts["near"] & parts["far"]).any()
    assert ((parts["near"] | parts["far"]) == (NEAR | FAR)).all()


def test_a_little_off_its_place_an_object_keeps_its_pixels() -> None:
    near = appearance_of(NEAR, DARK).at(centroid(NEAR) + np.array([2.0, -1.0]))
    parts = divide(
        picture_of([(FAR, BRIGHT), (NEAR, DARK)]),
        {"near": near, "far": appearance_of(FAR, BRIGHT)},
    )
    assert jaccard(parts["near"], NEAR) > 0.9


@pytest.mark.parametrize("front", ["near", "far"])
def test_of_two_that_look_alike_the_one_that_was_in_front_stays_there(front: str) -> None:
    plain = np.full(SHAPE, 30, np.uint8)
    appearances = {"near": appearance_of(NEAR, plain), "far": appearance_of(FAR, plain)}
    order: DepthOrder[str] = DepthOrder()
    order.observe(front, {"near": "far", "far": "near"}[front], 1.0)
    parts = divide(picture_of([(NEAR | FAR, plain)]), appearances, order)
    assert jaccard(parts[front], {"near": NEAR, "far": FAR}[front]) > 0.95


def test_who_is_in_front_is_learned_from_what_is_seen() -> None:
    order: DepthOrder[str] = DepthOrder()
    appearances = {"near": appearance_of(NEAR, DARK), "far": appearance_of(FAR, BRIGHT)}
    divide(picture_of([(FAR, BRIGHT), (NEAR, DARK)]), appearances, order)
    assert order.lead("near", "far") > 0.5
    assert order.lead("far", "near") == -order.lead("near", "far")
    assert order.front_to_back(["far", "near"]) == ["near", "far"]
    order.keep(["far"])
    assert order.lead("near", "far") == 0.0


def test_an_object_that_is_hidden_altogether_has_no_pixels() -> None:
    behind = rectangle(45, 35, 65, 55)
    appearances = {"near": appearance_of(NEAR, DARK), "behind": appearance_of(behind, BRIGHT)}
    found = CroppedMask.of(NEAR)
    parts = divided_among(found, appearances, picture_of([(NEAR, DARK)]), TILT, DepthOrder())
    assert parts.keys() == {"near"}


class TrueMasks(ObservingRefiner):
    """Judges every pixel by whether any object is there."""

    def __init__(self, truth: Sequence[np.ndarray]) -> None:
        self._truth = truth
        self._labels = truth[0]

    def crops(self, stamp: int, crops: Sequence[ObjectCrop]) -> None:
        self._labels = self._truth[stamp]

    def refine(self, crops: Sequence[ObjectCrop]) -> list[np.ndarray]:
        return [(self._labels[crop.box.slices] > 0).astype(np.float32) for crop in crops]


FRAMES = 40


def crossing() -> Iterator[tuple[ByteImage, np.ndarray]]:
    """Draw two objects that pass before one another, and their labels: 2 is in front."""
    ground = texture(SHAPE, seed=1)
    inside = {1: texture((24, 24), seed=2, low=150, high=250), 2: texture((30, 20), seed=3, low=0)}
    for number in range(FRAMES):
        image, labels = ground.copy(), np.zeros(SHAPE, np.uint16)
        for label, x, y in ((1, 6 + 3 * number, 34), (2, 134 - 3 * number, 38)):
            height, width = inside[label].shape
            image[y : y + height, x : x + width] = inside[label]
            labels[y : y + height, x : x + width] = label
        noise = np.random.default_rng(number).normal(0.0, 2.0, SHAPE)
        yield np.clip(image + noise, 0, 255).astype(np.uint8), labels


@pytest.fixture(scope="module")
def passing() -> list[tuple[SegmentationResult, np.ndarray]]:
    """The results of each frame of two objects that pass one another, and the truth."""
    drawn = list(crossing())
    truth = [labels for _, labels in drawn]
    parameters = Parameters.from_mapping({"resolution.processing": 160})
    with_true_masks = segmenter_refined_by(TrueMasks(truth), parameters)
    frames = [Frame(number, image) for number, (image, _) in enumerate(drawn)]
    results = [result for frame in frames for result in with_true_masks.push(frame)]
    return list(zip([*results, *with_true_masks.flush()], truth, strict=True))


@pytest.mark.parametrize("label", [1, 2])
def test_objects_that_pass_one_another_keep_their_pixels(
    passing: Sequence[tuple[SegmentationResult, np.ndarray]], label: int
) -> None:
    first, labels = passing[6]
    (known,) = np.unique(first.labels[labels == label])
    for result, truth in passing[6:]:
        own = truth == label
        # Of what peeps out from behind the other, a strip is a matter of a pixel.
        if np.count_nonzero(own) > 150:
            assert jaccard(result.labels == known, own) > 0.8, result.frame.stamp


def test_objects_that_pass_one_another_are_no_more_than_two(
    passing: Sequence[tuple[SegmentationResult, np.ndarray]],
) -> None:
    assert {found.id for result, _ in passing for found in result.objects} == {1, 2}
