"""Openings between rooms: where steps and slopes lead from one to the other."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.rooms.openings import find_openings


def openings(floor, rooms, links=()):
    """Rooms and cells of the openings of one level, steps of 0.25 m."""
    floor, rooms = np.array(floor, dtype=np.float64), np.array(rooms, dtype=np.uint16)
    level = LevelFloor("level 0", 0.0, floor, ~np.isnan(floor))
    pairs = np.array([(0, a, 0, b) for a, b in links], dtype=np.int64).reshape(-1, 4)
    found = find_openings([rooms], Floors([level], pairs, [], [], [], [], [], []), 0.25)
    return [(opening.rooms, opening.cells.tolist()) for opening in found]


@pytest.mark.parametrize(("links", "expected"), [([], []), ([(1, 2)], [((1, 2), [1, 2])])])
def test_a_slope_between_two_rooms_is_an_opening(links, expected):
    assert openings([[0.0, 0.3, 0.6, 0.9]], [[1, 1, 2, 2]], links) == expected


def test_a_slope_within_a_room_or_to_none_is_no_opening():
    assert openings([[0.0, 0.3, 0.6, 0.9]], [[1, 1, 1, 0]], [(0, 1), (1, 2), (2, 3)]) == []


def test_a_slope_beside_a_step_is_one_opening_with_it():
    floor, rooms = [[0.0, 0.2], [0.0, 0.3]], [[1, 2], [1, 2]]
    assert openings(floor, rooms) == [((1, 2), [0, 1])]
    assert openings(floor, rooms, [(2, 3)]) == [((1, 2), [0, 1, 2, 3])]
