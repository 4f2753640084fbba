"""Pictures for people."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turbseg_ros.evaluation.labels import result_from_labels
from turbseg_ros.overlay import (
    Canvas,
    IdAnnotator,
    OutlineAnnotator,
    OverlayStrip,
    RegionAnnotator,
    TrailAnnotator,
    colour_of,
    draw_overlay,
    evenly_spaced,
    outlines,
    to_bgr8,
    write_picture,
)
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult
from turbseg_ros.segmentation.marked_regions import (
    MarkedRegion,
    MarkedRegions,
    MaskPicture,
    Polygon,
)
from turbseg_ros.segmentation.resolution import Resolution


def drawn(image: np.ndarray | None = None, object_id: int = 3) -> SegmentationResult:
    """One 20x10 object on a dark frame of 120x80."""
    if image is None:
        image = np.zeros((80, 120), np.uint8)
    labels = np.zeros(image.shape[:2], np.uint16)
    labels[30:40, 50:70] = object_id
    return result_from_labels(Frame(0, image), labels)


def test_outline_of_a_rectangle_is_its_corners() -> None:
    result = drawn()
    (contour,) = outlines(result.labels, result.objects[0])
    assert set(map(tuple, contour.tolist())) == {(50, 30), (69, 30), (69, 39), (50, 39)}


def test_outlines_leave_the_frame_within_and_without_as_it_was() -> None:
    picture = draw_overlay(drawn(), [OutlineAnnotator()]).image
    np.testing.assert_allclose(picture[30, 60], colour_of(3), rtol=0.2)
    assert not picture[34:36, 55:65].any()
    assert not picture[:28].any()


@pytest.mark.parametrize("scale", [0.5, 2.0, 4.0])
def test_outlines_follow_the_scale_of_the_canvas(scale: float) -> None:
    picture = draw_overlay(drawn(), [OutlineAnnotator()], width=round(120 * scale)).image
    rows, columns = np.nonzero(picture.any(axis=2))
    centre = ((columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2)
    assert centre == pytest.approx((60 * scale - 0.5, 35 * scale - 0.5), abs=1.0)


@pytest.mark.parametrize(("width", "thick"), [(480, 2), (1920, 4)])
def test_outlines_are_two_pixels_wide_and_wider_on_large_canvases(width: int, thick: int) -> None:
    picture = draw_overlay(drawn(), [OutlineAnnotator()], width=width).image
    column = picture[: picture.shape[0] // 2 - width // 100, width // 2].max(axis=1)
    assert thick <= np.count_nonzero(column > 128) <= thick + 2


def test_regions_are_broken_lines_in_a_colour_for_each_kind_below_what_was_found() -> None:
    corners = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]])
    mask = np.zeros((80, 120), bool)
    mask[70:, :40] = True
    marked = MarkedRegions(
        (
            MarkedRegion("a", False, Polygon(corners)),
            MarkedRegion("b", True, MaskPicture(mask)),
        )
    ).fitted(Resolution((120, 80), (120, 80), (120, 80)))
    picture = draw_overlay(replace(drawn(), regions=marked), [RegionAnnotator()]).image
    green, red = (picture[..., channel].astype(int) for channel in (1, 2))
    is_green, is_red = green > red + 50, red > green + 50
    # The left side of the one, the right side of the other; about half of each is drawn.
    assert 0.3 < is_green[22:58, 29:31].any(axis=1).mean() < 0.8
    assert 0.3 < is_red[72:, 38:41].any(axis=1).mean() < 0.9
    # The names stand above.
    assert not picture[26:50, 36:84].any()
    assert not draw_overlay(drawn(), [RegionAnnotator()]).image.any()


def test_trail_is_drawn_where_the_object_was() -> None:
    result = drawn()
    moving_object = MovingObject(3, 0, (59.5, 34.5), (2, 0), 200, (50, 30, 20, 10), ((10, 34.5),))
    result = SegmentationResult(
        result.frame, result.labels, (moving_object,), result.motion_map, 0.1, "affine"
    )
    picture = draw_overlay(result, [TrailAnnotator()]).image
    drawn_columns = np.asarray(picture[34:36, 10:60].any(axis=(0, 2)))
    # From its beginning on it is dotted, which no outline is.
    assert drawn_columns[0]
    assert 5 <= np.count_nonzero(np.diff(drawn_columns.astype(int)) == 1) <= 8
    assert not picture[:, :8].any()


def test_an_id_in_the_corner_stays_inside_the_picture() -> None:
    labels = np.zeros((80, 120), np.uint16)
    labels[:6, 110:] = 12345
    result = result_from_labels(Frame(0, np.zeros((80, 120), np.uint8)), labels)
    inside = draw_overlay(result, [IdAnnotator()]).image
    labels = np.roll(labels, (40, -60), axis=(0, 1))
    free = draw_overlay(result_from_labels(result.frame, labels), [IdAnnotator()]).image
    assert np.count_nonzero(inside) == np.count_nonzero(free)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_deep_images_are_stretched(dtype: type) -> None:
    ramp = np.tile(np.linspace(1000, 3000, 256), (64, 1)).astype(dtype)
    grey = to_bgr8(ramp)[0, :, 0]
    assert grey[0] < 64
    assert grey[-1] > 191
    assert (np.diff(grey.astype(int)) >= 0).all()


def test_float_images_without_a_finite_value_are_black() -> None:
    assert not to_bgr8(np.full((8, 8), np.nan, np.float32)).any()


def test_a_flat_deep_image_divides_by_nothing() -> None:
    assert not to_bgr8(np.full((8, 8), 700, np.uint16)).any()


def test_drawing_leaves_the_frame_alone() -> None:
    image = np.zeros((80, 120, 3), np.uint8)
    draw_overlay(drawn(image))
    assert not image.any()


@given(total=st.integers(1, 500), wanted=st.integers(1, 20))
def test_evenly_spaced_indices_rise_over_the_whole(total: int, wanted: int) -> None:
    indices = evenly_spaced(total, wanted)
    assert indices == sorted(set(indices))
    assert len(indices) == min(total, wanted)
    assert indices[0] == 0
    if len(indices) > 1:
        assert indices[-1] == total - 1


def test_strip_shows_first_and_last_frame() -> None:
    strip = OverlayStrip(frames=10, tiles=4, tile_width=60)
    for grey in range(0, 100, 10):
        strip.add(drawn(np.full((80, 120), 100 + grey, np.uint8)))
    picture = strip.picture(columns=2)
    assert picture.shape == (2 * 40 + 4, 2 * 60 + 4, 3)
    assert picture[38, 58, 0] == 100
    assert picture[-2, -2, 0] == 190


def test_a_strip_without_frames_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        OverlayStrip(frames=3).picture()


def test_picture_is_written_as_it_is(tmp_path: Path) -> None:
    picture = Canvas.of(np.arange(256, dtype=np.uint8).reshape(16, 16)).image
    write_picture(tmp_path / "picture.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "picture.png")), picture)
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.png"]


def test_a_picture_called_jpg_is_one(tmp_path: Path) -> None:
    write_picture(tmp_path / "picture.jpg", np.full((16, 16, 3), 90, np.uint8))
    assert (tmp_path / "picture.jpg").read_bytes().startswith(b"\xff\xd8")
