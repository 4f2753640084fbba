"""The node as a process of its own, over DDS on localhost."""

import itertools
import re
import signal
import subprocess
import sys
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import ImageMarker, Marker, MarkerArray

from support.drawn_bag import write_drawn_bag
from support.node_harness import (
    BEST_EFFORT,
    PERIOD,
    SECOND,
    TIMEOUT,
    Camera,
    NodeProcess,
    Probe,
    figures,
    moving_square,
    stamps_of,
)
from turbseg_ros.bag.reader import BagReader
from turbseg_ros.cli.replay import main as replay
from turbseg_ros.factory import motion_segmenter
from turbseg_ros.messages.images import image_from_message, message_from_image, ns_to_stamp
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, segment

# Small enough to keep up on a busy machine; nothing is ever dropped.
SETTINGS = {
    "resolution.processing": 160,
    "resolution.detail": 160,
    "queue_size": 500,
    "latency.coast_from": 501,
    "latency.sparse_from": 501,
}
ARGUMENTS = [item for name, value in SETTINGS.items() for item in ("-p", f"{name}:={value}")]


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """One node for all tests that leave it as it was."""
    output = tmp_path_factory.mktemp("node") / "output"
    with NodeProcess(output, *ARGUMENTS) as process:
        yield process
        status = process.stop(signal.SIGINT)
    assert status == 0, process.output
    assert "Traceback" not in process.output


@pytest.fixture(scope="module")
def only_probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@pytest.fixture
def probe(only_probe) -> Iterator[Probe]:
    yield only_probe
    only_probe.forget()


@pytest.fixture
def labels(node, probe):
    return probe.listen("/turbseg/labels", Image)


@pytest.fixture
def camera(labels, probe):
    """A camera that the node hears, its last stream answered."""
    return Camera(probe)


def wait_for_answers(probe, labels, stamps):
    probe.wait_for(lambda: len(labels) >= len(stamps), f"{len(stamps)} labels")
    assert stamps_of(labels) == stamps


def test_every_frame_is_answered_once_and_in_order(camera, labels, probe):
    stamps = camera.play(moving_square(40))
    wait_for_answers(probe, labels, stamps)
    stamps += camera.play(moving_square(10))  # goes on after a pause
    wait_for_answers(probe, labels, stamps)
    assert {(label.encoding, label.width, label.height) for label in labels} == {
        ("mono16", 160, 120)
    }
    assert {label.header.frame_id for label in labels} == {"camera"}


def outlines_of_square(**settings):
    """Return where objects are in each frame of the clip `play_square` plays, by the method."""
    parameters = Parameters.from_mapping({**SETTINGS, **settings})
    clip = [Frame(number * SECOND // 30, image) for number, image in enumerate(moving_square(40))]
    with motion_segmenter(parameters) as segmenter:
        outlines = [result.labels > 0 for result in segment(clip, segmenter)]
    assert any(outline.any() for outline in outlines)
    return outlines


def play_square(probe, labels, expected):
    """Return where the node finds objects in a clip: as expected, or in the last of five plays.

    Where a busy machine holds the camera up for long, the frames before that are answered from
    what there is, and rightly so.
    """
    for _ in range(5):
        labels.clear()
        wait_for_answers(probe, labels, Camera(probe).play(moving_square(40)))
        # Ids go on from earlier tests; the outlines are the same.
        found = [image_from_message(label) > 0 for label in labels]
        if np.array_equal(found, expected):
            break
    return found


def test_labels_are_those_that_the_segmenter_gives(labels, probe):
    expected = outlines_of_square()
    np.testing.assert_array_equal(play_square(probe, labels, expected), expected)


def answers_of(topic):
    """Return the messages that answer a frame: not those that only take away what is shown."""
    return [message for message in topic if not takes_away(message)]


def takes_away(message):
    if isinstance(message, ImageMarker):
        return message.action != ImageMarker.ADD
    if isinstance(message, MarkerArray):
        return bool(message.markers) and not any(m.action == Marker.ADD for m in message.markers)
    return False


def test_topics_agree_on_what_was_found(camera, labels, probe):
    masks = probe.listen("/turbseg/mask", Image)
    slots = [
        probe.listen(f"/turbseg/objects/slot_{slot}/mask", Image)
        for slot in range(Parameters().max_objects)
    ]
    centroids = probe.listen("/turbseg/centroids", MarkerArray)
    annotations = probe.listen("/turbseg/annotations", ImageMarker)
    overlays = probe.listen("/turbseg/overlay", Image)
    motions = probe.listen("/turbseg/motion", Image)
    clutters = probe.listen("/turbseg/clutter", Image)
    stamped = [labels, masks, *slots, annotations, overlays, motions, clutters]
    everything = [*stamped, centroids]
    camera = Camera(probe, rate=30.0)
    images = moving_square(1000)
    probe.wait_for(lambda: camera.play([next(images)]) and all(everything), "all topics")
    # Whatever has moved so far ends with the stream.
    last = [camera.stamp]
    probe.wait_for(lambda: all(stamps_of(topic[-1:]) == last for topic in stamped), "the last one")
    probe.spin(0.5)
    for topic in everything:
        topic.clear()

    stamps = Camera(probe).play(moving_square(40), answers=everything)
    # What is shown is taken away whenever the stream pauses, which answers no frame.
    probe.wait_for(lambda: all(len(answers_of(topic)) >= 40 for topic in everything), "all topics")
    annotations[:] = answers_of(annotations)
    centroids[:] = answers_of(centroids)
    for topic in stamped:
        assert stamps_of(topic) == stamps
    # Markers carry no stamp when nothing is shown: an early one may have come late.
    centroids = centroids[-40:]
    for number, label in enumerate(map(image_from_message, labels)):
        ids = {int(value) for value in np.unique(label)} - {0}
        np.testing.assert_array_equal(image_from_message(masks[number]), 255 * (label > 0))
        shown = {m.id for m in centroids[number].markers if m.action == Marker.ADD}
        assert shown >= ids
        in_slots = [image_from_message(slot[number]) > 0 for slot in slots]
        for object_mask in in_slots:
            assert len(np.unique(label[object_mask])) <= 1
        assert sum(mask.any() for mask in in_slots) == min(len(ids), len(slots))
    assert {(m.encoding, m.width, m.height) for m in overlays} == {("bgr8", 160, 120)}
    assert {m.encoding for m in motions} == {"32FC1"}
    # A cell for four by four pixels.
    size = {(m.encoding, m.width // 4, m.height // 4) for m in motions}
    assert {(m.encoding, m.width, m.height) for m in clutters} == size


def encoded(image):
    """Return a grey image in every encoding, in the other byte order and with padded rows."""
    deep = image.astype(np.uint16) * 256
    for grey, bits in ((image, "8"), (deep, "16")):
        yield message_from_image(grey, f"mono{bits}", 0)
        yield message_from_image(grey, f"{bits}UC1", 0)
        for pattern in ("rggb", "bggr", "gbrg", "grbg"):
            yield message_from_image(grey, f"bayer_{pattern}{bits}", 0)
        for order in ("bgr", "rgb", "bgra", "rgba"):
            yield message_from_image(cv2.merge([grey] * len(order)), f"{order}{bits}", 0)
    for packed in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"):
        yield message_from_image(cv2.merge((image, image)), packed, 0)
    yield message_from_image(image.astype(np.float32) / 255, "32FC1", 0)
    padded = message_from_image(image, "mono8", 0)
    padded.step += 24
    padded.data = bytes(np.pad(image, ((0, 0), (0, 24))).tobytes())
    yield padded
    swapped = message_from_image(deep.byteswap(), "mono16", 0)
    swapped.is_bigendian = 1 - swapped.is_bigendian
    yield swapped


def test_every_encoding_is_taken_in_midstream(camera, labels, probe):
    first, second = moving_square(2)
    pairs = zip(encoded(first), encoded(second), strict=True)
    stamps = camera.play(itertools.chain.from_iterable(pairs), answers=[labels])
    wait_for_answers(probe, labels, stamps)
    assert len(stamps) > 50
    assert {(label.width, label.height) for label in labels} == {(160, 120)}


def test_the_size_may_change_in_midstream(camera, labels, probe, node):
    stamps = camera.play(moving_square(8)) + camera.play(moving_square(8, (90, 200)))
    wait_for_answers(probe, labels, stamps)
    assert [(label.width, label.height) for label in labels] == [(160, 120)] * 8 + [(200, 90)] * 8
    assert "new window: the image changed from 160x120x" in node.output


def test_bad_images_are_skipped(camera, labels, probe, node):
    good = list(moving_square(10))
    stamps = camera.play(good[:5])
    cut = message_from_image(good[0], "mono8", 0)
    cut.data = cut.data[:100]
    camera.send(cut)
    camera.send(Image(width=4, height=4, step=4, encoding="jpeg?", data=bytes(16)))
    camera.send(Image())
    stamps += camera.play(good[5:])
    wait_for_answers(probe, labels, stamps)
    assert "image skipped: " in node.output


def test_stamps_that_repeat_are_skipped_and_those_that_jump_back_begin_anew(
    camera, labels, probe, node
):
    stamps = camera.play(moving_square(5))
    camera.stamp -= SECOND // 30
    camera.play(moving_square(1))
    camera.stamp -= 60 * SECOND
    stamps += camera.play(moving_square(5))
    wait_for_answers(probe, labels, stamps)
    assert "new window: time jumped back by " in node.output


def test_subscribes_as_the_cameras_offer(camera, labels, probe):
    diagnostics = probe.listen("/diagnostics", DiagnosticArray)
    best_effort = Camera(probe, qos=BEST_EFFORT, rate=30.0)
    probe.wait_for(
        lambda: figures(diagnostics)["input reliability"] == "best_effort",
        "a best-effort subscription",
    )
    images = itertools.cycle(moving_square(40))
    sent = []  # any of which may be lost
    probe.wait_for(
        lambda: sent.extend(best_effort.play([next(images)])) or labels, "an image to be answered"
    )
    best_effort.close()
    probe.wait_for(
        lambda: figures(diagnostics)["input reliability"] == "reliable",
        "a reliable subscription",
    )
    wait_until_settled(probe, diagnostics)
    answered = stamps_of(labels)
    assert answered == sorted(set(answered) & set(sent))


def wait_until_settled(probe, diagnostics):
    """Wait until whatever was received has been answered, and nothing more comes."""

    def settled():
        counts = [
            {key: value for key, value in figures([array]).items() if key.startswith("images ")}
            for array in diagnostics[-2:]
        ]
        ends = ("answered", "skipped", "dropped", "failed")
        ended = sum(int(counts[-1][f"images {end}"]) for end in ends)
        return counts[0] == counts[-1] and int(counts[-1]["images received"]) == ended

    seen = len(diagnostics)
    probe.wait_for(lambda: len(diagnostics) >= seen + 2, "the last counts")
    probe.wait_for(settled, "all to be answered")


def test_diagnostics_come_every_second(camera, labels, probe):
    diagnostics = probe.listen("/diagnostics", DiagnosticArray)
    wait_for_answers(probe, labels, camera.play(moving_square(40)))
    seen = len(diagnostics)
    probe.wait_for(lambda: len(diagnostics) >= seen + 5, "diagnostics")
    # One may come late, but not all of them.
    steps = np.diff(stamps_of(diagnostics)) / SECOND
    assert np.mean(steps) == pytest.approx(1.0, abs=0.3)
    assert diagnostics[-1].status[0].name == "/turbseg: segmentation"
    assert diagnostics[-1].status[0].hardware_id == "camera"
    shown = figures(diagnostics)
    assert shown["images received"] != "0"
    assert shown["images dropped"] == "0"
    assert shown["input topic"] == "/image_raw"
    assert shown["ego-motion model"]


def test_reset_answers_what_is_at_hand(camera, labels, probe, node):
    stamps = camera.play(moving_square(20))
    response = probe.call("/turbseg/reset", Trigger, Trigger.Request())
    assert response.success
    wait_for_answers(probe, labels, stamps)
    assert "new window: reset was called" in node.output


def test_a_disabled_node_hears_nothing_until_it_is_enabled(camera, labels, probe):
    assert probe.call("/turbseg/enable", SetBool, SetBool.Request(data=False)).success
    probe.wait_for(lambda: not probe.node.count_subscribers("/image_raw"), "no subscription")
    camera.play(moving_square(5))
    probe.spin(0.5)
    assert labels == []
    assert probe.call("/turbseg/enable", SetBool, SetBool.Request(data=True)).success
    camera = Camera(probe)
    wait_for_answers(probe, labels, camera.play(moving_square(5)))


def set_parameters(probe, **values):
    kinds: dict[type, tuple[str, int]] = {int: ("integer_value", ParameterType.PARAMETER_INTEGER)}
    kinds[float] = ("double_value", ParameterType.PARAMETER_DOUBLE)
    kinds[str] = ("string_value", ParameterType.PARAMETER_STRING)
    parameters = []
    for name, value in values.items():
        field, kind = kinds[type(value)]
        content = ParameterValue(type=kind, **{field: value})
        parameters.append(Parameter(name=name.replace("__", "."), value=content))
    return probe.call(
        "/turbseg/set_parameters_atomically",
        SetParametersAtomically,
        SetParametersAtomically.Request(parameters=parameters),
    ).result


def test_parameters_change_live_or_are_refused_with_the_reason(camera, labels, probe):
    stamps = camera.play(moving_square(10))
    assert set_parameters(probe, growing__delta=0.5, seed__delta1=4.0).successful
    stamps += camera.play(moving_square(10))
    wait_for_answers(probe, labels, stamps)
    refused = set_parameters(probe, growing__delta=0.4, flow__interval=2)
    assert not refused.successful
    assert "read-only" in refused.reason and "flow.interval" in refused.reason
    refused = set_parameters(probe, growing__delta=-1.0)
    assert not refused.successful
    assert "growing.delta" in refused.reason
    default = Parameters()
    restored = {
        "growing__delta": default.growing.delta,
        "seed__delta1": default.seed.delta1,
    }
    assert set_parameters(probe, **restored).successful


def test_regions_are_ignored_from_when_their_file_is_set(labels, probe, node, tmp_path):
    file = tmp_path / "regions.yaml"
    # The right half of what the square goes over.
    file.write_text("regions: [{name: right, polygon: [[0.5, 0], [1, 0], [1, 1], [0.5, 1]]}]")
    expected = outlines_of_square(**{"regions.file": str(file)})
    refused = set_parameters(probe, regions__file=f"{file}.missing")
    assert not refused.successful
    assert refused.reason.endswith("regions.yaml.missing: No such file or directory")
    assert set_parameters(probe, regions__file=str(file)).successful
    try:
        found = play_square(probe, labels, expected)
        np.testing.assert_array_equal(found, expected)
        assert not np.any(np.asarray(found)[:, :, 80:])
        assert set_parameters(probe, regions__file=str(file)).successful
        probe.wait_for(lambda: "regions are read again" in node.output, "the log")
    finally:
        assert set_parameters(probe, regions__file="").successful


def test_markers_lie_on_the_unit_depth_plane_once_the_camera_is_known(node, probe):
    info = CameraInfo(width=160, height=120, k=[1000.0, 0.0, 80.0, 0.0, 1000.0, 60.0, 0, 0, 1.0])
    infos = probe.advertise("/camera_info", CameraInfo)
    centroids = probe.listen("/turbseg/centroids", MarkerArray)
    camera = Camera(probe, rate=30.0)

    def newest_balls():
        infos.publish(info)
        camera.play([next(images)])
        newest = centroids[-1].markers if centroids else []
        return [m for m in newest if m.action == Marker.ADD and m.ns == "centroid"]

    images = moving_square(1000)
    probe.wait_for(
        lambda: any(ball.pose.position.z == 1.0 for ball in newest_balls()), "the unit depth"
    )
    balls = newest_balls()
    assert {ball.pose.position.z for ball in balls} == {1.0}
    assert all(abs(ball.pose.position.x) <= 0.08 for ball in balls)


def shown_ids(messages):
    """Return which markers a viewer shows after these messages."""
    shown = set()
    for marker in (marker for message in messages for marker in message.markers):
        key = marker.ns, marker.id
        shown = shown | {key} if marker.action == Marker.ADD else shown - {key}
    return shown


@pytest.mark.parametrize("end", ["pause", "disable", "stop"])
def test_markers_are_deleted_when_no_more_images_come(tmp_path, probe, end):
    with NodeProcess(tmp_path / "output", *ARGUMENTS, "-r", "__ns:=/ends") as process:
        centroids = probe.listen("/ends/turbseg/centroids", MarkerArray)
        annotations = probe.listen("/ends/turbseg/annotations", ImageMarker)
        camera = Camera(probe, "/ends/image_raw", rate=30.0)
        images = moving_square(1000)
        probe.wait_for(lambda: camera.play([next(images)]) and shown_ids(centroids), "markers")
        assert all(
            marker.lifetime.sec >= 1
            for message in centroids
            for marker in message.markers
            if marker.action == Marker.ADD
        )
        if end == "disable":
            request = SetBool.Request(data=False)
            assert probe.call("/ends/turbseg/enable", SetBool, request).success
        elif end == "stop":
            process.process.send_signal(signal.SIGINT)
        probe.wait_for(lambda: not shown_ids(centroids), "deletion")
        probe.wait_for(
            lambda: annotations and annotations[-1].action == ImageMarker.REMOVE, "removal"
        )
        if end != "stop":
            process.process.send_signal(signal.SIGINT)
        assert process.wait() == 0, process.output
        assert "Traceback" not in process.output


@pytest.mark.parametrize("latched", [True, False])
def test_camera_info_is_heard_when_it_is_latched_and_when_it_is_not(tmp_path, probe, latched):
    info = CameraInfo(width=320, height=240, k=[2e3, 0.0, 160.0, 0.0, 2e3, 120.0, 0.0, 0.0, 1.0])
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL) if latched else 1
    infos = probe.advertise("/late/camera_info", CameraInfo, qos, heard=False)
    infos.publish(info)
    with NodeProcess(tmp_path / "output", *ARGUMENTS, "-r", "__ns:=/late") as process:
        centroids = probe.listen("/late/turbseg/centroids", MarkerArray)
        camera = Camera(probe, "/late/image_raw", rate=30.0)
        images = moving_square(1000)

        def balls():
            if not latched:
                infos.publish(info)
            camera.play([next(images)])
            markers = [marker for message in centroids[-3:] for marker in message.markers]
            return [marker for marker in markers if marker.ns == "centroid" and marker.scale.x]

        probe.wait_for(
            lambda: any(ball.pose.position.z == 1.0 for ball in balls()), "the unit depth"
        )
        # Those of half the sensor's resolution.
        assert all(abs(ball.pose.position.x) <= 0.08 for ball in balls())
        assert process.stop(signal.SIGINT) == 0, process.output
        assert "incompatible" not in process.output.lower()


def test_namespace_remapping_compressed_images_and_the_clock(tmp_path, probe):
    arguments = [
        *ARGUMENTS,
        *("-r", "__ns:=/north", "-r", "image_raw:=/lens/image"),
        *("-p", "image_transport:=compressed", "-p", "use_sim_time:=true"),
    ]
    with NodeProcess(tmp_path / "output", *arguments) as process:
        labels = probe.listen("/north/turbseg/labels", Image)
        camera = Camera(probe, "/lens/image/compressed", CompressedImage)
        stamps = []
        deep = (image.astype(np.uint16) * 256 for image in moving_square(4))
        for kind, images in (
            (".png", moving_square(4)),
            (".jpg", moving_square(4)),
            (".png", deep),
        ):
            for image in images:
                data = cv2.imencode(kind, image)[1].tobytes()
                stamps.append(camera.send(CompressedImage(format=kind[1:], data=data)))
        wait_for_answers(probe, labels, stamps)
        diagnostics = probe.listen("/diagnostics", DiagnosticArray)
        clock = probe.advertise("/clock", Clock)

        def times_told():
            return [
                array.header.stamp
                for array in diagnostics
                if array.status[0].name.startswith("/north")
            ]

        for second in (100, 101, 50):
            now = Clock(clock=ns_to_stamp(second * SECOND))
            # Time may pass a node by: /clock is best effort, and only its newest is kept.
            probe.wait_for(
                lambda now=now: clock.publish(now) or now.clock in times_told(), "the node's time"
            )
        probe.wait_for(lambda: "/clock jumped by -51.000 s" in process.output, "the log")
        assert process.stop(signal.SIGTERM) == 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("-p", "flow.interval:=99"), "parameter flow.interval lies between 1 and 16, not at 99"),
        (("-p", "image_transport:=avi"), "parameter image_transport is one of raw, compressed"),
        (("-p", "tracking.mode:=kmeans"), "set -p tracking.mode:=kalman, or segment a recorded"),
        (("--params-file", "missing.yaml"), "missing.yaml"),
        (("--nonsense",), "--nonsense"),
    ],
)
def test_what_is_refused_at_start_is_said_in_one_line(tmp_path, arguments, reason):
    with NodeProcess(tmp_path / "output", *arguments) as process:
        assert process.wait() == 2
    (line,) = [line for line in process.output.splitlines() if "[rcl]" not in line]
    assert line.startswith("turbseg_node: ")
    assert reason in line


def test_a_nodes_labels_are_those_of_the_replay(tmp_path, probe):
    stamps = [SECOND + number * PERIOD for number in range(40)]
    bag = write_drawn_bag(tmp_path / "bag", stamps)
    settings = [argument for argument in ARGUMENTS if argument != "-p"]
    given = [item for setting in settings for item in ("-p", setting)]
    assert replay([str(bag), "-o", str(tmp_path / "replayed"), *given]) == 0
    replayed = BagReader(tmp_path / "replayed")

    remapping = ("-r", "__ns:=/twin", "-r", "image_raw:=/lens/image_raw")
    kinds = {"labels": Image, "mask": Image, "centroids": MarkerArray, "annotations": ImageMarker}
    player = [sys.executable, "-m", "turbseg_ros.cli", "play", str(bag), "--rate", "0.5"]
    player += ["--wait", str(TIMEOUT), "--topics", "/lens/image_raw"]
    with NodeProcess(tmp_path / "output", *ARGUMENTS, *remapping) as node:
        live = {name: probe.listen(f"/twin/turbseg/{name}", kind) for name, kind in kinds.items()}
        with subprocess.Popen(player) as play:
            probe.wait_for(lambda: play.poll() is not None, "the player's end")
        for name, messages in live.items():
            probe.wait_for(lambda messages=messages: len(messages) >= 40, f"all of {name}")
        assert node.stop(signal.SIGINT) == 0
    assert any(image_from_message(label).any() for label in live["labels"])
    for name, messages in live.items():
        expected = [record.message() for record in replayed.messages([f"/turbseg/{name}"])]
        # Live, what is shown is taken away at the end.
        assert messages[:40] == expected
        assert len(messages) <= 40 + (name in ("centroids", "annotations"))


def test_two_nodes_in_namespaces_each_take_their_part_of_one_file(tmp_path, probe):
    file = tmp_path / "cameras.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n"
        "    resolution: {processing: 160, detail: 160}\n    queue_size: 100\n"
        "/north/turbseg:\n  ros__parameters: {max_objects: 1, lens: wide}\n"
        "south:\n  turbseg:\n    ros__parameters: {max_objects: 2}\n"
    )
    arguments = [
        ("--params-file", str(file), "-r", f"__ns:=/{name}") for name in ("north", "south")
    ]
    with (
        NodeProcess(tmp_path / "north", *arguments[0]) as north,
        NodeProcess(tmp_path / "south", *arguments[1]) as south,
    ):
        labels = {
            name: probe.listen(f"/{name}/turbseg/labels", Image) for name in ("north", "south")
        }
        cameras = {name: Camera(probe, f"/{name}/image_raw") for name in labels}
        stamps = {
            "north": cameras["north"].play(moving_square(20), answers=[labels["north"]]),
            "south": cameras["south"].play(
                moving_square(20, (90, 200)), answers=[labels["south"]]
            ),
        }
        for name in labels:
            wait_for_answers(probe, labels[name], stamps[name])
        assert {label.width for label in labels["north"]} == {160}
        assert {label.width for label in labels["south"]} == {200}
        topics = {name for name, _ in probe.node.get_topic_names_and_types()}
        assert {name for name in topics if re.match("/(north|south)/.*slot", name)} == {
            "/north/turbseg/objects/slot_0/mask",
            "/south/turbseg/objects/slot_0/mask",
            "/south/turbseg/objects/slot_1/mask",
        }
        assert [node.stop(signal.SIGINT) for node in (north, south)] == [0, 0]
    assert "ignored: unknown parameter lens" in north.output
    assert "unknown" not in south.output


def test_a_slot_goes_to_the_next_object_when_its_own_has_ended(tmp_path, probe):
    arguments = (*ARGUMENTS, "-r", "__ns:=/slots", "-p", "tracking.max_age:=8")
    with NodeProcess(tmp_path / "output", *arguments) as node:
        labels = probe.listen("/slots/turbseg/labels", Image)
        slots = probe.listen("/slots/turbseg/objects/slot_0/mask", Image)
        camera = Camera(probe, "/slots/image_raw")
        forth = list(moving_square(30))
        ground = np.minimum.reduce(forth)  # the square is brighter
        stamps = camera.play([*forth, *[ground] * 20, *forth[::-1]], answers=[labels, slots])
        wait_for_answers(probe, labels, stamps)
        probe.wait_for(lambda: len(slots) == len(stamps), "all slot masks")
        assert node.stop(signal.SIGINT) == 0
    ids = [np.unique(image_from_message(label)).tolist()[1:] for label in labels]
    assert ids[20:28] == [[1]] * 8
    # The flow looks ahead: what appears from nowhere in frame 50 may show in the one before.
    assert ids[44:49] == [[]] * 5
    assert ids[70:78] == [[2]] * 8
    for label, mask in zip(labels, slots, strict=True):
        held = image_from_message(mask) > 0
        np.testing.assert_array_equal(held, image_from_message(label) > 0)


def test_an_unknown_parameter_is_warned_about(tmp_path, probe):
    with NodeProcess(tmp_path / "output", "-p", "flow.intervl:=3") as process:
        probe.wait_for(lambda: process.output, "a warning")
        assert "unknown parameter flow.intervl; did you mean flow.interval?" in process.output
        assert process.stop(signal.SIGINT) == 0
