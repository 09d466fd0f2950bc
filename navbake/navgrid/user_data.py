"""What a file keeps for single cells, read when it is first asked for.

Names of what stands in each cell make up most of a grid's file, and few who load a grid ask for
them. So the reader may leave a `StoredUserData` in the place of the dictionary.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.types import Json

if TYPE_CHECKING:
    from navbake.navgrid.grid import SceneGrid2D


@contextmanager
def collector_off() -> Iterator[None]:
    """Keep the garbage collector from looking through all that is made, over and over."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class StoredUserData:
    """User data that are still in the form in which they were stored."""

    def resolve(self) -> dict[int, Json]:
        """Read them; the same dictionary each time.

        Raises:
            FormatError: they don't follow the format.
        """
        raise NotImplementedError


Parts = tuple[NDArray[np.int64], NDArray[np.int64], Sequence[Json]]


class SharedUserData(StoredUserData):
    """User data of which many cells have the same.

    Args:
        cells: cell ids, ascending, shape (n,), int64.
        number: which entry each cell has, shape (n,), int64.
        entries: the entries; nobody may change them.
    """

    def __init__(
        self, cells: NDArray[np.int64], number: NDArray[np.int64], entries: Sequence[Json]
    ) -> None:
        self._parts: Parts | Callable[[], Parts] = (cells, number, entries)
        self._resolved: dict[int, Json] | None = None

    @classmethod
    def later(cls, make: Callable[[], Parts]) -> SharedUserData:
        """User data whose cells, numbers and entries are made when they are first needed."""
        shared = cls(np.empty(0, np.int64), np.empty(0, np.int64), [])
        shared._parts = make
        return shared

    def __reduce__(self) -> tuple[type[SharedUserData], Parts]:
        return SharedUserData, self.parts

    @property
    def parts(self) -> Parts:
        """Cells, numbers and entries."""
        if callable(self._parts):
            self._parts = self._parts()
        return self._parts

    @property
    def cells(self) -> NDArray[np.int64]:
        """Cell ids, ascending, shape (n,), int64."""
        return self.parts[0]

    @property
    def number(self) -> NDArray[np.int64]:
        """Which entry each cell has, shape (n,), int64."""
        return self.parts[1]

    @property
    def entries(self) -> Sequence[Json]:
        """The entries that cells share; nobody may change them."""
        return self.parts[2]

    @property
    def is_resolved(self) -> bool:
        """Whether somebody has the dictionary, and so may have changed it."""
        return self._resolved is not None

    def resolve(self) -> dict[int, Json]:
        """Make them a dictionary; each cell gets an entry of its own, as from a file."""
        if self._resolved is None:
            shared = self.entries
            with collector_off():
                entries = [_copy_json(shared[k]) for k in self.number.tolist()]
            self._resolved = dict(zip(self.cells.tolist(), entries, strict=True))
        return self._resolved

    def find(self, cells: NDArray[np.int64]) -> list[Json]:
        """The entries of some cells, shape (n,), int64; an empty one where a cell has none."""
        if not len(self.cells):
            return [{}] * len(cells)
        place = np.minimum(np.searchsorted(self.cells, cells), len(self.cells) - 1)
        is_known = (self.cells[place] == cells).tolist()
        number, entries = self.number[place].tolist(), self.entries
        return [entries[k] if known else {} for k, known in zip(number, is_known, strict=True)]

    def replaced(self, changed: Mapping[int, Json]) -> SharedUserData:
        """The same with other entries in some cells; those whose entry is empty drop out.

        Args:
            changed: entries by cell id; nobody may change them.
        """
        kept = ~np.isin(self.cells, np.fromiter(changed, dtype=np.int64, count=len(changed)))
        added = {cell: entry for cell, entry in changed.items() if entry}
        own = np.fromiter(added, dtype=np.int64, count=len(added))
        known = self.entries
        is_used = np.zeros(len(known), dtype=np.bool_)
        is_used[self.number[kept]] = True
        entries = list(compress(known, is_used))  # or they pile up, change by change
        number = (np.cumsum(is_used) - 1)[self.number[kept]]
        cells = np.concatenate([self.cells[kept], own])
        number = np.concatenate([number, len(entries) + np.arange(len(own))])
        order = np.argsort(cells)
        return SharedUserData(cells[order], number[order], [*entries, *added.values()])


def _copy_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copy_json(part) for key, part in value.items()}
    return [_copy_json(part) for part in value] if isinstance(value, list) else value


class UserDataField:
    """The attribute `user_data` of a level: a dictionary, whatever was put there."""

    def __get__(self, level: SceneGrid2D | None, owner: type) -> Any:
        if level is None:
            return self
        held = held_user_data(level)
        if isinstance(held, StoredUserData):
            held = level.__dict__["user_data"] = held.resolve()
        return held

    def __set__(self, level: SceneGrid2D, value: dict[int, Json] | StoredUserData) -> None:
        level.__dict__["user_data"] = value


def held_user_data(level: SceneGrid2D) -> Any:
    """The user data as a level holds them: a dictionary, or a `StoredUserData` not read yet.

    It can be handed on to another level as it is.
    """
    return level.__dict__["user_data"]
