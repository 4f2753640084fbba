"""What the node tells of itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message, serialize_message

from turbseg_ros.nodes.diagnostics import Event, NodeState, Statistics, status_message
from turbseg_ros.parameters import DiagnosticsParameters
from turbseg_ros.segmentation.camera_state import CameraState
from turbseg_ros.segmentation.condition import Condition
from turbseg_ros.segmentation.frame import Frame, SegmentationResult
from turbseg_ros.segmentation.load import ANSWERED_STEPS, Step

RESULT = SegmentationResult(
    Frame(0, np.zeros((4, 4), np.uint8), "lens"),
    np.zeros((4, 4), np.uint16),
    (),
    np.zeros((4, 4), np.float32),
    0.734,
    "similarity",
)
OK = DiagnosticStatus.OK
LIMITS = DiagnosticsParameters(min_rate=0.0, max_turbulence=100.0)


class FakeClock:
    def __init__(self):
        self.time = 100.0

    def __call__(self):
        return self.time


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def statistics(clock):
    return Statistics(clock)


def status(report, **changes):
    state = {
        "topic": "/image_raw",
        "enabled": True,
        "idle": False,
        "publishers": 1,
        "mismatch": "",
        "reliability": "reliable",
        "pause_timeout": 1.0,
        "limits": LIMITS,
        "has_time": True,
        "latency_mode": "centred",
        "look_ahead": 6,
        "waiting": 2,
        "device": "cpu",
        **changes,
    }
    return status_message("/turbseg", report, NodeState(**state))


def figures(message):
    return {value.key: value.value for value in message.values}


def run_for_a_second(statistics, clock, frames=20):
    for number in range(frames):
        clock.time += 1.0 / frames
        statistics.count(Event.RECEIVED)
        statistics.answered(RESULT, since_stamp=0.2, since_arrival=0.001 * (number + 1))


def test_tells_how_many_were_answered_coasting(statistics, clock):
    run_for_a_second(statistics, clock)
    for coasted in (True, False, True):
        statistics.answered(replace(RESULT, coasted=coasted), since_stamp=0.2, since_arrival=0.1)
    message = status(statistics.take())
    assert (message.level, message.message) == (OK, "2 images answered by coasting")
    assert figures(message)["images answered by coasting"] == "2"
    assert figures(message)["images answered"] == "23"


def test_tells_the_load_step_of_the_period_and_how_many_were_answered_at_each(statistics, clock):
    run_for_a_second(statistics, clock)
    calm = figures(status(statistics.take()))
    assert calm["load step"] == "full"
    for step in (Step.COASTING, Step.SPARSE_MOTION, Step.COASTING):
        statistics.answered(replace(RESULT, step=step), since_stamp=0.2, since_arrival=0.1)
    shown = figures(status(statistics.take()))
    assert shown["load step"] == "sparse motion"
    assert [shown[f"images answered at step {step.label}"] for step in ANSWERED_STEPS] == [
        "20",
        "2",
        "1",
    ]
    nothing_since = figures(status(statistics.take()))
    assert nothing_since["load step"] == "full"
    assert nothing_since["images answered at step coasting"] == "2"


def test_while_images_are_dropped_that_is_the_load_step(statistics, clock):
    run_for_a_second(statistics, clock)
    statistics.count(Event.DROPPED)
    assert figures(status(statistics.take()))["load step"] == "dropping"


@pytest.mark.parametrize(
    ("step", "told"),
    [
        (Step.FULL, f"{Step.FULL.j:.2f}"),
        (Step.COASTING, f"{Step.COASTING.j:.2f} instead of {Step.FULL.j:.2f}"),
        (Step.SPARSE_MOTION, f"{Step.SPARSE_MOTION.j:.2f} instead of {Step.FULL.j:.2f}"),
    ],
)
def test_the_accuracy_of_the_load_step_is_that_of_what_is_answered(statistics, step, told):
    def shown(dropped):
        statistics.answered(replace(RESULT, step=step), since_stamp=0.2, since_arrival=0.1)
        statistics.count(Event.DROPPED, dropped)
        return figures(status(statistics.take()))["J of the load step"]

    where = "(the evaluation's scenes, default parameters)"
    assert shown(dropped=0) == f"{told} {where}"
    assert shown(dropped=2) == f"{told}, no masks of dropped images {where}"


def test_tells_of_frames_that_were_passed_over(statistics, clock):
    run_for_a_second(statistics, clock)
    for condition in (Condition.DAMAGED, Condition.SOUND, Condition.BLIND, Condition.DAMAGED):
        result = replace(RESULT, condition=condition)
        statistics.answered(result, since_stamp=0.2, since_arrival=0.1)
    message = status(statistics.take())
    assert message.level == DiagnosticStatus.WARN
    assert message.message == ("2 images passed over: damaged; 1 images passed over: blind")
    shown = figures(message)
    assert shown["images passed over: damaged"] == "2"
    assert shown["images passed over: repeated"] == "0"


def test_a_cut_or_a_repeated_picture_is_told_without_a_warning(statistics, clock):
    run_for_a_second(statistics, clock)
    for condition in (Condition.CUT, Condition.REPEATED):
        result = replace(RESULT, condition=condition)
        statistics.answered(result, since_stamp=0.2, since_arrival=0.1)
    message = status(statistics.take())
    assert message.level == OK
    assert message.message == "1 images passed over: repeated; 1 images of another scene"


def test_reports_rates_latencies_and_what_was_seen(statistics, clock):
    run_for_a_second(statistics, clock)
    message = status(statistics.take())
    assert message.level == DiagnosticStatus.OK
    assert message.name == "/turbseg: segmentation"
    assert message.hardware_id == "lens"
    shown = figures(message)
    assert float(shown["input rate (Hz)"]) == pytest.approx(20.0)
    assert float(shown["output rate (Hz)"]) == pytest.approx(20.0)
    assert float(shown["latency from stamp p50 (ms)"]) == pytest.approx(200.0)
    assert float(shown["latency from arrival p50 (ms)"]) == pytest.approx(10.5, abs=0.1)
    assert float(shown["latency from arrival p95 (ms)"]) == pytest.approx(19.05, abs=0.1)
    assert shown["turbulence (px)"] == "0.73"
    assert shown["ego-motion model"] == "similarity"
    assert shown["camera"] == "still"
    assert shown["objects"] == "0"
    assert shown["look-ahead (frames)"] == "6"
    assert shown["images waiting"] == "2"
    assert shown["device"] == "cpu"
    assert shown["latency mode"] == "centred"


def test_diagnostics_come_back_from_serialisation_as_they_went(statistics, clock):
    run_for_a_second(statistics, clock)
    message = status(statistics.take())
    assert deserialize_message(serialize_message(message), DiagnosticStatus) == message


def test_periods_count_apart_and_totals_go_on(statistics, clock):
    run_for_a_second(statistics, clock)
    statistics.take()
    clock.time += 0.5
    statistics.count(Event.RECEIVED, 5)
    report = statistics.take()
    assert report.rate(Event.RECEIVED) == pytest.approx(10.0)
    assert report.totals[Event.RECEIVED] == 25
    assert math.isnan(float(figures(status(report))["latency from stamp p50 (ms)"]))


@pytest.mark.parametrize(
    ("event", "level"),
    [
        (Event.DROPPED, DiagnosticStatus.WARN),
        (Event.LOST, DiagnosticStatus.WARN),
        (Event.SKIPPED, DiagnosticStatus.WARN),
        (Event.INCOMPLETE, DiagnosticStatus.WARN),
    ],
)
def test_level_follows_what_happened_in_the_period(statistics, clock, event, level):
    run_for_a_second(statistics, clock)
    statistics.count(event, 3)
    message = status(statistics.take())
    assert message.level == level
    assert message.message == f"3 images {event.value}"
    run_for_a_second(statistics, clock)
    assert status(statistics.take()).level == DiagnosticStatus.OK


def test_one_failure_warns_and_a_second_is_an_error(statistics, clock):
    run_for_a_second(statistics, clock)
    statistics.failed(frames=7)
    message = status(statistics.take())
    assert (message.level, message.message) == (
        DiagnosticStatus.WARN,
        "segmenting failed once; the log tells why",
    )
    assert figures(message)["images failed"] == "7"
    run_for_a_second(statistics, clock)
    statistics.failed()
    message = status(statistics.take())
    assert (message.level, message.message) == (
        DiagnosticStatus.ERROR,
        "segmenting failed 2 times; the log tells why",
    )
    for _ in range(11):
        run_for_a_second(statistics, clock)
    assert status(statistics.take()).level == DiagnosticStatus.OK


def test_warns_of_turbulence_in_which_objects_drown(statistics, clock):
    run_for_a_second(statistics, clock)
    report = statistics.take()  # 0.734 px on a picture of 4 pixels
    limits = replace(LIMITS, max_turbulence=18.0)
    message = status(report, limits=limits)
    assert message.level == DiagnosticStatus.WARN
    assert message.message == "turbulence of 0.7 px: objects may be missed"
    assert status(report, limits=replace(limits, max_turbulence=19.0)).level == OK
    unknown = replace(report, last=replace(RESULT, tilt=math.nan))
    assert status(unknown, limits=limits).level == OK


def test_warns_of_two_cameras_on_one_topic(statistics, clock):
    run_for_a_second(statistics, clock)
    message = status(statistics.take(), publishers=2)
    assert message.message == "2 publishers on /image_raw: their images mix"


def test_warns_while_there_is_no_clock(statistics, clock):
    run_for_a_second(statistics, clock)
    message = status(statistics.take(), has_time=False)
    assert message.message == "use_sim_time is set, but nothing comes on /clock"
    assert math.isnan(float(figures(message)["latency from stamp p95 (ms)"]))


@pytest.mark.parametrize(
    ("latency", "told"),
    [
        (1.8e9, "stamps are 20833 days behind this node's clock"),
        (-0.25, "stamps are 0.250 s ahead of this node's clock"),
    ],
)
def test_stamps_of_another_clock_are_told_instead_of_a_latency(statistics, clock, latency, told):
    for _ in range(5):
        statistics.count(Event.RECEIVED)
        statistics.answered(RESULT, since_stamp=latency, since_arrival=0.1)
    message = status(statistics.take())
    assert message.message == f"{told}: latency from stamp is not known"
    assert message.level == OK
    shown = figures(message)
    assert {shown[f"latency from stamp p{part} (ms)"] for part in (50, 95)} == {"nan"}
    assert float(shown["latency from arrival p50 (ms)"]) == pytest.approx(100.0)


def test_a_slow_answer_is_no_other_clock(statistics, clock):
    statistics.count(Event.RECEIVED)
    statistics.answered(RESULT, since_stamp=60.0, since_arrival=60.0)
    message = status(statistics.take())
    assert figures(message)["latency from stamp p50 (ms)"] == "60000.0"
    assert "clock" not in message.message


def test_a_topic_of_another_type_is_told(statistics):
    message = status(statistics.take(), publishers=0, mismatch="/a carries sensor_msgs/msg/Joy")
    assert (message.level, message.message) == (
        DiagnosticStatus.WARN,
        "/a carries sensor_msgs/msg/Joy",
    )


def test_an_enabled_node_waits_anew(statistics, clock):
    run_for_a_second(statistics, clock)
    clock.time += 60.0
    statistics.expect_images()
    clock.time += 0.5
    assert statistics.take().silence == pytest.approx(0.5)


def test_silence_is_an_error(statistics, clock):
    run_for_a_second(statistics, clock)
    statistics.take()
    clock.time += 3.0
    message = status(statistics.take())
    assert message.level == DiagnosticStatus.ERROR
    assert message.message == "no image on /image_raw for 3.0 s"


def test_warns_before_the_first_image(statistics):
    message = status(statistics.take(), publishers=0)
    assert message.level == DiagnosticStatus.WARN
    assert message.message == "no image yet on /image_raw (0 publishers)"


def test_warns_below_the_least_rate(statistics, clock):
    run_for_a_second(statistics, clock, frames=10)
    assert (
        status(statistics.take(), limits=replace(LIMITS, min_rate=15.0)).message
        == "input below 15 Hz"
    )


def test_a_disabled_node_is_well(statistics, clock):
    clock.time += 10.0
    message = status(statistics.take(), enabled=False)
    assert message.level == DiagnosticStatus.OK
    assert message.message == "disabled"


def test_a_node_to_which_nobody_listens_is_well(statistics, clock):
    clock.time += 10.0
    message = status(statistics.take(), idle=True)
    assert message.level == DiagnosticStatus.OK
    assert message.message == "idle: nobody listens to results"


@pytest.mark.parametrize("camera", [CameraState.SLEWING, CameraState.LOST])
def test_a_camera_that_slews_or_is_lost_is_told_but_no_fault(statistics, camera):
    statistics.count(Event.RECEIVED)
    statistics.answered(replace(RESULT, camera=camera), since_stamp=0.1, since_arrival=0.1)
    told = status(statistics.take())
    assert told.level == OK
    assert "camera" in told.message
    assert {each.key: each.value for each in told.values}["camera"] == camera.value
