"""What a path may lead to: positions, a room, an object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid, SceneGrid2D
    from navbake.runtime.flat_grid import FlatGrid
    from navbake.runtime.grid_cache import GridCache

Goal: TypeAlias = ArrayLike | str
"""A position, several of them, ``room:NAME`` or ``object:NAME``."""

KINDS = ("room", "object")
NAMED = ("objects", "doors", "walls")  # where the user data of a cell names what stands in it
MAX_LISTED = 12
MAX_REACH = 1.0  # metres that a place next to an object may be away from it


@dataclass(frozen=True, eq=False)
class Target:
    """Cells that a path may lead to.

    Attributes:
        name: what they are, for messages.
        cells: flat ids, free or not; -1 for positions in no cell.
        positions: world positions that they were given by, shape (n, 2) or (n, 3); None for
            rooms and objects.
    """

    name: str
    cells: Int
    positions: Float | None = None

    def free_cells(self, flat: FlatGrid) -> Int:
        """Those that are free, ascending and each once."""
        inside = self.cells[self.cells >= 0]
        return np.unique(inside[flat.free[inside]])

    def position_in(self, cell: int) -> Float | None:
        """World x, y of the first position that is in a cell; None for rooms and objects."""
        if self.positions is None:
            return None
        return self.positions[int(np.argmax(self.cells == cell)), :2]


def find_target(cache: GridCache, goal: Goal, level: int | None = None) -> Target:
    """Find the cells of a goal.

    Args:
        cache: the grid and what follows from it.
        goal: world position, shape (3,) [m]; several, shape (n, 3); ``room:`` and the id or name
            of a room; ``object:`` and a name of the grid's user data.
        level: which level positions are on; then z is ignored.

    Raises:
        QueryError: a position is not valid, or there is no such room or object.
    """
    flat = cache.flat
    if isinstance(goal, str):
        kind, _, name = goal.partition(":")
        if kind == "room":
            return Target(f"room {name!r}", cache.rooms.cells(name))
        if kind == "object":
            return Target(f"object {name!r}", cells_around(cache.grid, flat, name))
        raise QueryError(f"expected a position, room:NAME or object:NAME, got {goal!r}")
    p = check_positions(goal, flat.num_levels, level)
    if p.ndim > 2 or not p.size:
        raise QueryError(f"expected positions of shape (3,) or (n, 3), n >= 1, got {p.shape}")
    name = "the goal" if p.ndim == 1 else f"one of {len(p)} goals"
    p = np.atleast_2d(p)
    return Target(name, flat.cells_at(p, level), p)


def cells_around(grid: NavGrid, flat: FlatGrid, name: str) -> Int:
    """The free cells next to an object, or on it where it is no obstacle.

    On each level they are looked for ring by ring from the cells that carry the name, over cells
    in which nothing stands, so never through a wall: the nearest ring with a free cell and the
    one after it, at most 1 m away. In an inflated grid, that is as near as the agent gets.

    Args:
        grid: the grid.
        flat: its cells.
        name: of an object, a door or a wall in the grid's user data.

    Returns:
        Flat ids, ascending.

    Raises:
        QueryError: no cell carries the name.
    """
    found = []
    for number, (level, cells) in enumerate(zip(grid.levels, cells_named(grid, name), strict=True)):
        if len(cells):
            free = flat.free[flat.cells_of(number)].reshape(level.shape)
            found.append(flat.layout.start[number] + _nearest_ring(level, cells, free))
    return np.concatenate(found)


def cells_named(grid: NavGrid, name: str) -> list[Int]:
    """The cells of each level that an object, a door or a wall is in, by its name.

    Raises:
        QueryError: no cell carries the name.
    """
    if not isinstance(name, str):
        raise QueryError(f"expected the name of an object, got {name!r}")
    found = [
        [
            cell
            for cell, entry in level.user_data.items()
            if any(isinstance(v := entry.get(key), list) and name in v for key in NAMED)
        ]
        for level in grid.levels
    ]
    if not any(found):
        raise QueryError(f"no object {name!r} in {grid.scene_id!r}: {_known(grid, name)}")
    return [np.array(cells, dtype=np.int64) for cells in found]


def _nearest_ring(level: SceneGrid2D, cells: Int, free: Bool) -> Int:
    from scipy.ndimage import binary_dilation

    reached = np.zeros(level.shape, dtype=np.bool_)
    reached.ravel()[cells] = True
    # where nothing stands but the object itself, so that no ring grows through a wall
    passable = (level.occupancy == 0) | free | reached
    for _ in range(math.ceil(MAX_REACH / level.lattice.cell_size)):
        if (reached & free).any():
            break
        reached = binary_dilation(reached) & passable
    else:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(binary_dilation(reached) & passable & free)


def _known(grid: NavGrid, name: str) -> str:
    names = {
        n
        for level in grid.levels
        for entry in level.user_data.values()
        for key in NAMED
        if isinstance(listed := entry.get(key), list)
        for n in listed
        if isinstance(n, str)
    }
    near = get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    known = sorted(names)
    more = f", and {len(known) - MAX_LISTED} more" if len(known) > MAX_LISTED else ""
    return f"{hint}it has {', '.join(known[:MAX_LISTED]) or 'none'}{more}"
