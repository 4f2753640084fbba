"""What a frame costs, beside an optical flow in the same run: a guard against sudden slowness."""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from support.drawn_scene import DrawnScene
from support.segmenters import segmenter_by_rules
from turbseg_ros.evaluation.benchmark import YARDSTICK_SIZE, endless
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.motion_segmenter import MotionSegmenter

SIZE = (1920, 1080)
# Two of the periods in which motion is measured once.
WARM_UP, FRAMES = 16, 8
# Processor time of a frame over that of a DIS flow. It is about half of that on a machine that
# does nothing else; where memory is contended for, flow, which fits into the cache, suffers less.
LIMIT = 8.0


def seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def answer(segmenter: MotionSegmenter, frame: Frame, results: list[SegmentationResult]) -> None:
    results += segmenter.push(frame)


@pytest.mark.timeout(300)
def test_a_full_hd_frame_takes_no_more_than_so_many_flows() -> None:
    scene = DrawnScene(velocity=(6, 0), start=(40, 100), side=60, shape=(270, 480))
    clip = [cv2.merge([image] * 3) for image in scene.images(24)]
    greys = [cv2.resize(image[..., 0], YARDSTICK_SIZE) for image in clip]
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    # No frames pile up at the beginning, whose results would have to be caught up with.
    segmenter = segmenter_by_rules(Parameters().replace({"latency.warm_up": 0}))
    frames = endless(clip, SIZE, rate_hz=30.0)
    for frame in itertools.islice(frames, WARM_UP):
        segmenter.push(frame)
    pushes, flows, results = [], [], []
    for number, frame in enumerate(itertools.islice(frames, FRAMES)):
        pushes.append(seconds(functools.partial(answer, segmenter, frame, results)))
        pair = greys[number], greys[number + 1]
        flows.append(seconds(functools.partial(dis.calc, *pair, None)))
    assert any(result.objects for result in results)
    assert np.mean(pushes) < LIMIT * np.mean(flows)
