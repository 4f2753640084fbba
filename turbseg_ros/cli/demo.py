"""The demonstration: a bag through the live node over DDS, recorded, scored and drawn.

Run as `python -m turbseg_ros.cli demo`. It stays on this machine, in a ROS domain of its own.
"""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from turbseg_ros.bag.frames import BagFrames
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.schema import is_installed
from turbseg_ros.bag.topics import DIAGNOSTICS_TOPIC, LABELS_TOPIC, RESULT_NAMESPACE, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli.errors import UsageError, executable
from turbseg_ros.cli.outputs import check_folder
from turbseg_ros.cli.parsers.demo import build_parser
from turbseg_ros.cli.processes import (
    ChildProcess,
    ProcessError,
    SignalWatch,
    executable_process,
    signals_watched,
)
from turbseg_ros.evaluation.evaluate import EvaluationError, evaluate_labels
from turbseg_ros.evaluation.labels import (
    LabelsByStamp,
    StampedLabels,
    read_labels,
    result_from_labels,
)
from turbseg_ros.evaluation.scores import Table, write_json
from turbseg_ros.messages.events import EventMessages, EventWatch
from turbseg_ros.messages.results import CentroidMarkers, outputs
from turbseg_ros.nodes.recorder import Recorder
from turbseg_ros.overlay import OverlayStrip, write_picture
from turbseg_ros.parameters import Parameters

# No frame is dropped here, however slow the machine: as many as the queue takes may wait.
_PARAMETERS = Parameters().replace({"queue_size": 1000})
# Seconds that the processes may take to find one another, and that may pass without any result;
# generous, for a machine that is busy with other things.
_START_LIMIT = 60.0
_SILENCE_LIMIT = 30.0
# Seconds that other topics may be behind the last labels.
_SETTLE_LIMIT = 2.0


@dataclass(frozen=True)
class _Products:
    """What the demonstration leaves in its directory."""

    directory: Path

    @property
    def bag(self) -> Path:
        return self.directory / "bag"

    @property
    def scores(self) -> Path:
        return self.directory / "scores.json"

    @property
    def overlay(self) -> Path:
        return self.directory / "overlay.png"

    @property
    def logs(self) -> Path:
        return self.directory / "log"

    def clear(self) -> None:
        """Make the directory, without what an earlier run left in it.

        :raises UsageError: when something else lies where the bag shall be.
        """
        check_folder(self.directory)
        if self.bag.exists() and not (self.bag / "metadata.yaml").is_file():
            raise UsageError(f"{self.bag} is no bag; remove it or choose another --out")
        for directory in (self.bag, self.logs):
            shutil.rmtree(directory, ignore_errors=True)
        for file in (self.scores, self.overlay):
            file.unlink(missing_ok=True)
        self.logs.mkdir(parents=True)


@executable("demo")
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demonstration; return its exit status, 1 when something fell short."""
    options = build_parser().parse_args(arguments)
    source = BagReader(options.bag)
    image_topic = source.find_image_topic()
    truth = LabelsByStamp(read_labels(source, TRUTH_TOPIC))
    products = _Products(options.out)
    products.clear()

    _enter_own_domain(products.logs)
    print(f"{options.bag} through turbseg_node over DDS, recorded into {products.bag}", flush=True)
    try:
        _record_live(source, image_topic, products)
        unanswered = _draw(BagFrames(source, image_topic), products)
        scores = evaluate_labels(str(source.path), _recorded_labels(products), truth)
    except (ProcessError, EvaluationError) as error:
        return _fall_short(str(error))
    write_json(products.scores, [scores], _PARAMETERS.as_mapping())
    for table in Table.of_bags([scores.bag]).fitted():
        print(f"{table.head}\n{table.row(scores)}\n")
    print(f"{products.scores}, {products.overlay}")
    if unanswered:
        return _fall_short(f"{unanswered} of {scores.frames + unanswered} frames went unanswered")
    if scores.j is None or scores.j < options.minimum_j:
        return _fall_short(f"J is {scores.j or 0.0:.3f}, below {options.minimum_j}")
    return 0


def _fall_short(reason: str) -> int:
    print(f"demo: {reason}", file=sys.stderr)
    return 1


def _enter_own_domain(logs: Path) -> None:
    """Keep this process and those it starts apart from all other ROS nodes."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    # Domains above 100 reach into the range of ephemeral ports.
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_LOG_DIR"] = str(logs.resolve())


def _record_live(source: BagReader, image_topic: str, products: _Products) -> None:
    """Play the bag into a node; record what the node publishes, until all is answered or silent.

    :raises ProcessError: when node or player fail, or the node answers nothing.
    """
    node_log, play_log = products.logs / "turbseg_node.txt", products.logs / "turbseg_play.txt"
    node_arguments = ["--ros-args", "-r", f"image_raw:={image_topic}"]
    node_arguments += ["-p", f"queue_size:={_PARAMETERS.queue_size}"]
    play_arguments = [str(source.path), "--topics", image_topic, "--wait", str(_START_LIMIT)]
    with (
        signals_watched() as signals,
        executable_process("node", node_arguments, node_log) as node,
        BagWriter(products.bag) as bag,
        _ros_context(),
    ):
        # Slot masks say nothing that the labels don't.
        events = EventMessages(EventWatch(lambda: _PARAMETERS.tracking.max_age))
        results = outputs(0, CentroidMarkers(), events)
        published = [output for output in results if is_installed(output.type_name)]
        topics = {f"{RESULT_NAMESPACE}/{each.name}": each.type_name for each in published}
        of_frames = [f"{RESULT_NAMESPACE}/{each.name}" for each in published if each.every_frame]
        topics[DIAGNOSTICS_TOPIC] = "diagnostic_msgs/msg/DiagnosticArray"
        recorder = Recorder(bag, topics)
        _await_publishers(recorder, functools.partial(_step, recorder, signals, [node]))
        with executable_process("play", play_arguments, play_log) as play:
            step = functools.partial(_step, recorder, signals, [node, play])
            _await_results(recorder, of_frames, source.topics[image_topic].message_count, step)
        if not recorder.received(LABELS_TOPIC):
            raise ProcessError(f"turbseg_node answered no frame; {node_log} may tell why")


@contextlib.contextmanager
def _ros_context() -> Iterator[None]:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


def _step(recorder: Recorder, signals: SignalWatch, processes: Iterable[ChildProcess]) -> None:
    """Record for a moment, if all is still well."""
    signals.check()
    for process in processes:
        process.check()
    recorder.spin_once(timeout=0.1)


def _await_publishers(recorder: Recorder, step: Callable[[], None]) -> None:
    deadline = time.monotonic() + _START_LIMIT
    while not recorder.matched:
        if time.monotonic() > deadline:
            raise ProcessError(f"turbseg_node was not heard of within {_START_LIMIT:.0f} s")
        step()


def _await_results(
    recorder: Recorder, topics: Collection[str], frames: int, step: Callable[[], None]
) -> None:
    """Record until every topic has a message for each frame, or nothing comes any more.

    Each for itself: when the stream pauses, some have one more, which takes the last marks away.
    """
    received, quiet_since = 0, time.monotonic()
    with tqdm(total=frames, unit="frame", leave=False, disable=None) as progress:
        while any(recorder.received(topic) < frames for topic in topics):
            step()
            now_received = sum(map(recorder.received, topics))
            if now_received > received:
                received, quiet_since = now_received, time.monotonic()
            answered = recorder.received(LABELS_TOPIC)
            progress.update(answered - progress.n)
            limit = _SETTLE_LIMIT if answered >= frames else _SILENCE_LIMIT
            if time.monotonic() - quiet_since > limit:
                return


def _recorded_labels(products: _Products) -> Iterator[StampedLabels]:
    return read_labels(BagReader(products.bag), LABELS_TOPIC)


def _draw(frames: BagFrames, products: _Products) -> int:
    """Draw recorded labels on their frames; return how many frames have none."""
    recorded = LabelsByStamp(_recorded_labels(products))
    strip = OverlayStrip(len(frames))
    unanswered = 0
    for frame in frames:
        labels = recorded.at(frame.stamp)
        if labels is None:
            unanswered += 1
            labels = np.zeros(frame.image.shape[:2], np.uint16)
        strip.add(result_from_labels(frame, labels))
    write_picture(products.overlay, strip.picture())
    return unanswered
