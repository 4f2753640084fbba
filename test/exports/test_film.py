"""Films of results: every frame, in its own time, whatever encodes them."""

from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from turbseg_ros.exports.film import Film, FilmError
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

STEP = 40_000_000


def result(
    number: int, stamp: int | None = None, size: tuple[int, int] = (61, 90)
) -> SegmentationResult:
    image = np.full((*size, 3), 60, np.uint8)
    image[20:40, 10 + number : 30 + number] = 220
    labels = np.where(image[..., 0] > 128, 1, 0).astype(np.uint16)
    seen = MovingObject.from_mask(labels > 0, 1)
    taken = number * STEP if stamp is None else stamp
    frame = Frame(taken, image, period=STEP * 1e-9)
    return SegmentationResult(frame, labels, (seen,), np.zeros((6, 9), np.float32), 0.0, "affine")


def times(path: Path) -> list[float]:
    with av.open(str(path)) as container:
        return [float(picture.time) for picture in container.decode(video=0)]


def test_every_result_is_shown_at_its_time(tmp_path: Path) -> None:
    stamps = [0, STEP, 3 * STEP, 4 * STEP]
    with Film(tmp_path / "out.mp4") as out:
        for number, stamp in enumerate(stamps):
            out.add(result(number, stamp))
    assert times(tmp_path / "out.mp4") == pytest.approx([s * 1e-9 for s in stamps], abs=1e-3)


def test_a_film_shows_the_outlines(tmp_path: Path) -> None:
    with Film(tmp_path / "out.mp4") as out:
        out.add(result(0))
    read, picture = cv2.VideoCapture(str(tmp_path / "out.mp4")).read()
    assert read
    assert picture.shape == (60, 90, 3)
    # Grey everywhere but for what was drawn.
    assert (picture.max(axis=2).astype(int) - picture.min(axis=2) > 60).any()


@pytest.mark.parametrize("stamps", [[0, 0, 0], [5 * STEP, 3 * STEP, 0], [0, 10**14, 2 * 10**14]])
def test_stamps_that_say_nothing_make_a_film_all_the_same(
    tmp_path: Path, stamps: list[int]
) -> None:
    with Film(tmp_path / "out.mp4") as out:
        for number, stamp in enumerate(stamps):
            out.add(result(number, stamp))
    shown = times(tmp_path / "out.mp4")
    assert len(shown) == 3
    assert all(0 < b - a <= 2.1 for a, b in itertools.pairwise(shown))


def test_opencv_makes_it_where_pyav_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with Film(tmp_path / "out.mp4") as out:
        for number in range(5):
            out.add(result(number))
    assert len(times(tmp_path / "out.mp4")) == 5


@pytest.mark.parametrize("by_opencv", [False, True])
def test_a_film_that_cannot_be_written_is_one_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_opencv: bool
) -> None:
    if by_opencv:
        monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(FilmError, match="can't be written"):  # noqa: SIM117
        with Film(tmp_path / "missing" / "out.mp4") as out:
            out.add(result(0))


def test_an_exception_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), Film(tmp_path / "out.mp4") as out:
        out.add(result(0))
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_a_frame_of_another_size_is_fitted_in(tmp_path: Path) -> None:
    with Film(tmp_path / "out.mp4") as out:
        out.add(result(0))
        out.add(result(1, size=(50, 80)))
        out.add(result(2, size=(90, 120)))
    assert len(times(tmp_path / "out.mp4")) == 3
