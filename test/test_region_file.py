"""Files of marked regions: what they say, and one line for each mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from turbseg_ros.parameters import ParameterError, Parameters, RegionsParameters
from turbseg_ros.region_file import marked_regions, mask_picture, regions_in
from turbseg_ros.segmentation.marked_regions import Limits, MarkedRegion

SQUARE = [[0.25, 0.5], [0.75, 0.5], [0.75, 1.0], [0.25, 1.0]]


def content(*regions: object, **more: object) -> bytes:
    return json.dumps({"regions": list(regions), **more}).encode()


def read(*regions: object, **more: object) -> list[MarkedRegion]:
    return regions_in(content(*regions, **more), "file")


def refusal(given: bytes, *, is_json: bool = True) -> str:
    with pytest.raises(ParameterError) as caught:
        regions_in(given, "marks", is_json=is_json)
    return str(caught.value)


def test_a_region_is_a_polygon_with_a_name_a_kind_and_limits() -> None:
    text = """
    regions:
      - {name: trees, polygon: [[0, 0], [1, 0], [1, 0.5]]}
      - name: runway
        kind: include
        polygon: [[0.25, 0.5], [75e-2, 0.5], [0.75, 1], [0.25, 1]]
        min_size: 12
        max_size: 400
        min_speed: 20.5
    """
    trees, runway = regions_in(text.encode(), "file")
    assert (trees.name, trees.ignored, trees.limits) == ("trees", True, Limits())
    assert (runway.name, runway.ignored) == ("runway", False)
    assert runway.limits == Limits(12.0, 400.0, 20.5)
    assert runway.shape.size is None
    expected = np.zeros((10, 20), bool)
    expected[5:, 5:15] = True
    # A polygon holds the pixels that its border goes through.
    (found,) = [runway.shape.mask((20, 10))]
    assert (found & expected).sum() == expected.sum()
    assert found.sum() <= expected.sum() + 20


def test_pixels_are_those_of_a_picture_whose_size_the_file_says() -> None:
    square = [[x * 640, y * 480] for x, y in SQUARE]
    (in_pixels,) = read({"polygon": square}, image_size=[640, 480])
    (in_fractions,) = read({"polygon": SQUARE})
    assert in_pixels.shape.size == (640, 480)
    for size in ((640, 480), (320, 240), (111, 83)):
        np.testing.assert_array_equal(in_pixels.shape.mask(size), in_fractions.shape.mask(size))


def test_regions_without_names_are_numbered() -> None:
    assert [region.name for region in read({"polygon": SQUARE}, {"polygon": SQUARE})] == [
        "region 1",
        "region 2",
    ]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (b"regions: [{polygon: [", "not a YAML file"),
        (b"\xff\xfe\x00", "not YAML"),
        ("a: b\nim, \u03a2, {".encode(), "not a YAML file"),
        (b"", "no file of regions"),
        (b"[1, 2]", "no file of regions"),
        (b"/**: {ros__parameters: {}}", "no file of regions"),
        (content({}), "region 1: it has no polygon"),
        (content([]), "region 1: expected name, kind and polygon"),
        (b'{"regions": {}}', "regions is no list"),
        (content(*[{"polygon": SQUARE}] * 101), "101 regions, of which 100"),
        (
            content({"name": "road", "polygn": SQUARE}),
            "region 1 (road): unknown key 'polygn'; did",
        ),
        (content({"polygon": SQUARE}, size=[1, 1]), "unknown key 'size'"),
        (content({"polygon": SQUARE, "kind": "mask"}), "kind is one of ignore, include, not"),
        (content({"polygon": SQUARE[:2]}), "3 to 500 corners, not 2"),
        (content({"polygon": [[0, 0]] * 501}), "3 to 500 corners, not 501"),
        (content({"polygon": "0 0 1 1"}), "a polygon is a list of corners, each [x, y]"),
        (content({"polygon": [[0, 0, 0]] * 3}), "each [x, y]"),
        (content({"polygon": [[0, True]] * 3}), "each [x, y]"),
        (content({"polygon": [[0, 0], [1, float("nan")], [1, 1]]}), "each [x, y]"),
        (
            content({"polygon": [[0, 0], [320, 0], [320, 240]]}),
            "corner [320, 0] lies beyond 0 to 1; for corners in pixels the file says image_size",
        ),
        (
            content({"polygon": [[0, 0], [320, 0], [320, -1]]}, image_size=[320, 240]),
            "corner [320, -1] lies beyond the picture of 320x240",
        ),
        (content({"polygon": [[0, 0], [0.5, 0.5], [1, 1]]}), "the polygon has no area"),
        (content({"polygon": [[0.2, 0.2]] * 4}), "the polygon has no area"),
        (content({"polygon": [[1, 0], [1, 1], [1, 0], [0, 1]]}), "the polygon has no area"),
        (content({"polygon": [[0, 0], [1, 1], [1, 0], [0, 1]]}), "sides 1 and 3 of the polygon"),
        (content({"polygon": SQUARE}, image_size=[640]), "image_size takes [width, height]"),
        (content({"polygon": SQUARE}, image_size=[640, 0]), "image_size takes [width, height]"),
        (content({"polygon": SQUARE, "min_size": 3}), "min_size is for regions of kind include"),
        (
            content({"polygon": SQUARE, "kind": "include", "min_speed": -1}),
            "min_speed takes a number from 0 on, not -1",
        ),
        (
            content({"polygon": SQUARE, "kind": "include", "min_size": 9, "max_size": 8}),
            "min_size is above max_size",
        ),
        (content({"polygon": SQUARE, "name": "a\nb"}), "a name is one line of up to 60"),
        (content({"polygon": SQUARE, "name": ""}), "a name is one line of up to 60"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_file(given: bytes, text: str) -> None:
    said = refusal(given, is_json=given.startswith(b"{"))
    assert said.startswith("marks: ")
    assert text in said
    assert "\n" not in said


NUMBERS = st.one_of(st.integers(), st.floats(), st.text(max_size=3), st.booleans(), st.none())
POINTS = st.lists(st.one_of(NUMBERS, st.floats(0, 1)), max_size=3)
TREES = st.fixed_dictionaries(
    {},
    optional={
        "image_size": st.lists(st.integers(0, 50), max_size=3),
        "regions": st.lists(
            st.fixed_dictionaries(
                {},
                optional={
                    "name": st.text(max_size=70),
                    "kind": st.sampled_from(["ignore", "include", "other"]),
                    "polygon": st.lists(POINTS, max_size=5),
                    "min_size": NUMBERS,
                    "max_size": NUMBERS,
                    "min_speed": NUMBERS,
                },
            ),
            max_size=3,
        ),
    },
)


def assert_read_or_refused(given: bytes, is_json: bool) -> None:
    try:
        regions = regions_in(given, "marks", is_json=is_json)
    except ParameterError as error:
        assert str(error).isprintable()
        return
    for region in regions:
        assert region.shape.mask((16, 9)).any()


@settings(deadline=None)
@given(tree=TREES)
def test_whatever_a_file_says_it_is_read_or_refused_in_one_line(tree: dict[str, Any]) -> None:
    assert_read_or_refused(json.dumps(tree).encode(), is_json=True)
    assert_read_or_refused(yaml.safe_dump(tree).encode(), is_json=False)


@settings(deadline=None)
@given(given=st.binary(max_size=80), is_json=st.booleans())
def test_whatever_bytes_a_file_holds_it_is_read_or_refused_in_one_line(
    given: bytes, is_json: bool
) -> None:
    assert_read_or_refused(given, is_json)


@settings(deadline=None)
@given(
    angles=st.lists(st.integers(0, 359), min_size=3, max_size=8, unique=True),
    size=st.tuples(st.integers(1, 2000), st.integers(1, 2000)),
    limits=st.tuples(st.integers(0, 50), st.integers(50, 900), st.integers(0, 900)),
)
def test_yaml_and_json_say_the_same(
    angles: list[int], size: tuple[int, int], limits: tuple[int, int, int]
) -> None:
    turns = np.radians(sorted(angles))
    # On a circle, so that no two sides cross.
    corners = (0.5 + 0.5 * np.stack([np.cos(turns), np.sin(turns)], axis=-1)) * size
    names = ("min_size", "max_size", "min_speed")
    region = {
        "name": "a",
        "kind": "include",
        "polygon": np.clip(corners, 0, size).tolist(),
        **dict(zip(names, limits, strict=True)),
    }
    tree = {"image_size": list(size), "regions": [region]}
    (one,) = regions_in(json.dumps(tree).encode(), "file", is_json=True)
    (other,) = regions_in(yaml.safe_dump(tree).encode(), "file")
    assert one.limits == other.limits == Limits(*map(float, limits))
    np.testing.assert_array_equal(one.shape.mask((64, 48)), other.shape.mask((64, 48)))


def test_a_mask_is_what_is_white_whatever_its_depth_and_colours() -> None:
    white = np.zeros((6, 8), np.uint8)
    white[2:4, 3:] = 255
    for picture in (white, white.astype(np.uint16) * 257, cv2.merge([white] * 4)):
        _, encoded = cv2.imencode(".png", picture)
        np.testing.assert_array_equal(mask_picture(encoded.tobytes(), "m").pixels, white > 0)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (b"", "m: not a picture; polygons are named by regions.file"),
        (b"regions: []", "m: not a picture; polygons are named by regions.file"),
        (
            cv2.imencode(".png", np.ones((4, 4), np.uint8))[1].tobytes(),
            "m: nothing of the picture",
        ),
    ],
)
def test_a_mask_that_is_none_is_one_line(given: bytes, text: str) -> None:
    with pytest.raises(ParameterError) as caught:
        mask_picture(given, "m")
    assert text in str(caught.value)


@pytest.mark.parametrize("name", ["file", "ignore", "include"])
def test_a_file_that_is_missing_is_named_with_its_parameter(tmp_path: Path, name: str) -> None:
    for path, reason in ((tmp_path / "none", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(ParameterError) as caught:
            marked_regions(Parameters.from_mapping({f"regions.{name}": str(path)}).regions)
        assert str(caught.value).startswith(f"parameter regions.{name}: {path}: {reason}")


def test_polygons_and_pictures_go_together(tmp_path: Path) -> None:
    (tmp_path / "marks.JSON").write_bytes(content({"name": "road", "polygon": SQUARE}))
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((4, 4), 255, np.uint8))
    picture = str(tmp_path / "mask.png")
    regions = marked_regions(RegionsParameters(str(tmp_path / "marks.JSON"), picture, picture))
    assert [(region.name, region.ignored) for region in regions.marked] == [
        ("road", True),
        ("ignore", True),
        ("include", False),
    ]
    assert marked_regions(RegionsParameters()).marked == ()
