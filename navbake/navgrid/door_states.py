"""Changes the states of a grid's doors and links without a new bake."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.block_state import BLOCKED, OCCUPIED
from navbake.navgrid.doors import STATES, Door
from navbake.navgrid.grid import GridBase
from navbake.navgrid.islands import add_layers, renew_islands
from navbake.navgrid.links import LINK_STATES
from navbake.navgrid.user_data import NAMES, UserData, names_in
from navbake.types import Bool, Json

AnyGrid = TypeVar("AnyGrid", bound=GridBase)


def with_doors(grid: AnyGrid, states: Mapping[str, str] | str) -> AnyGrid:
    """Change the states of doors; the result equals a bake with the doors in these states.

    `states` are ``modelled``, ``open``, ``closed`` or ``removed``, by a door's id or for all.
    Raises a QueryError if a door or a state does not exist, or the grid was inflated.
    """
    if "inflation" in grid.metadata:
        raise QueryError(
            f"{grid.scene_id!r} was inflated: change doors on the grid as it was baked, then "
            "inflate the result"
        )
    if not isinstance(states, str | Mapping):
        raise QueryError(f"expected a state, or states by door, got {states!r}")
    before = {door.id: door for door in grid.doors}
    wanted = dict.fromkeys(before, states) if isinstance(states, str) else states
    for name, state in wanted.items():
        if name not in before:
            hint = suggest(name, sorted(before))
            raise QueryError(f"no door {name!r} in {grid.scene_id!r}: {hint}")
        if state not in STATES:
            raise QueryError(f"expected one of {', '.join(STATES)} for {name!r}, got {state!r}")
        if state not in before[name].states:
            possible = ", ".join(before[name].states)
            raise QueryError(f"door {name!r} can't be {state}: it can be {possible}")
    after = [replace(door, state=wanted.get(door.id, door.state)) for door in before.values()]
    occupied, solid = (
        [layer.astype(np.bool_).ravel() for layer in layers]
        for layers in zip(*((level.occupancy, level.solid) for level in grid.levels), strict=True)
    )
    # doors may overlap: all are taken out before any is put in
    for doors, is_there in ((before.values(), False), (after, True)):
        for door in doors:
            cells = door.cells_in(door.state, len(occupied)), door.solid_in(door.state, len(solid))
            for ids, mask in zip([*cells[0], *cells[1]], [*occupied, *solid], strict=True):
                mask[ids] = is_there
    return _rebuild(grid, after, occupied, solid)


def with_links(grid: AnyGrid, states: Mapping[str, str]) -> AnyGrid:
    """Open or close links; the new grid shares its arrays with this one.

    `states` are ``open`` or ``closed``, by a link's name. Raises a QueryError if a link or a state
    does not exist.
    """
    if not isinstance(states, Mapping):
        raise QueryError(f"expected states by link, as {{'A': 'closed'}}, got {states!r}")
    names = [link.name for link in grid.links]
    for name, state in states.items():
        if name not in names:
            raise QueryError(f"no link {name!r} in {grid.scene_id!r}: {suggest(name, names)}")
        if state not in LINK_STATES:
            raise QueryError(
                f"expected one of {', '.join(LINK_STATES)} for {name!r}, got {state!r}"
            )
    table = [
        {**entry, "state": states[entry["name"]]}
        if isinstance(entry, dict) and entry["name"] in states
        else entry
        for entry in grid.navbake.get("links") or []
    ]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "links": table}}
    changed = grid.with_levels([level.with_layers() for level in grid.levels], metadata)
    renew_islands(changed)
    return changed


def _rebuild(
    grid: AnyGrid, doors: Sequence[Door], occupied: list[Bool], solid: list[Bool]
) -> AnyGrid:
    levels = []
    for number, (level, mask) in enumerate(zip(grid.levels, occupied, strict=True)):
        is_occupied, was_occupied = mask.reshape(level.shape), level.occupancy.astype(np.bool_)
        is_solid = solid[number].reshape(level.shape)
        state = level.block_state
        if state is not None:
            is_occupied |= state.held(OCCUPIED)
            is_solid |= state.held(OCCUPIED)
        weights = level.weights.copy()
        # cells that no door changes keep their weight
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        if state is not None:
            weights[state.held(BLOCKED)] = np.inf
        named = None
        if grid.navbake.get("names", True):
            named = with_door_names(UserData.of(level.user_data), doors, number, len(occupied))
        attributes = {"occupancy": is_occupied.astype(np.uint8)}
        if "solid" in level.attributes:
            attributes["solid"] = is_solid.astype(np.uint8)
        levels.append(level.with_layers(weights=weights, attributes=attributes, user_data=named))
    stated = zip(grid.navbake.get("doors", []), doors, strict=True)
    tables = [{**entry, "state": door.state} for entry, door in stated]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": tables}}
    rebuilt = grid.with_levels(levels, metadata)
    add_layers(rebuilt, {name for level in levels for name in level.attributes})
    return rebuilt


def with_door_names(
    user_data: UserData, doors: Sequence[Door], level: int, num_levels: int
) -> UserData:
    """Add the doors of each cell to a level's user data, by ascending cell id.

    A cell's doors are those that block it, closed or in their current state. A door that blocks it
    in its current state is one of its objects, too.
    """
    if not doors:
        return user_data  # without reading them
    # all cells that a door blocks in any state: the user data may be from that state
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
    ids = {door.id for door in doors}
    known = user_data.find(np.fromiter(names, dtype=np.int64, count=len(names)))
    changed: dict[int, Json] = {}
    for (cell, found), before in zip(names.items(), known, strict=True):
        entry = _without_doors(before, ids)
        changed[cell] = _with_doors(entry, found, standing.get(cell, set())) if found else entry
    return user_data.replaced(changed)


def _without_doors(entry: Json, ids: set[str]) -> Json:
    """A cell's user data without doors and blockers, which may be doors."""
    if "doors" not in entry:
        return entry
    kept = {key: value for key, value in entry.items() if key not in ("doors", "blockers")}
    if isinstance(kept.get("objects"), list):
        kept["objects"] = [name for name in names_in(kept, "objects") if name not in ids]
    return {key: value for key, value in kept.items() if key != "objects" or value != []}


def _with_doors(entry: Json, names: set[str], standing: set[str]) -> Json:
    """A cell's user data with its doors; `standing` ones are objects, too."""
    objects = sorted({*names_in(entry, "objects"), *standing})
    named = {"doors": sorted(names), **({"objects": objects} if objects else {})}
    named |= {key: value for key, value in entry.items() if key not in named}
    # blockers are stated only where they aren't all that stands in the cell
    if standing and standing != {name for key in NAMES for name in names_in(named, key)}:
        named["blockers"] = sorted(standing)
    return named
