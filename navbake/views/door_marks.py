"""Where the doors of a level are, as lines from jamb to jamb."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navbake.navgrid.doors import Door
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Bool, Float, Int


class DoorMark(NamedTuple):
    """A door on a level: the line that its leaf covers when it is closed."""

    id: str
    state: str  # closed, open, modelled (neither) or removed
    start: tuple[float, float]  # one end, world x, y [m]
    end: tuple[float, float]  # the other end

    @property
    def width(self) -> float:
        """Of the doorway, to about a cell [m]."""
        return math.dist(self.start, self.end)

    @property
    def middle(self) -> tuple[float, float]:
        """World x, y [m]."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2


def find_door_marks(grid: NavGrid, number: int) -> tuple[DoorMark, ...]:
    """The doors that block cells of a level when they are closed.

    A grid with a layer ``solid`` knows the cells that the leaf itself covers: the mark runs along
    the longer axis of these. In another grid the cells are as many as an agent can't stand in, as
    deep as wide; there it runs to where the way is blocked at both ends, and is longer by the
    agent's radius at each.
    """
    level, num_levels = grid.levels[number], len(grid.levels)
    marks = []
    for door in grid.doors:
        state = doorway_state(door)
        leaf, blocked = door.solid_in(state, num_levels), door.cells_in(state, num_levels)
        if len(leaf[number]):
            ends = _find_ends(level, leaf[number])
        elif len(blocked[number]):
            ends = _find_ends_between_walls(level, blocked[number], grid.agent_radius)
        else:
            continue
        marks.append(DoorMark(door.id, door.like or door.state, *ends))
    return tuple(marks)


def doorway_state(door: Door) -> str:
    """The state whose cells are the doorway: closed, or what it is in if it has no such state."""
    return "closed" if "closed" in door.cells else door.state


def doorway_cells(grid: NavGrid, number: int, *, blocked: bool) -> Bool:
    """The cells of a level that doors block now, or else those of their doorways."""
    mask = np.zeros(grid.levels[number].shape, dtype=np.bool_)
    for door in grid.doors:
        state = door.state if blocked else doorway_state(door)
        mask.flat[door.cells_in(state, len(grid.levels))[number]] = True
    return mask


Ends = tuple[tuple[float, float], tuple[float, float]]


def _positions(level: SceneGrid2D, cells: Int) -> Float:
    rows, cols = np.divmod(cells, level.width)
    return level.lattice.positions(rows, cols)


def _find_ends(level: SceneGrid2D, cells: Int) -> Ends:
    """The ends of some cells along their longer principal axis."""
    at = _positions(level, cells)
    if len(at) == 1:
        return _span(at, np.array([1.0, 0.0]), level.lattice.cell_size)
    _, axes = np.linalg.eigh(np.cov(at.T, bias=True))
    return _span(at, axes[:, 1], level.lattice.cell_size)


def _find_ends_between_walls(level: SceneGrid2D, cells: Int, radius: float) -> Ends:
    """The ends along x or y, whichever has something in the way at both, else the longer."""
    at, cell_size = _positions(level, cells), level.lattice.cell_size
    rows, cols = np.divmod(cells, level.width)
    row, col = int(np.median(rows)), int(np.median(cols))
    beyond = (
        [(row, cols.min() - 1), (row, cols.max() + 1)],
        [(rows.min() - 1, col), (rows.max() + 1, col)],
    )
    free = np.pad(level.free, 1)  # beside the grid nothing is free
    walls = [sum(not free[r + 1, c + 1] for r, c in ends) for ends in beyond]
    extents = [int(np.ptp(cols)), int(np.ptp(rows))]
    along_y = (walls[1], extents[1]) > (walls[0], extents[0])
    axis = np.array([0.0, 1.0] if along_y else [1.0, 0.0])
    return _span(at, axis, cell_size + 2 * radius)


def _span(at: Float, axis: Float, extra: float) -> Ends:
    """Both ends of positions along an axis through their middle, longer by `extra` in all."""
    axis = axis if (axis[0], axis[1]) > (-axis[0], -axis[1]) else -axis
    along = at @ axis
    across = np.array([-axis[1], axis[0]])
    aside = at @ across
    middle = (aside.min() + aside.max()) / 2 * across
    first = middle + (along.min() - extra / 2) * axis
    last = middle + (along.max() + extra / 2) * axis
    return (float(first[0]), float(first[1])), (float(last[0]), float(last[1]))
