"""Where changes keep standing out that go nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from turbseg_ros.segmentation.geometry import translation
from turbseg_ros.segmentation.restless_places import RestlessPlaces

# Pixels of cells of four by four: ten rows of twenty.
CELLS = (10, 20)
HERE = np.array([[22.0, 13.0]])
AWAY = np.array([[60.0, 30.0]])


def test_a_place_is_restless_where_something_was_seen_and_its_neighbours_are() -> None:
    places = RestlessPlaces(CELLS)
    for _ in range(3):
        places.remember(HERE)
    assert places.sightings(HERE) == pytest.approx(3.0)
    assert places.sightings(HERE + 4.0) == pytest.approx(3.0)
    assert places.sightings(AWAY) == 0.0
    assert places.sightings(np.concatenate([HERE, AWAY])) == pytest.approx(1.5)


def test_it_is_forgotten() -> None:
    places = RestlessPlaces(CELLS)
    places.remember(HERE)
    for _ in range(200):
        places.propagate(np.eye(3))
    assert places.sightings(HERE) < 0.05


def test_it_follows_the_scene() -> None:
    places = RestlessPlaces(CELLS)
    places.remember(HERE)
    for _ in range(10):
        places.propagate(translation(4.0, 0.0))
    assert places.sightings(HERE + np.array([40.0, 0.0])) > 0.5
    assert places.sightings(HERE) < 0.1


def test_what_lies_out_of_view_is_not_remembered() -> None:
    places = RestlessPlaces(CELLS)
    places.remember(np.array([[-9.0, 5.0], [5.0, 900.0], [90.0, 5.0]]))
    assert places.sightings(np.array([[0.0, 0.0], [79.0, 39.0]])) == 0.0
