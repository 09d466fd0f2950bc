"""The user data of cells, as names of objects, parsed or made on first use.

They make up most of a grid's file, are rarely needed, and are often equal in many cells. So
`UserData` parses those of a file on first use, and lets cells share the entries of a bake until a
caller accesses single cells, which are writable.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from itertools import compress
from typing import NamedTuple, TypeAlias

import numpy as np

from navbake.types import Int, Json, JsonValue

NAME_KEYS = ("doors", "objects", "walls")  # keys of a cell's user data that list names


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Pause the garbage collector while many objects are made: it would scan them repeatedly."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class Shared(NamedTuple):
    """User data with entries shared by many cells."""

    cells: Int  #: Cell ids, ascending, shape (n,), int64.
    number: Int  #: The entry of each cell, shape (n,), int64.
    entries: Sequence[Json]  #: Must not be modified.


Entries: TypeAlias = MutableMapping[int, Json] | Shared


class UserData(MutableMapping[int, Json]):
    """User data by cell id (col + row * width).

    Args:
        source: A dictionary, which is modified in place; `Shared` entries, which become a
            dictionary on access to single cells; a function that returns one of these; or None for
            no data.
    """

    def __init__(self, source: Entries | Callable[[], Entries] | None = None) -> None:
        self._source: Entries | Callable[[], Entries] = {} if source is None else source

    @classmethod
    def of(cls, user_data: MutableMapping[int, Json]) -> UserData:
        """Convert a mapping to a `UserData`; a `UserData` is returned unchanged."""
        return user_data if isinstance(user_data, UserData) else cls(user_data)

    @property
    def is_read(self) -> bool:
        """Whether a caller has accessed single cells, and so may have changed their entries."""
        return isinstance(self._source, MutableMapping)

    @property
    def source(self) -> Entries:
        """The dictionary, or the entries that cells share."""
        if callable(self._source):
            with without_garbage_collection():
                self._source = self._source()
        return self._source

    @property
    def _cells(self) -> MutableMapping[int, Json]:
        """The dictionary; of shared entries, each cell gets a copy of its own."""
        source = self.source
        if not isinstance(source, Shared):
            return source
        with without_garbage_collection():
            entries = [_copy_json(source.entries[number]) for number in source.number.tolist()]
            by_cell: MutableMapping[int, Json] = dict(
                zip(source.cells.tolist(), entries, strict=True)
            )
        self._source = by_cell
        return by_cell

    def __getitem__(self, cell: int) -> Json:
        return self._cells[cell]

    def __setitem__(self, cell: int, entry: Json) -> None:
        self._cells[cell] = entry

    def __delitem__(self, cell: int) -> None:
        del self._cells[cell]

    def __iter__(self) -> Iterator[int]:
        return iter(self._cells)

    def __len__(self) -> int:
        return len(self._cells)

    def __repr__(self) -> str:
        return f"UserData({self._cells!r})" if self.is_read else "UserData(<not read yet>)"

    def __getstate__(self) -> Json:
        return {"_source": self.source}  # without the function, which holds a bake or a file

    def find(self, cells: Int) -> list[Json]:
        """Return the entries of cells, {} for cells without one; they must not be modified.

        Args:
            cells: Cell ids, shape (n,), int64.
        """
        source = self.source
        if not isinstance(source, Shared):
            return [source.get(cell, {}) for cell in cells.tolist()]
        index = np.searchsorted(source.cells, cells)
        # a -1 at the end, for cells beyond the last one that has an entry
        has_entry = np.append(source.cells, -1)[index] == cells
        numbers = np.where(has_entry, np.append(source.number, -1)[index], -1)
        entries = [*source.entries, {}]  # the last one has number -1, too
        return [entries[number] for number in numbers.tolist()]

    def shared(self) -> Shared:
        """Return all entries and their cells, in the source's order; they must not be modified."""
        source = self.source
        if isinstance(source, Shared):
            return source
        cells = np.fromiter(source, dtype=np.int64, count=len(source))
        return Shared(cells, np.arange(len(cells)), list(source.values()))

    def with_entries(self, changed: Mapping[int, Json]) -> UserData:
        """Return a copy with the entries of some cells replaced, by ascending cell id.

        Args:
            changed: The new entries by cell id, which must not be modified; an empty one removes
                the cell's entry.
        """
        source = self.source
        if not isinstance(source, Shared):
            merged = {**source, **changed}
            cells_with_entry = [
                cell for cell in sorted(merged) if cell not in changed or changed[cell]
            ]
            return UserData({cell: merged[cell] for cell in cells_with_entry})
        changed_cells = np.fromiter(changed, dtype=np.int64, count=len(changed))
        is_unchanged = ~np.isin(source.cells, changed_cells)
        number = source.number[is_unchanged]
        # unused entries are dropped: they would pile up
        is_used = np.bincount(number, minlength=len(source.entries)) > 0
        entries = list(compress(source.entries, is_used))
        new_entries = {cell: entry for cell, entry in changed.items() if entry}
        new_numbers = len(entries) + np.arange(len(new_entries))
        number = np.concatenate([(np.cumsum(is_used) - 1)[number], new_numbers])
        new_cells = np.fromiter(new_entries, dtype=np.int64)
        cells = np.concatenate([source.cells[is_unchanged], new_cells])
        order = np.argsort(cells)
        return UserData(Shared(cells[order], number[order], [*entries, *new_entries.values()]))


def names_in(entry: Json, key: str) -> list[str]:
    """Return the names under a key of a cell's user data.

    Other programs may store other things there; these are ignored.

    Args:
        entry: The user data of a cell.
        key: ``doors``, ``objects``, ``walls`` or ``blockers``.
    """
    names = entry.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _copy_json(value: JsonValue) -> JsonValue:
    """Copy parsed JSON, faster than `copy.deepcopy`."""
    if isinstance(value, dict):
        return {key: _copy_json(part) for key, part in value.items()}
    return [_copy_json(part) for part in value] if isinstance(value, list) else value
