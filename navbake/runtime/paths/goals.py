"""What a path may lead to: positions, a room, an object."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.user_data import NAMES
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.grid_cache import GridCache
from navbake.types import Bool, Float, Int, Json

Goal: TypeAlias = ArrayLike | str
"""A position, several of them, ``room:NAME`` or ``object:NAME``."""

MAX_REACH = 1.0  # metres that a place next to an object may be away from it


@dataclass(frozen=True, eq=False)
class Target:
    """Cells that a path may lead to."""

    name: str  # what they are, for messages
    cells: Int  # flat ids, free or not; -1 for positions in no cell
    positions: Float | None = None  # that they were given by, world, shape (n, 2) or (n, 3)

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
    """Find the cells of a goal, see `PathFinder`; raises QueryError for an unknown or wrong one."""
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
    """The free cells next to an object, or on it where it is no obstacle; flat ids, ascending.

    On each level they are looked for ring by ring from the cells that carry the name, over cells
    in which nothing stands, so never through a wall: the nearest ring with a free cell and the
    one after it, at most 1 m away. In an inflated grid, that is as near as the agent gets. What is
    shut in by other objects, like a thing on a table, is looked for over their cells, too.
    """
    named, found = cells_named(grid, flat, name), []
    for number, level in enumerate(grid.levels):
        part = flat.cells_of(number)
        cells = named[(named >= part.start) & (named < part.stop)] - part.start
        if len(cells):
            free = flat.free[part].reshape(level.shape)
            passable = (level.solid == 0) | free
            ring = _nearest_ring(level, cells, free, passable)
            if not len(ring):
                ring = _nearest_ring(level, cells, free, passable | _holds_objects(level))
            found.append(part.start + ring)
    return np.concatenate(found)


def cells_named(grid: NavGrid, flat: FlatGrid, name: str) -> Int:
    """The cells that an object, a door or a wall is in, by its name: flat ids, at least one."""
    if not isinstance(name, str):
        raise QueryError(f"expected the name of an object, got {name!r}")
    cells = [
        start + cell
        for level, start in zip(grid.levels, flat.layout.start.tolist(), strict=False)
        for cell, entry in level.user_data.items()
        if any(isinstance(v := entry.get(key), list) and name in v for key in NAMES)
    ]
    if not cells:
        entries = (entry for level in grid.levels for entry in level.user_data.values())
        lists = (entry.get(key) for entry in entries for key in NAMES)
        known = {n for v in lists if isinstance(v, list) for n in v if isinstance(n, str)}
        raise QueryError(f"no object {name!r} in {grid.scene_id!r}: {suggest(name, sorted(known))}")
    return np.array(cells, dtype=np.int64)


def _holds_objects(level: SceneGrid2D) -> Bool:
    """The cells in which objects stand, or that only objects block, and no wall."""
    entries = {cell: _names(entry) for cell, entry in level.user_data.items()}
    walls = {name for names in entries.values() for name in names["walls"]}
    holds = np.zeros(level.shape, dtype=np.bool_)
    holds.ravel()[[cell for cell, names in entries.items() if _is_of_objects(names, walls)]] = True
    return holds


def _is_of_objects(names: dict[str, list[str]], walls: set[str]) -> bool:
    in_way = {*names["objects"], *names["blockers"]}
    return bool(in_way) and not names["walls"] and not in_way & walls


def _names(entry: Json) -> dict[str, list[str]]:
    """The names that a cell's user data list by key; other programs may have anything there."""
    stated = {key: entry.get(key) for key in ("objects", "walls", "blockers")}
    return {
        key: [name for name in value if isinstance(name, str)] if isinstance(value, list) else []
        for key, value in stated.items()
    }


def _nearest_ring(level: SceneGrid2D, cells: Int, free: Bool, passable: Bool) -> Int:
    """The free cells of the first ring over passable cells that has any, and of the next one."""
    from scipy.ndimage import binary_dilation  # saves scipy at start-up

    reached = np.zeros(level.shape, dtype=np.bool_)
    reached.ravel()[cells] = True
    passable = passable | reached
    for _ in range(math.ceil(MAX_REACH / level.lattice.cell_size)):
        if (reached & free).any():
            break
        reached = binary_dilation(reached) & passable
    else:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(binary_dilation(reached) & passable & free)
