"""Logging that stays short however often something happens."""

from turbseg_ros.throttle import ThrottledLogger


class Recorder:
    def __init__(self):
        self.lines = []

    def info(self, text):
        self.lines.append(("info", text))

    def warning(self, text):
        self.lines.append(("warning", text))

    def error(self, text):
        self.lines.append(("error", text))


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_each_kind_is_said_at_once_and_then_with_a_count():
    recorder, clock = Recorder(), Clock()
    log = ThrottledLogger(recorder, period=5.0, clock=clock)
    for number in range(100):
        clock.now = 0.1 * number
        log.warning("late", f"frame {number}")
        if number == 3:
            log.error("broken", "once")
    log.info("new", "hello")
    assert recorder.lines == [
        ("warning", "frame 0"),
        ("error", "once"),
        ("warning", "frame 50 (49 more like it before)"),
        ("info", "hello"),
    ]


def test_a_burst_may_be_said_and_what_was_left_out_is_told_later():
    recorder, clock = Recorder(), Clock()
    log = ThrottledLogger(recorder, period=5.0, clock=clock, burst=3)
    for number in range(10):
        clock.now = 0.1 * number
        log.info("object", f"object {number}")
        log.catch_up("object", "more objects")
    clock.now = 5.05
    log.catch_up("object", "more objects")
    log.catch_up("object", "more objects")
    assert [text for _, text in recorder.lines] == [
        "object 0",
        "object 1",
        "object 2",
        "more objects: 7",
    ]
