"""Subscribing as publishers offer; node and publishers in one process, over localhost."""

import gc
import itertools
import threading
import time

import pytest
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Int32

from support.node_harness import BEST_EFFORT, RELIABLE, TIMEOUT, Probe
from turbseg_ros.messages.cdr import image_view
from turbseg_ros.nodes.rcl_take import MessageTaker
from turbseg_ros.nodes.receiving_node import ReceivingNode
from turbseg_ros.nodes.subscription import (
    MatchingSubscription,
    SequenceNumbers,
    strictest_reliability,
)
from turbseg_ros.parameters import ParameterError


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
    nodes, subscriptions = [], []
    topics = itertools.count()

    def subscribe(*arguments, reliability="auto", kind=Int32, when=None, fails_on=None):
        node = ReceivingNode(
            "listener",
            context=probe.context,
            cli_args=["--ros-args", *arguments],
            automatically_declare_parameters_from_overrides=True,
        )
        probe.add_node(node)
        nodes.append(node)
        received, lost = [], []

        def receive(serialised):
            if when is not None:
                assert when.wait(TIMEOUT)
            if fails_on is not None and numbers([serialised]) == [fails_on]:
                raise RuntimeError(f"message {fails_on} fails")
            received.append(serialised)

        subscription = MatchingSubscription(
            node,
            kind,
            f"numbers_{next(topics)}",
            receive,
            taker=MessageTaker(node),
            depth=10,
            reliability=reliability,
            on_lost=lost.append,
        )
        subscriptions.append(subscription)
        return subscription, received, lost

    yield subscribe
    for subscription in subscriptions:
        subscription.destroy()
    for node in nodes:
        node.destroy_node()


def numbers(received):
    return [deserialize_message(bytes(message), Int32).data for message in received]


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
    # Best effort: any one of them may be lost.
    probe.wait_for(lambda: weak.publish(Int32(data=1)) or received, "a message")
    assert set(numbers(received)) == {1}
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


def test_a_publisher_that_is_not_heard_is_reported_once(probe, subscribe, capfd):
    subscription, _, _ = subscribe(reliability="reliable")
    probe.advertise(subscription.topic, Int32, BEST_EFFORT, heard=False)
    printed = []

    def warned():
        subscription.match()
        printed.append(capfd.readouterr().err)
        return "offers less than reliable" in "".join(printed)

    probe.wait_for(warned, "a warning")
    subscription.match()
    printed.append(capfd.readouterr().err)
    assert "".join(printed).count("offers less than reliable") == 1


def test_messages_are_received_while_no_executor_runs(probe, subscribe):
    subscription, received, _ = subscribe()
    publisher = probe.advertise(subscription.topic, Int32)
    for number in range(5):
        publisher.publish(Int32(data=number))
    until = time.monotonic() + TIMEOUT
    while len(received) < 5 and time.monotonic() < until:
        time.sleep(0.01)
    assert numbers(received) == [0, 1, 2, 3, 4]


def test_what_was_received_stays_when_more_comes(probe, subscribe):
    subscription, kept, _ = subscribe(kind=Image)
    publisher = probe.advertise(subscription.topic, Image)
    for number in range(5):
        image = Image(height=1, width=100_000, step=100_000, encoding="mono8")
        image.data.frombytes(bytes([number]) * 100_000)
        publisher.publish(image)
    probe.wait_for(lambda: len(kept) == 5, "all images")
    gc.collect()
    data = [bytes(image_view(serialised).data) for serialised in kept]
    assert data == [bytes([number]) * 100_000 for number in range(5)]


@pytest.mark.parametrize("override", ["reliability:=perfect", "history:=all", "depth:=deep"])
def test_an_override_that_is_no_policy_is_refused(subscribe, override):
    with pytest.raises(ParameterError, match="/numbers_0"):
        subscribe("-p", f"qos_overrides./numbers_0.subscription.{override}")


def test_what_the_middleware_dropped_is_counted(probe, subscribe):
    room = threading.Event()
    room.set()
    subscription, received, lost = subscribe(when=room)
    publisher = probe.advertise(subscription.topic, Int32)
    publisher.publish(Int32(data=0))
    probe.wait_for(lambda: len(received) == 1, "the first message")
    room.clear()
    for number in range(1, 31):
        publisher.publish(Int32(data=number))
    room.set()
    probe.wait_for(lambda: numbers(received)[-1] == 30, "the last message")
    assert len(received) < 31
    assert len(received) + sum(lost) == 31


def test_a_message_that_fails_is_logged_and_the_next_received(probe, subscribe, capfd):
    subscription, received, _ = subscribe(fails_on=1)
    publisher = probe.advertise(subscription.topic, Int32)
    for number in range(3):
        publisher.publish(Int32(data=number))
    probe.wait_for(lambda: len(received) == 2, "the others")
    assert numbers(received) == [0, 2]
    assert "RuntimeError: message 1 fails" in capfd.readouterr().err
