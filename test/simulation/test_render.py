from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from turbseg_ros.simulation.camera import CameraMotion, Sensor
from turbseg_ros.simulation.landscape import Backdrop, Extent, Painter, Palette
from turbseg_ros.simulation.objects import KINDS, Path, SceneObject
from turbseg_ros.simulation.painters import PAINTERS
from turbseg_ros.simulation.render import RenderedFrame, render
from turbseg_ros.simulation.scenes import SCENES, Scene, UnknownSceneError, scene
from turbseg_ros.simulation.turbulence import Turbulence, warp
from turbseg_ros.simulation.warp import ClipWarper

NOISELESS = Sensor("mono8", full_well=1e9, read_noise=0, lens_blur=0.3)
STILL_AIR = Turbulence(0.0)


@pytest.fixture(scope="module", autouse=True)
def landscapes_painted_once() -> Iterator[None]:
    """A landscape is painted once for each seed and size: most of the time goes there."""
    with pytest.MonkeyPatch.context() as patch:
        for name, paint in list(PAINTERS.items()):
            patch.setitem(PAINTERS, name, remembering(paint))
        yield


def remembering(paint: Painter) -> Painter:
    paintings: dict[tuple[Extent, Palette, str], Backdrop] = {}

    def painted(extent: Extent, palette: Palette, rng: np.random.Generator) -> Backdrop:
        key = extent, palette, str(rng.bit_generator.state)
        if key not in paintings:
            paintings[key] = paint(extent, palette, rng)
        return paintings[key]

    return painted


def small_scene(*objects: SceneObject, frames: int = 3, landscape: str = "open_sky") -> Scene:
    return Scene(
        "small", "", landscape, STILL_AIR, objects, sensor=NOISELESS,
        width=240, height=160, frames=frames,
    )  # fmt: skip


def standing(identity: int, kind: str, size: float, x: float, y: float) -> SceneObject:
    return SceneObject(identity, kind, size, Path(((0, x, y),)))


def crossing(identity: int, kind: str, size: float, *waypoints: tuple[float, float, float]):
    return SceneObject(identity, kind, size, Path(waypoints))


def silhouette(
    drawn: SceneObject, shape: tuple[int, int], scale: int = 16
) -> npt.NDArray[np.float32]:
    """Coverage of an object that stands still, drawn at once and finely, facing right."""
    ((_, x, y),) = drawn.path.waypoints
    canvas = np.zeros((shape[0] * scale, shape[1] * scale), np.uint8)
    for part in KINDS[drawn.kind].shape(0.0, drawn.paint):
        points = np.array(part.points) * drawn.size
        pixels = np.column_stack((points[:, 0] - drawn.size / 2 + x, y - points[:, 1]))
        fixed = np.rint(((pixels + 0.5) * scale - 0.5) * 16).astype(np.int32)
        cv2.fillPoly(canvas, [fixed], (1,), shift=4)
    return canvas.reshape(shape[0], scale, shape[1], scale).mean(axis=(1, 3), dtype=np.float32)


def jaccard(first: npt.NDArray[np.bool_], second: npt.NDArray[np.bool_]) -> float:
    return float((first & second).sum() / (first | second).sum())


@pytest.mark.parametrize(
    ("kind", "size", "x", "y"),
    [("sedan", 90, 120.0, 110.0), ("truck", 130, 100.4, 90.7), ("airliner", 61, 50.3, 80.2)],
)
def test_truth_without_turbulence_is_the_drawn_silhouette(
    kind: str, size: float, x: float, y: float
) -> None:
    drawn = standing(5, kind, size, x, y)
    frame = next(render(small_scene(drawn)))
    coverage = silhouette(drawn, (160, 240))
    truth = frame.labels == 5
    assert jaccard(truth, coverage > 0.5) > 0.96
    assert not truth[coverage < 0.25].any()  # only borders may fall either way
    assert truth[coverage > 0.75].all()


def test_zero_turbulence_leaves_no_trace() -> None:
    first, second = itertools.islice(render(small_scene()), 2)
    assert np.abs(first.image.astype(int) - second.image).max() <= 1  # shot noise at a rounding
    assert not first.tilt_px.any()


def test_frame_and_truth_move_by_the_same_tilt() -> None:
    air = replace(Turbulence.typical(2.5, 240), blur_px=0.0)
    still = small_scene(standing(1, "van", 90, 120, 100), landscape="town")
    calm = next(render(still, seed=4))
    shimmering = next(render(replace(still, turbulence=air), seed=4))
    tilt = shimmering.tilt_px
    assert 1.0 < tilt.std() < 4.0

    truth = shimmering.labels == 1
    expected = warp((calm.labels == 1).astype(np.float32), tilt) > 0.5
    assert jaccard(truth, expected) > 0.97
    assert jaccard(truth, calm.labels == 1) < 0.95

    inner = np.s_[12:-12, 12:-12]
    error = np.abs(warp(calm.image.astype(np.float32), tilt) - shimmering.image)[inner].mean()
    unwarped = np.abs(calm.image.astype(np.float32) - shimmering.image)[inner].mean()
    assert error < 0.25 * unwarped


def test_nearer_objects_hide_farther_ones() -> None:
    far, near = standing(1, "bus", 120, 120, 110), standing(2, "person", 60, 120, 115)
    labels = next(render(small_scene(far, near))).labels
    alone = next(render(small_scene(near))).labels
    np.testing.assert_array_equal(labels == 2, alone == 2)
    assert (labels == 1).any()


def test_what_stands_before_an_object_hides_it() -> None:
    walker = standing(1, "bus", 200, 120, 110)
    open_view = next(render(small_scene(walker, landscape="town"))).labels
    hidden = next(render(small_scene(walker, landscape="town_behind_poles"))).labels
    behind = (open_view == 1) & (hidden == 0)
    assert behind.sum() > 100
    assert not ((hidden == 1) & (open_view == 0)).any()


def test_an_object_that_leaves_and_comes_back_keeps_its_id() -> None:
    path = ((0, 200, 80), (4, 330, 80), (6, 330, 80), (10, 180, 80))
    clip = small_scene(crossing(9, "bird", 40, *path), frames=11)
    seen = [set(np.unique(frame.labels)) - {0} for frame in render(clip)]
    assert seen[0] == {9}
    assert seen[5] == set()
    assert seen[10] == {9}


def test_objects_follow_their_path() -> None:
    clip = small_scene(crossing(1, "sedan", 50, (0, 60, 90), (6, 120, 90)), frames=7)
    centres = [np.nonzero(frame.labels == 1)[1].mean() for frame in render(clip)]
    assert np.diff(centres) == pytest.approx([10.0] * 6, abs=0.3)


def test_what_comes_closer_grows_on_its_way() -> None:
    path = Path(((0, 120, 60), (10, 120, 100)), scales=((0, 1.0), (10, 2.0)))
    clip = small_scene(SceneObject(1, "truck_front", 30, path), frames=11)
    boxes = [np.nonzero(frame.labels == 1) for frame in render(clip)]
    widths = [np.ptp(x) + 1 for _, x in boxes]
    assert widths[0] == pytest.approx(30, abs=1)
    assert widths[10] == pytest.approx(60, abs=1)
    assert min(np.diff(widths)) >= 0
    # It stands on its path.
    assert [y.max() + 1 for y, _ in (boxes[0], boxes[10])] == pytest.approx([60, 100], abs=1)


def test_a_panning_camera_moves_landscape_and_objects_alike() -> None:
    clip = small_scene(standing(1, "sedan", 60, 120, 100), landscape="town")
    clip = replace(clip, camera=CameraMotion(pan=(5.0, 0.0)))
    first, second = itertools.islice(render(clip), 2)
    np.testing.assert_array_equal(second.labels[:, :-5], first.labels[:, 5:])
    difference = second.image[:, 8:-8].astype(int) - first.image[:, 13:-3]
    assert np.abs(difference).max() <= 2


def test_shake_has_the_size_asked_for() -> None:
    maps = CameraMotion(shake=3.0).trajectory(4000, (0.0, 0.0), np.random.default_rng(0))
    steps = np.diff(maps[:, :, 2], axis=0)
    assert steps.std(axis=0) == pytest.approx([3.0, 3.0], rel=0.06)
    assert np.abs(maps[:, :, 2].mean(axis=0)).max() < 1.0


def test_stamps_follow_the_rate() -> None:
    clip = replace(small_scene(), rate_hz=25.0)
    stamps = [frame.stamp_ns for frame in render(clip)]
    assert np.diff(stamps).tolist() == [40_000_000] * 2


def frames_of(clip: Scene, seed: int) -> list[RenderedFrame]:
    return list(render(clip, seed))


def test_a_seed_gives_the_same_clip_and_another_seed_another() -> None:
    clip = replace(SCENES["shake"], width=200, height=120, frames=2)
    first, again, other = frames_of(clip, 1), frames_of(clip, 1), frames_of(clip, 2)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.image, two.image)
        np.testing.assert_array_equal(one.labels, two.labels)
        np.testing.assert_array_equal(one.tilt_px, two.tilt_px)
    assert (first[1].image != other[1].image).mean() > 0.5
    assert not np.array_equal(first[1].tilt_px, other[1].tilt_px)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_renders_with_valid_truth(name: str) -> None:
    # Without its camera's motion a scene has the same landscape as others.
    entry = replace(SCENES[name], frames=1, camera=CameraMotion())
    ids = [each.id for each in entry.objects]
    assert len(set(ids)) == len(ids)
    assert 0 not in ids
    dtype = np.uint16 if entry.sensor.encoding == "mono16" else np.uint8
    colours = (3,) if entry.sensor.encoding == "bgr8" else ()
    for frame in render(entry):
        assert frame.image.shape == (entry.height, entry.width, *colours)
        assert frame.image.dtype == dtype
        assert frame.image.std() > 0.02 * np.iinfo(dtype).max
        assert frame.labels.shape == (entry.height, entry.width)
        assert frame.labels.dtype == np.uint16
        assert set(np.unique(frame.labels)) <= {0, *ids}
    in_view = {
        each.id
        for each in entry.objects
        for _, x, y in each.path.waypoints[:1]
        if 0 < x < entry.width and 0 < y < entry.height
    }
    assert in_view <= set(np.unique(frame.labels))


def test_thermal_sensors_keep_their_column_pattern() -> None:
    sensor = Sensor("mono16", full_well=1e9, read_noise=0, column_noise=0.01)
    rng = np.random.default_rng(0)
    pattern = sensor.pattern(100, rng)
    grey = np.full((50, 100, 3), 0.5, np.float32)
    exposed = sensor.expose(grey, pattern, rng).astype(np.float64) / 65535
    np.testing.assert_allclose(exposed.mean(axis=0), 0.5 + pattern, atol=1e-3)


def test_noise_is_what_the_electrons_make() -> None:
    sensor = Sensor("mono16", full_well=10_000, read_noise=30)
    rng = np.random.default_rng(0)
    grey = np.full((200, 200, 3), 0.4, np.float32)
    exposed = sensor.expose(grey, sensor.pattern(200, rng), rng) / 65535 * 10_000
    assert exposed.std() == pytest.approx(np.sqrt(4_000 + 30**2), rel=0.03)


def test_an_unknown_scene_names_the_nearest() -> None:
    with pytest.raises(UnknownSceneError, match=r"'sever'.*'severe'.*normal, "):
        scene("sever")
    with pytest.raises(UnknownSceneError, match=r"'oncoming'.*normal, .*, oncoming"):
        scene("oncomin", others=["oncoming"])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_somebodys_frames_and_truth_are_warped_alike(dtype: type[np.generic]) -> None:
    labels = np.zeros((90, 120), np.uint8)
    labels[30:60, 40:80] = 255
    warper = ClipWarper((90, 120), Turbulence(2.0, aperture_px=10), seed=1)
    for _ in range(3):
        image, truth = warper.distort((labels > 0).astype(dtype) * dtype(200), labels)
        assert image.dtype == dtype
        assert truth is not None
        assert set(np.unique(truth)) == {0, 255}
        assert not np.array_equal(truth, labels)
        clear = np.abs(image.astype(np.float32) - 100) > 20
        np.testing.assert_array_equal(truth[clear] == 255, image[clear] > 100)
    with pytest.raises(ValueError, match="in a clip of"):
        warper.distort(np.zeros((10, 10), dtype), None)
