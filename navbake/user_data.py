"""What a file keeps for single cells, read when it is first asked for.

Names of what stands in each cell make up most of a grid's file, and few who load a grid ask for
them. So the reader may leave a `StoredUserData` in the place of the dictionary.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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
