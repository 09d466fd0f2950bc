"""Per-cell user data, parsed or made on first use.

Names of objects by cell make up most of a grid's file, are rarely needed, and are often equal in
many cells. So `UserData` parses a file's on first use, and shares a bake's entries until a caller
accesses single cells, which are writable.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from itertools import compress
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from navbake.types import Int, Json

NAMES = ("doors", "objects", "walls")  # keys of a cell's user data that list names


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Pause the garbage collector while many objects are made: it would scan them repeatedly."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class Shared(NamedTuple):
    """User data with entries shared by many cells."""

    cells: Int  #: Cell ids, ascending, shape (n,), int64.
    number: Int  #: The entry of each cell, shape (n,), int64.
    entries: Sequence[Json]  #: Must not be modified.


Entries: TypeAlias = MutableMapping[int, Json] | Shared


class UserData(MutableMapping[int, Json]):
    """User data by cell id (col + row * width).

    Its source is a dictionary, which is modified in place; `Shared` entries, which become a
    dictionary on access to single cells; or a function that returns one of these.
    """

    def __init__(self, source: Entries | Callable[[], Entries] | None = None) -> None:
        self._source: Any = {} if source is None else source

    @classmethod
    def of(cls, user_data: MutableMapping[int, Json]) -> UserData:
        """User data from any mapping; itself if it is one."""
        return user_data if isinstance(user_data, UserData) else cls(user_data)

    @property
    def is_read(self) -> bool:
        """Whether a caller accessed single cells, and so may have changed them."""
        return isinstance(self._source, MutableMapping)

    @property
    def source(self) -> Entries:
        """The dictionary, or the entries that cells share."""
        if callable(self._source):
            with without_garbage_collection():
                self._source = self._source()
        source: Entries = self._source
        return source

    @property
    def _cells(self) -> MutableMapping[int, Json]:
        """The dictionary; shared entries are copied into one for each cell."""
        source = self.source
        if isinstance(source, Shared):
            with without_garbage_collection():
                entries = [_copy_json(source.entries[k]) for k in source.number.tolist()]
                source = dict(zip(source.cells.tolist(), entries, strict=True))
            self._source = source
        return source

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
        """The entries of cells, shape (n,), int64; {} for none. They must not be modified."""
        source = self.source
        if not isinstance(source, Shared):
            return [source.get(cell, {}) for cell in cells.tolist()]
        known, number, entries = source
        place = np.searchsorted(known, cells)
        # one more at the end, for cells beyond the last one that has an entry
        is_known = np.append(known, -1)[place] == cells
        numbers = np.where(is_known, np.append(number, -1)[place], -1)
        with_none = [*entries, {}]
        return [with_none[k] for k in numbers.tolist()]

    def shared(self) -> Shared:
        """All entries and their cells, in the source's order. They must not be modified."""
        source = self.source
        if isinstance(source, Shared):
            return source
        cells = np.fromiter(source, dtype=np.int64, count=len(source))
        return Shared(cells, np.arange(len(cells)), list(source.values()))

    def replaced(self, changed: Mapping[int, Json]) -> UserData:
        """User data with other entries in some cells, by ascending cell id; empty ones are removed.

        The entries must not be modified.
        """
        source = self.source
        if not isinstance(source, Shared):
            merged = {**source, **changed}
            kept = (cell for cell in sorted(merged) if cell not in changed or changed[cell])
            return UserData({cell: merged[cell] for cell in kept})
        cells, number, known = source
        is_kept = ~np.isin(cells, np.fromiter(changed, dtype=np.int64, count=len(changed)))
        number = number[is_kept]
        # drop unused entries, or they would pile up
        is_used = np.bincount(number, minlength=len(known)) > 0
        entries = list(compress(known, is_used))
        added = {cell: entry for cell, entry in changed.items() if entry}
        new = len(entries) + np.arange(len(added))
        number = np.concatenate([(np.cumsum(is_used) - 1)[number], new])
        cells = np.concatenate([cells[is_kept], np.fromiter(added, dtype=np.int64)])
        order = np.argsort(cells)
        return UserData(Shared(cells[order], number[order], [*entries, *added.values()]))


def names_in(entry: Json, key: str) -> list[str]:
    """The names under a key of a cell's user data, which other programs may use for anything."""
    names = entry.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _copy_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy_json(part) for key, part in value.items()}
    return [_copy_json(part) for part in value] if isinstance(value, list) else value
