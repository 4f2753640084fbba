"""Clips under added turbulence and shake: frames and truth go together."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from turbseg_ros.evaluation.disturbance import (
    AddedShake,
    AddedTurbulence,
    Disturbance,
    DisturbanceError,
    DisturbedClip,
)
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.segmentation.frame import Frame

FRAMES = 12
SHAPE = (120, 160)


def picture() -> np.ndarray:
    """A white disc on black."""
    image = np.zeros(SHAPE, np.uint8)
    cv2.circle(image, (80, 60), 20, 255, -1)
    return image


def disturbed(disturbance: Disturbance) -> list[tuple[np.ndarray, np.ndarray]]:
    """The frames and their truth of a clip in which nothing moves."""
    truth = LabelsByStamp(StampedLabels(n, (picture() > 0) * np.uint16(9)) for n in range(FRAMES))
    clip = DisturbedClip((Frame(n, picture()) for n in range(FRAMES)), FRAMES, truth, disturbance)
    pairs = []
    for frame in clip:
        labels = clip.truth.at(frame.stamp)
        assert labels is not None
        pairs.append((frame.image, labels))
    return pairs


@pytest.mark.parametrize("disturbance", [AddedTurbulence(1.5), AddedShake(2.0, 3.0)])
def test_truth_moves_as_its_frame_does(disturbance: Disturbance) -> None:
    for image, labels in disturbed(disturbance):
        assert (image.dtype, labels.dtype) == (np.uint8, np.uint16)
        assert image.shape == labels.shape
        assert set(np.unique(labels)) == {0, 9}
        assert ((image > 127) != (labels > 0)).mean() < 0.01


@pytest.mark.parametrize("disturbance", [AddedTurbulence(1.5), AddedShake(2.0, 3.0)])
def test_no_two_frames_are_alike_but_two_runs_are(disturbance: Disturbance) -> None:
    first, second = disturbed(disturbance), disturbed(disturbance)
    for (one, one_truth), (other, other_truth) in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(one_truth, other_truth)
    assert len({image.tobytes() for image, _ in first}) == FRAMES


def test_another_seed_disturbs_otherwise() -> None:
    first, second = (disturbed(AddedTurbulence(1.0, seed)) for seed in (0, 1))
    assert any((one != other).any() for (one, _), (other, _) in zip(first, second, strict=True))


def test_added_turbulence_has_the_strength_that_was_asked_for() -> None:
    """The disc's centre wanders by the tilt, averaged over the disc, which is a little less."""
    strengths = []
    for tilt_px in (0.5, 2.0):
        centres = [
            np.argwhere(labels > 0).mean(axis=0)
            for seed in range(4)
            for _, labels in disturbed(AddedTurbulence(tilt_px, seed))
        ]
        strengths.append(np.std(centres, axis=0).mean() / tilt_px)
    assert strengths == pytest.approx([0.75, 0.75], abs=0.25)


@settings(max_examples=20, deadline=None)
@given(step=st.floats(0, 3), seed=st.integers(0, 1000))
def test_shakes_with_the_same_widest_show_the_same_part(step: float, seed: int) -> None:
    shapes = {image.shape for image, _ in disturbed(AddedShake(step, 3.0, seed))}
    still = {image.shape for image, _ in disturbed(AddedShake(0.0, 3.0, seed))}
    assert shapes == still
    assert len(shapes) == 1


def test_no_shake_only_cuts_the_picture() -> None:
    for image, _ in disturbed(AddedShake(0.0, 2.0)):
        cut = (SHAPE[0] - image.shape[0]) // 2
        assert cut > 0
        np.testing.assert_array_equal(image, picture()[cut:-cut, cut:-cut])


def test_a_shake_steps_by_what_was_asked_for() -> None:
    steps = []
    for seed in range(30):
        centres = [
            cv2.phaseCorrelate(picture_part.astype(np.float32), image.astype(np.float32))[0]
            for image, picture_part in with_cut_picture(AddedShake(2.0, 2.0, seed))
        ]
        steps.append(np.diff(centres, axis=0))
    assert np.sqrt(np.mean(np.square(steps))) == pytest.approx(2.0, rel=0.15)


def with_cut_picture(shake: AddedShake) -> list[tuple[np.ndarray, np.ndarray]]:
    pairs = []
    for image, _ in disturbed(shake):
        cut = (SHAPE[0] - image.shape[0]) // 2
        pairs.append((image, picture()[cut:-cut, cut:-cut]))
    return pairs


def test_a_shake_too_wide_for_the_picture_is_refused() -> None:
    with pytest.raises(DisturbanceError, match="a shake of 20 px moves the picture by up to"):
        disturbed(AddedShake(1.0, 20.0))


def test_frames_of_another_size_are_refused() -> None:
    frames = [Frame(0, picture()), Frame(1, picture()[:100])]
    clip = DisturbedClip(frames, 2, LabelsByStamp(), AddedTurbulence(1.0))
    with pytest.raises(DisturbanceError, match="a frame of"):
        list(clip)


def test_frames_without_truth_stay_without() -> None:
    clip = DisturbedClip([Frame(0, picture())], 1, LabelsByStamp(), AddedShake(1.0, 1.0))
    assert len(list(clip)) == 1
    assert len(clip.truth) == 0
