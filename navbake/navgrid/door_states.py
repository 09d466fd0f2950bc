"""Makes grids with doors and links in other states, and finds doors' lines from jamb to jamb."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import list_first, suggest
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.navgrid.islands import add_layers, renew_islands
from navbake.navgrid.links import LINK_STATES
from navbake.navgrid.obstacle_state import BLOCKED, OCCUPIED
from navbake.navgrid.rooms import DOOR_STATES, Door
from navbake.navgrid.user_data import NAME_KEYS, UserData, names_in
from navbake.types import Bool, Float, Json

AnyGrid = TypeVar("AnyGrid", bound=GridBase)

MAX_LISTED_DOORS = 3  # that a warning names
DECIMALS = 6  # the ends of lines are rounded to micrometres


class DoorStateWarning(UserWarning):
    """A warning that doors are no longer in the states that they were given.

    `PathFinder.use` issues it where doors have states of `with_doors` in the finder's grid, and are
    as modelled in the new grid, as after an update.

    ``warnings.simplefilter("error", navbake.DoorStateWarning)`` turns it into an error,
    ``"ignore"`` silences it.
    """


def with_doors(grid: AnyGrid, states: Mapping[str, str] | str) -> AnyGrid:
    """Return a copy of a grid in which doors have new states; see `GridBase.with_doors`.

    Args:
        grid: A grid that was not inflated.
        states: One state for all doors; or door id -> state, for some doors.

    Raises:
        QueryError: A door or a state does not exist, or the grid was inflated.
    """
    if "inflation" in grid.metadata:
        hint = "change doors on the grid as it was baked, then inflate the result"
        raise QueryError(f"{grid.scene_id!r} was inflated: {hint}", hint=hint)
    if not isinstance(states, str | Mapping):
        expected = "a state, or states by door"
        raise QueryError(
            f"expected {expected}, got {states!r}", key="states", value=states, expected=expected
        )
    doors_before = {door.id: door for door in grid.doors}
    new_states = dict.fromkeys(doors_before, states) if isinstance(states, str) else states
    _check_door_states(grid, doors_before, new_states)
    doors_after = [
        replace(door, state=new_states.get(door.id, door.state)) for door in doors_before.values()
    ]
    # for each level a mask, indexed by cell id
    occupied_masks = [level.occupancy.astype(np.bool_).ravel() for level in grid.levels]
    solid_masks = [level.solid.astype(np.bool_).ravel() for level in grid.levels]
    # doors may overlap, so all are taken out before any is put in
    _mark_doors(list(doors_before.values()), occupied_masks, solid_masks, is_blocked=False)
    _mark_doors(doors_after, occupied_masks, solid_masks, is_blocked=True)
    levels = []
    for level_number, level in enumerate(grid.levels):
        is_occupied = occupied_masks[level_number].reshape(level.shape)
        was_occupied = level.occupancy.astype(np.bool_)
        is_solid = solid_masks[level_number].reshape(level.shape)
        obstacle_state = level.obstacle_state
        if obstacle_state is not None:
            occupancy_layer = obstacle_state.layer_of_attribute.get("occupancy", OCCUPIED)
            is_occupied |= obstacle_state.mask_of(occupancy_layer)
            is_solid |= obstacle_state.mask_of(OCCUPIED)
        weights = level.weights.copy()
        # cells that no door changes keep their weight
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        if obstacle_state is not None:
            weights[obstacle_state.mask_of(BLOCKED)] = np.inf
        user_data = None
        if grid.navbake.get("names", True):
            user_data = with_door_names(
                UserData.of(level.user_data), doors_after, level_number, len(grid.levels)
            )
        attributes = {"occupancy": is_occupied.astype(np.uint8)}
        if "solid" in level.attributes:
            attributes["solid"] = is_solid.astype(np.uint8)
        levels.append(
            level.with_layers(weights=weights, attributes=attributes, user_data=user_data)
        )
    door_table = [
        {**entry, "state": door.state}
        for entry, door in zip(grid.navbake.get("doors", []), doors_after, strict=True)
    ]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": door_table}}
    changed_grid = grid.with_levels(levels, metadata)
    add_layers(changed_grid, {name for level in levels for name in level.attributes})
    return changed_grid


def describe_lost_states(old_grid: GridBase, new_grid: GridBase) -> str:
    """Word the warning that doors have other states in a grid, and are as modelled in the next one.

    Doors that block the same cells as modelled as in the state before are left out.

    Args:
        old_grid: A finder's grid.
        new_grid: The grid that the finder has next.

    Returns:
        The warning, which names the doors and their states in `old_grid`, and how to set them in
        the new grid; empty if there are no such doors, or if the grids are of two scenes.
    """
    old_states = {door.id: door.state for door in old_grid.doors if door.state != "modelled"}
    if not old_states or old_grid.scene_id != new_grid.scene_id:
        return ""
    lost_states = {
        door.id: old_states[door.id]
        for door in new_grid.doors
        if door.state == "modelled" and door.id in old_states and door.like != old_states[door.id]
    }
    if not lost_states:
        return ""
    names = [f"{door_id} was {state}" for door_id, state in lost_states.items()]
    entries = [f"{door_id!r}: {state!r}" for door_id, state in lost_states.items()]
    more_text = ", …" if len(entries) > MAX_LISTED_DOORS else ""
    states_text = f"{{{', '.join(entries[:MAX_LISTED_DOORS])}{more_text}}}"
    if len({door.state for door in old_grid.doors}) == 1:  # one word sets them all
        states_text = repr(old_grid.doors[0].state)
    return (
        f"doors of {new_grid.scene_id!r} are as modelled in the finder's new grid: "
        f"{list_first(names, MAX_LISTED_DOORS)}. Set the states of the new grid, too: "
        f"finder.use(grid.with_doors({states_text}))"
    )


def _check_door_states(
    grid: GridBase, doors: Mapping[str, Door], states: Mapping[str, str]
) -> None:
    """Raise a QueryError for a door that does not exist, or a state that it can't have."""
    for name, state in states.items():
        if name not in doors:
            hint = suggest(name, sorted(doors))
            if any(link.name == name for link in grid.links):
                hint = "it is a link, whose state `with_links` or `--open` and `--close` set"
            raise QueryError(
                f"no door {name!r} in {grid.scene_id!r}: {hint}", key=name, value=state, hint=hint
            )
        if state not in DOOR_STATES:
            expected = f"one of {', '.join(DOOR_STATES)}"
            raise QueryError(
                f"expected {expected} for {name!r}, got {state!r}",
                key=name,
                value=state,
                expected=expected,
            )
        if state not in doors[name].states:
            possible_states = ", ".join(doors[name].states)
            raise QueryError(
                f"door {name!r} can't be {state}: it can be {possible_states}",
                key=name,
                value=state,
                expected=possible_states,
            )


def _mark_doors(
    doors: Sequence[Door], occupied_masks: list[Bool], solid_masks: list[Bool], *, is_blocked: bool
) -> None:
    """Set the cells that doors block in their current states to `is_blocked`.

    Args:
        doors: The doors.
        occupied_masks: For each level a mask by cell id, which changes: the cells that a door
            blocks.
        solid_masks: For each level a mask by cell id, which changes: the cells whose square a door
            overlaps.
        is_blocked: The value to set.
    """
    for door in doors:
        for level_number, cells in enumerate(door.cells_in(door.state, len(occupied_masks))):
            occupied_masks[level_number][cells] = is_blocked
        for level_number, cells in enumerate(door.solid_in(door.state, len(solid_masks))):
            solid_masks[level_number][cells] = is_blocked


def with_links(grid: AnyGrid, states: Mapping[str, str]) -> AnyGrid:
    """Return a grid with links opened or closed; see `GridBase.with_links`.

    Args:
        grid: The grid; the new one shares its arrays.
        states: Link name -> ``open`` or ``closed``.

    Raises:
        QueryError: A link or a state does not exist.
    """
    if not isinstance(states, Mapping):
        expected = "states by link, as {'A': 'closed'}"
        raise QueryError(
            f"expected {expected}, got {states!r}", key="states", value=states, expected=expected
        )
    link_names = [link.name for link in grid.links]
    for name, state in states.items():
        if name not in link_names:
            hint = suggest(name, link_names)
            if any(door.id == name for door in grid.doors):
                hint = "it is a door, whose state `with_doors` or `--doors NAME=STATE` sets"
            raise QueryError(
                f"no link {name!r} in {grid.scene_id!r}: {hint}", key=name, value=state, hint=hint
            )
        if state not in LINK_STATES:
            expected = f"one of {', '.join(LINK_STATES)}"
            raise QueryError(
                f"expected {expected} for {name!r}, got {state!r}",
                key=name,
                value=state,
                expected=expected,
            )
    link_table = []
    for entry in grid.navbake.get("links") or []:
        is_changed = isinstance(entry, dict) and entry["name"] in states
        link_table.append({**entry, "state": states[entry["name"]]} if is_changed else entry)
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "links": link_table}}
    changed_grid = grid.with_levels([level.with_layers() for level in grid.levels], metadata)
    renew_islands(changed_grid)
    return changed_grid


def with_door_names(
    user_data: UserData, doors: Sequence[Door], level: int, num_levels: int
) -> UserData:
    """Copy the user data of a level, with the names of doors for the doors' current states.

    ``doors`` of a cell's entry gets the ids of the doors that block the cell, either when closed or
    in their current state. ``objects`` gets those that block it in their current state.

    Args:
        user_data: The user data, which may still list doors for their former states.
        doors: All doors of the grid.
        level: Number of the level, 0 is the lowest.
        num_levels: Number of levels of the grid.
    """
    if not doors:
        return user_data  # without parsing it
    # all cells that a door blocks in any state: the user data may be from that state
    door_ids_by_cell: dict[int, set[str]] = {}
    # doors that block the cell in their current state
    blocking_ids_by_cell: dict[int, set[str]] = {}
    for door in doors:
        for state in door.cells:
            for cell in door.cells_in(state, num_levels)[level].tolist():
                door_ids = door_ids_by_cell.setdefault(cell, set())
                if state in ("closed", door.state):
                    door_ids.add(door.id)
                if state == door.state:
                    blocking_ids_by_cell.setdefault(cell, set()).add(door.id)
    all_door_ids = {door.id for door in doors}
    cells = np.fromiter(door_ids_by_cell, dtype=np.int64, count=len(door_ids_by_cell))
    new_entries: dict[int, Json] = {}
    for cell, entry in zip(door_ids_by_cell, user_data.find(cells), strict=True):
        new_entries[cell] = _with_door_ids(
            _without_doors(entry, all_door_ids),
            door_ids_by_cell[cell],
            blocking_ids_by_cell.get(cell, set()),
        )
    return user_data.with_entries(new_entries)


def _without_doors(entry: Json, door_ids: set[str]) -> Json:
    """Return a cell's user data without ``doors`` and ``blockers``, and with no door as object."""
    if "doors" not in entry:
        return entry
    entry_without_doors = {
        key: value for key, value in entry.items() if key not in ("doors", "blockers")
    }
    if isinstance(entry_without_doors.get("objects"), list):
        object_names = [
            name for name in names_in(entry_without_doors, "objects") if name not in door_ids
        ]
        entry_without_doors["objects"] = object_names
        if not object_names:
            del entry_without_doors["objects"]
    return entry_without_doors


def _with_door_ids(entry: Json, door_ids: set[str], blocking_ids: set[str]) -> Json:
    """Return a cell's user data with `door_ids` as doors, and `blocking_ids` as objects, too."""
    if not door_ids:
        return entry
    name_lists: Json = {"doors": sorted(door_ids)}
    object_names = sorted({*names_in(entry, "objects"), *blocking_ids})
    if object_names:
        name_lists["objects"] = object_names
    entry = {**name_lists, **{key: value for key, value in entry.items() if key not in name_lists}}
    # blockers are listed only where they aren't all that stands in the cell
    if blocking_ids and blocking_ids != {
        name for key in NAME_KEYS for name in names_in(entry, key)
    }:
        entry["blockers"] = sorted(blocking_ids)
    return entry


# ---------------------------------------------------------------- lines


class DoorLine(NamedTuple):
    """A door on a level as a line from jamb to jamb, along its closed leaf."""

    id: str  #: Id of the door.
    state: str  #: ``closed``, ``open``, ``removed``; else ``modelled``.
    start: tuple[float, float]  #: One end, world x, y [m].
    end: tuple[float, float]  #: The other end, world x, y [m].
    leaf_width: float | None = None  #: Width of the leaf's geometry [m]; None if unknown.

    @property
    def width(self) -> float:
        """Length of the line [m], which is that of the doorway to about a cell."""
        return math.dist(self.start, self.end)

    @property
    def middle(self) -> tuple[float, float]:
        """The middle of the line, world x, y [m]."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2


def find_door_lines(grid: NavGrid, level_number: int) -> tuple[DoorLine, ...]:
    """Find the doors of a level, each as a line from jamb to jamb; see `find_leaf_ends`.

    Args:
        grid: The grid.
        level_number: Number of the level, 0 is the lowest.
    """
    lines = []
    for door in grid.doors:
        ends = find_leaf_ends(grid, door, level_number)
        if ends is not None:
            lines.append(
                DoorLine(door.id, door.like or door.state, ends[0], ends[1], leaf_width=door.width)
            )
    return tuple(lines)


def name_doors(leaf_ids: Iterable[str]) -> dict[str, str]:
    """Name the doors that leaves belong to, as Open-RMF does.

    ``NAME_right`` and ``NAME_left`` are the two leaves of the door ``NAME``; any other leaf is a
    door by itself.

    Args:
        leaf_ids: Ids of doors of a grid, one for each leaf.

    Returns:
        Id of a leaf -> name of its door.
    """
    unique_ids = dict.fromkeys(leaf_ids)
    door_name_by_leaf = {}
    for leaf_id in unique_ids:
        door_name, _, side = leaf_id.rpartition("_")
        is_pair = (
            side in ("right", "left")
            and f"{door_name}_right" in unique_ids
            and f"{door_name}_left" in unique_ids
        )
        door_name_by_leaf[leaf_id] = door_name if is_pair else leaf_id
    return door_name_by_leaf


def mark_door_cells(grid: NavGrid, level_number: int, *, in_current_state: bool) -> Bool:
    """Mark the cells of a level that doors block.

    Args:
        grid: The grid.
        level_number: Number of the level, 0 is the lowest.
        in_current_state: Whether to mark the cells that doors block in their current states. If
            False, the cells that they block when closed; a door without the state ``closed`` is
            taken in its current one.

    Returns:
        Shape (height, width), bool.
    """
    is_door_cell = np.zeros(grid.levels[level_number].shape, dtype=np.bool_)
    for door in grid.doors:
        state = "closed" if "closed" in door.cells and not in_current_state else door.state
        is_door_cell.flat[door.cells_in(state, len(grid.levels))[level_number]] = True
    return is_door_cell


LineEnds = tuple[tuple[float, float], tuple[float, float]]
"""Both ends of a line, world x, y [m]."""


def find_leaf_ends(grid: NavGrid, door: Door, level_number: int) -> LineEnds | None:
    """Find the ends of a door's leaf on a level.

    The leaf is taken in the first state in which the grid has cells of it on the level: closed, the
    current state, then any other state.

    With a layer ``solid``, the cells of the leaf itself are known: the line follows their longer
    axis, from edge to edge. Without it, only the blocked cells are known. They may be deeper than
    the door is wide, so the line follows the axis with more obstacles at its ends, or else the
    longer axis. It is then longer by the agent's radius at each end.

    Args:
        grid: The grid.
        door: One of its doors.
        level_number: Number of the level, 0 is the lowest.

    Returns:
        The ends, or None if the door has no cells on the level.
    """
    level = grid.levels[level_number]
    num_levels = len(grid.levels)
    for state in ("closed", door.state, *door.states):
        leaf_cells = door.solid_in(state, num_levels)[level_number]
        has_leaf = len(leaf_cells) > 0
        cells = leaf_cells if has_leaf else door.cells_in(state, num_levels)[level_number]
        if len(cells):
            break
    else:
        return None
    cell_size = level.lattice.cell_size
    centers = level.lattice.positions(*np.divmod(cells, level.width))
    middle = centers.mean(axis=0)
    center_offsets = centers - middle
    # the longer principal axis: the eigenvector of the largest eigenvalue
    axis = _point_right(np.linalg.eigh(center_offsets.T @ center_offsets)[1][:, 1])
    if np.ptp(center_offsets @ axis) * np.abs(axis).min() < cell_size / 2:
        # within half a cell, it runs along a row or a column
        axis = np.round(axis) + 0.0
    extra_length = 0.0
    if not has_leaf:
        is_free = np.pad(level.free, 1)  # no cell outside the grid is free

        def count_obstacles(axis: Float) -> int:
            """Count at how many ends of the leaf the next cell is blocked, 0 to 2.

            Args:
                axis: Unit vector x, y along which the leaf is taken to run.
            """
            normal = _point_right(np.array([-axis[1], axis[0]]))
            positions_on_axis = centers @ axis
            normal_offset = np.median(centers @ normal) * normal
            end_positions_on_axis = np.array(
                [[positions_on_axis.min() - cell_size], [positions_on_axis.max() + cell_size]]
            )
            rows, cols = level.lattice.rows_cols(end_positions_on_axis * axis + normal_offset)
            rows = (rows + 1).clip(0, is_free.shape[0] - 1)
            cols = (cols + 1).clip(0, is_free.shape[1] - 1)
            return int(np.count_nonzero(~is_free[rows, cols]))

        shorter_axis = _point_right(np.array([-axis[1], axis[0]]))
        if count_obstacles(shorter_axis) > count_obstacles(axis):
            axis = shorter_axis
        extra_length = grid.agent_radius
    # to the outermost edges of the cells
    distances = center_offsets @ axis
    extra_length += cell_size / 2 / np.abs(axis).max()
    end_distances = np.array([[distances.min() - extra_length], [distances.max() + extra_length]])
    ends = (np.round(middle + end_distances * axis, DECIMALS) + 0.0).tolist()
    return (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])


def _point_right(axis: Float) -> Float:
    """Return the axis or its opposite: the one towards +x, or towards +y if both have x = 0."""
    return axis if tuple(axis) > (0.0, 0.0) else 0.0 - axis
