"""What stops stays, becomes background at last, and leaves no ghost when it drives off."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from support.drawn_clip import PARAMETERS, assert_sound, ids
from support.drawn_scene import ByteImage, jaccard, texture
from support.segmenters import segmenter_by_rules
from turbseg_ros.segmentation.frame import Frame, SegmentationResult, segment

RATE = 30.0
SHAPE = (96, 160)
SIDE, TOP = 24, 36
# Where the square is: it comes at 3 pixels a frame, stands for five seconds, and goes on.
COMES = list(range(-20, 70, 3))
STANDS = [70] * 150
GOES = list(range(73, 130, 3))


def images(
    places: Sequence[int], pan: float = 0.0, bar: Sequence[int] = (), brighter: float = 0.0
) -> list[ByteImage]:
    """Draw a textured square at places along x of the scene, before a camera that pans.

    :param pan: pixels a frame.
    :param bar: from which column on something 40 pixels wide hides the whole height, a frame each.
    :param brighter: grey values that the light grows by over all frames.
    """
    height, width = SHAPE
    ground = texture((height, width + 400), seed=1)
    square = texture((SIDE, SIDE), seed=2, low=10, high=90)
    hiding = texture((height, 40), seed=3, low=150, high=250)
    drawn = []
    for number, place in enumerate(places):
        scene = np.pad(ground, ((0, 0), (100, 0)), mode="edge").astype(np.float32)
        scene[TOP : TOP + SIDE, 100 + place : 100 + place + SIDE] = square
        shift = np.array([[1.0, 0.0, -100.0 - number * pan], [0.0, 1.0, 0.0]])
        image = cv2.warpAffine(scene, shift, (width, height))
        if number < len(bar):
            columns = np.arange(bar[number], bar[number] + 40)
            seen = (columns >= 0) & (columns < width)
            image[:, columns[seen]] = hiding[:, seen]
        noise = np.random.default_rng(number).normal(0.0, 2.0, SHAPE)
        light = brighter * number / len(places)
        drawn.append(np.clip(image + noise + light, 0, 255).astype(np.uint8))
    return drawn


def segmented(clip: Sequence[ByteImage], **changes: float) -> list[SegmentationResult]:
    """Segment a clip with some parameters of tracking changed."""
    changed = {f"tracking.{name}": value for name, value in changes.items()}
    segmenter = segmenter_by_rules(PARAMETERS.replace(changed))
    frames = (
        Frame(round(number * 1e9 / RATE), image, period=1 / RATE)
        for number, image in enumerate(clip)
    )
    return list(segment(frames, segmenter))


def truth(place: float) -> npt.NDArray[np.bool_]:
    mask = np.zeros(SHAPE, bool)
    left, right = (int(np.clip(round(x), 0, SHAPE[1])) for x in (place, place + SIDE))
    mask[TOP : TOP + SIDE, left:right] = True
    return mask


def overlaps(results: Sequence[SegmentationResult], places: Sequence[float]) -> list[float]:
    return [
        jaccard(result.labels > 0, truth(place))
        for result, place in zip(results, places, strict=True)
    ]


def test_what_stops_stays_and_drives_on_with_its_id() -> None:
    places = COMES + STANDS + GOES
    results = segmented(images(places))
    assert_sound(results)
    assert ids(results) == {1}
    overlap = overlaps(results, places)
    first, last = len(COMES), len(COMES + STANDS)
    assert min(overlap[first:last]) > 0.7
    # It leaves no ghost.
    assert min(overlap[last + 8 : last + 16]) > 0.6


def test_what_stops_stays_while_the_light_changes() -> None:
    places = COMES + STANDS + GOES
    results = segmented(images(places, brighter=40.0))
    assert ids(results) == {1}
    assert min(overlaps(results, places)[len(COMES) : len(COMES + STANDS)]) > 0.7


def test_what_stops_stays_in_a_view_that_moves() -> None:
    places = COMES + STANDS
    pan = 0.25
    results = segmented(images(places, pan=pan))
    assert ids(results) == {1}
    seen = [place - number * pan for number, place in enumerate(places)]
    assert np.mean(overlaps(results, seen)[len(COMES) :]) > 0.7
    assert all(len(result.objects) == 1 for result in results[len(COMES) :])


def test_what_stands_is_hidden_for_a_while_and_is_there_again() -> None:
    places = COMES + STANDS
    passes = len(COMES) + 60
    bar = [-40] * passes + list(range(-40, 200, 8))
    results = segmented(images(places, bar=bar))
    whole = [
        overlap
        for overlap, number in zip(overlaps(results, places), range(len(places)), strict=True)
        if number >= len(COMES) and not passes <= number < passes + 30
    ]
    assert min(whole) > 0.6
    standing = [
        {found.id for found in result.objects if (result.labels[truth(70)] == found.id).any()}
        for result in (results[passes - 1], results[-1])
    ]
    assert standing == [{1}, {1}]


@pytest.mark.parametrize("seconds", [1.0, 3.0])
def test_what_stands_for_long_becomes_background(seconds: float) -> None:
    places = COMES + STANDS + GOES
    results = segmented(images(places), stopped=seconds)
    (last,) = [n for n, each in enumerate(results) for found in each.objects if found.absorbed]
    assert last == pytest.approx(len(COMES) + seconds * RATE, abs=12)
    standing = len(COMES + STANDS)
    assert not any(result.objects for result in results[last + 1 : standing - 1])
    # It drives off as another object.
    assert ids(results) == {1, 2}
    assert min(overlaps(results, places)[standing + 10 : standing + 16]) > 0.6


def test_with_no_time_to_stand_it_ends_as_before() -> None:
    places = COMES + STANDS
    results = segmented(images(places), stopped=0.0, max_age=16)
    seen = [number for number, result in enumerate(results) if result.objects]
    assert seen[-1] < len(COMES) + 30
    assert not any(found.absorbed for result in results for found in result.objects)


def test_what_stood_there_from_the_first_frame_on_leaves_no_ghost() -> None:
    places = [40] * 50 + [40 + number for number in range(1, 36)]
    results = segmented(images(places))
    assert len(ids(results)) == 1
    # It is found soon after, and then known to have stood.
    assert np.mean(overlaps(results, places)[57:69]) > 0.75
