"""The same grid with its doors in other states.

A file states what each door blocks in each state, and nothing else does. So another state needs no
scene and no new bake.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from navbake.errors import QueryError
from navbake.navgrid.block_state import BLOCKED, OCCUPIED
from navbake.navgrid.doors import STATES, Door
from navbake.navgrid.islands import add_layers
from navbake.navgrid.user_data import SharedUserData, held_user_data
from navbake.types import Bool

if TYPE_CHECKING:
    from navbake.navgrid.grid import SceneGrid2D
    from navbake.navgrid.grid_base import GridBase

AnyGrid = TypeVar("AnyGrid", bound="GridBase")

UserData = TypeVar("UserData", dict[int, dict[str, Any]], SharedUserData)

NAMES = ("doors", "objects", "walls")
"""Keys of a cell's user data that list what stands in it."""


def with_doors(grid: AnyGrid, states: Mapping[str, str] | str) -> AnyGrid:
    """The same grid with doors in other states; see `SceneGrid2D.with_doors`."""
    if "inflation" in grid.metadata:
        raise QueryError(
            f"{grid.scene_id!r} was inflated with its doors as they were: change them on the grid "
            "as it was baked, then inflate that"
        )
    if not isinstance(states, str | Mapping):
        raise QueryError(f"expected a state, or states by door, got {states!r}")
    before = {door.id: door for door in grid.doors}
    wanted = dict.fromkeys(before, states) if isinstance(states, str) else states
    for name, state in wanted.items():
        _check_state(name, state, before, grid.scene_id)
    after = [replace(door, state=wanted.get(door.id, door.state)) for door in before.values()]
    occupied = [level.occupancy.astype(np.bool_).ravel() for level in grid.levels]
    # doors may overlap: all are taken out before any is put in
    for doors, is_there in ((before.values(), False), (after, True)):
        for door in doors:
            for mask, cells in zip(occupied, door.cells_in(door.state, len(occupied)), strict=True):
                mask[cells] = is_there
    return _rebuild(grid, after, occupied)


def _check_state(name: str, state: str, doors: Mapping[str, Door], scene_id: str | None) -> None:
    """Refuse a door that there is not, and a state that it hasn't."""
    if name not in doors:
        near = get_close_matches(name, doors, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        known = ", ".join(sorted(doors)) or "none"
        raise QueryError(f"no door {name!r} in {scene_id!r}: {hint}it has {known}")
    if state not in STATES:
        raise QueryError(f"expected one of {', '.join(STATES)} for {name!r}, got {state!r}")
    if state not in doors[name].states:
        possible = ", ".join(doors[name].states)
        raise QueryError(f"door {name!r} can't be {state}: it can be {possible}")


def _rebuild(grid: AnyGrid, doors: Sequence[Door], occupied: list[Bool]) -> AnyGrid:
    levels = []
    for number, (level, mask) in enumerate(zip(grid.levels, occupied, strict=True)):
        is_occupied, is_blocked = mask.reshape(level.shape), np.zeros(level.shape, dtype=np.bool_)
        if level.block_state is not None:
            is_occupied |= level.block_state.held(level, OCCUPIED)
            is_blocked = level.block_state.held(level, BLOCKED)
        was_occupied = level.occupancy.astype(np.bool_)
        weights = level.weights.copy()
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        weights[is_blocked] = np.inf
        named = None
        if grid.navbake.get("names", True):
            named = name_door_cells(_known(level), doors, number, len(occupied))
        attributes = {"occupancy": is_occupied.astype(np.uint8)}
        levels.append(level.with_layers(weights=weights, attributes=attributes, user_data=named))
    stated = zip(grid.navbake.get("doors", []), doors, strict=True)
    tables = [{**entry, "state": door.state} for entry, door in stated]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": tables}}
    rebuilt = grid.with_levels(levels, metadata)
    add_layers(rebuilt, {name for level in levels for name in level.attributes})
    return rebuilt


def name_door_cells(
    user_data: UserData, doors: Sequence[Door], level: int, num_levels: int
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
    ids = {door.id for door in doors}
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
    doors: Sequence[Door], level: int, num_levels: int
) -> tuple[dict[int, set[str]], dict[int, set[str]]]:
    """The doors that each cell is in, and those that block it.

    Among the former are all cells that a door blocks in any state, as it may have been in that.
    """
    names: dict[int, set[str]] = {}
    standing: dict[int, set[str]] = {}
    for door in doors:
        for state in door.cells:
            for cell in door.cells_in(state, num_levels)[level].tolist():
                found = names.setdefault(cell, set())
                if state in ("closed", door.state):
                    found.add(door.id)
                if state == door.state:
                    standing.setdefault(cell, set()).add(door.id)
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
