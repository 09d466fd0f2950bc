"""The user data of cells, such as names of objects; they are parsed or made on first use.

User data make up most of a grid's file, are rarely needed, and are often equal in many cells. So
`UserData` parses a file's data on first use. Cells of a bake share equal entries. Each cell gets an
entry of its own, which may be modified, once a caller accesses single cells.
"""

from __future__ import annotations

import gc
import re
import threading
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from itertools import compress
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np

from navbake.navgrid.metadata import read_table
from navbake.types import Int, Json, JsonValue

Box: TypeAlias = tuple[float, float, float, float, float, float]
"""World x, y, z of an upright box's lower corner, then of its upper corner [m]."""

NAME_KEYS = ("doors", "objects", "walls")  # keys of a cell's user data that list names
# matches the reversed end of names like chair_1, where it has a number; from the front, its cost
# would grow as the square
REVERSED_COUNTER = re.compile(r"[\W_]*\d[\d\W_]*")


class CollectorPauses:
    """The pauses of the garbage collector that threads have begun and not ended.

    The collector is one for all threads: the first pause disables it, and the end of the last one
    restores it.
    """

    def __init__(self) -> None:
        """Begin without pauses."""
        self._lock = threading.Lock()
        self._num_pauses = 0
        self._was_enabled = False

    def begin(self) -> None:
        """Disable the collector, if no pause has done so."""
        with self._lock:
            if self._num_pauses == 0:
                self._was_enabled = gc.isenabled()
                gc.disable()
            self._num_pauses += 1

    def end(self) -> None:
        """Enable the collector if this was the last pause, and if it was enabled before."""
        with self._lock:
            self._num_pauses -= 1
            if self._num_pauses == 0 and self._was_enabled:
                gc.enable()


COLLECTOR_PAUSES = CollectorPauses()


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Pause the garbage collector while many objects are made: it would scan them repeatedly.

    Other threads may do so at the same time.
    """
    COLLECTOR_PAUSES.begin()
    try:
        yield
    finally:
        COLLECTOR_PAUSES.end()


class SharedEntries(NamedTuple):
    """The user data of a level, in which many cells share one entry."""

    cells: Int  #: Cell ids, ascending, shape (n,), int64.
    entry_index: Int  #: Index in `entries` for each cell, shape (n,), int64.
    entries: Sequence[Json]  #: The different entries; they must not be modified.


Entries: TypeAlias = MutableMapping[int, Json] | SharedEntries


class UserData(MutableMapping[int, Json]):
    """The user data of cells: cell id (col + row * width) -> entry.

    Args:
        source: A dictionary, which is modified in place; or `SharedEntries`, which becomes a
            dictionary on access to single cells; or a function that returns one of these and is
            called on first use; or None for no data.
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
        """The user data, as a dictionary or as `SharedEntries`; read or made on first access."""
        if callable(self._source):
            with without_garbage_collection():
                self._source = self._source()
        return self._source

    @property
    def _cells(self) -> MutableMapping[int, Json]:
        """The dictionary; shared entries are turned into one, with a copy for each cell."""
        source = self.source
        if not isinstance(source, SharedEntries):
            return source
        with without_garbage_collection():
            entries = [copy_json(source.entries[number]) for number in source.entry_index.tolist()]
            entry_by_cell: MutableMapping[int, Json] = dict(
                zip(source.cells.tolist(), entries, strict=True)
            )
        self._source = entry_by_cell
        return entry_by_cell

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
        if not isinstance(source, SharedEntries):
            return [source.get(cell, {}) for cell in cells.tolist()]
        indices = np.searchsorted(source.cells, cells)
        # a -1 at the end, for cells beyond the last one that has an entry
        has_entry = np.append(source.cells, -1)[indices] == cells
        entry_indices = np.where(has_entry, np.append(source.entry_index, -1)[indices], -1)
        entries = [*source.entries, {}]  # the last one has number -1, too
        return [entries[entry_index] for entry_index in entry_indices.tolist()]

    def shared_entries(self) -> SharedEntries:
        """Return all entries and their cells, in the source's order.

        The entries must not be modified.
        """
        source = self.source
        if isinstance(source, SharedEntries):
            return source
        cells = np.fromiter(source, dtype=np.int64, count=len(source))
        return SharedEntries(cells, np.arange(len(cells)), list(source.values()))

    def with_entries(self, changed_entries: Mapping[int, Json]) -> UserData:
        """Return a copy, sorted by cell id, in which some cells have other entries.

        Args:
            changed_entries: Cell id -> new entry, which must not be modified. An empty entry
                removes the one that the cell has.
        """
        source = self.source
        if not isinstance(source, SharedEntries):
            all_entries = {**source, **changed_entries}
            cells_with_entry = [
                cell
                for cell in sorted(all_entries)
                if cell not in changed_entries or changed_entries[cell]
            ]
            return UserData({cell: all_entries[cell] for cell in cells_with_entry})
        changed_cells = np.fromiter(changed_entries, dtype=np.int64, count=len(changed_entries))
        is_unchanged = ~np.isin(source.cells, changed_cells)
        entry_indices = source.entry_index[is_unchanged]
        # unused entries are dropped: they would pile up
        is_used = np.bincount(entry_indices, minlength=len(source.entries)) > 0
        entries = list(compress(source.entries, is_used))
        new_entries = {cell: entry for cell, entry in changed_entries.items() if entry}
        new_indices = len(entries) + np.arange(len(new_entries))
        entry_indices = np.concatenate([(np.cumsum(is_used) - 1)[entry_indices], new_indices])
        new_cells = np.fromiter(new_entries, dtype=np.int64)
        cells = np.concatenate([source.cells[is_unchanged], new_cells])
        sort_indices = np.argsort(cells)
        return UserData(
            SharedEntries(
                cells[sort_indices], entry_indices[sort_indices], [*entries, *new_entries.values()]
            )
        )


def copy_json(value: JsonValue) -> JsonValue:
    """Copy parsed JSON with all that it contains, faster than `copy.deepcopy`.

    Args:
        value: The value, without cycles.

    Returns:
        The copy; its dictionaries and lists are new objects.
    """
    return msgspec.to_builtins(value)


def names_in(entry: Json, key: str) -> list[str]:
    """Return the names under a key of a cell's user data.

    Values that are no names, in files of other programs, are ignored.

    Args:
        entry: The user data of a cell.
        key: ``doors``, ``objects``, ``walls`` or ``blockers``.
    """
    names = entry.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def parse_boxes(entries: JsonValue) -> dict[str, Box]:
    """Check and convert ``metadata.navbake.boxes``.

    Args:
        entries: The table.

    Returns:
        Name -> box.

    Raises:
        FormatError: The table is broken.
    """
    return read_table(entries, dict[str, Box], "metadata.navbake.boxes")


def find_category(name: str) -> str:
    """Return an object's category: its name in lower case, without the number at its end."""
    counter_match = REVERSED_COUNTER.match(name[::-1])
    name_without_counter = name[: len(name) - (counter_match.end() if counter_match else 0)]
    return name_without_counter.lower() or name.lower()
