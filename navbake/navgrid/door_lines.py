"""Where the doors of a level are, as lines from jamb to jamb."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navbake.navgrid.doors import Door
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.types import Bool, Float, Int

DECIMALS = 6  # of ends: micrometres


class DoorLine(NamedTuple):
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


def find_door_lines(grid: NavGrid, number: int) -> tuple[DoorLine, ...]:
    """The doors of a level; see `find_ends`."""
    ends = [(door, find_ends(grid, door, number)) for door in grid.doors]
    return tuple(
        DoorLine(door.id, door.like or door.state, *found) for door, found in ends if found
    )


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
"""Both ends of a line, world x, y [m]."""


def find_ends(grid: NavGrid, door: Door, number: int) -> Ends | None:
    """The ends of a door's leaf on a level when it is closed, or as it is where it can't be.

    A grid with a layer ``solid`` knows the cells that the leaf itself covers: the line runs along
    the longer axis of these, from edge to edge. In another grid the cells are those that an agent
    can't stand in, which may be deeper than wide: there it runs along the axis that has something
    in the way at both ends, else the longer one, and is longer by the agent's radius at each end.

    Returns:
        None where the door has no cells on the level.
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
    """The longer principal axis of some cells, and the other one."""
    at = _positions(level, cells)
    from_middle = at - at.mean(axis=0)
    # the eigenvector of the largest eigenvalue
    axis = np.linalg.eigh(from_middle.T @ from_middle)[1][:, 1]
    axis = axis if tuple(axis) > (0.0, 0.0) else -axis
    if np.ptp(from_middle @ axis) * np.abs(axis).min() < level.lattice.cell_size / 2:
        # over its length it leaves the row of cells by less than the cells tell
        axis = np.round(axis) + 0.0
    return axis, _across(axis)


def _across(axis: Float) -> Float:
    """The axis at a right angle."""
    across = np.array([-axis[1], axis[0]])
    return across if tuple(across) > (0.0, 0.0) else 0.0 - across


def _axis_between_walls(level: SceneGrid2D, cells: Int) -> Float:
    """Of the principal axes, the one with something in the way at both ends, else the longer."""
    at = _positions(level, cells)
    # beside the grid nothing is free
    free = np.pad(level.free, 1)

    def walls(axis: Float) -> int:
        along, aside = at @ axis, at @ _across(axis)
        middle = np.median(aside) * _across(axis)
        reach = level.lattice.cell_size
        ends = np.array([[along.min() - reach], [along.max() + reach]]) * axis + middle
        rows, cols = (v + 1 for v in level.lattice.rows_cols(ends))
        rows, cols = rows.clip(0, free.shape[0] - 1), cols.clip(0, free.shape[1] - 1)
        return int(np.count_nonzero(~free[rows, cols]))

    return max(_axes_of(level, cells), key=walls)  # of two that are alike the longer, the first


def _span(level: SceneGrid2D, cells: Int, axis: Float, more: float) -> Ends:
    """Both ends of some cells along an axis through their middle, and so much more at each [m]."""
    at = _positions(level, cells)
    middle = at.mean(axis=0)
    along = (at - middle) @ axis
    # to the outermost edges
    more += level.lattice.cell_size / 2 / np.abs(axis).max()
    ends = middle + np.array([[along.min() - more], [along.max() + more]]) * axis
    first, last = (np.round(ends, DECIMALS) + 0.0).tolist()
    return (first[0], first[1]), (last[0], last[1])
