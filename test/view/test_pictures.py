"""Camera images as JPEG, waiting for their results."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from turbseg_ros.view.pictures import Jpeg, JpegEncoder, Pace, WaitingPictures

PICTURE = Jpeg(b"", (1, 1))


def decoded(picture: Jpeg) -> npt.NDArray[np.uint8]:
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image)


@pytest.mark.parametrize("shape", [(90, 160), (90, 160, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_images_of_any_depth_become_pictures(
    shape: tuple[int, ...], dtype: type[np.generic]
) -> None:
    image = np.zeros(shape, dtype)
    image[:, 80:] = np.asarray(200).astype(dtype)
    picture = JpegEncoder(width=640).encode(image)
    assert picture.size == (160, 90)
    found = decoded(picture)
    assert found.shape == shape
    assert float(found[:, 100:].mean()) > float(found[:, :60].mean()) + 100


def test_large_images_are_made_smaller_and_tell_their_own_size() -> None:
    picture = JpegEncoder(width=320).encode(np.zeros((1080, 1920), np.uint8))
    assert picture.size == (1920, 1080)
    assert decoded(picture).shape == (180, 320)


def test_a_result_gets_the_picture_of_its_image_and_earlier_ones_go() -> None:
    waiting = WaitingPictures()
    pictures = {stamp: Jpeg(bytes([stamp]), (1, 1)) for stamp in range(5)}
    for stamp, picture in pictures.items():
        waiting.add(stamp, picture)
    assert waiting.take(2) is pictures[2]
    assert waiting.take(1) is None
    assert waiting.take(9) is None
    assert waiting.take(4) is pictures[4]


def test_pictures_that_no_result_asks_for_are_in_vain() -> None:
    waiting = WaitingPictures()
    for stamp in range(200):
        waiting.add(stamp, PICTURE)
        waiting.take(-1)
    assert waiting.are_in_vain
    assert waiting.take(0) is None
    assert waiting.take(199) is PICTURE
    assert not waiting.are_in_vain


def test_no_more_pass_than_may_and_no_burst_follows_a_pause() -> None:
    pace = Pace(10.0)
    passed = [now for now in np.arange(0, 10, 0.033) if pace.lets_through(float(now))]
    assert 95 <= len(passed) <= 102
    after = [now for now in np.arange(60, 61, 0.001) if pace.lets_through(float(now))]
    assert len(after) <= 12
