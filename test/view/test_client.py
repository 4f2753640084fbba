"""The ROS side: a node that the test plays, and what the viewer makes of it."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header
from visualization_msgs.msg import ImageMarker

from support.node_harness import Probe
from turbseg_ros.messages.images import message_from_image, ns_to_stamp
from turbseg_ros.view.client import Viewer
from turbseg_ros.view.state import ViewState

IMAGE = np.zeros((9, 16), np.uint8)


class PlayedNode:
    """What a node says, said by the test."""

    def __init__(self, probe: Probe, name: str = "/north/turbseg") -> None:
        self._probe, self._name = probe, name
        self._diagnostics = probe.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._annotations = probe.node.create_publisher(ImageMarker, f"{name}/annotations", 10)

    def say(self, **figures: str) -> None:
        """Publish diagnostics; the key `input_topic` stands for "input topic"."""
        values = [KeyValue(key=key.replace("_", " "), value=v) for key, v in figures.items()]
        status = DiagnosticStatus(
            name=f"{self._name}: segmentation", message="segmenting", values=values
        )
        self._diagnostics.publish(DiagnosticArray(status=[status]))

    def answer(self, stamp: int, action: int = ImageMarker.ADD) -> None:
        """Publish that nothing was found in an image."""
        header = Header(stamp=ns_to_stamp(stamp))
        self._annotations.publish(ImageMarker(header=header, action=action))


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


@pytest.fixture
def state() -> ViewState:
    # However long a busy machine takes, the node is there.
    return ViewState(clock=lambda: 0.0)


@pytest.fixture
def viewer(probe: Probe, state: ViewState) -> Iterator[Viewer]:
    viewer = Viewer(state, rate=1e6, context=probe.context)
    probe.add_node(viewer)
    yield viewer
    viewer.destroy_node()


def heard(probe: Probe, state: ViewState, node: PlayedNode, **figures: str) -> None:
    def said() -> bool:
        node.say(**figures)
        return bool(state.summary()["node"])

    probe.wait_for(said, "the viewer to hear the node")


def camera(probe: Probe, viewer: Viewer, topic: str = "/camera/image", kind=Image) -> Publisher:
    publisher = probe.node.create_publisher(kind, topic, 10)
    viewer.watch(True)
    probe.wait_for(publisher.get_subscription_count, f"a subscription to {topic}")
    return publisher


def test_the_first_node_that_is_heard_is_looked_at_and_others_are_named(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    first, second = PlayedNode(probe), PlayedNode(probe, "/south/turbseg")
    heard(probe, state, first, camera="still")
    assert state.summary()["node"] == "/north/turbseg"
    assert state.summary()["figures"]["camera"] == "still"

    def named() -> bool:
        second.say()
        return state.summary()["others"] == ["/south/turbseg"]

    probe.wait_for(named, "the other node to be named")
    assert state.summary()["node"] == "/north/turbseg"


def test_what_only_sounds_like_a_node_is_passed_over(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    for name in ("camera driver", "segmenter", "", "/two//slashes"):
        status = DiagnosticStatus(name=f"{name}: segmentation")
        publisher = probe.advertise("/diagnostics", DiagnosticArray)
        publisher.publish(DiagnosticArray(status=[status]))
    node = PlayedNode(probe)
    viewer.watch(True)
    heard(probe, state, node, input_topic="no topic at all")
    assert state.summary()["node"] == "/north/turbseg"
    probe.spin(0.3)
    node.say(input_topic="/camera/image")
    camera(probe, viewer)


def test_images_are_received_only_while_somebody_looks(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    heard(probe, state, PlayedNode(probe), input_topic="/camera/image")
    images = probe.node.create_publisher(Image, "/camera/image", 10)
    probe.spin(0.5)
    assert images.get_subscription_count() == 0
    viewer.watch(True)
    probe.wait_for(images.get_subscription_count, "a subscription")
    viewer.watch(False)
    probe.wait_for(lambda: not images.get_subscription_count(), "its end")


@pytest.mark.parametrize("kind", [Image, CompressedImage])
def test_a_picture_is_shown_when_its_result_comes(
    kind: type, probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    topic = "/camera/image" if kind is Image else "/camera/image/compressed"
    node = PlayedNode(probe)
    heard(probe, state, node, input_topic=topic)
    images = camera(probe, viewer, topic, kind)
    if kind is Image:
        message = message_from_image(IMAGE, "mono8", 5)
    else:
        message = CompressedImage(format="png", header=Header(stamp=ns_to_stamp(5)))
        message.data = cv2.imencode(".png", IMAGE)[1].tobytes()

    def shown() -> bool:
        images.publish(message)
        probe.spin(0.05)
        node.answer(5)
        return state.picture is not None

    probe.wait_for(shown, "a picture")
    assert state.picture is not None
    assert (state.picture.result.stamp, state.picture.drawn) == (5, False)
    assert (state.picture.width, state.picture.height) == (16, 9)


def test_outlines_come_with_the_very_image_that_they_were_found_in(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    node = PlayedNode(probe)
    heard(probe, state, node, input_topic="/camera/image")
    images = camera(probe, viewer)

    def shown() -> bool:
        # Results come many images later; the grey tells which image it is.
        for stamp in range(1, 21):
            images.publish(message_from_image(IMAGE + np.uint8(10 * stamp), "mono8", stamp))
            probe.spin(0.02)
        node.answer(7)
        probe.spin(0.1)
        return state.picture is not None

    probe.wait_for(shown, "a picture")
    picture = state.picture
    assert picture is not None
    image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.result.stamp == 7
    assert image is not None and image.mean() == pytest.approx(70, abs=3)


def test_where_no_result_has_an_images_stamp_the_nodes_own_picture_is_shown(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    node = PlayedNode(probe)
    heard(probe, state, node, input_topic="/camera/image")
    images = camera(probe, viewer)
    overlay = probe.node.create_publisher(Image, "/north/turbseg/overlay", 10)
    stamps = iter(range(1, 10**6))

    def gives_up() -> bool:
        images.publish(message_from_image(IMAGE, "mono8", next(stamps)))
        node.answer(10**9)
        return overlay.get_subscription_count() > 0

    probe.wait_for(gives_up, "a subscription to ~/overlay")

    def shown() -> bool:
        node.answer(2 * 10**9)
        overlay.publish(message_from_image(IMAGE, "mono8", 2 * 10**9))
        return state.picture is not None

    probe.wait_for(shown, "the node's picture")
    assert state.picture is not None and state.picture.drawn


def test_an_image_that_can_not_be_read_is_said_in_a_line(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    heard(probe, state, PlayedNode(probe), input_topic="/camera/image")
    images = camera(probe, viewer)
    broken = message_from_image(IMAGE, "mono8", 5)
    broken.encoding = "nonsense"

    def said() -> str:
        images.publish(broken)
        return str(state.summary()["problem"])

    probe.wait_for(said, "the reason")
    assert "nonsense" in state.summary()["problem"]


def test_objects_go_when_the_node_removes_its_outlines(
    probe: Probe, state: ViewState, viewer: Viewer
) -> None:
    node = PlayedNode(probe)
    heard(probe, state, node)
    changes: list[int] = []
    state.on_change = lambda: changes.append(1)

    def removed() -> bool:
        node.answer(5, ImageMarker.REMOVE)
        return bool(changes)

    probe.wait_for(removed, "the change")
    assert state.summary()["objects"] == []


def test_a_parameter_of_a_node_that_was_never_heard_is_refused(
    probe: Probe, viewer: Viewer
) -> None:
    answer = viewer.set_parameter("seed.size", 3)
    probe.wait_for(answer.done, "the answer")
    assert answer.result() == "the node was not heard yet"
