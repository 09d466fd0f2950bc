"""Rooms from gaps that part spaces by their width against the width of both."""

import numpy as np
from numpy.typing import NDArray

from navbake.baker.rooms.directions import Direction, find_directions, turned
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.kernels.gaps import Crossings, Gaps, Scan
from navbake.baker.rooms.kernels.labels import count_cells, label_parts
from navbake.baker.rooms.spaces import CloseCall, GapsOfDirection, Spaces
from navbake.threads import run_beside
from navbake.types import Bool, Int32

Marks = NDArray[np.uint8]

# The widest mouth of a passage that is a room of its own, and the widest opening in whose line
# another wall can end [m]
PASSAGE, WIDE = 3.2, 4.0
# A gap is looked for where the space widens by this factor, and by this much [m]
GROWTH, RISE = 1.15, 0.2
# Walls are at most this thick at a doorway [m]
THICKNESS = 0.6
# What is smaller is no space but part of the gaps round it: where walls are at an angle to the
# lattice, lines of a gap that are next to each other leave single cells between them [m²]
ISLAND = 0.1
# How wide the spaces are is measured so far behind the gap; the widest counts [m]
DEPTHS = (0.1, 0.25, 0.45)


def _find_gap_cells(open_cells: Bool, directions: list[Direction], cell_size: float) -> list[Marks]:
    """Mark the cells of the gaps of each direction, as it is scanned.

    Gaps with steps on both sides, such as doorways, come first. They are walls to what is found
    then: so a line across a corridor does not lead through a door into a room, and a wall that
    ends in the middle of a wide opening goes on up to the line of that opening.
    """
    marks = [np.zeros(turned(open_cells, d).shape, dtype=np.uint8) for d in directions]
    for widest, both in ((WIDE, True), (PASSAGE, False)):
        is_open = open_cells & ~_join_marks(marks, directions, open_cells)
        waiting = [
            run_beside(_mark_direction, direction, is_open, cell_size, widest, both, mark)
            for direction, mark in zip(directions, marks, strict=True)
        ]
        for wait in waiting:
            wait()
    return marks


def _mark_direction(
    direction: Direction, is_open: Bool, cell_size: float, widest: float, both: bool, mark: Marks
) -> None:
    """Mark the cells of the gaps of a direction, at most so wide [m], as it is scanned."""
    run = kernels.measure_runs(turned(is_open, direction), direction.shift)
    step = direction.stretch * cell_size
    thickness = int(THICKNESS * direction.stretch / cell_size) + 2
    kernels.mark_gaps(run, int(widest / step), GROWTH, RISE / step, thickness, both, mark)


def _join_marks(marks: list[Marks], directions: list[Direction], like: Bool) -> Bool:
    """The cells that are marked in any direction."""
    marked = np.zeros(like.shape, dtype=np.bool_)
    for mark, direction in zip(marks, directions, strict=True):
        marked |= (mark.T if direction.swapped else mark) > 0
    return marked


def part_at_gaps(open_cells: Bool, holes: Bool, cell_size: float) -> tuple[Int32, list[CloseCall]]:
    """Label the spaces that gaps part; the cells of gaps have none yet.

    Holes have no floor, but no wall either. Also lists the gaps that hardly part two spaces, and
    those that nearly do.
    """
    space = open_cells | holes
    directions = find_directions(space, cell_size)
    marks = _find_gap_cells(space, directions, cell_size)
    marked = _join_marks(marks, directions, open_cells)
    label, count = label_parts(open_cells & ~marked)
    cells = count_cells(label, count + 1)
    keeps = cells * cell_size**2 >= ISLAND
    keeps[0] = True
    if not keeps.all():  # those that are left keep their order
        marked |= open_cells & ~keeps[label]
        number = np.where(keeps, np.cumsum(keeps) - 1, 0).astype(np.int32)
        label, cells = number[label], np.bincount(number, cells).astype(np.int64)
    found = []
    for direction, own in zip(directions, marks, strict=True):
        label_there = turned(label, direction)
        thickness = int(THICKNESS * direction.stretch / cell_size) + 2
        crossings = kernels.list_crossings(label_there, turned(marked, direction), own, thickness)
        depths = [max(1, round(depth * direction.stretch / cell_size)) for depth in DEPTHS]
        leans = np.rint(np.array(depths) * direction.slope / direction.stretch**2)
        scan = Scan(
            label_there,
            turned(space, direction),
            direction.shift,
            np.array(depths, dtype=np.int64),
            leans.astype(np.int64),
        )
        found.append(GapsOfDirection(direction, scan, _list_gaps(crossings, direction)))
    spaces = Spaces(found, cells, cell_size)
    spaces.join_continued()
    spaces.join_narrower()
    return spaces.wholes()[label], spaces.close_calls()


def _list_gaps(crossings: Crossings, direction: Direction) -> Gaps:
    """The gaps that crossings make up."""
    number = kernels.group_crossings(crossings, direction.shift)
    order = np.argsort(number, kind="stable")
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    last = np.append(first[1:], len(order))[: len(first)] - 1
    a, b = order[first], order[last]
    marks = np.maximum.reduceat(crossings.mark[order], first) if len(first) else crossings.mark
    return Gaps(
        crossings.col[a],
        crossings.col[b],
        np.stack([crossings.top[a], crossings.top[b]], axis=1),
        np.stack([crossings.bottom[a], crossings.bottom[b]], axis=1),
        crossings.above[a],
        crossings.below[a],
        marks == 2,
    )
