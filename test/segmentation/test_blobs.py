"""What stands out from all of its surroundings in one picture, small and large."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.drawn_sky import sky_with_dots
from turbseg_ros.segmentation.blobs import SCALES, blob_pyramid, blobs_in


def test_what_stands_out_is_found_where_it_is() -> None:
    blobs = blobs_in(sky_with_dots([(50.3, 40.0)], 1))
    assert blobs.points.shape == (1, 2)
    np.testing.assert_allclose(blobs.points[0], (50.3, 40.0), atol=0.4)
    assert blobs.contrast[0] > 10.0


def test_a_darker_target_has_a_negative_contrast() -> None:
    blobs = blobs_in(sky_with_dots([(50.0, 40.0)], 1, contrast=-40.0))
    assert len(blobs.contrast) == 1
    assert blobs.contrast[0] < -10.0


@pytest.mark.parametrize("part", [np.s_[:0], np.s_[70:], np.s_[20:23], np.s_[:, 80:83]], ids=str)
def test_noise_edges_and_wires_do_not_stand_out(part: tuple[slice, ...]) -> None:
    seen = sky_with_dots([], 1)
    seen[part] += 50
    assert len(blobs_in(seen).points) == 0


def disc(radius: int, shape: tuple[int, int] = (240, 320)) -> np.ndarray:
    """Draw a bright disc at (150.5, 110.5) before a sky of noise 1."""
    sky = np.full(shape, 90, np.uint8)
    cv2.circle(sky, (150, 110), radius, 130, cv2.FILLED)
    noise = np.random.default_rng(1).normal(0.0, 1.0, shape)
    return np.clip(np.rint(sky + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("radius", "scale"), [(2, 1), (10, 4), (28, 8)])
def test_what_is_large_stands_out_in_a_smaller_picture(radius: int, scale: int) -> None:
    found = dict(zip(SCALES, blob_pyramid(disc(radius)), strict=True))
    (place,) = found[scale].points
    np.testing.assert_allclose(scale * (place + 0.5) - 0.5, (150.0, 110.0), atol=0.3 * scale)
    assert found[scale].contrast[0] > 10.0
    assert all(len(found[other].points) == 0 for other in SCALES if other < scale)


@pytest.mark.parametrize("shape", [(16, 16), (16, 700), (50, 51)], ids=str)
def test_a_picture_too_small_for_a_scale_has_no_blob_of_it(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(1)
    found = blob_pyramid(random.integers(0, 255, shape, dtype=np.uint8))
    assert len(found) == len(SCALES)
    assert len(found[-1].points) == 0
