"""For whom the node works."""

from __future__ import annotations

import pytest

from turbseg_ros.nodes.demand import Demand


class FakeClock:
    def __init__(self) -> None:
        self.time = 100.0

    def __call__(self) -> float:
        return self.time


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


def test_demand_lasts_for_a_while_without_a_listener(clock: FakeClock) -> None:
    demand = Demand(clock)
    clock.time += 4.0
    assert demand.lasts(listened=False, patience=5.0)
    clock.time += 1.0
    assert not demand.lasts(listened=False, patience=5.0)


def test_a_listener_renews_it(clock: FakeClock) -> None:
    demand = Demand(clock)
    clock.time += 100.0
    assert demand.lasts(listened=True, patience=5.0)
    clock.time += 4.0
    assert demand.lasts(listened=False, patience=5.0)
    clock.time += 4.0
    demand.renew()
    clock.time += 4.0
    assert demand.lasts(listened=False, patience=5.0)


def test_without_a_limit_it_lasts_for_ever(clock: FakeClock) -> None:
    demand = Demand(clock)
    clock.time += 1e9
    assert demand.lasts(listened=False, patience=0.0)
