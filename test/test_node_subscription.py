"""Subscribing as publishers offer; node and publishers in one process, over localhost."""

import itertools

import pytest
from node_harness import BEST_EFFORT, RELIABLE, Probe
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Int32

from turbseg_ros.parameters import ParameterError
from turbseg_ros.ros.subscription import (
    MatchingSubscription,
    SequenceNumbers,
    strictest_reliability,
)


@pytest.mark.parametrize(
    ("offered", "expected"),
    [
        ([RELIABLE], ReliabilityPolicy.RELIABLE),
        ([RELIABLE, RELIABLE], ReliabilityPolicy.RELIABLE),
        ([BEST_EFFORT], ReliabilityPolicy.BEST_EFFORT),
        ([RELIABLE, BEST_EFFORT], ReliabilityPolicy.BEST_EFFORT),
    ],
)
def test_asks_for_what_every_publisher_meets(offered, expected):
    assert strictest_reliability(offered) == expected


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ([], 0),
        ([7], 0),  # joined late
        ([1, 2, 3], 0),
        ([1, 2, 5, 6, 8], 3),
        ([9, 10, 1, 2], 0),  # the publisher began anew
        ([None, None], 0),  # a middleware that does not number
    ],
)
def test_missing_numbers_are_counted(numbers, missing):
    sequence = SequenceNumbers()
    assert sum(sequence.missing_before(number) for number in numbers) == missing


@pytest.fixture(scope="module")
def only_probe():
    with Probe() as probe:
        yield probe


@pytest.fixture
def probe(only_probe):
    yield only_probe
    only_probe.forget()


@pytest.fixture
def subscribe(probe):
    """Make a matching subscription on a fresh topic, in a node started with arguments."""
    nodes = []
    topics = itertools.count()

    def subscribe(*arguments, reliability="auto"):
        node = Node(
            "listener",
            context=probe.context,
            cli_args=["--ros-args", *arguments],
            automatically_declare_parameters_from_overrides=True,
        )
        nodes.append(node)
        probe.add_node(node)
        received, lost = [], []
        subscription = MatchingSubscription(
            node,
            Int32,
            f"numbers_{next(topics)}",
            received.append,
            depth=10,
            reliability=reliability,
            on_lost=lost.append,
        )
        return subscription, received, lost

    yield subscribe
    for node in nodes:
        node.destroy_node()


def wait_for_match(probe, subscription, reliability):
    def matched():
        subscription.match()
        return subscription.reliability == reliability

    probe.wait_for(matched, f"a {reliability.name} subscription")


def test_changes_over_when_publishers_change(probe, subscribe):
    subscription, received, _ = subscribe()
    assert subscription.reliability == ReliabilityPolicy.RELIABLE
    weak = probe.advertise(subscription.topic, Int32, BEST_EFFORT, heard=False)
    wait_for_match(probe, subscription, ReliabilityPolicy.BEST_EFFORT)
    probe.wait_for(weak.get_subscription_count, "the best-effort publisher to be heard")
    weak.publish(Int32(data=1))
    probe.wait_for(lambda: [message.data for message in received] == [1], "a message")
    probe.withdraw(weak)
    probe.wait_for(lambda: subscription.publisher_count == 0, "the publisher to go")
    subscription.match()
    assert subscription.reliability == ReliabilityPolicy.BEST_EFFORT
    probe.advertise(subscription.topic, Int32, RELIABLE, heard=False)
    wait_for_match(probe, subscription, ReliabilityPolicy.RELIABLE)


@pytest.mark.parametrize(
    ("arguments", "reliability", "expected"),
    [
        ((), "reliable", ReliabilityPolicy.RELIABLE),
        ((), "best_effort", ReliabilityPolicy.BEST_EFFORT),
        (("reliability:=best_effort",), "auto", ReliabilityPolicy.BEST_EFFORT),
        (("reliability:=reliable",), "best_effort", ReliabilityPolicy.RELIABLE),
    ],
    ids=str,
)
def test_a_forced_reliability_stays(probe, subscribe, arguments, reliability, expected):
    override = "qos_overrides./numbers_0.subscription."
    given = [item for value in arguments for item in ("-p", override + value)]
    subscription, _, _ = subscribe(*given, reliability=reliability)
    other = RELIABLE if expected == ReliabilityPolicy.BEST_EFFORT else BEST_EFFORT
    probe.advertise(subscription.topic, Int32, other, heard=False)
    probe.wait_for(lambda: subscription.publisher_count == 1, "the publisher")
    subscription.match()
    assert subscription.reliability == expected


def test_a_publisher_that_is_not_heard_is_reported(probe, subscribe, capfd):
    subscription, _, _ = subscribe(reliability="reliable")
    probe.advertise(subscription.topic, Int32, BEST_EFFORT, heard=False)
    printed = []

    def warned():
        printed.append(capfd.readouterr().err)
        return "offers less than reliable" in "".join(printed)

    probe.wait_for(warned, "a warning")


@pytest.mark.parametrize("override", ["reliability:=perfect", "history:=all", "depth:=deep"])
def test_an_override_that_is_no_policy_is_refused(subscribe, override):
    with pytest.raises(ParameterError, match="/numbers_0"):
        subscribe("-p", f"qos_overrides./numbers_0.subscription.{override}")


def test_what_the_middleware_dropped_is_counted(probe, subscribe):
    subscription, received, lost = subscribe()
    publisher = probe.advertise(subscription.topic, Int32)
    publisher.publish(Int32(data=0))
    probe.wait_for(lambda: len(received) == 1, "the first message")
    for number in range(1, 31):
        publisher.publish(Int32(data=number))
    probe.wait_for(lambda: received[-1].data == 30, "the last message")
    assert len(received) < 31
    assert len(received) + sum(lost) == 31
