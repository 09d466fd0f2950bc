"""Doors of a grid: the cells that each can block, and the same grid with them in other states.

The file carries, for each door and state, the cells that the door blocks and nothing else does.
So another state needs no scene and no new bake.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.navgrid.islands import add_layers
from navbake.navgrid.user_data import SharedUserData, held_user_data

if TYPE_CHECKING:
    from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

    AnyGrid = TypeVar("AnyGrid", SceneGrid2D, MultiLevelGrid)

UserData = TypeVar("UserData", dict[int, dict[str, Any]], SharedUserData)

STATES = ("modelled", "open", "closed", "removed")

NAMES = ("doors", "objects", "walls")
"""Keys of a cell's user data that list what stands in it."""

Runs = list[int]
"""Cell ids as runs: first id, count, first id, count, …"""


def to_runs(cells: NDArray[np.int64]) -> Runs:
    """Pack ascending cell ids, shape (n,), into runs."""
    if not len(cells):
        return []
    breaks = np.flatnonzero(np.diff(cells) != 1) + 1
    first = np.concatenate([[0], breaks])
    count = np.diff(np.concatenate([first, [len(cells)]]))
    return [int(v) for v in np.stack([cells[first], count], axis=1).ravel()]


def from_runs(runs: Iterable[int]) -> NDArray[np.int64]:
    """Unpack runs into ascending cell ids, shape (n,), int64."""
    pairs = np.asarray(list(runs), dtype=np.int64).reshape(-1, 2)
    parts = [np.arange(first, first + count) for first, count in pairs]
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)


def door_cells(door: Mapping[str, Any], state: str, num_levels: int) -> list[NDArray[np.int64]]:
    """The cells that a door blocks in a state, and nothing else does.

    Args:
        door: its entry in the grid's `doors`.
        state: one of modelled, open, closed, removed.
        num_levels: how many levels the grid has.

    Returns:
        Ascending cell ids for each level.
    """
    per_level: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)] * num_levels
    for level, runs in door["cells"].get(state, []):
        per_level[level] = from_runs(runs)
    return per_level


def check_doors(doors: Any, sizes: list[int]) -> None:
    """Check the doors of a file.

    Args:
        doors: what stands at ``metadata.navbake.doors``.
        sizes: number of cells of each level.

    Raises:
        FormatError: a door names no cells, or cells that the grid doesn't have, or a level twice
            for a state, or two doors share an id.
    """
    where = "metadata.navbake.doors"
    if not isinstance(doors, list):
        raise FormatError(f"expected a list at `{where}`, got {type(doors).__name__}")
    seen: set[str] = set()
    for number, door in enumerate(doors):
        here = f"{where}[{number}]"
        if not isinstance(door, dict) or not isinstance(door.get("cells"), dict):
            raise FormatError(f"expected a door with `cells` at `{here}`")
        if not isinstance(door.get("id"), str) or door.get("state") not in STATES:
            raise FormatError(f"expected a door with an `id` and a `state` at `{here}`")
        if door["id"] in seen:
            raise FormatError(f"expected an id of its own, got {door['id']!r} again at `{here}.id`")
        seen.add(door["id"])
        if not isinstance(door.get("joint"), str | None) or not _are_rooms(door.get("rooms", [])):
            raise FormatError(f"expected `joint` to be a name and `rooms` to be ids at `{here}`")
        for state, entries in door["cells"].items():
            if state not in STATES or not isinstance(entries, list):
                raise FormatError(f"expected a list for a known state at `{here}.cells`")
            _check_entries(entries, sizes, f"`{here}.cells.{state}`")


def _check_entries(entries: list[Any], sizes: list[int], where: str) -> None:
    seen: set[int] = set()
    for entry in entries:
        if not _is_entry(entry, sizes):
            raise FormatError(
                f"expected [level, [first cell, count, …]] within the grid at {where}"
            )
        if entry[0] in seen:
            raise FormatError(f"expected one entry a level, got level {entry[0]} again at {where}")
        seen.add(entry[0])


def _are_rooms(rooms: Any) -> bool:
    return isinstance(rooms, list) and all(isinstance(room, str | None) for room in rooms)


def _is_entry(entry: Any, sizes: list[int]) -> bool:
    if not isinstance(entry, list) or len(entry) != 2:
        return False
    level, runs = entry
    if type(level) is not int or not 0 <= level < len(sizes):
        return False
    if not isinstance(runs, list) or len(runs) % 2 or any(type(v) is not int for v in runs):
        return False
    end = 0
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        if first < end or not 0 < count <= sizes[level] - first:
            return False
        end = first + count
    return True


def list_doors(grid: SceneGrid2D | MultiLevelGrid) -> list[dict[str, Any]]:
    """Summarise a grid's doors in values that JSON can hold.

    Returns:
        Of each door, as the file lists them: ``id``, ``joint`` (or None), ``rooms`` (the ids of
        the two that it joins, None for the outside), ``levels`` (those where it blocks cells in
        any state), ``state``, ``like`` (which of closed and open is the same as modelled, where
        one is and that is its state; else None), and ``states``: all that it can be in.
    """
    return [
        {
            "id": door["id"],
            "joint": door.get("joint"),
            "rooms": list(door.get("rooms", [])),
            "levels": sorted({level for entry in door["cells"].values() for level, _ in entry}),
            "state": door["state"],
            "like": _like(door),
            "states": _possible(door),
        }
        for door in grid.doors
    ]


def _like(door: Mapping[str, Any]) -> str | None:
    cells = door["cells"]
    if door["state"] != "modelled" or "modelled" not in cells:
        return None
    return next((s for s in ("closed", "open") if cells.get(s) == cells["modelled"]), None)


def _possible(door: Mapping[str, Any]) -> list[str]:
    return [state for state in STATES if state in door["cells"] or state == "removed"]


def _check_state(
    name: str, state: str, doors: Mapping[str, Mapping[str, Any]], scene_id: str | None
) -> None:
    """Refuse a door that there is not, and a state that it hasn't."""
    if name not in doors:
        near = get_close_matches(name, doors, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        known = ", ".join(sorted(doors)) or "none"
        raise QueryError(f"no door {name!r} in {scene_id!r}: {hint}it has {known}")
    if state not in STATES:
        raise QueryError(f"expected one of {', '.join(STATES)} for {name!r}, got {state!r}")
    if state != "removed" and state not in doors[name]["cells"]:
        possible = ", ".join(_possible(doors[name]))
        raise QueryError(f"door {name!r} can't be {state}: it can be {possible}")


def with_doors(grid: AnyGrid, states: Mapping[str, str] | str) -> AnyGrid:
    """The same grid with doors in other states; see `SceneGrid2D.with_doors`."""
    if "inflation" in grid.metadata:
        raise QueryError(
            f"{grid.scene_id!r} was inflated with its doors as they were: change them on the grid "
            "as it was baked, then inflate that"
        )
    if not isinstance(states, str | Mapping):
        raise QueryError(f"expected a state, or states by door, got {states!r}")
    doors = [dict(door) for door in grid.doors]
    by_id: dict[str, dict[str, Any]] = {door["id"]: door for door in doors}
    wanted: dict[str, str] = (
        dict.fromkeys(by_id, states) if isinstance(states, str) else dict(states)
    )
    for name, state in wanted.items():
        _check_state(name, state, by_id, grid.scene_id)
    levels = grid.levels
    occupied = [level.occupancy.astype(np.bool_).ravel() for level in levels]
    for door in doors:
        for mask, cells in zip(occupied, door_cells(door, door["state"], len(levels)), strict=True):
            mask[cells] = False
    for door in doors:
        door["state"] = wanted.get(door["id"], door["state"])
        for mask, cells in zip(occupied, door_cells(door, door["state"], len(levels)), strict=True):
            mask[cells] = True
    return _rebuild(grid, doors, occupied)


def name_door_cells(
    user_data: UserData, doors: list[dict[str, Any]], level: int, num_levels: int
) -> UserData:
    """Write the doors of each cell into a level's user data.

    A cell is in a door where the door blocks it when closed, or as it stands. Where it blocks as
    it stands, the door is one of the cell's objects, too.

    Args:
        user_data: what else is known of the level's cells; not changed.
        doors: the grid's doors.
        level: which level.
        num_levels: how many the grid has.

    Returns:
        User data of the same kind with `doors` where a cell is in one, by ascending cell id.
    """
    if not doors:
        return user_data
    names, standing = _doors_by_cell(doors, level, num_levels)
    ids = {door["id"] for door in doors}
    if isinstance(user_data, SharedUserData):
        known = user_data.find(np.fromiter(names, dtype=np.int64, count=len(names)))
    else:
        known = [user_data.get(cell, {}) for cell in names]
    changed: dict[int, dict[str, Any]] = {}
    for (cell, found), before in zip(names.items(), known, strict=True):
        entry = _without_doors(before, ids)
        changed[cell] = _with_doors(entry, found, standing.get(cell, set())) if found else entry
    if isinstance(user_data, SharedUserData):
        replaced: Any = user_data.replaced(changed)
        return replaced  # type: ignore[no-any-return]
    merged = {**user_data, **changed}
    return {cell: merged[cell] for cell in sorted(merged) if cell not in changed or changed[cell]}


def _doors_by_cell(
    doors: list[dict[str, Any]], level: int, num_levels: int
) -> tuple[dict[int, set[str]], dict[int, set[str]]]:
    """The doors that each cell is in, and those that block it.

    Among the former are all cells that a door blocks in any state, as it may have been in that.
    """
    names: dict[int, set[str]] = {}
    standing: dict[int, set[str]] = {}
    for door in doors:
        for state in door["cells"]:
            for cell in door_cells(door, state, num_levels)[level].tolist():
                found = names.setdefault(cell, set())
                if state in ("closed", door["state"]):
                    found.add(door["id"])
                if state == door["state"]:
                    standing.setdefault(cell, set()).add(door["id"])
    return names, standing


def _without_doors(entry: dict[str, Any], ids: set[str]) -> dict[str, Any]:
    """A cell's user data without doors; what blocks a door's cell is a door as well."""
    if "doors" not in entry:
        return entry
    kept = {key: value for key, value in entry.items() if key not in ("doors", "blockers")}
    kept["objects"] = [name for name in kept.get("objects", []) if name not in ids]
    return {key: value for key, value in kept.items() if key != "objects" or value}


def _with_doors(entry: dict[str, Any], names: set[str], standing: set[str]) -> dict[str, Any]:
    """A cell's user data with the doors that it is in, and those of them that block it."""
    objects = sorted({*entry.get("objects", []), *standing})
    named = {"doors": sorted(names), **({"objects": objects} if objects else {})}
    named |= {key: value for key, value in entry.items() if key not in named}
    if standing and standing != {name for key in NAMES for name in named.get(key, [])}:
        named["blockers"] = sorted(standing)
    return named


def _known(level: SceneGrid2D) -> Any:
    """A level's user data: as a dictionary, unless nobody can have changed what cells share."""
    held = held_user_data(level)
    is_shared = isinstance(held, SharedUserData) and not held.is_resolved
    return held if is_shared else level.user_data


def _with_blocks(
    level: SceneGrid2D, occupied: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What is occupied, and where nobody can stand, with what `grid.block` blocks now."""
    from navbake.runtime.blocks.block import known_changes
    from navbake.runtime.blocks.shape import BLOCKED, OCCUPIED

    changes = known_changes(level)
    if changes is None:
        return occupied, np.zeros_like(occupied)
    held = (changes.count > 0).reshape(-1, *level.shape)
    return occupied | held[OCCUPIED], held[BLOCKED]


def _rebuild(
    grid: AnyGrid, doors: list[dict[str, Any]], occupied: list[NDArray[np.bool_]]
) -> AnyGrid:
    from navbake.navgrid.grid import MultiLevelGrid
    from navbake.runtime.blocks.block import own_attributes

    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": doors}}
    levels = []
    for number, (level, mask) in enumerate(zip(grid.levels, occupied, strict=True)):
        is_occupied = mask.reshape(level.shape)
        is_occupied, is_blocked = _with_blocks(level, is_occupied)
        was_occupied = level.occupancy.astype(np.bool_)
        weights = level.weights.copy()
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        weights[is_blocked] = np.inf
        levels.append(
            replace(
                level,
                weights=weights,
                attributes={**own_attributes(level), "occupancy": is_occupied.astype(np.uint8)},
                user_data=(
                    name_door_cells(_known(level), doors, number, len(occupied))
                    if grid.navbake.get("names", True)
                    else held_user_data(level)
                ),
                metadata=metadata,
            )
        )
    whole: Any = grid
    rebuilt: Any = levels[0]
    if isinstance(grid, MultiLevelGrid):
        rebuilt = replace(whole, grids=levels, metadata=metadata)
    add_layers(rebuilt, {name for level in levels for name in level.attributes})
    result: AnyGrid = rebuilt
    return result
