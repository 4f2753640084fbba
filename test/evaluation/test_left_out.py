"""What a user has marked to be ignored counts neither as missed nor as false."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.evaluation.evaluate import evaluate_labels
from turbseg_ros.evaluation.labels import LabelsByStamp, StampedLabels
from turbseg_ros.evaluation.left_out import without_marked
from turbseg_ros.evaluation.truth import BoxesByStamp
from turbseg_ros.messages.detections import IGNORED, Detection
from turbseg_ros.parameters import ParameterError
from turbseg_ros.segmentation.marked_regions import MarkedRegion, MarkedRegions, MaskPicture

SHAPE = (40, 60)


def marked() -> np.ndarray:
    """The right third."""
    mask = np.zeros(SHAPE, bool)
    mask[:, 40:] = True
    return mask


REGIONS = MarkedRegions((MarkedRegion("right", True, MaskPicture(marked()), source="file"),))


def labels(**columns: tuple[int, int]) -> np.ndarray:
    """Bars, rows 10 to 20, named by their labels: `_3=(0, 8)` has label 3."""
    image = np.zeros(SHAPE, np.uint16)
    for name, (start, stop) in columns.items():
        image[10:20, start:stop] = int(name[1:])
    return image


@pytest.mark.parametrize("second", [1, 2])
def test_of_masks_the_marked_and_objects_mostly_there_are_left_out(second: int) -> None:
    # One lies within, one mostly, one less than half; they may have one label or several.
    truth = labels(_1=(50, 55)) + labels(**{f"_{second}": (34, 46)}) + labels(_3=(30, 32))
    truth[30:38, 36:46] = 1
    left_truth, left_out = without_marked(truth, None, marked())
    assert left_truth is truth
    assert left_out is not None
    beyond = (left_out != 0) & ~marked()
    expected = np.zeros(SHAPE, bool)
    expected[30:38, 36:40] = True
    np.testing.assert_array_equal(beyond, expected)
    assert (left_out[marked()] != 0).all()


def test_what_is_ignored_anyway_stays_so() -> None:
    ignored = labels(_9=(0, 5))
    _, left_out = without_marked(labels(), ignored, marked())
    np.testing.assert_array_equal(np.asarray(left_out) != 0, marked() | (ignored != 0))


def test_of_boxes_those_that_mostly_are_marked_need_not_be_found() -> None:
    boxes = (
        Detection((42, 0, 10, 10), "within"),
        Detection((35, 0, 20, 10), "mostly"),
        Detection((30, 0, 20, 10), "half"),
        Detection((55, 0, 500, 10), "beyond the picture"),
    )
    truth, left_out = without_marked(boxes, None, marked())
    assert isinstance(truth, tuple)
    kinds = {each.id: each.class_id for each in truth}
    assert kinds == {
        "within": IGNORED,
        "mostly": IGNORED,
        "half": "",
        "beyond the picture": IGNORED,
    }
    np.testing.assert_array_equal(np.asarray(left_out) != 0, marked())


def test_scores_are_those_of_the_rest_of_the_picture() -> None:
    # The right one is not found, and something else is.
    truth = labels(_1=(5, 15), _2=(45, 50))
    found = [StampedLabels(0, labels(_1=(5, 15), _7=(55, 60)))]

    def scored(regions: MarkedRegions) -> tuple[float | None, float | None, int]:
        known = LabelsByStamp(iter([StampedLabels(0, truth)]))
        scores = evaluate_labels("bag", found, known, marked=regions)
        return scores.j, scores.false_objects, scores.scored_frames

    assert scored(MarkedRegions()) == (0.5, 1.0, 1)
    assert scored(REGIONS) == (1.0, 0.0, 1)


def test_boxes_are_scored_without_what_is_marked() -> None:
    boxes = BoxesByStamp()
    boxes.insert((Detection((5, 10, 10, 10), "1"), Detection((45, 10, 5, 10), "2")), 0, 0)
    found = [StampedLabels(0, labels(_1=(5, 15), _7=(55, 60)))]
    all_of_it = evaluate_labels("bag", found, boxes)
    rest = evaluate_labels("bag", found, boxes, marked=REGIONS)
    assert (all_of_it.hits, all_of_it.false_objects) == (0.5, 1.0)
    assert (rest.hits, rest.false_objects) == (1.0, 0.0)


def test_regions_of_other_pictures_are_refused() -> None:
    known = LabelsByStamp(iter([StampedLabels(0, np.zeros((60, 40), np.uint16))]))
    with pytest.raises(ParameterError, match="file: 60x40 pixels, which images of 40x60 can't be"):
        evaluate_labels(
            "bag", [StampedLabels(0, np.zeros((60, 40), np.uint16))], known, marked=REGIONS
        )
