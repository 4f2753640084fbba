"""The worker thread, with a segmenter that the tests can watch and break."""

import threading
import time

import numpy as np
import pytest

from support.node_harness import TIMEOUT
from turbseg_ros.messages.images import ImageConversionError
from turbseg_ros.nodes.diagnostics import Event, Statistics
from turbseg_ros.nodes.worker import Arrival, Inbox, SegmentationWorker
from turbseg_ros.parameters import ParameterError, Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

PERIOD = 33_000_000


class DelayedSegmenter:
    """Answers each frame two frames later; can be told to wait or to fail."""

    delay = 2

    def __init__(self):
        self.calls = []
        self.waiting = []
        self.gate = threading.Event()
        self.gate.set()
        self.fail_at = ()
        self._window = []

    def push(self, frame, waiting=0):
        self.waiting.append(waiting)
        self.gate.wait(TIMEOUT)
        self.calls.append(frame.stamp)
        if frame.stamp in self.fail_at:
            raise RuntimeError("broken")
        self._window.append(frame)
        return [result_of(self._window.pop(0))] if len(self._window) > self.delay else []

    def flush(self, waiting):
        self.waiting_at_flush = waiting
        results = [result_of(frame) for frame in self._window]
        self._window = []
        return results

    def reset(self):
        self.calls.append("reset")
        self._window = []

    def reconfigure(self, parameters):
        self.calls.append(parameters)

    def empty_result(self, frame):
        return SegmentationResult.empty(frame, (2, 2))

    def close(self):
        self.calls.append("close")


class RecordingLogger:
    def __init__(self):
        self.lines = []

    def info(self, text, **_):
        self.lines.append(text)

    warning = error = info


def result_of(frame):
    labels = np.ones(frame.image.shape, np.uint16)
    return SegmentationResult(frame, labels, (), np.zeros((2, 2), np.float32), 0.1, "affine")


def frame_of(message):
    if isinstance(message, ImageConversionError):
        raise message
    return Frame(message, np.zeros((4, 6), np.uint8))


class Harness:
    def __init__(self, queue_size=100):
        self.segmenter = DelayedSegmenter()
        self.statistics = Statistics()
        self.logger = RecordingLogger()
        self.results = []
        # How many results were published before each pause.
        self.pauses = []
        self.publish = self.results.append
        self.worker = SegmentationWorker(
            self.segmenter,
            convert=frame_of,
            publish=lambda result: self.publish(result),
            now=lambda: 0,
            statistics=self.statistics,
            logger=self.logger,
            queue_size=queue_size,
            on_pause=lambda: self.pauses.append(len(self.results)),
        )
        self.worker.start()

    @property
    def answered(self):
        return [result.frame.stamp for result in self.results]

    def submit(self, *messages):
        for message in messages:
            self.worker.submit(message)

    def finish(self):
        """Let the worker do all that waits, then stop it."""
        self.settle()
        self.worker.stop()

    def settle(self):
        done = threading.Event()
        deadline = time.monotonic() + TIMEOUT
        while self.worker.waiting and time.monotonic() < deadline:
            time.sleep(0.001)
        self.worker._inbox.command(done.set)
        assert done.wait(TIMEOUT)

    def totals(self):
        return self.statistics.take().totals


@pytest.fixture
def harness():
    harness = Harness()
    yield harness
    harness.segmenter.gate.set()
    harness.worker.stop()


def stamps(count, start=0):
    return [start + PERIOD * number for number in range(count)]


def test_answers_every_frame_once_and_in_order(harness):
    harness.submit(*stamps(20))
    harness.finish()
    assert harness.answered == stamps(20)
    assert harness.totals()[Event.ANSWERED] == 20


def test_answers_the_last_frames_when_the_stream_pauses(harness):
    harness.submit(*stamps(5))
    deadline = time.monotonic() + TIMEOUT
    while len(harness.results) < 5 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert harness.answered == stamps(5)


def test_keeps_the_newest_images_when_too_many_wait():
    harness = Harness(queue_size=3)
    harness.segmenter.gate.clear()
    harness.submit(0)
    while harness.worker.waiting:
        time.sleep(0.001)
    harness.submit(*stamps(10, PERIOD))
    harness.segmenter.gate.set()
    harness.finish()
    assert harness.answered == [0, *stamps(3, 8 * PERIOD)]
    assert harness.totals()[Event.DROPPED] == 7


def test_tells_the_segmenter_how_many_images_wait(harness):
    harness.segmenter.gate.clear()
    harness.submit(0)
    while not harness.segmenter.waiting:
        time.sleep(0.001)
    harness.submit(*stamps(6, PERIOD))
    harness.segmenter.gate.set()
    harness.finish()
    assert harness.segmenter.waiting == [0, 5, 4, 3, 2, 1, 0]


def test_an_image_that_cannot_be_read_is_skipped(harness):
    bad = ImageConversionError("no such encoding")
    harness.submit(*stamps(3), bad, *stamps(3, 3 * PERIOD))
    harness.finish()
    assert harness.answered == stamps(6)
    assert harness.totals()[Event.SKIPPED] == 1
    assert any("no such encoding" in line for line in harness.logger.lines)


def test_a_repeated_stamp_is_skipped(harness):
    harness.submit(0, PERIOD, PERIOD, 2 * PERIOD)
    harness.finish()
    assert harness.answered == stamps(3)
    assert harness.totals()[Event.SKIPPED] == 1


def test_a_bag_that_loops_begins_a_new_window(harness):
    harness.submit(*stamps(20), *stamps(20))
    harness.finish()
    assert harness.answered == stamps(20) * 2
    assert harness.segmenter.calls.count("reset") == 1
    assert harness.segmenter.calls.index("reset") == 20


def test_a_failing_frame_is_answered_empty_and_the_next_go_on(harness):
    harness.segmenter.fail_at = (stamps(20)[10],)
    harness.submit(*stamps(20))
    harness.finish()
    assert harness.answered == stamps(20)
    empty = [result for result in harness.results if not result.labels.any()]
    # The frame itself and the two whose look-ahead it ended.
    assert [result.frame.stamp for result in empty] == stamps(3, stamps(20)[8])
    assert empty[0].labels.shape == (4, 6)
    assert harness.totals()[Event.FAILED] == 3
    (line,) = [line for line in harness.logger.lines if "RuntimeError: broken" in line]
    assert "the image of 0.330000000 s" in line
    assert harness.segmenter.calls[11:13] == ["reset", 11 * PERIOD]


def test_what_does_not_fit_the_images_is_one_line(harness, monkeypatch):
    def refuse(*_, **__):
        raise ParameterError("regions are of another picture")

    monkeypatch.setattr(harness.segmenter, "push", refuse)
    harness.submit(*stamps(3))
    harness.finish()
    assert harness.answered == stamps(3)
    lines = [line for line in harness.logger.lines if "another picture" in line]
    assert lines
    assert not any("Traceback" in line for line in lines)


def test_each_kind_of_bad_image_is_warned_about_once(harness):
    class OtherError(ImageConversionError):
        pass

    bad = [ImageConversionError("cut short"), OtherError("no such encoding")] * 20
    harness.submit(*bad, 0, *[0] * 20)
    harness.finish()
    said = [line for line in harness.logger.lines if "image skipped" in line]
    assert len(said) == 3
    for reason in ("cut short", "no such encoding", "it has the stamp of the frame before"):
        assert any(reason in line for line in said)
    assert harness.totals()[Event.SKIPPED] == 60


def test_a_stream_that_begins_anew_again_and_again_is_not_said_each_time(harness):
    for _ in range(16):
        harness.submit(*stamps(6))
    harness.finish()
    assert len(harness.answered) == 96
    assert len([line for line in harness.logger.lines if "time jumped back" in line]) == 1


def test_outlives_a_publisher_that_fails(harness):
    def refuse(_result):
        raise ValueError("cannot publish")

    good, harness.publish = harness.publish, refuse
    harness.submit(*stamps(5))
    harness.settle()
    harness.publish = good
    harness.submit(*stamps(5, 5 * PERIOD))
    harness.finish()
    assert harness.answered == stamps(7, 3 * PERIOD)
    assert harness.totals()[Event.FAILED] == 3
    assert any("cannot publish" in line for line in harness.logger.lines)


def test_a_restart_answers_what_is_at_hand(harness):
    harness.submit(*stamps(5))
    harness.settle()
    harness.worker.restart("asked to")
    harness.settle()
    assert harness.answered == stamps(5)
    assert harness.segmenter.calls[-1] == "reset"
    assert "new window: asked to" in harness.logger.lines


def test_new_parameters_reach_the_segmenter_between_frames(harness):
    changed = Parameters.from_mapping({"diagnostics.min_rate": 5.0})
    harness.submit(*stamps(5))
    harness.settle()
    harness.worker.reconfigure(changed)
    harness.submit(*stamps(5, 5 * PERIOD))
    harness.finish()
    assert harness.answered == stamps(10)
    assert harness.segmenter.calls[5] == changed


def test_stopping_answers_the_window_and_drops_what_waits(harness):
    harness.submit(*stamps(4))
    harness.settle()
    harness.segmenter.gate.clear()
    harness.submit(*stamps(4, 4 * PERIOD))
    stopper = threading.Thread(target=harness.worker.stop)
    stopper.start()
    harness.segmenter.gate.set()
    stopper.join(TIMEOUT)
    assert not stopper.is_alive()
    assert harness.answered == stamps(len(harness.answered))
    totals = harness.totals()
    assert totals[Event.ANSWERED] + totals[Event.DROPPED] == 8


def test_stopping_gives_up_on_a_frame_that_takes_for_ever(harness, monkeypatch):
    monkeypatch.setattr("turbseg_ros.nodes.worker._STOP_TIMEOUT", 0.05)
    harness.submit(*stamps(4))
    harness.settle()
    harness.segmenter.gate.clear()
    harness.submit(*stamps(1, 4 * PERIOD))
    while harness.worker.waiting:
        time.sleep(0.001)
    answered = harness.answered
    harness.worker.stop()
    assert any("go unanswered" in line for line in harness.logger.lines)
    harness.segmenter.gate.set()
    harness.worker._thread.join(TIMEOUT)
    assert harness.answered == answered


def test_a_flush_learns_how_many_images_wait_by_then(harness):
    harness.submit(*stamps(5), stamps(1, -(10**10))[0])
    harness.settle()
    harness.segmenter.gate.clear()
    harness.submit(*stamps(4, -(10**10) + PERIOD))
    while harness.worker.waiting > 3:
        time.sleep(0.001)
    assert harness.segmenter.waiting_at_flush() == 3


def test_inbox_gives_commands_before_images():
    inbox = Inbox(capacity=2)
    inbox.put(Arrival("image", 0))

    def command():
        pass

    inbox.command(command)
    assert inbox.take(0.0) is command
    assert inbox.take(0.0) == Arrival("image", 0)
    assert inbox.take(0.0) is None


def test_inbox_counts_what_it_clears():
    inbox = Inbox(capacity=2)
    assert [inbox.put(Arrival(number, 0)) for number in range(4)] == [0, 0, 1, 1]
    assert inbox.clear() == 2
    assert inbox.clear() == 0


def test_the_oldest_image_kept_tells_that_others_were_dropped_before_it():
    inbox = Inbox(capacity=2)
    for number in range(4):
        inbox.put(Arrival(number, 0))
    taken = [inbox.take(0.0) for _ in range(2)]
    assert taken == [Arrival(2, 0, after_drops=True), Arrival(3, 0)]


def test_images_that_were_dropped_are_no_pause():
    harness = Harness(queue_size=3)
    harness.segmenter.gate.clear()
    harness.submit(*stamps(3))
    while harness.worker.waiting > 2:
        time.sleep(0.001)
    harness.submit(*stamps(60, 3 * PERIOD))
    harness.segmenter.gate.set()
    harness.finish()
    assert harness.totals()[Event.DROPPED] > 30
    assert not any("new window" in line for line in harness.logger.lines)


def wait_for_pauses(harness, count):
    deadline = time.monotonic() + TIMEOUT
    while len(harness.pauses) < count and time.monotonic() < deadline:
        time.sleep(0.01)
    return harness.pauses


def test_a_pause_is_told_once_after_all_results(harness):
    harness.submit(*stamps(5))
    assert wait_for_pauses(harness, 1) == [5]
    harness.submit(*stamps(5, 5 * PERIOD))
    assert wait_for_pauses(harness, 2) == [5, 10]


def test_frames_that_took_long_are_no_pause(harness, monkeypatch):
    monkeypatch.setattr("turbseg_ros.nodes.worker._GRACE", TIMEOUT)
    harness.segmenter.gate.clear()
    harness.submit(PERIOD)
    time.sleep(harness.worker.pause_timeout + 0.1)
    harness.segmenter.gate.set()
    # The next image is still on its way.
    time.sleep(0.2)
    assert harness.pauses == []
    harness.submit(2 * PERIOD)
    harness.settle()
    harness.worker.stop()
    assert harness.answered == [PERIOD, 2 * PERIOD]


def test_a_stream_that_is_said_to_end_pauses_once_what_waits_is_answered():
    harness = Harness()
    harness.segmenter.gate.clear()
    harness.submit(0)
    while not harness.segmenter.waiting:
        time.sleep(0.001)
    harness.submit(*stamps(6, PERIOD))
    harness.worker.end_stream()
    assert harness.pauses == []
    harness.segmenter.gate.set()
    assert wait_for_pauses(harness, 1) == [7]
    harness.worker.stop()
    assert harness.pauses == [7, 7]


def test_stopping_is_a_pause(harness):
    harness.submit(*stamps(3))
    harness.finish()
    assert harness.pauses[0] == 3


def test_images_whose_stamps_are_not_set_are_all_answered_and_told_once(harness):
    number = iter(range(1, 1000))

    def frame(_message):
        return Frame(0, np.full((4, 6), next(number), np.uint8))

    times = iter(range(10**18, 10**18 + 1000 * PERIOD, PERIOD))
    harness.worker._convert = frame
    harness.worker._now = lambda: next(times)
    harness.submit(*range(30))
    harness.settle()
    harness.worker._now = lambda: 0
    harness.finish()
    assert len(harness.answered) == 30
    assert harness.answered[0] == 10**18
    assert len({*harness.answered}) == 30
    assert sum("stamps are unusable" in line for line in harness.logger.lines) == 1
