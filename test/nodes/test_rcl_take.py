"""Taking messages by rcl, what happens where that fails, and who else could take them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import Int32

from support.node_harness import RELIABLE, TIMEOUT
from turbseg_ros.nodes import rcl_take
from turbseg_ros.nodes.rcl_take import MessageTaker, Taken
from turbseg_ros.nodes.receiving_node import ReceivingNode
from turbseg_ros.nodes.subscription import MatchingSubscription

COUNT = 5
BY_RCL, BY_RCLPY = "images are taken by rcl,", "images are taken by rclpy,"


@pytest.fixture
def node(context: Context) -> Iterator[ReceivingNode]:
    node = ReceivingNode("taking", context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def fresh_library() -> Iterator[None]:
    """Let rcl be looked up anew, and again afterwards."""
    rcl_take._rcl.cache_clear()
    yield
    rcl_take._rcl.cache_clear()


def rest() -> None:
    time.sleep(0.01)


def wait_until(condition: Callable[[], object], wait: Callable[[], None] = rest) -> None:
    until = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < until
        wait()


class Reception:
    """A subscription that keeps the numbers it receives, and their publisher."""

    def __init__(
        self, node: ReceivingNode, taker: MessageTaker, wait: Callable[[], None] = rest
    ) -> None:
        self._wait = wait
        self.received: list[int] = []
        self.lost: list[int] = []
        self._subscription = MatchingSubscription(
            node,
            Int32,
            "numbers",
            lambda cdr: self.received.append(deserialize_message(bytes(cdr), Int32).data),
            taker=taker,
            depth=2 * COUNT,
            reliability="reliable",
            on_lost=self.lost.append,
        )
        self._publisher: Publisher = node.create_publisher(Int32, "numbers", RELIABLE)
        wait_until(self._publisher.get_subscription_count)

    def __enter__(self) -> Reception:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscription.destroy()

    def send(self, *numbers: int) -> None:
        """Publish numbers; wait until the last of them is received."""
        for number in numbers:
            self._publisher.publish(Int32(data=number))
        wait_until(lambda: self.received[-1:] == [*numbers][-1:], self._wait)


def test_rcl_is_used_where_it_gives_what_rclpy_gives(
    node: ReceivingNode, capfd: pytest.CaptureFixture[str]
) -> None:
    taker = MessageTaker(node)
    assert taker.uses_rcl
    with Reception(node, taker) as reception:
        reception.send(*range(COUNT))
        assert (reception.received, reception.lost) == ([*range(COUNT)], [])
    assert taker.uses_rcl
    log = capfd.readouterr().err
    assert (log.count(BY_RCL), log.count(BY_RCLPY)) == (1, 0)


def test_the_trial_leaves_nothing_in_the_graph(node: ReceivingNode) -> None:
    MessageTaker(node)
    assert not [name for name, _ in node.get_topic_names_and_types() if "trial" in name]


@pytest.mark.usefixtures("fresh_library")
def test_without_a_symbol_messages_come_by_rclpy(
    node: ReceivingNode, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    gone = (*rcl_take._FUNCTIONS, ("rcl_that_is_gone", (), None))
    monkeypatch.setattr(rcl_take, "_FUNCTIONS", gone)
    with Reception(node, MessageTaker(node)) as reception:
        reception.send(*range(COUNT))
        assert (reception.received, reception.lost) == ([*range(COUNT)], [])
    log = capfd.readouterr().err
    assert (log.count(BY_RCL), log.count(BY_RCLPY)) == (0, 1)
    assert "rcl_that_is_gone" in log


class FailingLibrary:
    """rcl, but taking a message fails."""

    def __init__(self) -> None:
        self._sound = rcl_take._rcl()
        self.calls = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sound, name)

    def rcl_take_serialized_message(self, *_: object) -> int:
        self.calls += 1
        return 1


def test_after_an_error_messages_come_by_rclpy_for_good(
    node: ReceivingNode, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    taker = MessageTaker(node)
    failing = FailingLibrary()
    with Reception(node, taker) as reception:
        reception.send(0)
        with monkeypatch.context() as patched:
            patched.setattr(rcl_take, "_rcl", lambda: failing)
            reception.send(1)
        reception.send(*range(2, COUNT))
        assert (reception.received, reception.lost) == ([*range(COUNT)], [])
    assert failing.calls == 1
    assert not taker.uses_rcl
    log = capfd.readouterr().err
    assert (log.count(BY_RCL), log.count(BY_RCLPY)) == (1, 1)
    assert "rcl_take_serialized_message returned 1: " in log


@pytest.mark.parametrize(
    ("taken", "reason"),
    [
        (lambda taken: taken and Taken(taken.data[:-1], taken.number), "not give what rclpy"),
        (lambda taken: taken and Taken(taken.data, 9), "not give what rclpy"),
        (lambda _: None, "no message came within"),
    ],
    ids=["cut", "other number", "nothing"],
)
def test_rcl_is_not_used_where_it_differs_from_rclpy(
    taken: Callable[[Taken | None], Taken | None],
    reason: str,
    node: ReceivingNode,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    sound = rcl_take.take_by_rcl
    monkeypatch.setattr(rcl_take, "_TRIAL_LIMIT", 0.5)
    monkeypatch.setattr(rcl_take, "take_by_rcl", lambda source: taken(sound(source)))
    assert not MessageTaker(node).uses_rcl
    log = capfd.readouterr().err
    assert (log.count(BY_RCL), log.count(BY_RCLPY)) == (0, 1)
    assert reason in log


@pytest.mark.parametrize(
    "executor",
    [
        "rclpy.executors.SingleThreadedExecutor",
        "rclpy.executors.MultiThreadedExecutor",
        "rclpy.experimental.events_executor.EventsExecutor",
    ],
)
def test_no_executor_takes_the_messages(
    executor: str, node: ReceivingNode, context: Context
) -> None:
    module, _, name = executor.rpartition(".")
    spinning = getattr(pytest.importorskip(module), name)(context=context)
    ticks: list[None] = []
    node.create_timer(0.01, lambda: ticks.append(None))
    taker = MessageTaker(node)
    with Reception(node, taker, wait=lambda: spinning.spin_once(timeout_sec=0.02)) as reception:
        spinning.add_node(node)
        for number in range(COUNT):
            reception.send(number)
        wait_until(lambda: ticks, wait=lambda: spinning.spin_once(timeout_sec=0.02))
        spinning.shutdown()
        assert (reception.received, reception.lost) == ([*range(COUNT)], [])
