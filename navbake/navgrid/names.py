"""Lists the names in a grid that a user can ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from navbake.navgrid.user_data import UserData, names_in

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def list_room_names(grid: NavGrid) -> list[str]:
    """List the ids and names of the rooms of a grid."""
    return [name for room in grid.rooms for name in (room.id, room.name) if name]


def list_object_names(grid: NavGrid) -> list[str]:
    """List the names of the objects in the cells of a grid, sorted."""
    names: set[str] = set()
    for level in grid.levels:
        for entry in UserData.of(level.user_data).shared_entries().entries:
            names.update(names_in(entry, "objects"))
    return sorted(names)
