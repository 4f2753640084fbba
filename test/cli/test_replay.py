"""turbseg_replay and turbseg_evaluate, from the command line to their files."""

from __future__ import annotations

import csv
import json
import signal
import threading
import time
from collections import Counter, deque
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from visualization_msgs.msg import ImageMarker

from turbseg_ros.bag.reader import BagReader
from turbseg_ros.bag.topics import IMAGE_TOPIC, LABELS_TOPIC, TRUTH_TOPIC
from turbseg_ros.bag.writer import BagWriter
from turbseg_ros.cli import errors, evaluate, replay
from turbseg_ros.cli.errors import StopRequest
from turbseg_ros.cli.parsers.replay import VIEWS
from turbseg_ros.evaluation import baselines
from turbseg_ros.evaluation.labels import read_labels
from turbseg_ros.messages.images import message_from_image
from turbseg_ros.messages.results import (
    Output,
    annotations_message,
    one,
    outputs,
    views,
)
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, MovingObject, SegmentationResult

SIZE = (60, 90)
STEP = 33_000_000
TIME_LIMIT = 20
START = 1_700_000_000_000_000_000
# Of types that may not be installed.
SERIALISED_HERE = {"/turbseg/detections", "/turbseg/image_annotations"}


class SquareFinder:
    """Knows the drawn scene: what is bright is object 7 in slot 1. Answers two frames late."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self._waiting: deque[Frame] = deque()

    def push(self, frame: Frame) -> list[SegmentationResult]:
        self._waiting.append(frame)
        return [self._result()] if len(self._waiting) > 2 else []

    def flush(self) -> list[SegmentationResult]:
        return [self._result() for _ in range(len(self._waiting))]

    def _result(self) -> SegmentationResult:
        frame = self._waiting.popleft()
        labels = np.where(frame.image > 128, 7, 0).astype(np.uint16)
        objects = []
        if labels.any():
            x, y, width, height = cv2.boundingRect(labels.astype(np.uint8))
            centroid = (x + (width - 1) / 2, y + (height - 1) / 2)
            objects.append(MovingObject(7, 1, centroid, (3.0, 0.0), 100, (x, y, width, height)))
        motion = np.zeros((30, 45), np.float32)
        return SegmentationResult(frame, labels, tuple(objects), motion, 0.25, "affine")


@pytest.fixture(autouse=True)
def known_segmenter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "clip_segmenter", lambda p, _: SquareFinder(p))
    monkeypatch.setattr(baselines, "clip_segmenter", SquareFinder)


def picture(number: int) -> np.ndarray:
    """A bright square that is there from frame 2 to 5 and moves by 3 pixels a frame."""
    image = np.full(SIZE, 50, np.uint8)
    if 2 <= number <= 5:
        image[20:30, 10 + 3 * number : 20 + 3 * number] = 220
    return image


def write_bag(path: Path, frames: int = 8, spoiled: tuple[int, ...] = ()) -> Path:
    with BagWriter(path) as bag:
        for number in range(frames):
            stamp = START + number * STEP
            message = message_from_image(picture(number), "mono8", stamp, "lens")
            if number in spoiled:
                message.step = 1
            bag.write(IMAGE_TOPIC, message, stamp)
            truth = (picture(number) > 128).astype(np.uint8) * 3
            bag.write(TRUTH_TOPIC, message_from_image(truth, "mono8", stamp, "lens"), stamp)
    return path


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "bag")


def test_result_bag_is_read_by_an_independent_library(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert replay.main([str(bag), "-o", str(out)]) == 0
    with AnyReader([out]) as reader:
        labels: list[Any] = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages(
                [c for c in reader.connections if c.topic == "/turbseg/labels"]
            )
        ]
    assert len(labels) == 8
    for number, message in enumerate(labels):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == START + number * STEP
        assert (message.encoding, message.header.frame_id) == ("mono16", "lens")
        found = message.data.view(np.uint16).reshape(message.height, message.width)
        np.testing.assert_array_equal(found, np.where(picture(number) > 128, 7, 0))


def test_result_bag_holds_the_topics_of_the_node(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    replay.main([str(bag), "-o", str(out)])
    counts = {topic.name: topic.message_count for topic in BagReader(out).topics.values()}
    assert counts == {
        "/turbseg/labels": 8,
        "/turbseg/mask": 8,
        "/turbseg/centroids": 8,
        "/turbseg/annotations": 8,
        "/turbseg/image_annotations": 8,
        "/turbseg/events": 1,
        "/turbseg/detections": 8,
        # From the first frame with an object on, and also when it is gone.
        "/turbseg/objects/slot_1/mask": 6,
        "/diagnostics": 1,
    }


def test_two_replays_give_the_same_messages(bag: Path, tmp_path: Path) -> None:
    recorded = []
    for name in ("first", "second"):
        replay.main([str(bag), "-o", str(tmp_path / name)])
        records = BagReader(tmp_path / name).messages()
        # As messages: their serialised bytes differ in what fills up alignment. Those that this
        # package serialises itself don't, and theirs may not be installed.
        recorded.append(
            [
                (
                    item.topic,
                    item.stamp_ns,
                    item.data if item.topic in SERIALISED_HERE else item.message(),
                )
                for item in records
            ]
        )
    assert recorded[0] == recorded[1]


def test_an_unreadable_image_is_left_out_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", spoiled=(3,))
    assert replay.main([str(bag), "-o", str(tmp_path / "out")]) == 0
    labels = list(read_labels(BagReader(tmp_path / "out"), LABELS_TOPIC))
    assert [item.stamp for item in labels] == [START + n * STEP for n in (0, 1, 2, 4, 5, 6, 7)]
    assert "7 results, 1 images skipped" in capsys.readouterr().out


@pytest.mark.parametrize("metadata", [True, False])
def test_a_cut_recording_is_replayed_as_far_as_it_goes_and_the_loss_told(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    metadata: bool,
) -> None:
    bag = write_bag(tmp_path / "bag", frames=400)
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 8 // 10])
    if not metadata:
        (bag / "metadata.yaml").unlink()
    assert replay.main([str(bag), "-o", str(tmp_path / "out")]) == 0
    count = BagReader(tmp_path / "out").topics[LABELS_TOPIC].message_count
    assert 100 < count < 400
    printed = capsys.readouterr().out
    assert f"{count} results, 0 images skipped" in printed
    assert (f"{400 - count} images lost with what is damaged" in printed) == metadata
    assert "is truncated" in caplog.text
    assert ("how many messages are lost is not recorded" in caplog.text) != metadata


def test_an_output_that_fails_takes_no_other_along(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(result: SegmentationResult) -> ImageMarker:
        if result.objects:
            raise ValueError("no outline today")
        return annotations_message(result)

    def with_broken(*given: Any) -> tuple[Output, ...]:
        return tuple(
            replace(output, build=one(broken)) if output.name == "annotations" else output
            for output in outputs(*given)
        )

    monkeypatch.setattr(replay, "outputs", with_broken)
    out = tmp_path / "out"
    assert replay.main([str(bag), "-o", str(out)]) == 1
    counts = {topic.name: topic.message_count for topic in BagReader(out).topics.values()}
    assert counts == {
        "/turbseg/labels": 8,
        "/turbseg/mask": 8,
        "/turbseg/centroids": 8,
        "/turbseg/annotations": 4,
        "/turbseg/image_annotations": 8,
        "/turbseg/events": 1,
        "/turbseg/detections": 8,
        "/turbseg/objects/slot_1/mask": 6,
        "/diagnostics": 1,
    }
    assert (
        "8 results, 0 images skipped, annotations missing in 4 frames" in capsys.readouterr().out
    )
    assert caplog.text.count("output annotations failed") == 1
    assert "no outline today" in caplog.text


def test_nothing_is_written_when_no_image_can_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", frames=2, spoiled=(0, 1))
    assert replay.main([str(bag), "-o", str(tmp_path / "out")]) != 0
    assert "none of 2 images could be read" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]


def test_a_stamp_before_the_epoch_is_kept(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write(IMAGE_TOPIC, message_from_image(picture(3), "mono8", -STEP), START)
    assert replay.main([str(tmp_path / "bag"), "-o", str(tmp_path / "out")]) == 0
    (labels,) = read_labels(BagReader(tmp_path / "out"), LABELS_TOPIC)
    assert labels.stamp == -STEP


def test_overlay_strip_is_drawn_on_request(bag: Path, tmp_path: Path) -> None:
    overlay = tmp_path / "pictures" / "strip.png"
    replay.main([str(bag), "-o", str(tmp_path / "out"), "--overlay", str(overlay)])
    picture = cv2.imread(str(overlay))
    assert picture is not None
    assert picture.shape == (3 * 320 + 8, 3 * 480 + 8, 3)


def test_a_section_of_a_bag_is_replayed(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    section = ["--start", "0.06", "--duration", "0.1"]
    assert replay.main([str(bag), "-o", str(out), *section]) == 0
    stamps = [item.stamp for item in read_labels(BagReader(out), LABELS_TOPIC)]
    assert stamps == [START + number * STEP for number in (2, 3, 4)]
    assert "3 results, 0 images skipped\n1 object moved" in capsys.readouterr().out


def test_a_section_behind_the_end_is_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay.main([str(bag), "-o", str(tmp_path / "out"), "--start", "9"]) == 2
    assert "is 0.2 s long and has nothing from 9 s on" in capsys.readouterr().err


def test_a_section_of_a_bag_is_scored(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scores = tmp_path / "scores.json"
    arguments = [str(bag), "--json", str(scores), "--start", "0.06", "--duration", "0.1"]
    assert evaluate.main([*arguments, "--workers", "1"]) == 0
    (scored,) = json.loads(scores.read_text())["bags"]
    assert scored["frames"] == 3


def test_a_film_and_a_table_of_objects_are_made_on_request(bag: Path, tmp_path: Path) -> None:
    film, objects, pictures = (tmp_path / name for name in ("film.mp4", "o.csv", "pictures"))
    arguments = [str(bag), "-o", str(tmp_path / "out"), "--video", str(film)]
    arguments += ["--objects", str(objects), "--object-pictures", str(pictures)]
    assert replay.main(arguments) == 0
    capture = cv2.VideoCapture(str(film))
    assert sum(1 for _ in iter(capture.grab, False)) == 8
    (row,) = csv.DictReader(objects.read_text().splitlines())
    assert (row["id"], row["frames"], row["from_stamp"]) == ("7", "4", str(START + 2 * STEP))
    assert [path.name for path in pictures.iterdir()] == [row["picture"]]


@pytest.mark.parametrize(
    ("option", "name", "complaint"),
    [
        ("--video", "film.gif", "end the name in .mp4 or .mkv or .mov"),
        ("--objects", "objects.xls", "end the name in .csv or .parquet"),
        ("--objects", "out/objects.csv", "lies in the bag to be written"),
    ],
)
def test_a_name_that_cannot_be_is_refused_before_the_work(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    name: str,
    complaint: str,
) -> None:
    out = tmp_path / "out"
    assert replay.main([str(bag), "-o", str(out), option, str(tmp_path / name)]) == 2
    assert complaint in capsys.readouterr().err
    assert not out.exists()


def test_topics_for_people_are_written_on_request(bag: Path, tmp_path: Path) -> None:
    assert replay.main([str(bag), "-o", str(tmp_path / "out"), "--views", "clutter,motion"]) == 0
    assert replay.main([str(bag), "-o", str(tmp_path / "without")]) == 0
    shown, without = (BagReader(tmp_path / name) for name in ("out", "without"))
    assert set(shown.topics) - set(without.topics) == {"/turbseg/clutter", "/turbseg/motion"}
    counts = Counter(record.topic for record in shown.messages())
    assert counts["/turbseg/clutter"] == counts["/turbseg/labels"]
    assert {view.name for view in views()} == set(VIEWS)


def test_a_topic_that_is_none_for_people_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        replay.main([str(bag), "-o", str(tmp_path / "out"), "--views", "motion,labels"])
    assert "'labels' is none of overlay, motion, clutter" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("executable", ["replay", "evaluate"])
def test_parameters_come_from_file_and_then_from_the_command_line(
    executable: str, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []
    module, maker = {"replay": (replay, replay), "evaluate": (evaluate, baselines)}[executable]
    monkeypatch.setattr(maker, "clip_segmenter", lambda p, *_: given.append(p) or SquareFinder(p))
    file = tmp_path / "parameters.yaml"
    file.write_text("turbseg:\n  ros__parameters:\n    max_objects: 5\n    flow: {interval: 3}\n")
    arguments = [str(bag), "--params-file", str(file), "-p", "flow.interval:=2"]
    if executable == "replay":
        arguments += ["-o", str(tmp_path / "out")]
    assert module.main(arguments) == 0
    assert (given[0].max_objects, given[0].flow.interval) == (5, 2)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["-p", "flow.intervall:=2"], "unknown parameter flow.intervall; did you mean"),
        (["-p", "flow.interval:=99"], "parameter flow.interval lies between 1 and 16"),
        (["-p", "flow.interval:=[2"], "-p flow.interval:=[2: the value is not YAML"),
        (["-p", "flow.interval=2"], "-p takes NAME:=VALUE, not 'flow.interval=2'"),
        (["--params-file", "missing.yaml"], "missing.yaml"),
        (["--image-topic", "/no/such"], "has no images on /no/such"),
    ],
)
@pytest.mark.parametrize("executable", ["replay", "evaluate"])
def test_a_wrong_argument_is_one_line_and_no_output(
    executable: str,
    arguments: list[str],
    text: str,
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if executable == "replay":
        status = replay.main([str(bag), "-o", str(tmp_path / "out"), *arguments])
    else:
        status = evaluate.main([str(bag), "--json", str(tmp_path / "out"), *arguments])
    error = capsys.readouterr().err
    assert status in (1, 2)
    assert text in error
    assert error.startswith(f"turbseg_{executable}: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_evaluate_writes_table_and_json(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "results" / "scores.json"
    assert evaluate.main([str(bag), "--json", str(file), "-p", "max_objects:=4"]) == 0
    content = json.loads(file.read_text())
    (scores,) = content["bags"]
    assert (scores["bag"], scores["frames"], scores["scored_frames"]) == (str(bag), 8, 8)
    assert (scores["j"], scores["g"], scores["false_alarm_frames"]) == (1.0, 1.0, 0)
    assert (scores["id_switches"], scores["tilt_px"]) == (0, 0.25)
    assert content["mean"]["j"] == 1.0
    assert content["parameters"]["max_objects"] == 4
    assert f"\n{bag.name} " in capsys.readouterr().out


def test_one_bag_that_fails_does_not_stop_the_others(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_bag(tmp_path / "other")
    file = tmp_path / "scores.json"
    missing = tmp_path / "missing"
    arguments = [str(bag), str(missing), str(other), "--json", str(file), "--workers", "1"]
    assert evaluate.main(arguments) == 1
    assert [s["bag"] for s in json.loads(file.read_text())["bags"]] == [str(bag), str(other)]
    assert f"no such bag: {missing}" in capsys.readouterr().err


def test_recorded_labels_are_scored_against_the_truth_of_their_source(
    bag: Path, tmp_path: Path
) -> None:
    out, file = tmp_path / "out", tmp_path / "scores.json"
    replay.main([str(bag), "-o", str(out)])
    assert evaluate.main([str(bag), "--predictions", str(out), "--json", str(file)]) == 0
    content = json.loads(file.read_text())
    assert content["bags"][0]["j"] == 1.0
    assert content["bags"][0]["fps"] is None
    assert content["parameters"] == {}


def test_recorded_labels_belong_to_one_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main([str(bag), str(bag), "--predictions", str(bag)]) == 2
    assert "--predictions are those of one BAG" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_replay_keeps_the_results_there_are(
    number: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Interrupting(SquareFinder):
        def push(self, frame: Frame) -> list[SegmentationResult]:
            if frame.stamp == START + 10 * STEP:
                # As from a terminal: to the thread that the handler runs in.
                main_thread = threading.main_thread().ident
                assert main_thread is not None
                signal.pthread_kill(main_thread, number)
            return super().push(frame)

    monkeypatch.setattr(replay, "clip_segmenter", lambda p, _: Interrupting(p))
    source, out = write_bag(tmp_path / "long", frames=60), tmp_path / "out"
    strip = tmp_path / "strip.png"
    arguments = [str(source), "-o", str(out), "--overlay", str(strip)]
    assert replay.main(arguments) == 128 + number
    stamps = [labels.stamp for labels in read_labels(BagReader(out), LABELS_TOPIC)]
    # Every frame that was read got its result.
    assert stamps == [START + n * STEP for n in range(len(stamps))]
    assert 10 < len(stamps) < 60
    partial = f"interrupted after {len(stamps)} of 60 frames"
    metadata = yaml.safe_load((out / "metadata.yaml").read_text())
    assert metadata["rosbag2_bagfile_information"]["custom_data"] == {"partial": partial}
    with AnyReader([out]) as reader:
        assert reader.message_count > len(stamps)
    assert capsys.readouterr().err == f"turbseg_replay: {out} is partial: {partial}\n"
    assert strip.exists()


def test_a_replay_interrupted_twice_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupting(SquareFinder):
        def flush(self) -> list[SegmentationResult]:
            main_thread = threading.main_thread().ident
            assert main_thread is not None
            for _ in range(2):
                signal.pthread_kill(main_thread, signal.SIGINT)
                answered.wait(TIME_LIMIT)
            return super().flush()

    class Answered(StopRequest):
        def note(self, number: int, frame: FrameType | None) -> None:
            answered.set()
            super().note(number, frame)

    answered = threading.Event()
    monkeypatch.setattr(errors, "StopRequest", Answered)
    monkeypatch.setattr(replay, "clip_segmenter", lambda p, _: Interrupting(p))
    source, out = write_bag(tmp_path / "bag"), tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        replay.main([str(source), "-o", str(out)])
    assert ended.value.code == 130
    assert not out.exists()
    assert capsys.readouterr().err.endswith("interrupted; nothing of it is kept\n")


def test_a_network_fitted_to_the_clip_is_given_up_between_epochs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Fitting(SquareFinder):
        def __init__(self, parameters: Parameters, shown: Any) -> None:
            super().__init__(parameters)
            self._shown = shown

        def flush(self) -> list[SegmentationResult]:
            for epoch in self._shown(range(1000)):
                assert epoch < 999
                main_thread = threading.main_thread().ident
                assert main_thread is not None
                signal.pthread_kill(main_thread, signal.SIGINT)
                time.sleep(0.01)
            return super().flush()

    monkeypatch.setattr(replay, "clip_segmenter", Fitting)
    # Only the first signal is one: a second would interrupt by itself.
    monkeypatch.setattr(
        errors.StopRequest, "note", lambda self, n, _: setattr(self, "_received", n)
    )
    source, out = write_bag(tmp_path / "bag"), tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        replay.main([str(source), "-o", str(out)])
    assert ended.value.code == 130
    assert not out.exists()
    assert "turbseg_replay: interrupted; nothing of it is kept\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            ["-p", "outline.threshold:=3.5"],
            "outline.threshold has no effect while refine.mode is pretrained; "
            "it is used with refine.mode none or optimise",
        ),
        (["-p", "queue_size:=3"], "queue_size has no effect here; it is used by the live node"),
        (["-p", "latency.coast_from:=0"], ""),
        (["-p", "outline.threshold:=3.5", "-p", "refine.mode:=none"], ""),
    ],
)
def test_a_parameter_without_effect_says_so(
    given: list[str], said: str, bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert replay.main([str(bag), "-o", str(tmp_path / "out"), *given]) == 0
    assert capfd.readouterr().err.strip() == said


def test_of_a_nodes_file_only_what_its_own_mode_leaves_idle_is_said(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "node.yaml"
    parameters = {"queue_size": 3, "outline.threshold": 3.5, "seed.delta1": 6.0}
    file.write_text(json.dumps({"/**": {"ros__parameters": parameters}}))
    assert replay.main([str(bag), "-o", str(tmp_path / "out"), "--params-file", str(file)]) == 0
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("outline.threshold has no effect while refine.mode is pretrained")
