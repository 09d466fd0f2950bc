"""Checks a grid, without its scene, for faults that a person would notice.

This module has the checks of levels, boxes, steps, rooms, doors, the agent, named links and areas,
and the list of all checks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from os import PathLike

import numpy as np

from navbake.auditor import cells as cell_checks
from navbake.auditor.cells import find_differing_pairs
from navbake.auditor.facts import (
    ERROR,
    REMARK,
    AuditReport,
    Facts,
    Finding,
    Remark,
    find_wrong_sizes,
)
from navbake.errors import FormatError, count_of
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import describe_type
from navbake.lengths import format_length
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.rooms import Door
from navbake.types import Bool, Float, Int, Vector3

ALIGNMENT_TOLERANCE = 1e-3  # by which cells of two levels may be misaligned [cells]
BOX_SLACK = 1e-4  # by which a cell may lie outside its level's box [m]
MAX_SHARE_IN_LOWER_BOXES = 0.5  # share of a level's free cells that may lie in lower levels' boxes
DEFAULT_MAX_SLOPE = 45.0  # of ramps, if the grid states no other [degrees]
MAX_STEP_LENGTH = 1.5  # between the ends of a step, seen from above [cells]
AREA_TOLERANCE = 0.01  # share by which a room's area and that in its entry may differ
CENTER_TOLERANCE = 0.1  # distance of a room's centre from the one in its entry [cells]
MAX_STOREY_HEIGHT = 15.0  # of a storey with rooms; halls are lower, bar a few [m]
MIN_ROOM_AREA = 1.0  # floors with less area than this need no way out [m²]


def check_lattices(facts: Facts) -> Iterator[Finding]:
    """Find levels whose corner is not at finite coordinates, or whose cells have no size."""
    for level_number, level in enumerate(facts.levels):
        lattice = level.lattice
        if not 0 < lattice.cell_size < math.inf:
            text = f"its cells have a size of {lattice.cell_size:g} m"
            yield Finding(ERROR, level_number, None, text)
        if not all(map(math.isfinite, (lattice.x_min, lattice.y_max, level.ground))):
            yield Finding(ERROR, level_number, None, "its corner is at infinite or NaN coordinates")


def check_level_order(facts: Facts) -> Iterator[Finding]:
    """Find levels that are out of order, are not aligned with the lowest, or appear twice."""
    lowest_lattice = facts.levels[0].lattice
    for level_number, level in enumerate(facts.levels[1:], start=1):
        level_below = facts.levels[level_number - 1]
        lattice = level.lattice
        if level.ground < level_below.ground:
            text = f"its ground, {format_length(level.ground)} m, is below that of the level before"
            yield Finding(ERROR, level_number, None, text)
        col_offset = (lattice.x_min - lowest_lattice.x_min) / lowest_lattice.cell_size
        row_offset = (lowest_lattice.y_max - lattice.y_max) / lowest_lattice.cell_size
        misalignment = max(abs(col_offset - round(col_offset)), abs(row_offset - round(row_offset)))
        has_other_cell_size = abs(lattice.cell_size / lowest_lattice.cell_size - 1) > 1e-6
        if misalignment > ALIGNMENT_TOLERANCE or has_other_cell_size:
            text = f"its cells lie {misalignment:.3f} of a cell beside those of the lowest level"
            yield Finding(ERROR, level_number, None, text)
        has_same_floors = np.array_equal(
            facts.floors[level_number], facts.floors[level_number - 1], equal_nan=True
        )
        if has_same_floors and lattice == level_below.lattice:
            text = "its floors are those of the level before, cell by cell"
            yield Finding(ERROR, level_number, None, text)


def check_boxes(facts: Facts) -> Iterator[Finding]:
    """Find free cells of a level that lie outside of its box, or in the box of a lower level.

    The box (`bbox` in the file) is the range of x, y and z that belongs to the level.
    """
    boxes = [level.bbox_yup for level in facts.levels]
    for level_number, box_yup in enumerate(boxes):
        if box_yup is None:
            continue
        is_free = facts.free[level_number]
        floor_heights = facts.floors[level_number]
        is_outside = is_free & ~_mark_cells_in_box(facts, level_number, box_yup)
        for other_level_number, other_floor_heights in enumerate(facts.floors):
            # where levels interleave, no boxes are right
            heights_of_other_level = other_floor_heights[
                facts.free[other_level_number] & ~np.isnan(other_floor_heights)
            ]
            if (
                is_outside.any()
                and other_level_number != level_number
                and len(heights_of_other_level)
            ):
                is_outside &= ~(
                    (floor_heights >= heights_of_other_level.min())
                    & (floor_heights <= heights_of_other_level.max())
                )
        if is_outside.any():
            text = f"{int(is_outside.sum())} free cells lie outside of its box (`bbox`)"
            yield Finding(
                ERROR, level_number, facts.find_first_position(level_number, is_outside), text
            )
        is_in_lower_box = np.zeros_like(is_free)
        for lower_box in boxes[:level_number]:
            if lower_box is not None:
                is_in_lower_box |= is_free & _mark_cells_in_box(facts, level_number, lower_box)
        # where levels interleave, some cells have to lie in two boxes
        if level_number and is_in_lower_box.sum() > MAX_SHARE_IN_LOWER_BOXES * is_free.sum():
            num_cells = int(is_in_lower_box.sum())
            text = f"{num_cells} free cells lie in the box of a lower level, too"
            yield Finding(
                REMARK, level_number, facts.find_first_position(level_number, is_in_lower_box), text
            )


def check_storey_heights(facts: Facts) -> Iterator[Finding]:
    """Find levels with rooms whose box is so high that the scene is hardly in metres."""
    for level_number, level in enumerate(facts.levels):
        try:
            has_indoor_room = not all(room.outdoors for room in level.rooms)
        except FormatError:  # `check_room_table` says so
            return
        if level.bbox_yup is None or not has_indoor_room:
            continue
        height = (level.bbox_yup[1][1] - level.bbox_yup[0][1]) * level.unit
        if height > MAX_STOREY_HEIGHT:
            text = f"its storey is {format_length(height)} m high: is the unit right?"
            yield Finding(REMARK, level_number, None, text)


def _mark_cells_in_box(
    facts: Facts, level_number: int, box_yup: tuple[tuple[float, ...], ...]
) -> Bool:
    """Mark the cells of a level whose centres, on the floor, are in a box of the file (y up)."""
    level = facts.levels[level_number]
    floor = facts.floors[level_number]
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    z = np.where(np.isnan(floor), level.ground, floor)
    centers_yup = np.stack([x, z, -y], axis=-1)
    low_corner, high_corner = np.array(box_yup) * level.unit
    slack = np.array([BOX_SLACK, 1e-6, BOX_SLACK])
    is_inside = (centers_yup >= low_corner - slack) & (centers_yup <= high_corner + slack)
    return np.asarray(is_inside.all(axis=-1))


def check_steps(facts: Facts) -> Iterator[Finding]:
    """Find steps to cells that don't exist, have no floor, are too far away, or too high."""
    steps = facts.grid.step_array
    start_positions = _find_step_positions(facts, steps[:, :2])
    end_positions = _find_step_positions(facts, steps[:, 2:])
    max_rise = _find_max_step_rise(facts)
    rises = np.abs(start_positions - end_positions)[:, 2]
    lengths = np.hypot(*(start_positions - end_positions)[:, :2].T)
    is_too_far = lengths > MAX_STEP_LENGTH * facts.levels[0].lattice.cell_size
    for is_wrong, destination in (
        (np.isnan(rises), "to cells without a floor"),
        (is_too_far, "to cells that aren't neighbours"),
        (rises > max_rise, f"up by more than {max_rise:.2f} m"),
    ):
        if not is_wrong.any():
            continue
        worst_step = int(np.nanargmax(np.where(is_wrong, np.nan_to_num(rises), -1.0)))
        x, y, z = start_positions[worst_step].tolist()
        level_number = int(steps[worst_step, 0])
        if np.isnan(z):
            z = facts.levels[level_number].ground
        num_wrong = int(is_wrong.sum())
        text = f"{count_of(num_wrong, 'link')} lead{'s' if num_wrong == 1 else ''} {destination}"
        if destination.startswith("up"):
            text += f": {rises[worst_step]:.2f} m"
        yield Finding(ERROR, level_number, (x, y, z), text)


def _find_step_positions(facts: Facts, level_cells: Int) -> Float:
    """Return world x, y and floor z [m] of cells.

    Args:
        facts: the facts about the grid.
        level_cells: level and cell id of each cell, shape (n, 2).

    Returns:
        The positions, shape (n, 3); z is NaN for a cell without a floor.
    """
    positions = np.full((len(level_cells), 3), np.nan)
    level_of_cell, cell_ids = level_cells.T
    for level_number, level_grid in enumerate(facts.levels):
        is_on_level = level_of_cell == level_number
        rows, cols = np.divmod(cell_ids[is_on_level], level_grid.width)
        positions[is_on_level, :2] = level_grid.lattice.positions(rows, cols).reshape(-1, 2)
        positions[is_on_level, 2] = facts.floors[level_number][rows, cols]
    return positions


def _find_max_step_rise(facts: Facts) -> float:
    """Return how far a step of `step_array` may lead up or down [m].

    It is the agent's highest step; or its sum with the rise of the steepest ramp over a cell, if
    that rise is larger: a bake lists the steps of steep ramps.
    """
    baked_slope = facts.grid.navbake.get("maxSlope")
    max_slope = DEFAULT_MAX_SLOPE
    if (
        isinstance(baked_slope, int | float)
        and not isinstance(baked_slope, bool)
        and 0 <= baked_slope < 90
    ):
        max_slope = baked_slope
    ramp_rise = facts.levels[0].lattice.cell_size * math.tan(math.radians(max_slope))
    return facts.step_limit + (ramp_rise if ramp_rise > facts.step_limit else 0.0)


def check_missing_steps(facts: Facts) -> Iterator[Finding]:
    """Find neighbouring free cells of two levels that no step joins, though their heights allow it.

    They are reported only where nothing else connects the islands of both cells.
    """
    if not facts.grid.navbake:
        return  # files of other programs know no links
    for lower_level, upper_level in itertools.combinations(range(len(facts.levels)), 2):
        rows, cols = np.nonzero(facts.free[upper_level])
        is_unlinked = _mark_unlinked(facts, lower_level, upper_level, rows, cols)
        if is_unlinked.any():
            first_index = int(np.argmax(is_unlinked))
            num_unlinked = int(is_unlinked.sum())
            verb = "has" if num_unlinked == 1 else "have"
            cells_text = count_of(num_unlinked, "free cell")
            text = f"{cells_text} a step away from level {lower_level} {verb} no link to it, "
            text += "and nothing else leads there"
            place = facts.find_position(upper_level, int(rows[first_index]), int(cols[first_index]))
            yield Finding(ERROR, upper_level, place, text)


def _mark_unlinked(facts: Facts, lower_level: int, upper_level: int, rows: Int, cols: Int) -> Bool:
    """Mark cells of the upper level that lack a connection to the lower level.

    These cells are next to a free cell of the lower level, at most a step apart in height, and on
    another island.

    Args:
        facts: the facts about the grid.
        lower_level: the index of the lower level.
        upper_level: the index of the upper level.
        rows: the rows of free cells of the upper level, shape (n,).
        cols: their columns, shape (n,).

    Returns:
        A mask of these cells, shape (n,).
    """
    lattice = facts.levels[lower_level].lattice
    positions = facts.levels[upper_level].lattice.positions(rows, cols)
    lower_rows, lower_cols = lattice.rows_cols(positions)
    is_unlinked = np.zeros(len(rows), dtype=np.bool_)
    for row_offset, col_offset in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        row = lower_rows + row_offset
        col = lower_cols + col_offset
        is_inside = lattice.holds(row, col)
        row = np.where(is_inside, row, 0)
        col = np.where(is_inside, col, 0)
        rises = np.abs(facts.floors[lower_level][row, col] - facts.floors[upper_level][rows, cols])
        is_walkable = is_inside & facts.free[lower_level][row, col] & (rises <= facts.step_limit)
        is_unlinked |= is_walkable & (
            facts.islands[lower_level][row, col] != facts.islands[upper_level][rows, cols]
        )
    return is_unlinked


def check_agent(facts: Facts) -> Iterator[Finding]:
    """Find impossible sizes of the agent, and sizes that differ from the bake's settings.

    A step that is at least as high as the agent is impossible. A step lower than that of the
    settings is no fault, see `Facts.has_lower_step`.
    """
    grid = facts.grid
    agent_settings = facts.settings.get("agent", {})
    problems = find_wrong_sizes(grid)
    for key, stated_size, setting_name, default_size in (
        ("agentHeight", grid.agent_height, "height", 1.14),
        ("agentRadius", grid.agent_radius, "radius", 0.05),
        ("traversableFloorHeight", grid.max_step, "traversable_floor_height", 0.25),
    ):
        if key in problems:
            yield Finding(ERROR, None, None, f"{problems[key]}: it counts as {stated_size:g} m")
            continue
        if not facts.settings or not isinstance(agent_settings, dict):
            continue
        baked_size = agent_settings.get(setting_name, default_size)
        if key == "traversableFloorHeight" and facts.has_lower_step:
            continue
        if type(baked_size) in (int, float) and not math.isclose(stated_size, baked_size):
            stated_text = f"`{key}` is {stated_size:g} m"
            text = f"{stated_text}, but its settings say that it was baked for {baked_size:g} m"
            yield Finding(ERROR, None, None, text)
    if "step" in problems:
        yield Finding(ERROR, None, None, problems["step"])
    if grid.agent_radius > 5:
        text = f"the agent has a radius of {grid.agent_radius:g} m: is the unit right?"
        yield Finding(REMARK, None, None, text)


def check_room_table(facts: Facts) -> Iterator[Finding]:
    """Find contradictions between the table of rooms and the rooms of the cells."""
    room_table = facts.grid.stated_rooms
    if room_table is None:
        return
    described_room_keys = {(room.level, room.index) for room in room_table}
    for level_number, level in enumerate(facts.levels):
        num_cells = np.bincount(level.room_index.ravel())
        centers = find_room_centers(level)
        for room_number in centers:
            if (level_number, room_number) not in described_room_keys:
                text = f"{num_cells[room_number]} cells are in room {room_number}"
                text += ", which no entry describes"
                place = facts.find_first_position(level_number, level.room_index == room_number)
                yield Finding(ERROR, level_number, place, text)
        for room in room_table:
            if room.level != level_number:
                continue
            name = repr(room.name or room.id)
            center = centers.get(room.index)
            if center is None:
                yield Finding(ERROR, level_number, room.centroid, f"room {name} has no cells")
                continue
            area = num_cells[room.index] * level.lattice.cell_size**2
            num_axes = 3 if level.uses_cell_floors else 2  # else its z isn't that of the floors
            center_distance = math.dist(center[:num_axes], room.centroid[:num_axes])
            if abs(area - room.area) > AREA_TOLERANCE * max(area, room.area):
                text = f"room {name} has {area:.2f} m², not {room.area:.2f}"
                yield Finding(ERROR, level_number, room.centroid, text)
            elif center_distance > CENTER_TOLERANCE * level.lattice.cell_size:
                text = f"room {name} lies {center_distance:.2f} m from where its entry says"
                yield Finding(ERROR, level_number, center, text)


def find_room_centers(level: SceneGrid2D) -> dict[int, Vector3]:
    """Return the mean position of the cells of each room.

    Args:
        level: a level of a grid.

    Returns:
        Index of a room -> world x, y, z [m], rounded to micrometres as in the table of rooms.
    """
    room_indices, room_of_cell, num_cells = np.unique(
        level.room_index, return_inverse=True, return_counts=True
    )
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    z = np.where(np.isnan(level.floor), level.ground, level.floor)
    mean_coordinates = [
        np.bincount(room_of_cell.ravel(), axis.ravel()) / num_cells for axis in (x, y, z)
    ]
    centers = (np.round(mean_coordinates, 6) + 0.0).T.tolist()  # no -0.0
    return {
        room: (center[0], center[1], center[2])
        for room, center in zip(room_indices.tolist(), centers, strict=True)
        if room
    }


def check_rooms_without_way_out(facts: Facts) -> Iterator[Finding]:
    """Find rooms that nothing leads out of, even with all doors open."""
    name_of_room = {(room.level, room.index): room.name or room.id for room in facts.rooms or ()}
    for level_number, level in enumerate(facts.levels):
        room_layer = level.room_index
        is_passable = facts.passable[level_number]
        has_exit = np.zeros(int(room_layer.max()) + 1, dtype=np.bool_)
        num_cells = np.bincount(room_layer[is_passable], minlength=len(has_exit))
        if np.count_nonzero(num_cells) < 2:
            continue  # there is nothing to lead to
        # cells connect if they are at most a step apart, or if a step of `step_array` joins them
        room_of_cell = room_layer.ravel()
        is_passable_cell = is_passable.ravel()
        floor = facts.floors[level_number].ravel()
        for cells, id_offset in find_differing_pairs(room_layer, 1):
            neighbors = cells + id_offset
            with np.errstate(invalid="ignore"):
                is_connected = ~(np.abs(floor[cells] - floor[neighbors]) > facts.step_limit)
            is_connected &= is_passable_cell[cells] & is_passable_cell[neighbors]
            has_exit[room_of_cell[cells[is_connected]]] = True
            has_exit[room_of_cell[neighbors[is_connected]]] = True
        for step_ends in (facts.steps[:, :2], facts.steps[:, 2:]):
            has_exit[room_of_cell[step_ends[step_ends[:, 0] == level_number, 1]]] = True
        room_areas = num_cells * level.lattice.cell_size**2
        for room_number in np.flatnonzero(~has_exit & (room_areas >= MIN_ROOM_AREA)).tolist():
            if room_number:
                name = (
                    repr(name_of_room[level_number, room_number])
                    if (level_number, room_number) in name_of_room
                    else str(room_number)
                )
                text = f"nothing leads out of room {name} ({room_areas[room_number]:.1f} m²)"
                place = facts.find_first_position(
                    level_number, (room_layer == room_number) & is_passable
                )
                yield Finding(REMARK, level_number, place, text)


def check_doors(facts: Facts) -> Iterator[Finding]:
    """Find doors between a room and itself, doors of missing rooms, and wrong cells of doors.

    A door's cells are wrong where their occupancy contradicts the door's state.
    """
    room_ids = None if facts.rooms is None else {room.id for room in facts.rooms}
    doors = facts.grid.doors
    door_cells = facts.mark_door_cells([(door, door.state) for door in doors])
    for door in doors:
        level, place = _find_door_middle(facts, door)
        rooms = [room for room in door.rooms if room is not None]
        if len(rooms) == 2 and rooms[0] == rooms[1]:
            text = f"door {door.id!r} joins room {rooms[0]!r} to itself"
            yield Finding(REMARK, level, place, text)
        if room_ids is not None:
            for room in sorted(set(rooms) - room_ids):
                text = f"door {door.id!r} joins room {room!r}, which there isn't"
                yield Finding(ERROR, level, place, text)
        num_unoccupied, num_occupied = _count_wrong_cells(facts, door, door_cells)
        state = "stands as modelled" if door.state == "modelled" else f"is {door.state}"
        if num_unoccupied:
            text = f"door {door.id!r} {state}, but {num_unoccupied} of its cells aren't occupied"
            yield Finding(ERROR, level, place, text)
        if num_occupied:
            verb = "is" if num_occupied == 1 else "are"
            occupied_text = f"{count_of(num_occupied, 'cell')} {verb}"
            text = f"door {door.id!r} {state}, but {occupied_text} occupied"
            text += " that it blocks in other states only"
            yield Finding(ERROR, level, place, text)


def _find_door_middle(facts: Facts, door: Door) -> tuple[int | None, Vector3 | None]:
    """Return the level and the position of a door; both are None if it has no cells.

    The position is the middle one of the door's cells, in the first state in which it has any.
    """
    for state in door.cells:
        for level_number, door_cells in enumerate(door.cells_in(state, len(facts.levels))):
            if len(door_cells):
                middle_cell = int(door_cells[len(door_cells) // 2])
                row, col = divmod(middle_cell, facts.levels[level_number].width)
                return level_number, facts.find_position(level_number, row, col)
    return None, None


def _count_wrong_cells(facts: Facts, door: Door, door_cells: list[Bool]) -> tuple[int, int]:
    """Count the cells whose occupancy contradicts a door's state.

    A door's table has only cells that nothing else blocks, except other doors. So a cell that it
    blocks only in other states must not be occupied, unless another door blocks it.

    Args:
        facts: the facts about the grid.
        door: the door.
        door_cells: for each level, a mask of the cells that any door blocks in its state.

    Returns:
        The number of cells that the door should block but that are not occupied, and the number of
        cells that it blocks only in other states but that are occupied.
    """
    num_levels = len(facts.levels)
    cells_by_state = [door.cells_in(state, num_levels) for state in door.cells]
    cells_by_level_in_state = door.cells_in(door.state, num_levels)
    num_unoccupied = 0
    num_occupied = 0
    for level_number, level in enumerate(facts.levels):
        is_occupied = level.occupancy.ravel() != 0
        cells_in_state = cells_by_level_in_state[level_number]
        cells_of_any_state = np.concatenate(
            [cells_by_level[level_number] for cells_by_level in cells_by_state]
        )
        cells_in_other_states = np.setdiff1d(cells_of_any_state, cells_in_state)
        is_door_cell = door_cells[level_number].ravel()[cells_in_other_states]
        cells_in_other_states = cells_in_other_states[~is_door_cell]
        num_unoccupied += int(np.count_nonzero(~is_occupied[cells_in_state]))
        num_occupied += int(np.count_nonzero(is_occupied[cells_in_other_states]))
    return num_unoccupied, num_occupied


def check_named_links(facts: Facts) -> Iterator[Finding]:
    """Find links with blocked stops, stops in dead spots, and lifts within one level.

    A dead spot is a small piece of floor that only this link leads to. Links for agents that the
    grid doesn't list are found, too.
    """
    links = facts.grid.links
    agents = facts.grid.agents
    islands = facts.islands_without_links if links else []
    num_cells = np.bincount(
        np.concatenate([[0], *(island_number.ravel() for island_number in islands)])
    )
    island_areas = num_cells * facts.levels[0].lattice.cell_size ** 2
    for link in links:
        link_text = f"{link.kind} {link.name!r}"
        for stop in link.stops:
            row, col = divmod(stop.cell, facts.levels[stop.level].width)
            place = facts.find_position(stop.level, row, col)
            island_number = int(islands[stop.level][row, col])
            if not facts.free[stop.level][row, col]:
                is_door = bool(facts.passable[stop.level][row, col])
                may_be_meant = is_door or facts.inflation_reach is not None
                problem = "a door blocks" if is_door else "blocked is"
                severity = REMARK if may_be_meant else ERROR
                yield Finding(severity, stop.level, place, f"{problem} a stop of {link_text}")
            elif island_areas[island_number] < MIN_ROOM_AREA:
                text = f"{link_text} leads to {island_areas[island_number]:.2f} m² of floor"
                text += ", and nothing else does"
                yield Finding(REMARK, stop.level, place, text)
        if link.kind == "lift" and len({stop.level for stop in link.stops}) == 1:
            first_stop = link.stops[0]
            text = f"all {count_of(len(link.stops), 'stop')} of {link_text} are on one level"
            yield Finding(REMARK, first_stop.level, first_stop.position, text)
        for name in sorted(set(link.agents or ()) - set(agents)):
            text = f"{link_text} is for agent {name!r}, whom the grid doesn't list"
            yield Finding(ERROR, None, None, text)


def check_areas(facts: Facts) -> Iterator[Finding]:
    """Find areas without cells, areas for unknown agents, and cells of unlisted areas."""
    areas = facts.grid.areas
    agents = facts.grid.agents
    if not areas:
        return
    num_cells = np.zeros(256, dtype=np.int64)
    for level_number, level in enumerate(facts.levels):
        area_layer = level.attributes.get("area", np.zeros(1, dtype=np.uint8))
        is_unlisted = (area_layer < 0) | (area_layer > len(areas))
        text = "in an area that the table doesn't list"
        yield from facts.report_wrong_cells(level_number, is_unlisted, text)
        num_cells += np.bincount(level.area_index.ravel(), minlength=256)
    for area_number, area in enumerate(areas, 1):
        if not num_cells[area_number]:
            text = f"area {area.name!r} covers no cell of any level"
            yield Finding(REMARK, None, None, text)
        for name in sorted(set(area.agents or ()) - set(agents)):
            text = f"area {area.name!r} is for agent {name!r}, whom the grid doesn't list"
            yield Finding(ERROR, None, None, text)


CHECKS: dict[str, tuple[str, Callable[[Facts], Iterator[Finding]]]] = {
    "all cells are free": ("all free", cell_checks.check_all_free),
    "a level is empty or all blocked": ("empty level", cell_checks.check_empty_levels),
    "hardly any cell is free": ("hardly free", cell_checks.check_free_share),
    "weights contradict occupancy": ("weights", cell_checks.check_weights),
    "an inflation can't be read": ("inflation", cell_checks.check_inflation),
    "a free cell has no floor": ("floors", cell_checks.check_floors),
    "the floor jumps": ("jumps", cell_checks.check_jumps),
    "stored layers are wrong": ("layers", cell_checks.check_layers),
    "one cell cuts off an island": ("cut off", cell_checks.check_cut_off),
    "no link reaches a level": ("unreached", cell_checks.check_unreached_levels),
    "the room table contradicts the cells": ("room table", check_room_table),
    "nothing leads out of a room": ("no way out", check_rooms_without_way_out),
    "a door joins what it can't": ("doors", check_doors),
    "cells have no size, or no place": ("lattices", check_lattices),
    "levels are out of order": ("levels", check_level_order),
    "boxes exclude their own cells": ("boxes", check_boxes),
    "a storey is very high": ("storey", check_storey_heights),
    "links lead nowhere": ("links", check_steps),
    "links are missing": ("no link", check_missing_steps),
    "a link stops where it can't": ("named links", check_named_links),
    "an area is nowhere": ("areas", check_areas),
    "the agent can't be": ("agent", check_agent),
}
"""What a check looks for -> the `check` of its remarks, and its function."""


def run_check(
    check_function: Callable[[Facts], Iterator[Finding]], facts: Facts
) -> Iterator[Finding]:
    """Run a check; metadata that it cannot read are reported as an error.

    Args:
        check_function: one of the functions of `CHECKS`.
        facts: the facts about the grid.

    Yields:
        The findings of the check. If it raises a FormatError, the last finding is that error.
    """
    try:
        yield from check_function(facts)
    except FormatError as error:
        yield Finding(ERROR, None, None, str(error))


def audit(grid: NavGrid | str | PathLike[str]) -> AuditReport:
    """Check a grid of any program for faults that a person would notice.

    Args:
        grid: the grid, or the path of its file.

    Returns:
        The remarks, errors first; the report is `ok` without errors.

    Raises:
        FormatError: `grid` is neither a grid nor a path, or the file can't be read.

    Example:
        >>> report = navbake.audit("house.grid.json")
        >>> for remark in report.remarks:
        ...     print(remark)
    """
    if isinstance(grid, GridBase):
        nav_grid: GridBase = grid
    elif isinstance(grid, str | PathLike):
        nav_grid = read_navgrid(grid)
    else:
        raise FormatError(f"expected a grid or the path of its file, got {describe_type(grid)}")
    facts = Facts(nav_grid)
    remarks = []
    for name, check in CHECKS.values():
        for finding in run_check(check, facts):
            place = finding.place
            if place is not None and not all(map(math.isfinite, place)):
                place = None  # the grid's corner may have infinite coordinates
            remarks.append(Remark(name, finding.severity, finding.level, place, finding.text))
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(nav_grid.scene_id, remarks, [name for name, _ in CHECKS.values()])
