"""The names of what stands in the cells of a grid, by cell and by name, with the things' boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import UserData, names_in
from navbake.types import Bool, Float, Int, Int32, Json

NO_ENTRY = -1  # the number of the entry of a cell without names; the last row of tables of entries


class NameEntry(NamedTuple):
    """The names in a cell; many cells share an entry.

    Attributes:
        objects: names of the objects over the cell's square, up to the next storey.
        walls: names of the walls there.
        doors: names of the doors there.
        blocking: names of the objects, walls and doors there that are in an agent's way.
    """

    objects: frozenset[str]
    walls: frozenset[str]
    doors: frozenset[str]
    blocking: frozenset[str]


@dataclass(frozen=True, eq=False)
class NameMap:
    """The names in all cells of a grid.

    Attributes:
        entry_of_cell: by flat id, the number of the cell's entry, `NO_ENTRY` for none, int32.
        entries: the different entries.
        sorted_cells: flat ids of the cells that have an entry, by entry, ascending in each.
        first_of_entry: for each entry, the index in `sorted_cells` of its first cell, and at the
            end the number of all.
        entries_of_name: the numbers of the entries that list a name.
        boxes: name -> x, y, z of its box's lower, then of its upper corner [m], if it is known.
        names_of_entry: for each entry, the numbers of what may hide something, with -1 after them,
            shape (entries + 1, most names); the last row has none.
        number_of_name: name -> its number in `names_of_entry`.
        bottoms: heights of the lower ends of these things, in that shape, world z [m]; -inf where
            it isn't known, inf where there is no thing.
        tops: heights of their upper ends, inf where it isn't known, -inf where there is no thing.
        has_blocking: for each entry, whether anything in it is in an agent's way; False in the end.
    """

    entry_of_cell: Int32
    entries: Sequence[NameEntry]
    sorted_cells: Int
    first_of_entry: Int
    entries_of_name: dict[str, list[int]]
    boxes: dict[str, Float]
    names_of_entry: Int
    number_of_name: dict[str, int]
    bottoms: Float
    tops: Float
    has_blocking: Bool

    def cells_of(self, name: str) -> Int:
        """List the cells over which an object, door or wall stands.

        Args:
            name: a key of `entries_of_name`.

        Returns:
            Flat ids, ascending.
        """
        slices = [
            self.sorted_cells[self.first_of_entry[number] : self.first_of_entry[number + 1]]
            for number in self.entries_of_name[name]
        ]
        return np.sort(np.concatenate(slices))

    def list_objects(self) -> list[str]:
        """List the names of all objects, sorted; walls and doors are left out."""
        objects = {name for entry in self.entries for name in entry.objects}
        structure = {name for entry in self.entries for name in entry.walls | entry.doors}
        return sorted(objects - structure)


def map_names(grid: NavGrid) -> NameMap:
    """Look up the names in all cells of a grid.

    Args:
        grid: the grid, with its user data.
    """
    number_of_entry: dict[NameEntry, int] = {}
    entry_of_cell_by_level = []
    for level in grid.levels:
        cells, entry_indices, level_data = UserData.of(level.user_data).shared_entries()
        level_entries = [_read_entry(user_data) for user_data in level_data]
        numbers = [
            number_of_entry.setdefault(entry, len(number_of_entry)) for entry in level_entries
        ]
        entry_of_cell = np.full(level.height * level.width, NO_ENTRY, dtype=np.int32)
        entry_of_cell[cells] = np.array(numbers, dtype=np.int32)[entry_indices]
        entry_of_cell_by_level.append(entry_of_cell)
    entry_of_cell = np.concatenate(entry_of_cell_by_level)
    entries = list(number_of_entry)
    entries_of_name: dict[str, list[int]] = {}
    for entry, number in number_of_entry.items():
        for name in entry.objects | entry.walls | entry.doors:
            entries_of_name.setdefault(name, []).append(number)
    sorted_cells = np.argsort(entry_of_cell, kind="stable")
    sorted_cells = sorted_cells[entry_of_cell[sorted_cells] != NO_ENTRY]
    first_of_entry = np.searchsorted(entry_of_cell[sorted_cells], np.arange(len(entries) + 1))

    boxes = {name: np.array(box) for name, box in grid.name_boxes.items()}
    number_of_name = {name: number for number, name in enumerate(entries_of_name)}
    hiding_names = [
        sorted(name for name in entry.objects | entry.walls | entry.doors if name in boxes)
        + sorted(entry.blocking - boxes.keys())
        for entry in entries
    ]
    shape = (len(entries) + 1, max(map(len, hiding_names), default=0) + 1)
    names_of_entry = np.full(shape, -1, dtype=np.int64)
    bottoms = np.full(shape, np.inf)
    tops = np.full(shape, -np.inf)
    for number, names in enumerate(hiding_names):
        for index, name in enumerate(names):
            names_of_entry[number, index] = number_of_name[name]
            bottoms[number, index] = boxes[name][2] if name in boxes else -np.inf
            tops[number, index] = boxes[name][5] if name in boxes else np.inf
    return NameMap(
        entry_of_cell=entry_of_cell,
        entries=entries,
        sorted_cells=sorted_cells,
        first_of_entry=first_of_entry,
        entries_of_name=entries_of_name,
        boxes=boxes,
        names_of_entry=names_of_entry,
        number_of_name=number_of_name,
        bottoms=bottoms,
        tops=tops,
        has_blocking=np.array([*(bool(entry.blocking) for entry in entries), False]),
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
