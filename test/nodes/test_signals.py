"""However and whenever the node is asked to stop, it ends well."""

from __future__ import annotations

import itertools
import random
import signal
import time
from collections.abc import Iterator

import pytest
from sensor_msgs.msg import Image

from support.node_harness import (
    Camera,
    NodeProcess,
    Probe,
    moving_square,
    quick_and_soak,
    stamps_of,
)

SIGNALS = [
    (signal.SIGINT,),
    (signal.SIGTERM,),
    (signal.SIGINT, signal.SIGINT),
    (signal.SIGTERM, signal.SIGINT),
]
by_signals = pytest.mark.parametrize(
    "signals", SIGNALS, ids=lambda signals: "+".join(number.name for number in signals)
)
# Small enough that the window is answered at once.
SMALL = ("-p", "resolution.processing:=160", "-p", "resolution.detail:=160")


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@by_signals
@pytest.mark.parametrize("times", quick_and_soak(1, 50))
@pytest.mark.timeout(1800)
def test_signals_while_it_starts_end_it_well(tmp_path, probe, signals, times):
    for number in range(times):
        stop_while_it_starts(tmp_path, probe, signals, random.Random(number).uniform(0.0, 1.5))


def stop_while_it_starts(tmp_path, probe, signals, delay):
    with NodeProcess(tmp_path / "output") as process:
        # Before its first line Python itself answers signals.
        probe.wait_for(lambda: process.blocks(signals[0]), "the node's first line")
        time.sleep(delay)
        assert process.stop(*signals) == 0
    # At most what it listens to.
    assert all("[INFO]" in line for line in process.output.splitlines()), process.output


@by_signals
@pytest.mark.parametrize("times", quick_and_soak(1, 50))
@pytest.mark.timeout(1800)
def test_signals_under_load_end_it_well(tmp_path, probe, signals, times):
    for number in range(times):
        stop_under_load(tmp_path, probe, signals, number)
        probe.forget()


def stop_under_load(tmp_path, probe, signals, more_frames):
    # With little room, so that it is busy and drops images when it is stopped.
    arguments = (*SMALL, "-r", "__ns:=/loaded", "-p", "queue_size:=2")
    with NodeProcess(tmp_path / "output", *arguments) as process:
        labels = probe.listen("/loaded/turbseg/labels", Image)
        camera = Camera(probe, "/loaded/image_raw", rate=200.0)
        images = itertools.cycle(moving_square(60, (240, 320)))
        stamps = []
        probe.wait_for(
            lambda: (
                stamps.extend(camera.play(itertools.islice(images, 20)))
                or "the oldest are dropped" in process.output
            ),
            "images to be dropped",
        )
        stamps += camera.play(moving_square(1 + more_frames, (240, 320)))
        assert process.stop(*signals) == 0
        probe.spin(0.2)
    assert "Traceback" not in process.output
    assert "unanswered" not in process.output
    answered = stamps_of(labels)
    assert answered == sorted(set(answered) & set(stamps))


@pytest.mark.parametrize("times", quick_and_soak(2, 50))
@pytest.mark.timeout(1800)
def test_signals_while_it_ends_change_nothing(tmp_path, probe, times):
    for number in range(times):
        stop_again_and_again(tmp_path, probe, random.Random(number))
        probe.forget()


def stop_again_and_again(tmp_path, probe, chance):
    with NodeProcess(tmp_path / "output", *SMALL, "-r", "__ns:=/ending") as process:
        labels = probe.listen("/ending/turbseg/labels", Image)
        camera = Camera(probe, "/ending/image_raw")
        stamps = camera.play(moving_square(9))
        probe.wait_for(lambda: labels, "an answer")
        process.process.send_signal(signal.SIGINT)
        for _ in range(5):
            time.sleep(chance.uniform(0.0, 0.05))
            process.process.send_signal(chance.choice((signal.SIGINT, signal.SIGTERM)))
        assert process.wait() == 0
        # The window's last frames are answered before it goes.
        probe.wait_for(lambda: len(labels) == len(stamps), "the last answers")
    assert "Traceback" not in process.output
