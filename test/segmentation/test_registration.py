"""Registration of pictures whose motion is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.drawn_scene import ByteImage, texture
from turbseg_ros.segmentation.geometry import pixel_grid
from turbseg_ros.segmentation.registration import (
    align,
    phase_correlation,
    register_affine,
    visible,
)

SHAPE = (144, 240)
GROUND = texture(SHAPE, seed=5, low=0, high=255, grain=2.0)


def shift(x: float, y: float) -> np.ndarray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def camera_motion(degrees: float, zoom: float, x: float, y: float) -> np.ndarray:
    centre = (SHAPE[1] / 2, SHAPE[0] / 2)
    turned = np.vstack([cv2.getRotationMatrix2D(centre, degrees, zoom), [0, 0, 1]])
    return shift(x, y) @ turned


def warped(image: ByteImage, transform: np.ndarray) -> ByteImage:
    return cv2.warpAffine(
        image,
        transform[:2],
        (image.shape[1], image.shape[0]),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT,
    )


def largest_error(found: np.ndarray | None, true: np.ndarray) -> float:
    """Distance in pixels between where two transforms take a pixel, where it is worst."""
    points = pixel_grid(SHAPE).reshape(-1, 1, 2).astype(float)
    there = cv2.perspectiveTransform(points, found) - cv2.perspectiveTransform(points, true)
    return float(np.linalg.norm(there, axis=-1).max())


@pytest.mark.parametrize("step", [(0, 0), (5, -3), (2.5, 1.25), (-14, 9)], ids=str)
def test_phase_correlation_finds_a_translation(step: tuple[float, float]) -> None:
    found, _ = phase_correlation(GROUND, warped(GROUND, shift(*step)))
    assert found[:2, :2].tolist() == [[1, 0], [0, 1]]
    # It only has to put the search for corners on the right track.
    np.testing.assert_allclose(found[:2, 2], step, atol=0.25)


@pytest.mark.parametrize(
    "motion",
    [
        np.eye(3),
        shift(7.0, -4.0),
        camera_motion(1.0, 1.0, 0.0, 0.0),
        camera_motion(-0.5, 1.01, 9.3, 4.6),
        camera_motion(0.3, 0.99, -12.0, -6.0),
    ],
    ids=["none", "shift", "roll", "all", "strong shake"],
)
def test_an_affine_motion_is_found_within_a_tenth_of_a_pixel(motion: np.ndarray) -> None:
    assert largest_error(register_affine(GROUND, warped(GROUND, motion)), motion) < 0.1


def test_a_leap_by_a_third_of_the_picture_is_found() -> None:
    leap = shift(-70.0, 40.0)
    # Half of the picture is left to measure it by.
    assert largest_error(register_affine(GROUND, warped(GROUND, leap)), leap) < 0.2


def with_lorry(image: ByteImage, x: int) -> ByteImage:
    """Paint a textured object over a third of the picture."""
    union_mask = image.copy()
    union_mask[30:126, x : x + 120] = texture((96, 120), seed=6, low=0, high=255, grain=2.0)
    return union_mask


def test_objects_before_a_faint_sky_take_no_part_in_the_ego_motion() -> None:
    """Two objects at different heights, whose motions an affine transform could explain."""
    sky = texture((240, 400), seed=8, low=196, high=204, grain=3.0)
    pictures = []
    for number in range(2):
        picture = sky.astype(float)
        for seed, top, left in ((1, 30, 100 + 3 * number), (2, 180, 260 - 4 * number)):
            picture[top : top + 24, left : left + 48] = texture((24, 48), seed, low=0, high=255)
        picture += np.random.default_rng(number).normal(0, 1.0, picture.shape)
        pictures.append(np.clip(picture, 0, 255).astype(np.uint8))
    found = register_affine(*pictures)
    assert found is not None
    corners = np.array([[[0.0, 0.0]], [[399.0, 0.0]], [[0.0, 239.0]], [[399.0, 239.0]]])
    assert np.abs(cv2.perspectiveTransform(corners, found) - corners).max() < 1.5


def test_a_big_moving_object_takes_no_part_in_the_ego_motion() -> None:
    motion = camera_motion(0.3, 1.0, 2.0, -1.0)
    source = with_lorry(GROUND, 60)
    target = with_lorry(warped(GROUND, motion), 71)
    # Only corners at the rim are left.
    assert largest_error(register_affine(source, target), motion) < 0.2


@pytest.mark.parametrize(
    "other",
    [
        np.random.default_rng(0).integers(0, 256, SHAPE).astype(np.uint8),
        texture(SHAPE, seed=6, low=0, high=255, grain=2.0),
        np.random.default_rng(0).poisson(3.0, SHAPE).astype(np.uint8),
        np.full(SHAPE, 128, np.uint8),
        np.zeros(SHAPE, np.uint8),
    ],
    ids=["noise", "another scene", "covered lens", "plain", "black"],
)
def test_pictures_with_nothing_in_common_have_no_motion(other: ByteImage) -> None:
    for source, target in ((GROUND, other), (other, GROUND)):
        assert register_affine(source, target) is None


@pytest.mark.parametrize("shape", [(16, 16), (36, 64), (90, 160), (243, 432)], ids=str)
def test_noise_has_nothing_in_common_with_noise(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        source, target = random.integers(0, 256, (2, *shape)).astype(np.uint8)
        assert register_affine(source, target) is None


def test_with_too_few_corners_the_translation_stands() -> None:
    window = np.full(SHAPE, 40, np.uint8)
    window[50:100, 90:150] = 200
    target = warped(window, shift(4.0, -2.0))
    found = register_affine(window, target)
    assert found is not None
    np.testing.assert_array_equal(found, phase_correlation(window, target)[0])
    np.testing.assert_allclose(found[:2, 2], (4.0, -2.0), atol=0.5)


@pytest.mark.parametrize("grey", [0, 1, 128, 255])
def test_a_plain_picture_lies_anywhere(grey: int) -> None:
    plain = np.full(SHAPE, grey, np.uint8)
    assert register_affine(plain, plain) is None


def test_aligning_undoes_the_motion_where_the_other_frame_sees_it() -> None:
    motion = camera_motion(0.5, 1.01, 6.0, -3.0)
    aligned = align(warped(GROUND, motion), motion)
    inside = visible(SHAPE, motion, margin=2.0)
    assert 0.8 < inside.mean() < 1.0
    difference = np.abs(aligned.astype(float) - GROUND)[inside]
    assert np.percentile(difference, 99) < 8.0


def test_a_pixel_is_visible_when_the_other_frame_holds_it() -> None:
    seen = visible((4, 6), shift(2.0, -1.0))
    expected = np.zeros((4, 6), bool)
    expected[1:, :4] = True
    np.testing.assert_array_equal(seen, expected)


def test_a_margin_keeps_off_the_other_frames_border() -> None:
    expected = np.zeros((6, 8), bool)
    expected[2:4, 2:6] = True
    np.testing.assert_array_equal(visible((6, 8), np.eye(3), margin=2.0), expected)
