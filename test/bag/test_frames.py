"""Items made ahead of their use: the same, in order, in another thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from turbseg_ros.bag.frames import ahead

TIME_LIMIT = 20.0


@pytest.mark.parametrize("count", [0, 1, 2, 3, 20])
@pytest.mark.parametrize("depth", [1, 2, 5])
def test_items_come_whole_and_in_order(count: int, depth: int) -> None:
    assert list(ahead(range(count), depth)) == list(range(count))


def test_none_is_an_item_like_any_other() -> None:
    assert list(ahead([None, 1, None])) == [None, 1, None]


def test_items_are_made_while_others_are_used() -> None:
    made = threading.Event()

    def items() -> Iterator[int]:
        yield 1
        made.set()
        yield 2

    first = next(items_ahead := ahead(items()))
    assert first == 1
    assert made.wait(TIME_LIMIT)
    assert list(items_ahead) == [2]


def test_no_more_are_made_than_asked_for() -> None:
    made = []

    def items() -> Iterator[int]:
        for number in range(10):
            made.append(number)
            yield number

    items_ahead = ahead(items(), depth=3)
    for used in range(1, 6):
        next(items_ahead)
        assert len(made) <= used + 3
    items_ahead.close()


def test_an_error_arrives_after_what_came_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("as it was")

    items_ahead = ahead(items())
    assert next(items_ahead) == 1
    with pytest.raises(ValueError, match="as it was"):
        next(items_ahead)


def test_whoever_stops_early_leaves_no_thread_behind() -> None:
    before = threading.active_count()
    items_ahead = ahead(iter(int, 1))
    next(items_ahead)
    items_ahead.close()
    assert threading.active_count() == before
