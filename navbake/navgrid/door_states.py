"""The doors of a grid as lines from jamb to jamb, and other states of its doors and links."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.navgrid.islands import add_layers, renew_islands
from navbake.navgrid.links import LINK_STATES
from navbake.navgrid.obstacle_state import BLOCKED, OCCUPIED
from navbake.navgrid.rooms import STATES, Door
from navbake.navgrid.user_data import NAMES, UserData, names_in
from navbake.types import Bool, Float, Json

AnyGrid = TypeVar("AnyGrid", bound=GridBase)

DECIMALS = 6  # of ends of lines: micrometres


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
    levels = []
    for number, (level, mask) in enumerate(zip(grid.levels, occupied, strict=True)):
        is_occupied = mask.reshape(level.shape)
        was_occupied = level.occupancy.astype(np.bool_)
        is_solid = solid[number].reshape(level.shape)
        blocks = level.obstacle_state
        if blocks is not None:
            is_occupied |= blocks.mask_of(OCCUPIED)
            is_solid |= blocks.mask_of(OCCUPIED)
        weights = level.weights.copy()
        # cells that no door changes keep their weight
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        if blocks is not None:
            weights[blocks.mask_of(BLOCKED)] = np.inf
        named = None
        if grid.navbake.get("names", True):
            named = with_door_names(UserData.of(level.user_data), after, number, len(occupied))
        attributes = {"occupancy": is_occupied.astype(np.uint8)}
        if "solid" in level.attributes:
            attributes["solid"] = is_solid.astype(np.uint8)
        levels.append(level.with_layers(weights=weights, attributes=attributes, user_data=named))
    stated = zip(grid.navbake.get("doors", []), after, strict=True)
    tables = [{**entry, "state": door.state} for entry, door in stated]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": tables}}
    rebuilt = grid.with_levels(levels, metadata)
    add_layers(rebuilt, {name for level in levels for name in level.attributes})
    return rebuilt


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
        entry = before
        if "doors" in before:  # without them, and without blockers, which may be doors
            entry = {key: v for key, v in before.items() if key not in ("doors", "blockers")}
            if isinstance(entry.get("objects"), list):
                entry["objects"] = [n for n in names_in(entry, "objects") if n not in ids]
            entry = {key: v for key, v in entry.items() if key != "objects" or v != []}
        if found:
            blocking = standing.get(cell, set())
            objects = sorted({*names_in(entry, "objects"), *blocking})
            named = {"doors": sorted(found), **({"objects": objects} if objects else {})}
            entry = {**named, **{key: v for key, v in entry.items() if key not in named}}
            # blockers are stated only where they aren't all that stands in the cell
            if blocking and blocking != {name for key in NAMES for name in names_in(entry, key)}:
                entry["blockers"] = sorted(blocking)
        changed[cell] = entry
    return user_data.replaced(changed)


# ---------------------------------------------------------------- lines


class DoorLine(NamedTuple):
    """The line of a door's closed leaf on a level."""

    id: str
    state: str  # closed, open, modelled (neither) or removed
    start: tuple[float, float]  # one end, world x, y [m]
    end: tuple[float, float]  # the other end

    @property
    def width(self) -> float:
        """Width of the doorway, to about a cell [m]."""
        return math.dist(self.start, self.end)

    @property
    def middle(self) -> tuple[float, float]:
        """World x, y [m]."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2


def find_door_lines(grid: NavGrid, number: int) -> tuple[DoorLine, ...]:
    """The lines of a level's doors; see `find_leaf_ends`."""
    ends = [(door, find_leaf_ends(grid, door, number)) for door in grid.doors]
    return tuple(
        DoorLine(door.id, door.like or door.state, *found) for door, found in ends if found
    )


def doorway_cells(grid: NavGrid, number: int, *, blocked: bool) -> Bool:
    """The cells of a level that doors currently block, or else those that they can close."""
    mask = np.zeros(grid.levels[number].shape, dtype=np.bool_)
    for door in grid.doors:
        state = "closed" if "closed" in door.cells and not blocked else door.state
        mask.flat[door.cells_in(state, len(grid.levels))[number]] = True
    return mask


Ends = tuple[tuple[float, float], tuple[float, float]]
"""Both ends of a line, world x, y [m]."""


def find_leaf_ends(grid: NavGrid, door: Door, number: int) -> Ends | None:
    """The ends of a door's leaf on a level when closed, else in its current state.

    With a layer ``solid``, the cells of the leaf itself are known: the line follows their longer
    axis, from edge to edge. Without it, only the blocked cells are known, which may be deeper than
    the door is wide: the line follows the axis with obstacles at both ends, or else the longer one,
    and is longer by the agent's radius at each end. None if the door has no cells on the level.
    """
    level = grid.levels[number]
    num_levels = len(grid.levels)
    cells, leaf = np.empty((2, 0), dtype=np.int64)
    for state in ("closed", door.state, *door.states):
        leaf = door.solid_in(state, num_levels)[number]
        cells = leaf if len(leaf) else door.cells_in(state, num_levels)[number]
        if len(cells):
            break
    else:
        return None
    size = level.lattice.cell_size
    at = level.lattice.positions(*np.divmod(cells, level.width))
    from_middle = at - at.mean(axis=0)
    # the longer principal axis: the eigenvector of the largest eigenvalue
    longer = _upwards(np.linalg.eigh(from_middle.T @ from_middle)[1][:, 1])
    if np.ptp(from_middle @ longer) * np.abs(longer).min() < size / 2:
        # it is along the row of cells, to their resolution
        longer = np.round(longer) + 0.0
    axis = longer
    more = 0.0
    if not len(leaf):
        free = np.pad(level.free, 1)  # no cell outside the grid is free

        def walls(axis: Float) -> int:
            across = _upwards(np.array([-axis[1], axis[0]]))
            along = at @ axis
            aside = np.median(at @ across) * across
            ends = np.array([[along.min() - size], [along.max() + size]]) * axis + aside
            rows, cols = (v + 1 for v in level.lattice.rows_cols(ends))
            rows = rows.clip(0, free.shape[0] - 1)
            cols = cols.clip(0, free.shape[1] - 1)
            return int(np.count_nonzero(~free[rows, cols]))

        shorter = _upwards(np.array([-longer[1], longer[0]]))
        # max returns the first, longer one of a tie
        axis = max((longer, shorter), key=walls)
        more = grid.agent_radius
    # to the outermost edges
    along = from_middle @ axis
    more = more + size / 2 / np.abs(axis).max()
    ends = at.mean(axis=0) + np.array([[along.min() - more], [along.max() + more]]) * axis
    first, last = (np.round(ends, DECIMALS) + 0.0).tolist()
    return (first[0], first[1]), (last[0], last[1])


def _upwards(axis: Float) -> Float:
    """The axis, turned round unless it points up or, if level, to the right."""
    return axis if tuple(axis) > (0.0, 0.0) else 0.0 - axis
