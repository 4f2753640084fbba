"""The whole method over a small drawn clip, and what holds for all that it gives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from support.drawn_scene import DrawnScene
from support.paths import CONFIG
from support.segmenters import segmenter_by_rules
from turbseg_ros.parameter_file import load_parameters
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

# At the scene's own resolution, which is enough for it and fast.
PARAMETERS = Parameters.from_mapping({"resolution.processing": 160})
PAPER = load_parameters(CONFIG / "paper.yaml").replace({"resolution.processing": 160})
SCENE = DrawnScene()
SHAPE = SCENE.shape
CLIP = list(SCENE.images(30))


def frames(images: Iterable[np.ndarray], first: int = 0) -> list[Frame]:
    return [Frame(first + number, image, "lens") for number, image in enumerate(images)]


def segmented(
    images: Iterable[np.ndarray], parameters: Parameters = PARAMETERS
) -> list[SegmentationResult]:
    segmenter = segmenter_by_rules(parameters)
    results = [result for frame in frames(images) for result in segmenter.push(frame)]
    return results + segmenter.flush()


def stamps(results: Sequence[SegmentationResult]) -> list[int]:
    return [result.frame.stamp for result in results]


def ids(results: Sequence[SegmentationResult]) -> set[int]:
    return {moving.id for result in results for moving in result.objects}


def assert_sound(results: Sequence[SegmentationResult]) -> None:
    """Check what holds for every result: sizes, finite numbers, labels that fit the objects."""
    for result in results:
        shape = result.frame.image.shape[:2]
        assert result.labels.dtype == np.uint16
        assert result.labels.shape == shape
        assert result.motion_map.dtype == np.float32
        assert result.motion_map.ndim == 2
        assert np.isfinite(result.motion_map).all()
        assert np.isnan(result.tilt) or result.tilt >= 0.0
        # Every labelled pixel belongs to one object.
        assert sum(moving.area for moving in result.objects) == np.count_nonzero(result.labels)
        assert {moving.id for moving in result.objects} == set(np.unique(result.labels)) - {0}
        for moving in result.objects:
            assert moving.area > 0
            assert np.isfinite([*moving.centroid, *moving.velocity]).all()
            assert np.isfinite(moving.trail).all()
            x, y, width, height = moving.box
            assert 0 <= x < x + width <= shape[1]
            assert 0 <= y < y + height <= shape[0]
