"""What a file keeps for single cells, read when it is first asked for.

Names of what stands in each cell make up most of a grid's file, and few who load a grid ask for
them. So the reader may leave a `StoredUserData` in the place of the dictionary.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from navbake.grid import SceneGrid2D

Json = dict[str, Any]


class StoredUserData:
    """User data that are still in the form in which they were stored."""

    def resolve(self) -> dict[int, Json]:
        """Read them; the same dictionary each time.

        Raises:
            FormatError: they don't follow the format.
        """
        raise NotImplementedError


class SharedUserData(StoredUserData):
    """User data of which many cells have the same.

    Attributes:
        cells: cell ids, ascending, shape (n,), int64.
        number: which entry each cell has, shape (n,), int64.
        entries: the entries; nobody may change them.
    """

    def __init__(
        self, cells: NDArray[np.int64], number: NDArray[np.int64], entries: Sequence[Json]
    ) -> None:
        self.cells, self.number, self.entries = cells, number, entries
        self._resolved: dict[int, Json] | None = None

    @property
    def is_resolved(self) -> bool:
        """Whether somebody has the dictionary, and so may have changed it."""
        return self._resolved is not None

    def resolve(self) -> dict[int, Json]:
        """Make them a dictionary; cells of one entry share it."""
        if self._resolved is None:
            found = map(self.entries.__getitem__, self.number.tolist())
            self._resolved = dict(zip(self.cells.tolist(), found, strict=True))
        return self._resolved


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
