"""What happens to pictures on their way."""

from __future__ import annotations

import numpy as np
import pytest

from support.drawn_scene import texture
from turbseg_ros.simulation.transmission import Transmission, random_transmission

SHAPE = (96, 160)
PICTURE = texture(SHAPE, 1)
COLOUR = np.dstack([PICTURE, PICTURE // 2, PICTURE])


def received(how: Transmission, image: np.ndarray = PICTURE, frame: int = 0) -> np.ndarray:
    return how.receiver().received(image, frame)


@pytest.mark.parametrize("image", [PICTURE, COLOUR])
def test_a_good_line_changes_nothing(image: np.ndarray) -> None:
    np.testing.assert_array_equal(received(Transmission(), image), image)


@pytest.mark.parametrize("image", [PICTURE, COLOUR])
def test_a_low_quality_shows_blocks(image: np.ndarray) -> None:
    fine, coarse = (received(Transmission(quality=quality), image) for quality in (95, 15))
    errors = [np.abs(each.astype(int) - image).mean() for each in (fine, coarse)]
    assert fine.shape == coarse.shape == image.shape
    assert 0 < errors[0] < errors[1] / 2


def test_a_lower_resolution_takes_detail_away() -> None:
    def detail(image: np.ndarray) -> float:
        return float(np.abs(np.diff(image.astype(int), axis=1)).mean())

    assert detail(received(Transmission(reduction=2.5))) < 0.8 * detail(PICTURE)


def test_interlaced_rows_are_late() -> None:
    receiver = Transmission(interlaced=True).receiver()
    dark, bright = (np.full(SHAPE, value, np.uint8) for value in (20, 200))
    receiver.received(dark, 0)
    woven = receiver.received(bright, 1)
    assert set(np.unique(woven[::2])) == {200}
    assert set(np.unique(woven[1::2])) == {110}
    assert set(np.unique(receiver.received(bright, 2))) == {200}


def test_text_stands_still_and_the_clock_runs() -> None:
    how = Transmission(texts=(("CAM 1", 0.5, 0.9),), clock=True)
    one, other = (received(how, frame=frame) for frame in (3, 38))
    changed = one != other
    assert (one != PICTURE)[60:, 80:].any()
    assert not changed[30:].any()
    assert changed[:30].any()


def test_drawn_lines_differ() -> None:
    rng = np.random.default_rng(0)
    drawn = [random_transmission(rng) for _ in range(200)]
    for how in drawn:
        assert received(how).shape == SHAPE
    for share in (
        np.mean([how.quality > 0 for how in drawn]),
        np.mean([how.reduction > 1 for how in drawn]),
        np.mean([bool(how.texts) for how in drawn]),
        np.mean([how.interlaced for how in drawn]),
    ):
        assert 0.01 < share < 0.7
