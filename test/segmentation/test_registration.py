"""Registration of pictures whose motion is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.drawn_scene import ByteImage, texture
from turbseg_ros.segmentation import registration
from turbseg_ros.segmentation.geometry import pixel_grid
from turbseg_ros.segmentation.registration import (
    EgoMotionModel,
    align,
    phase_correlation,
    register,
    visible,
    without_vote,
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


def affine(source: ByteImage, target: ByteImage) -> np.ndarray:
    """Register pictures whose motion can be told in full."""
    found = register(source, target)
    assert found is not None
    assert found.model is EgoMotionModel.AFFINE
    return found.motion


def largest_error(found: np.ndarray, true: np.ndarray) -> float:
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
    assert largest_error(affine(GROUND, warped(GROUND, motion)), motion) < 0.1


@pytest.mark.parametrize(
    ("motion", "stands"),
    [
        (np.eye(3), True),
        (camera_motion(0.1, 1.002, 0.4, -0.3), True),
        (shift(3.0, 1.0), False),
        (camera_motion(0.3, 0.99, -12.0, -6.0), False),
        (shift(-70.0, 40.0), False),
    ],
    ids=["none", "jitter", "shift", "strong shake", "leap"],
)
def test_a_camera_that_stood_may_move_on(motion: np.ndarray, stands: bool) -> None:
    found = register(GROUND, warped(GROUND, motion), stands=True)
    assert found is not None
    assert largest_error(found.motion, motion) < 0.2
    assert found.stands is stands
    # As it is found by one who doesn't know that it stood.
    anyway = register(GROUND, warped(GROUND, motion))
    assert anyway is not None
    assert anyway.stands is stands


def test_a_camera_that_stands_is_told_by_its_corners_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def asked(*_: object) -> None:
        raise AssertionError("corners tell it")

    monkeypatch.setattr(registration, "phase_correlation", asked)
    found = register(noisy(GROUND, 1), noisy(GROUND, 2), stands=True)
    assert found is not None
    assert found.stands


def test_another_scene_is_no_camera_that_stands() -> None:
    other = texture(SHAPE, seed=11, low=0, high=255, grain=2.0)
    assert register(GROUND, other, stands=True) is None


def test_a_leap_by_a_third_of_the_picture_is_found() -> None:
    leap = shift(-70.0, 40.0)
    # Half of the picture is left to measure it by.
    assert largest_error(affine(GROUND, warped(GROUND, leap)), leap) < 0.2


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
    found = affine(*pictures)
    corners = np.array([[[0.0, 0.0]], [[399.0, 0.0]], [[0.0, 239.0]], [[399.0, 239.0]]])
    assert np.abs(cv2.perspectiveTransform(corners, found) - corners).max() < 1.5


def test_a_big_moving_object_takes_no_part_in_the_ego_motion() -> None:
    motion = camera_motion(0.3, 1.0, 2.0, -1.0)
    source = with_lorry(GROUND, 60)
    target = with_lorry(warped(GROUND, motion), 71)
    # Only corners at the rim are left.
    assert largest_error(affine(source, target), motion) < 0.2


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
        assert register(source, target, stood=True) is None
        assert register(source, target) is None


@pytest.mark.parametrize("shape", [(16, 16), (36, 64), (90, 160), (243, 432)], ids=str)
def test_noise_has_nothing_in_common_with_noise(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        source, target = random.integers(0, 256, (2, *shape)).astype(np.uint8)
        assert register(source, target) is None


def noisy(image: ByteImage, seed: int, deviation: float = 1.5) -> ByteImage:
    noise = np.random.default_rng(seed).normal(0.0, deviation, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def sky_with_target(x: int, y: int, seed: int, size: tuple[int, int] = (12, 20)) -> ByteImage:
    """A plain sky with a sensor's noise, and one textured target before it."""
    sky = np.full((243, 432), 190, np.uint8)
    sky[y : y + size[0], x : x + size[1]] = texture(size, seed=4, low=20, high=150)
    return noisy(sky, seed)


@pytest.mark.parametrize("step", [(0, 0), (3, -1), (15, 6)], ids=str)
def test_one_target_before_a_plain_sky_tells_no_camera_motion(step: tuple[int, int]) -> None:
    found = register(
        sky_with_target(200, 120, 1), sky_with_target(200 + step[0], 120 + step[1], 2)
    )
    assert found is not None
    assert found.model is EgoMotionModel.HELD
    assert not found.is_supported
    np.testing.assert_array_equal(found.motion, np.eye(3))


def test_corners_of_one_plain_block_tell_no_camera_motion() -> None:
    window = np.full(SHAPE, 40, np.uint8)
    window[50:100, 90:150] = 200
    found = register(window, warped(window, shift(4.0, -2.0)))
    assert found is not None
    assert found.model is EgoMotionModel.HELD


def test_a_line_of_corners_bears_out_a_similarity_at_most() -> None:
    """A skyline under a plain sky: how the picture is stretched upwards, nobody can tell."""
    land = np.full((243, 432), 190, np.uint8)
    land[225:] = texture((18, 432), seed=3, low=20, high=150)
    found = register(noisy(land, 1), noisy(warped(land, shift(4.0, -2.0)), 2))
    assert found is not None
    assert found.model in (EgoMotionModel.SIMILARITY, EgoMotionModel.TRANSLATION)
    np.testing.assert_allclose(found.motion[:2, :2], np.eye(2), atol=0.02)
    np.testing.assert_allclose(found.motion @ (216, 234, 1), (220, 232, 1), atol=0.5)


def test_noise_does_not_keep_a_scene_from_being_registered() -> None:
    ground = texture((300, 500), seed=5, low=90, high=170, grain=3.0)
    source, target = ground[30:273, 30:462], ground[32:275, 27:459]
    found = register(noisy(source, 1, 8.0), noisy(target, 2, 8.0))
    assert found is not None
    assert found.is_supported
    np.testing.assert_allclose(found.motion @ (216, 121, 1), (219, 119, 1), atol=0.6)


def through_air(image: ByteImage, tilt: float, seed: int) -> ByteImage:
    """Return a picture whose places are moved by so many pixels rms an axis, neighbours alike."""
    random = np.random.default_rng(seed)
    height, width = image.shape
    noise = random.normal(size=(height, width, 2)).astype(np.float32)
    field = cv2.GaussianBlur(noise, None, 9.0)
    field *= tilt / field.std()
    there = (pixel_grid((height, width)).reshape(height, width, 2) + field).astype(np.float32)
    return cv2.remap(image, there, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("step", [(0, 0), (6, -4)], ids=str)
def test_a_scene_through_strong_turbulence_is_registered(step: tuple[int, int]) -> None:
    shape = (243, 432)
    fine, coarse = (texture(shape, seed=7, low=0, high=255, grain=g) for g in (1.5, 9.0))
    scene = cv2.addWeighted(fine, 0.4, coarse, 0.6, 0.0)
    for seed in range(4):
        source = through_air(scene, 2.0, seed)
        target = warped(through_air(scene, 2.0, seed + 100), shift(*step))
        found = register(source, target)
        assert found is not None
        assert found.is_supported
        middle = found.motion @ (216.0, 121.0, 1.0)
        np.testing.assert_allclose(middle[:2], np.add((216, 121), step), atol=1.5)


def test_what_has_no_vote_does_not_register_the_picture() -> None:
    """A lorry over two thirds of the view moves, the ground behind it stays."""
    pictures = []
    for number, x in enumerate((40, 47)):
        picture = GROUND.copy()
        picture[10:134, x : x + 170] = texture((124, 170), seed=6, low=0, high=255, grain=2.0)
        pictures.append(noisy(picture, number))
    lorry = np.zeros((36, 60), bool)
    lorry[2:34, 9:54] = True
    found = register(pictures[0], pictures[1], lorry)
    assert found is not None
    assert largest_error(found.motion, np.eye(3)) < 0.3


def test_a_target_that_fills_the_view_tells_no_camera_motion() -> None:
    target = texture((243, 532), seed=6, low=0, high=255, grain=2.0)
    everything = np.ones((61, 108), bool)
    everything[:2] = False
    found = register(noisy(target[:, 7:439], 1), noisy(target[:, :432], 2), everything)
    assert found is not None
    assert found.model is EgoMotionModel.HELD


def test_fast_objects_over_much_of_a_still_view_are_not_its_motion() -> None:
    # Cars that fill more than a third of a road with little texture go on by 24 pixels.
    road = texture((240, 320), seed=5, grain=3.0).astype(np.float32)
    road = 110.0 + 0.3 * (road - road.mean())
    cars = texture((240, 320), seed=6, grain=3.0)
    where = np.zeros((240, 320), bool)
    where[:, 40:100] = where[:, 180:240] = True
    source, target = (
        np.where(where, np.roll(cars, step, axis=0), road).astype(np.uint8) for step in (0, 24)
    )
    found = register(source, target)
    assert found is not None
    assert np.abs(found.motion - np.eye(3)).max() < 0.5


def traffic(step: int) -> ByteImage:
    """A faint road with cars over half of it, which have gone on by some pixels."""
    ground = texture((240, 320), seed=5, grain=3.0).astype(np.float32)
    seen = 110.0 + 0.2 * (ground - ground.mean())
    seen[:, 80:240] = np.roll(texture((240, 160), seed=6, grain=3.0), step, axis=0)
    return noisy(seen, step)


def test_what_fills_half_of_a_view_does_not_move_a_camera_that_stood() -> None:
    known, told = (register(traffic(0), traffic(18), stood=each) for each in (True, False))
    assert known is not None
    assert told is not None
    assert np.array_equal(known.motion, np.eye(3))
    assert known.outvoted
    # One pair of pictures doesn't tell it.
    assert told.motion[1, 2] == pytest.approx(18.0, abs=1.0)


def test_a_camera_that_stood_may_be_moved() -> None:
    motion = shift(14.0, -9.0)
    found = register(GROUND, warped(GROUND, motion), stood=True)
    assert found is not None
    assert not found.outvoted
    assert largest_error(found.motion, motion) < 0.2


def test_a_view_that_changes_but_for_its_margin_is_the_same_scene() -> None:
    # Leaves before the lens, no two pictures alike; what is beside them stays.
    before, after = GROUND.copy(), GROUND.copy()
    for seed, picture in enumerate((before, after)):
        picture[:, 40:] = texture((144, 200), seed=20 + seed, low=0, high=255, grain=2.0)
    assert register(before, after) is None
    found = register(before, after, stood=True)
    assert found is not None
    assert np.abs(found.motion - np.eye(3)).max() < 0.5


@pytest.mark.parametrize("grey", [0, 1, 128, 255])
def test_a_plain_picture_lies_anywhere(grey: int) -> None:
    plain = np.full(SHAPE, grey, np.uint8)
    assert register(plain, plain) is None


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


def test_objects_have_a_vote_unless_they_are_large() -> None:
    small, large, overlay = (np.zeros((36, 60), bool) for _ in range(3))
    small[10:14, 10:20], large[5:30, 10:50], overlay[:3] = True, True, True
    assert without_vote(None, small) is None
    assert without_vote(overlay, small) is overlay
    assert without_vote(None, large) is large
    np.testing.assert_array_equal(without_vote(overlay, large), overlay | large)
