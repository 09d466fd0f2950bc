"""The doors that each cell is in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from navbake.types import Int

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.flat_grid import FlatGrid

DoorMap = dict[int, list[str]]
"""The ids of the doors of each cell that is in one, by flat id."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Lay out the doors of a grid: the cells that each blocks when closed, or as it stands.

    Of a file without a table of doors, what its user data say.
    """
    found: DoorMap = {}
    start = flat.layout.start
    for door in grid.doors:
        cells: set[int] = set()
        for state in ("closed", door.state):
            for level, ids in enumerate(door.cells_in(state, flat.num_levels)):
                cells.update((ids + start[level]).tolist())
        for cell in sorted(cells):
            found.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level, part in enumerate(grid.levels):
            for cell, entry in part.user_data.items():
                stored = entry.get("doors")
                if not isinstance(stored, list):
                    continue
                names = [name for name in stored if isinstance(name, str)]
                if names:
                    found[int(start[level]) + cell] = names
    return found


def doors_on(doors: DoorMap, cells: Int) -> list[str]:
    """The doors that a route goes through, in order; one that is entered again is there again."""
    passed: list[str] = []
    current: Iterable[str] = ()
    for cell in cells.tolist():
        here = doors.get(cell, ())
        passed += [name for name in here if name not in current]
        current = here
    return passed
