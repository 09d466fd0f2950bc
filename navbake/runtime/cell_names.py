"""The names of the things in the cells of a grid, looked up by cell and by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import UserData, names_in
from navbake.types import Int, Int32, Json

NO_ENTRY = -1  # the number of the entry of a cell without names


class NameEntry(NamedTuple):
    """The names of things in a cell; many cells share an entry.

    Attributes:
        objects: the objects over the cell's square, up to the next storey.
        walls: the walls there.
        doors: the doors there.
        blocking: the objects, walls and doors that are in an agent's way.
    """

    objects: frozenset[str]
    walls: frozenset[str]
    doors: frozenset[str]
    blocking: frozenset[str]


class CellNames(NamedTuple):
    """The names in all cells of a grid.

    Attributes:
        entry_of_cell: by flat id, the number of the cell's entry, `NO_ENTRY` for none, int32.
        entries: the different entries.
        sorted_cells: flat ids of the cells that have an entry, by entry, ascending in each.
        first_of_entry: for each entry, the index in `sorted_cells` of its first cell; then, as the
            last element, the number of all cells in `sorted_cells`.
        entries_of_name: the numbers of the entries that list a name.
    """

    entry_of_cell: Int32
    entries: Sequence[NameEntry]
    sorted_cells: Int
    first_of_entry: Int
    entries_of_name: dict[str, list[int]]

    def cells_of(self, name: str) -> Int:
        """List the cells over which an object, door or wall stands.

        Args:
            name: a key of `entries_of_name`.

        Returns:
            Flat ids, ascending.
        """
        cells_of_entries = [
            self.sorted_cells[
                self.first_of_entry[entry_number] : self.first_of_entry[entry_number + 1]
            ]
            for entry_number in self.entries_of_name[name]
        ]
        return np.sort(np.concatenate(cells_of_entries))

    def check(self, name: str, scene: str | None) -> None:
        """Check that a grid has an object, door or wall of a name.

        Args:
            name: the name.
            scene: the grid's scene, for the error.

        Raises:
            QueryError: there is no such name.
        """
        if name not in self.entries_of_name:
            hint = suggest(name, sorted(self.entries_of_name))
            raise QueryError(
                f"no object {name!r} in {scene!r}: {hint}", key="object", value=name, hint=hint
            )

    def list_objects(self) -> list[str]:
        """List the names of all objects, sorted; walls and doors are left out."""
        object_names = {name for entry in self.entries for name in entry.objects}
        structure_names = {name for entry in self.entries for name in entry.walls | entry.doors}
        return sorted(object_names - structure_names)


def map_names(grid: NavGrid) -> CellNames:
    """Look up the names in all cells of a grid.

    Args:
        grid: the grid, with its user data.
    """
    number_by_entry: dict[NameEntry, int] = {}
    entries_by_level = []
    for level in grid.levels:
        cells, entry_indices, level_data = UserData.of(level.user_data).shared_entries()
        entries = [_read_entry(user_data) for user_data in level_data]
        entry_numbers = [
            number_by_entry.setdefault(entry, len(number_by_entry)) for entry in entries
        ]
        entry_of_cell = np.full(level.height * level.width, NO_ENTRY, dtype=np.int32)
        entry_of_cell[cells] = np.array(entry_numbers, dtype=np.int32)[entry_indices]
        entries_by_level.append(entry_of_cell)
    entry_of_cell = np.concatenate(entries_by_level)
    sorted_cells = np.argsort(entry_of_cell, kind="stable")
    num_without_entry = int(np.count_nonzero(entry_of_cell == NO_ENTRY))
    entries_of_name: dict[str, list[int]] = {}
    for entry, entry_number in number_by_entry.items():
        for name in entry.objects | entry.walls | entry.doors:
            entries_of_name.setdefault(name, []).append(entry_number)
    sorted_cells = sorted_cells[num_without_entry:]
    return CellNames(
        entry_of_cell=entry_of_cell,
        entries=list(number_by_entry),
        sorted_cells=sorted_cells,
        first_of_entry=np.searchsorted(
            entry_of_cell[sorted_cells], np.arange(len(number_by_entry) + 1)
        ),
        entries_of_name=entries_of_name,
    )


def _read_entry(user_data: Json) -> NameEntry:
    """Read the names in the user data of a cell."""
    objects = frozenset(names_in(user_data, "objects"))
    walls = frozenset(names_in(user_data, "walls"))
    doors = frozenset(names_in(user_data, "doors"))
    blocking = objects | walls | doors
    if "blockers" in user_data:
        # the disc of the agent also meets what stands beside the cell's square
        blocking &= frozenset(names_in(user_data, "blockers")) | doors
    return NameEntry(objects, walls, doors, blocking)
