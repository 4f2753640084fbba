"""What is published for whom."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from std_msgs.msg import String

from support.node_harness import Probe
from support.result_topics import fresh_outputs
from turbseg_ros.bag.schema import is_installed
from turbseg_ros.messages.results import Output, one, views
from turbseg_ros.nodes.publishers import ResultPublisher
from turbseg_ros.parameters import Parameters
from turbseg_ros.segmentation.frame import Frame, SegmentationResult

TEXT = "std_msgs/msg/String"


@pytest.fixture
def probe() -> Iterator[Probe]:
    with Probe() as probe:
        yield probe


def result(stamp: int, image_wanted: bool = True) -> SegmentationResult:
    labels = np.zeros((4, 5), np.uint16)
    frame = Frame(stamp, np.zeros((4, 5), np.uint8), image_wanted=image_wanted)
    return SegmentationResult(frame, labels, (), np.zeros((4, 5), np.float32), 0.0, "none")


class Counter:
    """Builds messages that tell how many results it was given."""

    def __init__(self) -> None:
        self.built = 0

    def __call__(self, result: SegmentationResult) -> String:
        self.built += 1
        return String(data=f"{self.built} at {result.frame.stamp}")


def test_only_what_is_heard_or_stateful_is_built(probe):
    heard, unheard, stateful = Counter(), Counter(), Counter()
    publisher = ResultPublisher(
        probe.node,
        [
            Output("heard", TEXT, one(heard)),
            Output("unheard", TEXT, one(unheard)),
            Output("stateful", TEXT, one(stateful), stateful=True),
        ],
    )
    publisher.publish(result(1))
    assert (heard.built, unheard.built, stateful.built) == (0, 0, 1)
    messages = probe.listen("/probe/heard", String)
    publishers = {publisher.topic_name: publisher for publisher in probe.node.publishers}
    probe.wait_for(publishers["/probe/heard"].get_subscription_count, "the listener")
    publisher.publish(result(2))
    publisher.publish(result(3))
    assert (heard.built, unheard.built, stateful.built) == (2, 0, 3)
    probe.wait_for(lambda: len(messages) == 2, "both messages")
    assert [message.data for message in messages] == ["1 at 2", "2 at 3"]


def test_an_output_that_fails_takes_no_other_along(probe, capfd):
    def broken(_result: SegmentationResult) -> String:
        raise ValueError("cannot be drawn")

    incomplete: list[bool] = []
    before, after = Counter(), Counter()
    publisher = ResultPublisher(
        probe.node,
        [
            Output("before", TEXT, one(before), stateful=True),
            Output("broken", TEXT, one(broken), stateful=True),
            Output("ill", TEXT, lambda _: ["not a message"], stateful=True),
            Output("after", TEXT, one(after), stateful=True),
        ],
        on_incomplete=lambda: incomplete.append(True),
    )
    for stamp in range(5):
        publisher.publish(result(stamp))
    assert (before.built, after.built, len(incomplete)) == (5, 5, 5)
    log = capfd.readouterr().err
    assert log.count("output broken failed") == 1
    assert log.count("output ill failed") == 1
    assert "cannot be drawn" in log


def test_images_are_wanted_while_somebody_looks_at_them(probe):
    overlay = Counter()
    publisher = ResultPublisher(
        probe.node,
        [
            Output("labels", TEXT, one(Counter())),
            Output("overlay", TEXT, one(overlay), shows_image=True),
        ],
    )
    labels = probe.listen("/probe/labels", String)
    probe.wait_for(lambda: publisher.publish(result(1)) or labels, "labels")
    assert not publisher.image_wanted
    probe.listen("/probe/overlay", String)
    probe.wait_for(lambda: publisher.image_wanted, "the listener")
    # A frame whose image had gone when the listener came.
    publisher.publish(result(2, image_wanted=False))
    assert overlay.built == 0
    publisher.publish(result(3))
    assert overlay.built == 1


def test_a_topic_whose_type_is_not_installed_is_left_out_and_told_once(probe, capfd):
    there = Counter()
    publisher = ResultPublisher(
        probe.node,
        [
            Output("absent", "no_such_msgs/msg/Thing", one(Counter()), stateful=True),
            Output("there", TEXT, one(there), stateful=True),
        ],
    )
    publisher.publish(result(1))
    assert there.built == 1
    log = capfd.readouterr().err
    assert log.count("~/absent is not published: no_such_msgs is not installed") == 1
    assert "failed" not in log


def test_the_overlay_alone_shows_the_image():
    topics = (*fresh_outputs(2), *views())
    assert [output.name for output in topics if output.shows_image] == ["overlay"]


def test_markers_are_deleted_for_listeners_that_come_later():
    stateful = {output.name for output in fresh_outputs(2) if output.stateful}
    assert stateful == {"centroids", "events"}


def test_each_topic_keeps_as_many_messages_as_its_output_says(probe):
    topics = fresh_outputs(1)
    ResultPublisher(probe.node, topics)
    depths = {item.topic_name: item.qos_profile.depth for item in probe.node.publishers}
    wanted = {f"/probe/{out.name}": out.depth for out in topics if is_installed(out.type_name)}
    assert wanted.items() <= depths.items()
    assert depths["/probe/centroids"] > depths["/probe/labels"]
    # A stream that pauses while its first frames wait has all of them answered at once.
    assert min(output.depth for output in topics) >= Parameters().latency.warm_up


def test_waits_for_listeners_but_not_for_ever(probe):
    publisher = ResultPublisher(
        probe.node, [Output("labels", TEXT, one(lambda _: String(data="x")))]
    )
    publisher.publish(result(1))
    assert publisher.wait_until_received(5.0)
    messages = probe.listen("/probe/labels", String)
    (labels,) = [item for item in probe.node.publishers if item.topic_name == "/probe/labels"]
    probe.wait_for(labels.get_subscription_count, "the listener")
    publisher.publish(result(2))
    assert publisher.wait_until_received(5.0)
    probe.wait_for(lambda: messages, "the message")
