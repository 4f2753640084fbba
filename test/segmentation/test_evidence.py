"""Whether pictures confirm motion, on pictures that are drawn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from turbseg_ros.segmentation.evidence import PictureEvidence

SHAPE = (96, 128)
MIDDLE = np.array([64]), np.array([48])
SIZE = 9


def textured(contrast: float, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, SHAPE), (0, 0), 1.5)
    return 100.0 + contrast * texture / texture.std()


def seen(picture: np.ndarray, noise: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(picture + rng.normal(0.0, noise, SHAPE)), 0, 255).astype(np.uint8)


def shifted(picture: np.ndarray, x: float) -> np.ndarray:
    way = np.array([[1.0, 0.0, x], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(picture, way, SHAPE[::-1], borderMode=cv2.BORDER_REFLECT)


def flow_of(x: float) -> np.ndarray:
    flow = np.zeros((*SHAPE, 2), np.float32)
    flow[..., 0] = x
    return flow


def gain(evidence: PictureEvidence) -> float:
    return float(evidence.gain(*MIDDLE, SIZE)[0])


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_what_really_moved_is_confirmed(noise: float) -> None:
    scene = textured(20.0)
    evidence = PictureEvidence(
        seen(scene, noise, 1), {4: seen(shifted(scene, 3.0), noise, 2)}, {4: flow_of(3.0)}
    )
    assert gain(evidence) > 3.0


@pytest.mark.parametrize("noise", [0.5, 2.0, 8.0])
def test_motion_that_flow_invents_before_a_plain_sky_is_not(noise: float) -> None:
    sky = np.full(SHAPE, 120.0)
    pictures = {k: seen(sky, noise, k + 9) for k in (-4, 4)}
    flow = {k: cv2.GaussianBlur(noisy_flow(k + 9), (0, 0), 6.0) for k in pictures}
    evidence = PictureEvidence(seen(sky, noise, 1), pictures, flow)
    x, y = (each.ravel() for each in np.meshgrid(np.arange(10, 118, 9), np.arange(10, 86, 9)))
    assert evidence.gain(x, y, SIZE).max() < 0.7


def noisy_flow(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 30.0, (*SHAPE, 2)).astype(np.float32)


def test_what_stands_still_under_an_invented_flow_speaks_against_it() -> None:
    scene = textured(20.0)
    flow = flow_of(0.0)
    flow[36:60, 52:76] = (3.0, 0.0)
    evidence = PictureEvidence(seen(scene, 1.0, 1), {4: seen(scene, 1.0, 2)}, {4: flow})
    assert gain(evidence) < -3.0


def test_the_scale_is_the_noise_of_the_picture_not_its_contrast() -> None:
    def of_contrast(share: float) -> float:
        scene = 100.0 + share * (textured(40.0) - 100.0)
        return gain(
            PictureEvidence(
                seen(scene, share * 4.0, 1),
                {4: seen(shifted(scene, 3.0), share * 4.0, 2)},
                {4: flow_of(3.0)},
            )
        )

    assert of_contrast(0.25) == pytest.approx(of_contrast(1.0), rel=0.15)


def test_without_neighbours_nothing_is_confirmed() -> None:
    assert gain(PictureEvidence(seen(textured(20.0), 0.0, 1), {}, {})) == 0.0


def test_a_window_over_the_corner_counts_what_is_in_the_picture() -> None:
    scene = textured(20.0)
    evidence = PictureEvidence(
        seen(scene, 0.0, 1), {4: seen(shifted(scene, 3.0), 0.0, 2)}, {4: flow_of(3.0)}
    )
    corner = np.array([0, SHAPE[1] - 1]), np.array([0, SHAPE[0] - 1])
    assert np.isfinite(evidence.gain(*corner, SIZE)).all()


def test_flow_has_nothing_to_hold_on_to_in_a_plain_sky_and_has_in_leaves() -> None:
    half = textured(20.0)
    half[:, :64] = 120.0
    evidence = PictureEvidence(seen(half, 1.0, 1), {4: seen(half, 1.0, 2)}, {4: flow_of(0.0)})
    textured_there = evidence.textured()
    assert not textured_there[:, :50].any()
    assert textured_there[:, 75:].mean() > 0.95


def test_only_seeds_that_the_pictures_bear_out_are_left() -> None:
    half = textured(20.0)
    half[:, :64] = 120.0
    evidence = PictureEvidence(
        seen(half, 1.0, 1), {4: seen(shifted(half, 3.0), 1.0, 2)}, {4: flow_of(3.0)}
    )
    strength = np.zeros(SHAPE, np.float32)
    strength[48, 30] = strength[48, 100] = 9.0
    left = evidence.confirmed(strength, SIZE, 2.0)
    assert left[48, 30] == 0.0
    assert left[48, 100] == 9.0


def test_a_target_smaller_than_the_window_is_confirmed_by_its_own_pixels() -> None:
    def drawn(x: int, seed: int) -> np.ndarray:
        picture = np.full(SHAPE, 120.0)
        picture[47:50, x : x + 3] = 150.0
        return seen(picture, 2.0, seed)

    evidence = PictureEvidence(drawn(63, 1), {4: drawn(67, 2)}, {4: flow_of(4.0)})
    assert gain(evidence) > 2.0


def test_flow_is_followed_where_it_is_what_moved_and_not_where_it_smears() -> None:
    scene = textured(20.0)
    flows = {k: flow_of(0.0) for k in (-4, 4)}
    for k, flow in flows.items():
        flow[:, 96:] = (2.0 * k, 0.0)
    pictures = {k: seen(scene, 1.0, k + 9) for k in flows}
    followed = PictureEvidence(seen(scene, 1.0, 1), pictures, flows).followed()
    assert followed is not None
    assert followed[:, :88].mean() > 0.9
    assert not followed[:, 104:].any()


def test_nothing_is_followed_before_a_plain_sky() -> None:
    sky = np.full(SHAPE, 120.0)
    evidence = PictureEvidence(seen(sky, 1.0, 1), {4: seen(sky, 1.0, 2)}, {4: flow_of(0.0)})
    assert evidence.followed() is None
    assert PictureEvidence(seen(sky, 1.0, 1), {}, {}).followed() is None
