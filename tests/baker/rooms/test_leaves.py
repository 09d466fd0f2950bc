"""Which closed leaves part what is round them, on plans drawn by cells of 0.1 m."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.baker.rooms.flags import LevelFlags
from navbake.baker.rooms.leaves import ClosedLeaf, LeafLines, mark_leaves

CELL = 0.1
ROWS, COLS = 40, 60
MIDDLE = 30  # the column of walls and leaves


def level_of(is_open: np.ndarray, occupied: np.ndarray | None = None) -> LevelFlags:
    none = np.zeros_like(is_open)
    taken = ~is_open if occupied is None else occupied
    return LevelFlags(np.zeros(is_open.shape), is_open, none, none, none, none, taken)


def leaf_at(first: int, end: int, col: int = MIDDLE) -> ClosedLeaf:
    """A leaf in some rows of a column, whose sides look west and east."""
    rows = np.arange(first, end)
    lines = np.linspace(first + 1, end - 2, 5).round().astype(int)
    steps = np.arange(7)
    sight = np.stack([lines[:, None] * COLS + col - steps, lines[:, None] * COLS + col + steps])
    ends = np.stack([first - 1 - np.arange(5), end + np.arange(5)])
    ends = np.where((ends >= 0) & (ends < ROWS), ends * COLS + col, -1)
    return ClosedLeaf([rows * COLS + col], LeafLines(sight, ends))


def room_with_wall(*rows: tuple[int, int]) -> np.ndarray:
    """A room with a wall across it but for some openings, first row and end."""
    is_open = np.zeros((ROWS, COLS), dtype=bool)
    is_open[1:-1, 1:-1] = True
    is_open[:, MIDDLE] = False
    for first, end in rows:
        is_open[first:end, MIDDLE] = True
    return is_open


def parting_rows(is_open: np.ndarray, *leaves: ClosedLeaf, occupied=None) -> list[int]:
    marks = mark_leaves(level_of(is_open, occupied), 0, leaves, CELL)
    return [] if marks is None else np.flatnonzero(marks.is_separating[:, MIDDLE]).tolist()


def test_a_leaf_that_fills_an_opening_parts():
    assert parting_rows(room_with_wall((10, 20)), leaf_at(10, 20)) == list(range(10, 20))


def test_leaves_of_one_opening_part_together_only():
    is_open = room_with_wall((10, 30))
    assert parting_rows(is_open, leaf_at(10, 20)) == []
    assert parting_rows(is_open, leaf_at(10, 20), leaf_at(20, 30)) == list(range(10, 30))


@pytest.mark.parametrize(("apart", "parts"), [(5, False), (8, False), (15, True)])
def test_a_leaf_parts_nothing_where_one_gets_round_it_within_a_metre(apart, parts):
    is_open = room_with_wall((5, 15), (15 + apart, 39))
    assert bool(parting_rows(is_open, leaf_at(5, 15))) == parts


def test_a_leaf_in_the_open_parts_nothing_and_hinders_no_other():
    is_open = room_with_wall((10, 20))
    in_the_open = leaf_at(12, 24, col=10)
    marks = mark_leaves(level_of(is_open), 0, [in_the_open, leaf_at(10, 20)], CELL)
    assert not marks.is_separating[:, 10].any()
    assert marks.is_not_separating[12:24, 10].all()
    assert marks.is_separating[10:20, MIDDLE].all()
    assert not marks.is_not_separating[:, MIDDLE].any()


@pytest.mark.parametrize(("free_cells", "parts"), [(0, False), (9, False), (12, True)])
def test_behind_a_leaf_something_has_to_be_free(free_cells, parts):
    """A niche of 10 x 5 cells east of the leaf; 0.1 m² are 10 cells."""
    is_open = room_with_wall((10, 20))
    is_open[:, MIDDLE + 1 :] = False
    is_open[10:20, MIDDLE + 1 : MIDDLE + 6] = True
    occupied = ~is_open
    taken = np.ones(50, dtype=bool)
    taken[:free_cells] = False
    occupied[10:20, MIDDLE + 1 : MIDDLE + 6] = taken.reshape(10, 5)
    assert bool(parting_rows(is_open, leaf_at(10, 20), occupied=occupied)) == parts


def test_what_stands_in_line_with_a_leaf_belongs_to_it():
    """Stubs that are no walls, and are open cells where something stands."""
    is_open = room_with_wall((8, 22))
    occupied = ~is_open
    occupied[[8, 9, 20, 21], MIDDLE] = True
    leaf = leaf_at(10, 20)
    assert parting_rows(is_open, leaf, occupied=occupied) == list(range(8, 22))
    assert parting_rows(is_open, leaf) == []


def test_what_little_lies_between_two_leaves_belongs_to_them():
    is_open = room_with_wall((10, 18))
    is_open[:, MIDDLE : MIDDLE + 3] = False
    is_open[10:18, MIDDLE : MIDDLE + 3] = True
    leaves = [leaf_at(10, 18), leaf_at(10, 18, col=MIDDLE + 2)]
    marks = mark_leaves(level_of(is_open), 0, leaves, CELL)
    assert marks.is_separating[10:18, MIDDLE : MIDDLE + 3].all()
    assert marks.is_separating.sum() == 24
