"""The doors of a level as lines from jamb to jamb."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navbake.navgrid.doors import Door
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Bool, Float, Int

DECIMALS = 6  # of ends: micrometres


class DoorLine(NamedTuple):
    """The line of a door's closed leaf on a level."""

    id: str
    state: str  # closed, open, modelled (neither) or removed
    start: tuple[float, float]  # one end, world x, y [m]
    end: tuple[float, float]  # the other end

    @property
    def width(self) -> float:
        """Width of the doorway, to about a cell [m]."""
        return math.dist(self.start, self.end)

    @property
    def middle(self) -> tuple[float, float]:
        """World x, y [m]."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2


def find_door_lines(grid: NavGrid, number: int) -> tuple[DoorLine, ...]:
    """The lines of a level's doors; see `find_ends`."""
    ends = [(door, find_ends(grid, door, number)) for door in grid.doors]
    return tuple(
        DoorLine(door.id, door.like or door.state, *found) for door, found in ends if found
    )


def doorway_cells(grid: NavGrid, number: int, *, blocked: bool) -> Bool:
    """The cells of a level that doors currently block, or else those that they can close."""
    mask = np.zeros(grid.levels[number].shape, dtype=np.bool_)
    for door in grid.doors:
        state = "closed" if "closed" in door.cells and not blocked else door.state
        mask.flat[door.cells_in(state, len(grid.levels))[number]] = True
    return mask


Ends = tuple[tuple[float, float], tuple[float, float]]
"""Both ends of a line, world x, y [m]."""


def find_ends(grid: NavGrid, door: Door, number: int) -> Ends | None:
    """The ends of a door's leaf on a level when closed, else in its current state.

    With a layer ``solid``, the cells of the leaf itself are known: the line runs along their
    longer axis, from edge to edge. Else the door's blocked cells may be deeper than wide: the line
    runs along the axis with obstacles at both ends, else the longer one, and is longer by the
    agent's radius at each end. None if the door has no cells on the level.
    """
    level, num_levels = grid.levels[number], len(grid.levels)
    for state in ("closed", door.state, *door.states):
        leaf, blocked = (
            cells(state, num_levels)[number] for cells in (door.solid_in, door.cells_in)
        )
        if len(leaf):
            along, _ = _axes_of(level, leaf)
            return _span(level, leaf, along, 0.0)
        if len(blocked):
            along = _axis_between_walls(level, blocked)
            return _span(level, blocked, along, grid.agent_radius)
    return None


def _positions(level: SceneGrid2D, cells: Int) -> Float:
    rows, cols = np.divmod(cells, level.width)
    return level.lattice.positions(rows, cols)


def _axes_of(level: SceneGrid2D, cells: Int) -> tuple[Float, Float]:
    """The longer and the shorter principal axis of cells."""
    at = _positions(level, cells)
    from_middle = at - at.mean(axis=0)
    # the eigenvector of the largest eigenvalue
    axis = np.linalg.eigh(from_middle.T @ from_middle)[1][:, 1]
    axis = axis if tuple(axis) > (0.0, 0.0) else -axis
    if np.ptp(from_middle @ axis) * np.abs(axis).min() < level.lattice.cell_size / 2:
        # the axis is along the row of cells, to their resolution
        axis = np.round(axis) + 0.0
    return axis, _across(axis)


def _across(axis: Float) -> Float:
    across = np.array([-axis[1], axis[0]])
    return across if tuple(across) > (0.0, 0.0) else 0.0 - across


def _axis_between_walls(level: SceneGrid2D, cells: Int) -> Float:
    """The principal axis with obstacles at both ends, else the longer one."""
    at = _positions(level, cells)
    # no cell outside the grid is free
    free = np.pad(level.free, 1)

    def walls(axis: Float) -> int:
        along, aside = at @ axis, at @ _across(axis)
        middle = np.median(aside) * _across(axis)
        reach = level.lattice.cell_size
        ends = np.array([[along.min() - reach], [along.max() + reach]]) * axis + middle
        rows, cols = (v + 1 for v in level.lattice.rows_cols(ends))
        rows, cols = rows.clip(0, free.shape[0] - 1), cols.clip(0, free.shape[1] - 1)
        return int(np.count_nonzero(~free[rows, cols]))

    return max(_axes_of(level, cells), key=walls)  # max returns the first, longer one of a tie


def _span(level: SceneGrid2D, cells: Int, axis: Float, more: float) -> Ends:
    """The extent of cells along an axis through their middle, with `more` [m] at each end."""
    at = _positions(level, cells)
    middle = at.mean(axis=0)
    along = (at - middle) @ axis
    # to the outermost edges
    more += level.lattice.cell_size / 2 / np.abs(axis).max()
    ends = middle + np.array([[along.min() - more], [along.max() + more]]) * axis
    first, last = (np.round(ends, DECIMALS) + 0.0).tolist()
    return (first[0], first[1]), (last[0], last[1])
