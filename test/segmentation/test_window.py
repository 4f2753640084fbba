"""The sliding window: what is ready when, what is kept, and how frames lie to one another."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.drawn_scene import texture
from turbseg_ros.segmentation.background import unmasked
from turbseg_ros.segmentation.camera_state import CameraState, CameraTrack
from turbseg_ros.segmentation.cropped_mask import CroppedMask
from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.observer import StageObserver
from turbseg_ros.segmentation.preparation import PreparedFrame, prepare
from turbseg_ros.segmentation.registration import EgoMotionModel
from turbseg_ros.segmentation.resolution import Resolution
from turbseg_ros.segmentation.window import FrameWindow


def tiny_frame(
    index: int, from_previous: np.ndarray | None = None, continues: bool = True
) -> PreparedFrame:
    return PreparedFrame(
        index=index,
        grey=np.zeros((2, 2), np.uint8),
        scene=unmasked(np.zeros((2, 2), np.uint8)),
        from_previous=np.eye(3) if from_previous is None else from_previous,
        continues=continues,
    )


def window_of(
    interval: int = 2, look_ahead: int = 2, memory: int = 12, key_step: int = 3
) -> FrameWindow:
    return FrameWindow(interval, look_ahead, memory, key_step)


def filled(count: int, **settings: int) -> FrameWindow:
    """A window whose frames are all still to be segmented."""
    window = window_of(**settings)
    for index in range(count):
        window.append(tiny_frame(index))
    return window


def ready_frames(window: FrameWindow, *, ended: bool = False, at_most: int = 1) -> list[int]:
    """Take the frames that can be segmented now, no more than so many unless the stream ended."""
    taken: list[int] = []
    while ended or len(taken) < at_most:
        index = window.pop_ready(ended)
        if index is None:
            break
        taken.append(index)
    return taken


def done(window: FrameWindow, count: int, motions: list[np.ndarray] | None = None) -> FrameWindow:
    """Push frames and segment each as soon as it is ready."""
    for index in range(window.count, count):
        window.append(tiny_frame(index, None if motions is None else motions[index]))
        ready_frames(window)
    return window


@given(count=st.integers(0, 30), interval=st.integers(1, 4), causal=st.booleans())
def test_every_frame_is_ready_once_and_in_order(count: int, interval: int, causal: bool) -> None:
    window = window_of(interval, 0 if causal else interval)
    given_out = []
    for index in range(count):
        window.append(tiny_frame(index))
        given_out += ready_frames(window)
    given_out += ready_frames(window, ended=True)
    assert given_out == list(range(count))


@given(count=st.integers(1, 30), interval=st.integers(1, 4))
def test_a_frame_waits_for_those_that_it_is_compared_with(count: int, interval: int) -> None:
    window = window_of(interval, interval)
    for index in range(count):
        window.append(tiny_frame(index))
        for centre in ready_frames(window):
            after = window.count - 1 - centre
            assert after >= interval


def test_a_frame_waits_no_longer_than_it_must() -> None:
    window = window_of(interval=2, look_ahead=2)
    ready = []
    for index in range(5):
        window.append(tiny_frame(index))
        ready.append(ready_frames(window))
    assert ready == [[], [], [0], [1], [2]]


@pytest.mark.parametrize(
    ("at_most", "expected"),
    [
        (1, [[], [], [], [], [], [0], [1], [2], [3], [4]]),
        (2, [[], [], [], [], [], [0, 1], [2, 3], [4, 5], [6], [7]]),
    ],
)
def test_the_first_frames_wait_for_the_warm_up_and_are_then_worked_off(
    at_most: int, expected: list[list[int]]
) -> None:
    window = FrameWindow(2, 2, memory=48, key_step=3, warm_up=6)
    ready = []
    for index in range(10):
        window.append(tiny_frame(index))
        ready.append(ready_frames(window, at_most=at_most))
    assert ready == expected
    left = list(range(sum(map(len, expected)), 10))
    assert ready_frames(window, ended=True) == left


def test_without_look_ahead_a_frame_is_ready_when_it_comes() -> None:
    window = window_of(look_ahead=0)
    for index in range(5):
        window.append(tiny_frame(index))
        assert ready_frames(window) == [index]


def test_the_newest_frame_is_at_hand() -> None:
    window = window_of()
    assert window.newest is None
    window.append(tiny_frame(0))
    window.append(tiny_frame(1))
    assert window.newest is window[1]


def test_neighbours_lie_on_both_sides() -> None:
    assert filled(9, interval=4).neighbours(4, [-4, -2, 2, 4]) == [-4, -2, 2, 4]


@pytest.mark.parametrize(
    ("centre", "neighbours"),
    [
        (0, [1, 2, 4, 12]),
        (3, [-2, 1, 2, 4, 12]),
        (4, [-4, 4, 12]),
        (12, [-12, -4, 4]),
        (22, [-12, -4, -2, -1]),
    ],
)
def test_at_an_end_neighbours_come_from_the_other_side(centre: int, neighbours: list[int]) -> None:
    window = FrameWindow(12, 100, memory=48, key_step=3)
    for index in range(23):
        window.append(tiny_frame(index))
    assert window.neighbours(centre, [-12, -4, 4]) == neighbours


@pytest.mark.parametrize(
    ("following", "neighbours"),
    [
        (4, [-12, -4, 4]),
        (3, [-12, -5, 3]),
        (2, [-12, -6, 2]),
        (1, [-12, -4, -2, -1]),
        (0, [-12, -4, -2, -1]),
    ],
)
def test_where_fewer_frames_follow_the_pair_on_both_sides_is_shifted_back(
    following: int, neighbours: list[int]
) -> None:
    window = FrameWindow(12, 100, memory=48, key_step=3)
    for index in range(20 + following):
        window.append(tiny_frame(index))
    assert window.neighbours(19, [-12, -4, 4]) == neighbours


def test_the_pair_is_not_shifted_while_the_camera_moves() -> None:
    window = FrameWindow(12, 100, memory=48, key_step=3)
    for index in range(22):
        window.append(tiny_frame(index, translation(0.5 * (index > 12), 0.0)))
    assert window.neighbours(19, [-12, -4, 4]) == [-12, -4, 2]


@pytest.mark.parametrize(
    ("centre", "neighbours"), [(1, []), (2, [-2, -1]), (3, [-3, -2, -1]), (4, [-4, -2, -1])]
)
def test_at_the_beginning_a_past_half_as_long_will_do(centre: int, neighbours: list[int]) -> None:
    window = FrameWindow(12, 0, memory=48, key_step=3)
    for index in range(centre + 1):
        window.append(tiny_frame(index))
    assert window.neighbours(centre, [-12, -4, 4]) == neighbours


def test_a_mean_is_not_shifted() -> None:
    assert filled(9, interval=4).neighbours(6, [-4, -2, 2, 4]) == [-4, -2, 2]


def test_a_short_stream_has_the_neighbours_that_it_has() -> None:
    assert filled(1, interval=4).neighbours(0, [-12, -4, 4]) == []
    assert filled(2, interval=4).neighbours(0, [-12, -4, 4]) == []
    assert filled(3, interval=4).neighbours(0, [-12, -4, 4]) == [1, 2]
    assert filled(5, interval=4).neighbours(0, [-12, -4, 4]) == [1, 2, 4]


def test_a_frame_that_has_nothing_in_common_with_others_is_compared_with_none() -> None:
    window = window_of(interval=2, look_ahead=2)
    for index in range(9):
        # Frame 4 is torn: neither it nor the one after it continues what was before.
        window.append(tiny_frame(index, continues=index not in (0, 4, 5)))
    assert [index for index in range(9) if not window.shows_scene(index)] == [4]
    assert window.neighbours(3, [-2, -1, 1, 2]) == [-2, -1, 2]
    assert window.key_frames(3) == [0, 1, 2, 5, 6, 7, 8]


def test_the_scene_is_shown_by_key_frames() -> None:
    window = done(window_of(interval=2, look_ahead=2, memory=30, key_step=3), 40)
    keys = window.key_frames(36)
    assert keys
    assert all(k % 3 == 0 and k != 36 for k in keys)
    assert min(keys) >= 36 - 30 - 3
    assert len(keys) >= 9


def test_while_key_frames_are_few_every_frame_shows_the_scene() -> None:
    assert filled(5).key_frames(2) == [0, 1, 3, 4]


@pytest.mark.parametrize(("look_ahead", "memory", "key_step"), [(4, 48, 3), (0, 48, 3), (4, 8, 1)])
def test_the_number_of_frames_kept_stays_the_same_over_two_thousand(
    look_ahead: int, memory: int, key_step: int
) -> None:
    window = window_of(4, look_ahead, memory, key_step)
    alive = 0

    def released() -> None:
        nonlocal alive
        alive -= 1

    kept = []
    for index in range(2000):
        frame = tiny_frame(index)
        alive += 1
        weakref.finalize(frame.grey, released)
        window.append(frame)
        del frame
        for centre in ready_frames(window):
            window.mark_objects(centre, [])
        kept.append(alive)
    assert max(kept[100:]) == max(kept[100:200])
    assert max(kept) <= 2 * 4 + look_ahead + memory / key_step + 3


@st.composite
def camera_motions(draw: st.DrawFn) -> np.ndarray:
    numbers = st.floats(-0.02, 0.02)
    motion = np.eye(3)
    motion[:2, :2] += [[draw(numbers), draw(numbers)], [draw(numbers), draw(numbers)]]
    motion[:2, 2] = draw(st.floats(-10, 10)), draw(st.floats(-10, 10))
    return motion


def chained(motions: list[np.ndarray], source: int, target: int) -> np.ndarray:
    product = np.eye(3)
    for motion in motions[source + 1 : target + 1]:
        product = motion @ product
    return product


@settings(max_examples=30, deadline=None)
@given(motions=st.lists(camera_motions(), min_size=10, max_size=10))
def test_transforms_compose_and_invert(motions: list[np.ndarray]) -> None:
    window = window_of(interval=10, look_ahead=10)
    for index, motion in enumerate(motions):
        window.append(tiny_frame(index, motion))
    there = window.transform(2, 8)
    np.testing.assert_allclose(there, chained(motions, 2, 8), atol=1e-9)
    np.testing.assert_allclose(window.transform(5, 8) @ window.transform(2, 5), there, atol=1e-9)
    np.testing.assert_allclose(window.transform(8, 2) @ there, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(window.transform(4, 4), np.eye(3))


@settings(max_examples=20, deadline=None)
@given(motions=st.lists(camera_motions(), min_size=40, max_size=40))
def test_dropped_frames_hand_on_their_motion(motions: list[np.ndarray]) -> None:
    window = done(window_of(interval=2, look_ahead=2, memory=24, key_step=6), 40, motions)
    keys = window.key_frames(37)
    assert len(keys) >= 4
    for key in keys:
        with_all = chained(motions, min(key, 37), max(key, 37))
        with_all = with_all if key < 37 else np.linalg.inv(with_all)
        np.testing.assert_allclose(window.transform(key, 37), with_all, atol=1e-7)


def test_objects_are_remembered_with_their_frame() -> None:
    window = filled(3)
    window.mark_objects(1, [CroppedMask.of(np.array([[True, False], [False, False]]))])
    assert window[1].objects_known
    np.testing.assert_array_equal(window[1].scene.image[..., -1], [[255, 0], [0, 0]])
    assert not window[0].objects_known
    assert not window[0].scene.image[..., -1].any()


def test_objects_of_a_frame_that_is_gone_are_no_matter() -> None:
    window = done(window_of(memory=8), 40)
    window.mark_objects(1, [CroppedMask.of(np.ones((2, 2), bool))])
    with pytest.raises(KeyError):
        window[1]


SIZES = st.integers(48, 2000)


@given(width=SIZES, height=SIZES, processing=st.integers(64, 1920))
def test_processing_takes_as_many_pixels_as_in_a_wide_picture(
    width: int, height: int, processing: int
) -> None:
    resolution = Resolution.of((height, width), processing, 864)
    w, h = resolution.processing
    assert resolution.input == (width, height)
    # Sides are whole pixels, and 16 at least.
    if min(w, h) > 16:
        assert w * h == pytest.approx(processing**2 * 9 / 16, rel=0.05)
        assert w / h == pytest.approx(width / height, rel=0.06)


@given(width=SIZES, height=SIZES, detail=st.integers(64, 3840))
def test_outlines_are_never_larger_than_the_picture(width: int, height: int, detail: int) -> None:
    resolution = Resolution.of((height, width), 432, detail)
    if width * height <= detail**2 * 9 / 16:
        assert resolution.detail == (width, height)
    else:
        w, h = resolution.detail
        assert w <= width
        assert h <= height
        # Sides are whole pixels, and 16 at least.
        assert min(w, h) == 16 or w * h <= 1.1 * detail**2 * 9 / 16


@given(width=SIZES, height=SIZES, x=st.floats(-20, 20), y=st.floats(-20, 20))
def test_a_shift_between_processing_pictures_is_scaled_for_outlines(
    width: int, height: int, x: float, y: float
) -> None:
    resolution = Resolution.of((height, width), 432, 864)
    factors = resolution.detail_from_processing
    processing = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    expected = np.array([[1, 0, x * factors[0]], [0, 1, y * factors[1]], [0, 0, 1]])
    np.testing.assert_allclose(resolution.to_detail(processing), expected, atol=1e-6)


def test_a_turn_about_the_middle_stays_one_for_outlines() -> None:
    # The middle of a picture lies at (w - 1) / 2, whatever its scale.
    resolution = Resolution(input=(200, 100), processing=(100, 50), detail=(200, 100))
    to_middle = np.array([[1, 0, 49.5], [0, 1, 24.5], [0, 0, 1]])
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    turned = resolution.to_detail(to_middle @ turn @ np.linalg.inv(to_middle))
    np.testing.assert_allclose(turned @ [99.5, 49.5, 1], [99.5, 49.5, 1])
    np.testing.assert_allclose(turned[:2, :2], turn[:2, :2])


@pytest.mark.parametrize("colours", [(), (3,)], ids=["grey", "colour"])
def test_a_prepared_frame_has_the_sizes_of_its_resolution(colours: tuple[int, ...]) -> None:
    resolution = Resolution.of((96, 160), 80, 120)
    picture = np.full((96, 160, *colours), 7, np.uint8)
    prepared = prepare(picture, resolution, 0, None, StageObserver())
    assert prepared.grey.shape == resolution.processing[::-1]
    assert prepared.detail.shape == (*resolution.detail[::-1], *(colours or (1,)))
    assert not prepared.objects_known
    np.testing.assert_array_equal(prepared.from_previous, np.eye(3))


def test_a_prepared_frame_knows_how_the_one_before_lies_to_it() -> None:
    ground = texture((96, 160), seed=4, grain=2.0)
    resolution = Resolution.of(ground.shape, 160, 160)
    before = prepare(ground, resolution, 0, None, StageObserver())
    rolled = np.roll(ground, (-2, 5), axis=(0, 1))
    after = prepare(rolled, resolution, 1, before, StageObserver())
    scale = resolution.processing[0] / 160
    np.testing.assert_allclose(after.from_previous[:2, 2], (5 * scale, -2 * scale), atol=0.2)


def test_frames_of_another_view_are_not_compared() -> None:
    """A slew lies between them."""
    window = window_of(interval=4, memory=12, key_step=1)
    for index in range(10):
        view = CameraTrack(view=int(index >= 5))
        window.append(replace(tiny_frame(index), camera=view))
    assert window.neighbours(6, [-4, -1, 1, 3]) == [-1, 1, 3]
    assert window.neighbours(2, [-2, 2, 4]) == [-2, 2]
    assert window.key_frames(6) == [5, 7, 8, 9]


def test_a_neighbourhood_tells_whether_the_cameras_motion_is_known() -> None:
    window = window_of(interval=1)
    for index, state in enumerate((CameraState.STILL, CameraState.STILL, CameraState.LOST)):
        window.append(replace(tiny_frame(index), camera=CameraTrack(state=state)))
    assert window.neighbourhood(1, [-1, 1]).camera_known
    assert not window.neighbourhood(2, [-1]).camera_known


def test_a_frame_that_has_nothing_to_hold_on_to_goes_on_as_expected() -> None:
    """Before a plain sky a camera that panned steadily is taken to go on so."""
    resolution, observer = Resolution.of((96, 160), 160, 160), StageObserver()
    land = texture((96, 400), seed=3)
    frame = None
    for index in range(12):
        picture = np.ascontiguousarray(land[:, 3 * index : 3 * index + 160])
        frame = prepare(picture, resolution, index, frame, observer)
    sky = np.full((96, 160), 190, np.uint8)
    noisy = [(sky + np.random.default_rng(k).integers(0, 3, sky.shape)) for k in range(2)]
    assert frame is not None
    assert frame.camera.state is CameraState.FOLLOWING
    before = prepare(noisy[0].astype(np.uint8), resolution, 0, None, observer)
    held = prepare(
        noisy[1].astype(np.uint8), resolution, 1, replace(before, camera=frame.camera), observer
    )
    assert held.camera.model in (EgoMotionModel.HELD, EgoMotionModel.NONE)
    assert held.camera.state is CameraState.LOST
    np.testing.assert_allclose(held.from_previous, frame.from_previous, atol=0.1)
