"""Frames that are damaged, blind or repeated, and what tells them from a cut."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from support.drawn_clip import PARAMETERS, SHAPE, assert_sound, frames, segmented, stamps
from support.drawn_scene import ByteImage, DrawnScene, jaccard, texture
from support.segmenters import segmenter_by_rules
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import SegmentationResult
from turbseg_ros.segmentation.passed_frames import MAX_PASSED

SCENE = DrawnScene(velocity=(2, 0), start=(10, 36))
CLIP = list(SCENE.images(40))
CAUSAL = PARAMETERS.replace({"latency.mode": "causal"})
HALF = SHAPE[0] // 2
# Where motion is measured.
AT = 20


def with_lower_half(image: ByteImage, lower: ByteImage | np.uint8) -> ByteImage:
    damaged = image.copy()
    damaged[HALF:] = lower
    return damaged


def shutter(number: int) -> ByteImage:
    """One grey value, with the sensor's own columns and noise."""
    columns = np.random.default_rng(5).normal(0, 6, SHAPE[1])
    noise = np.random.default_rng(number).normal(0, 3, SHAPE)
    return np.clip(128 + columns + noise, 0, 255).astype(np.uint8)


def blocks_replaced(image: ByteImage) -> ByteImage:
    damaged = image.copy()
    for y in range(0, SHAPE[0], 32):
        damaged[y : y + 16] = damaged[y, :1]
    return damaged


DAMAGES: dict[str, Callable[[int], ByteImage]] = {
    "half grey": lambda k: with_lower_half(CLIP[k], np.uint8(128)),
    "smeared": lambda k: with_lower_half(CLIP[k], CLIP[k][HALF]),
    "torn": lambda k: with_lower_half(CLIP[k], np.roll(CLIP[k - 6][HALF:], 45, axis=1)),
    "frozen": lambda k: with_lower_half(CLIP[k], CLIP[k - 1][HALF:]),
    "stripes": lambda k: blocks_replaced(CLIP[k]),
}
BLINDNESS: dict[str, Callable[[int], ByteImage]] = {
    "black": lambda k: np.zeros(SHAPE, np.uint8),
    "white": lambda k: np.full(SHAPE, 255, np.uint8),
    "shutter": shutter,
}


def replaced(at: Sequence[int], damage: Callable[[int], ByteImage]) -> list[ByteImage]:
    return [damage(k) if k in at else image for k, image in enumerate(CLIP)]


def conditions(results: Sequence[SegmentationResult]) -> dict[int, Condition]:
    """The conditions of the frames that are not sound, by number."""
    found = {number: result.condition for number, result in enumerate(results)}
    return {k: each for k, each in found.items() if each is not Condition.SOUND}


def overlaps(results: Sequence[SegmentationResult]) -> list[float]:
    return [jaccard(r.labels > 0, SCENE.truth(k)) for k, r in enumerate(results)]


def ids(results: Sequence[SegmentationResult]) -> set[int]:
    return {moving.id for result in results for moving in result.objects}


@pytest.fixture(scope="module")
def undisturbed() -> list[SegmentationResult]:
    return segmented(CLIP)


def test_sound_frames_are_sound(undisturbed: list[SegmentationResult]) -> None:
    assert conditions(undisturbed) == {}
    assert conditions(segmented(CLIP[:30], CAUSAL)) == {}


@pytest.mark.parametrize("at", [[AT], [AT - 1, AT]], ids=["one", "two"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_frame_costs_no_sound_one(
    damage: Callable[[int], ByteImage], at: list[int], undisturbed: list[SegmentationResult]
) -> None:
    results = segmented(replaced(at, damage))
    assert stamps(results) == list(range(len(CLIP)))
    assert_sound(results)
    # Of frozen rows only the first frame repeats those of a sound one.
    assert conditions(results)[at[0]] is Condition.DAMAGED
    found, usual = overlaps(results), overlaps(undisturbed)
    others = [k for k in range(8, len(CLIP)) if k not in at]
    assert np.mean([found[k] - usual[k] for k in others]) > -0.02
    assert min(found[k] for k in at) > 0.6
    assert ids(results) == ids(undisturbed)


@pytest.mark.parametrize("length", [1, 3, MAX_PASSED])
@pytest.mark.parametrize("cover", BLINDNESS.values(), ids=BLINDNESS)
def test_objects_live_through_what_hides_the_scene(
    cover: Callable[[int], ByteImage], length: int, undisturbed: list[SegmentationResult]
) -> None:
    hidden = range(AT - 4, AT - 4 + length)
    results = segmented(replaced(hidden, cover))
    assert conditions(results) == dict.fromkeys(hidden, Condition.BLIND)
    assert not any(results[k].labels.any() for k in hidden)
    assert min(overlaps(results)[hidden.stop :]) > 0.6
    assert ids(results) == ids(undisturbed)


def test_a_repeated_picture_is_answered_as_it_was_before() -> None:
    results = segmented(replaced([AT, AT + 5], lambda k: CLIP[k - 1]))
    assert conditions(results) == dict.fromkeys([AT, AT + 5], Condition.REPEATED)
    for k in (AT, AT + 5):
        np.testing.assert_array_equal(results[k].labels, results[k - 1].labels)
    assert len(ids(results)) == 1


def test_pictures_that_always_repeat_are_no_damage() -> None:
    still = [texture(SHAPE, seed=4)] * 24
    assert conditions(segmented(still)) == {}


def test_a_frozen_camera_is_believed_in_the_end() -> None:
    results = segmented([*CLIP[:AT], *[CLIP[AT - 1]] * 45])
    repeated = [k for k, each in conditions(results).items() if each is Condition.REPEATED]
    assert repeated == list(range(AT, AT + 30))


def test_a_cut_is_one_only_when_the_old_scene_does_not_come_back() -> None:
    other = [255 - image for image in DrawnScene(velocity=(-2, 0), start=(120, 20)).images(40)]
    for length in (3, MAX_PASSED):
        images = [*CLIP[:AT], *other[:length], *CLIP[AT + length :]]
        away = range(AT, AT + length)
        assert conditions(segmented(images)) == dict.fromkeys(away, Condition.BLIND)
    assert conditions(segmented([*CLIP[:AT], *other])) == {AT: Condition.CUT}


def test_a_stream_that_ends_after_a_cut_shows_the_new_scene() -> None:
    other = [255 - image for image in SCENE.images(4)]
    results = segmented([*CLIP[:AT], *other])
    assert conditions(results) == {AT: Condition.CUT}
    assert stamps(results) == list(range(AT + 4))


def test_what_comes_before_part_of_the_scene_and_stays_is_believed() -> None:
    wall, top = texture((72, 2 * SHAPE[1]), seed=12), 2 * SHAPE[0] - 72
    images = [cv2.resize(image, None, fx=2, fy=2) for image in CLIP[:32]]
    for number, image in enumerate(images[AT:]):
        noise = np.random.default_rng(number).normal(0, 2, wall.shape)
        image[top:] = np.clip(wall + noise, 0, 255)
    larger = {"resolution.processing": 320}
    results = segmented(images, PARAMETERS.replace(larger))
    assert conditions(results) == {}
    assert stamps(results) == list(range(len(images)))
    # Without look-ahead it takes some frames to know.
    causal = segmented(images, CAUSAL.replace(larger))
    assert conditions(causal) == dict.fromkeys(range(AT, AT + 3), Condition.DAMAGED)


@pytest.mark.parametrize("damage", [*DAMAGES.values(), shutter], ids=[*DAMAGES, "shutter"])
def test_without_look_ahead_every_frame_is_answered_at_once(
    damage: Callable[[int], ByteImage],
) -> None:
    segmenter = segmenter_by_rules(CAUSAL)
    results = []
    for frame in frames(replaced([AT], damage)):
        given = segmenter.push(frame)
        assert stamps(given) == [frame.stamp]
        results += given
    assert list(conditions(results)) == [AT]
    assert len(ids(results)) == 1


def test_a_lens_that_stays_covered_keeps_nothing_waiting() -> None:
    segmenter = segmenter_by_rules(PARAMETERS)
    images = [*CLIP[:AT], *[np.zeros(SHAPE, np.uint8)] * 60]
    answered = [len(segmenter.push(frame)) for frame in frames(images)]
    waiting = np.arange(1, len(images) + 1) - np.cumsum(answered)
    # The frames at the beginning, those whose condition is open, and those that are waited out.
    assert max(waiting) <= PARAMETERS.latency.warm_up + 2 * (MAX_PASSED + 1)
    assert answered[-10:] == [1] * 10
