"""The doors that each cell is in."""

from collections.abc import Iterable

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.types import Int

DoorMap = dict[int, list[str]]
"""The ids of the doors of each cell that is in one, by flat id."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Find the cells that each door blocks when closed or as it stands.

    In files of other programs, the user data of the cells name the doors.
    """
    found: DoorMap = {}
    start = flat.layout.start.tolist()
    for door in grid.doors:
        states = (door.cells_in(state, flat.num_levels) for state in ("closed", door.state))
        cells = [start[k] + ids for by_level in states for k, ids in enumerate(by_level)]
        for cell in np.unique(np.concatenate(cells)).tolist():
            found.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level, part in enumerate(grid.levels):
            for cell, entry in part.user_data.items():
                if isinstance(stored := entry.get("doors"), list):
                    names = [name for name in stored if isinstance(name, str)]
                    found[start[level] + cell] = names
    return found


def doors_on(doors: DoorMap, cells: Int) -> list[str]:
    """The doors that a route goes through, in order; a door that is entered again is repeated."""
    passed: list[str] = []
    current: Iterable[str] = ()
    for cell in cells.tolist():
        here = doors.get(cell, ())
        passed += [name for name in here if name not in current]
        current = here
    return passed
