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
from navbake.auditor.cells import pairs_across
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
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.rooms import Door
from navbake.types import Bool, Float, Int, Vector3

ALIGNMENT_TOLERANCE = 1e-3  # by which cells of two levels may be misaligned [cells]
BOX_SLACK = 1e-4  # by which a cell may lie outside its level's box [m]
MAX_IN_LOWER_BOXES = 0.5  # share of a level's free cells that may lie in lower levels' boxes
DEFAULT_MAX_SLOPE = 45.0  # of ramps, if the grid states no other [degrees]
MAX_LINK_LENGTH = 1.5  # between the ends of a step, seen from above [cells]
AREA_TOLERANCE = 0.01  # share by which a room's area and that in its entry may differ
CENTER_TOLERANCE = 0.1  # distance of a room's centre from the one in its entry [cells]
MIN_ROOM_AREA = 1.0  # floors with less area than this need no way out [m²]


def check_lattices(facts: Facts) -> Iterator[Finding]:
    """Finds: levels whose corner is not at finite coordinates, or whose cells have no size."""
    for number, level in enumerate(facts.levels):
        lattice = level.lattice
        if not 0 < lattice.cell_size < math.inf:
            text = f"its cells have a size of {lattice.cell_size:g} m"
            yield Finding(ERROR, number, None, text)
        if not all(map(math.isfinite, (lattice.x_min, lattice.y_max, level.ground))):
            yield Finding(ERROR, number, None, "its corner is at no place")


def check_order(facts: Facts) -> Iterator[Finding]:
    """Finds: levels that are out of order, are not aligned with the lowest, or appear twice."""
    first = facts.levels[0].lattice
    for number, level in enumerate(facts.levels[1:], start=1):
        below = facts.levels[number - 1]
        lattice = level.lattice
        if level.ground < below.ground:
            text = f"its ground, {level.ground:.2f} m, is below that of the level before"
            yield Finding(ERROR, number, None, text)
        num_cols = (lattice.x_min - first.x_min) / first.cell_size
        num_rows = (first.y_max - lattice.y_max) / first.cell_size
        offset = max(abs(num_cols - round(num_cols)), abs(num_rows - round(num_rows)))
        size_differs = abs(lattice.cell_size / first.cell_size - 1) > 1e-6
        if offset > ALIGNMENT_TOLERANCE or size_differs:
            text = f"its cells lie {offset:.3f} of a cell beside those of the lowest level"
            yield Finding(ERROR, number, None, text)
        has_floors_of_below = np.array_equal(
            facts.floors[number], facts.floors[number - 1], equal_nan=True
        )
        if has_floors_of_below and lattice == below.lattice:
            text = "its floors are those of the level before, cell by cell"
            yield Finding(ERROR, number, None, text)


def check_boxes(facts: Facts) -> Iterator[Finding]:
    """Finds: free cells of a level that lie outside of its box, or in the box of a lower level."""
    boxes = [level.bbox_yup for level in facts.levels]
    for number, box in enumerate(boxes):
        if box is None:
            continue
        free = facts.free[number]
        floor = facts.floors[number]
        outside = free & ~_in_box(facts, number, box)
        for other_number, other_floor in enumerate(facts.floors):
            # where levels interleave, no boxes are right
            heights = other_floor[facts.free[other_number] & ~np.isnan(other_floor)]
            if outside.any() and other_number != number and len(heights):
                outside &= ~((floor >= heights.min()) & (floor <= heights.max()))
        if outside.any():
            text = f"{int(outside.sum())} free cells lie outside of its box (`bbox`)"
            yield Finding(ERROR, number, facts.first_place(number, outside), text)
        in_lower_boxes = np.zeros_like(free)
        for lower_box in boxes[:number]:
            if lower_box is not None:
                in_lower_boxes |= free & _in_box(facts, number, lower_box)
        # where levels interleave, some cells have to lie in two boxes
        if number and in_lower_boxes.sum() > MAX_IN_LOWER_BOXES * free.sum():
            count = int(in_lower_boxes.sum())
            text = f"{count} free cells lie in the box of a lower level, too"
            yield Finding(REMARK, number, facts.first_place(number, in_lower_boxes), text)


def _in_box(facts: Facts, number: int, box: tuple[tuple[float, ...], ...]) -> Bool:
    """Mark the cells of a level whose centres, on the floor, are in a box of the file (y up)."""
    level = facts.levels[number]
    floor = facts.floors[number]
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    z = np.where(np.isnan(floor), level.ground, floor)
    centers_yup = np.stack([x, z, -y], axis=-1)
    low, high = np.array(box) * level.unit
    slack = np.array([BOX_SLACK, 1e-6, BOX_SLACK])
    is_inside = (centers_yup >= low - slack) & (centers_yup <= high + slack)
    return np.asarray(is_inside.all(axis=-1))


def check_links(facts: Facts) -> Iterator[Finding]:
    """Finds: steps to cells that don't exist, have no floor, are too far away, or too high."""
    links = facts.grid.step_array
    starts = _link_ends(facts, links[:, :2])
    ends = _link_ends(facts, links[:, 2:])
    limit = _max_link_rise(facts)
    rise = np.abs(starts - ends)[:, 2]
    length = np.hypot(*(starts - ends)[:, :2].T)
    is_far = length > MAX_LINK_LENGTH * facts.levels[0].lattice.cell_size
    for is_wrong, destination in (
        (np.isnan(rise), "to cells without a floor"),
        (is_far, "to cells that aren't neighbours"),
        (rise > limit, f"up by more than {limit:.2f} m"),
    ):
        if not is_wrong.any():
            continue
        worst = int(np.nanargmax(np.where(is_wrong, np.nan_to_num(rise), -1.0)))
        x, y, z = starts[worst].tolist()
        number = int(links[worst, 0])
        if np.isnan(z):
            z = facts.levels[number].ground
        count = int(is_wrong.sum())
        text = f"{count_of(count, 'link')} lead{'s' if count == 1 else ''} {destination}"
        if destination.startswith("up"):
            text += f": {rise[worst]:.2f} m"
        yield Finding(ERROR, number, (x, y, z), text)


def _link_ends(facts: Facts, level_cells: Int) -> Float:
    """Return world x, y and floor z [m] of cells.

    Args:
        facts: the facts about the grid.
        level_cells: level and cell id of each cell, shape (n, 2).

    Returns:
        The positions, shape (n, 3); z is NaN for a cell without a floor.
    """
    positions = np.full((len(level_cells), 3), np.nan)
    level, cell = level_cells.T
    for number, grid in enumerate(facts.levels):
        on_level = level == number
        rows, cols = np.divmod(cell[on_level], grid.width)
        positions[on_level, :2] = grid.lattice.positions(rows, cols).reshape(-1, 2)
        positions[on_level, 2] = facts.floors[number][rows, cols]
    return positions


def _max_link_rise(facts: Facts) -> float:
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
    ramp = facts.levels[0].lattice.cell_size * math.tan(math.radians(max_slope))
    return facts.step_limit + (ramp if ramp > facts.step_limit else 0.0)


def check_missing_links(facts: Facts) -> Iterator[Finding]:
    """Finds: neighbouring free cells of two levels, a step apart in height, that no step joins.

    They are reported only where nothing else connects the islands of both cells.
    """
    if not facts.grid.navbake:
        return  # files of other programs know no links
    for lower, upper in itertools.combinations(range(len(facts.levels)), 2):
        rows, cols = np.nonzero(facts.free[upper])
        unlinked = _mark_unlinked(facts, lower, upper, rows, cols)
        if unlinked.any():
            first = int(np.argmax(unlinked))
            count = int(unlinked.sum())
            verb = "has" if count == 1 else "have"
            cells = count_of(count, "free cell")
            text = f"{cells} a step away from level {lower} {verb} no link to it, "
            text += "and nothing else leads there"
            place = facts.place(upper, int(rows[first]), int(cols[first]))
            yield Finding(ERROR, upper, place, text)


def _mark_unlinked(facts: Facts, lower: int, upper: int, rows: Int, cols: Int) -> Bool:
    """Mark cells of the upper level that lack a connection to the lower level.

    These cells are next to a free cell of the lower level, at most a step apart in height, and on
    another island.

    Args:
        facts: the facts about the grid.
        lower: the index of the lower level.
        upper: the index of the upper level.
        rows: the rows of free cells of the upper level, shape (n,).
        cols: their columns, shape (n,).

    Returns:
        A mask of these cells, shape (n,).
    """
    lattice = facts.levels[lower].lattice
    positions = facts.levels[upper].lattice.positions(rows, cols)
    lower_rows, lower_cols = lattice.rows_cols(positions)
    unlinked = np.zeros(len(rows), dtype=np.bool_)
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        row = lower_rows + down
        col = lower_cols + right
        inside = lattice.holds(row, col)
        row = np.where(inside, row, 0)
        col = np.where(inside, col, 0)
        rise = np.abs(facts.floors[lower][row, col] - facts.floors[upper][rows, cols])
        is_walk = inside & facts.free[lower][row, col] & (rise <= facts.step_limit)
        unlinked |= is_walk & (facts.islands[lower][row, col] != facts.islands[upper][rows, cols])
    return unlinked


def check_agent(facts: Facts) -> Iterator[Finding]:
    """Finds: impossible sizes of the agent, and sizes that differ from the bake's settings.

    A step that is at least as high as the agent is impossible.
    """
    grid = facts.grid
    agent_settings = facts.settings.get("agent", {})
    problems = find_wrong_sizes(grid)
    for key, size, name, default in (
        ("agentHeight", grid.agent_height, "height", 1.14),
        ("agentRadius", grid.agent_radius, "radius", 0.05),
        ("traversableFloorHeight", grid.max_step, "traversable_floor_height", 0.25),
    ):
        if key in problems:
            yield Finding(ERROR, None, None, f"{problems[key]}: it counts as {size:g} m")
            continue
        if not facts.settings or not isinstance(agent_settings, dict):
            continue
        baked = agent_settings.get(name, default)
        if type(baked) in (int, float) and not math.isclose(size, baked):
            text = f"`{key}` is {size:g} m, but its settings say that it was baked for {baked:g} m"
            yield Finding(ERROR, None, None, text)
    if "step" in problems:
        yield Finding(ERROR, None, None, problems["step"])
    if grid.agent_radius > 5:
        text = f"the agent has a radius of {grid.agent_radius:g} m: is the unit right?"
        yield Finding(REMARK, None, None, text)


def check_room_table(facts: Facts) -> Iterator[Finding]:
    """Finds: contradictions between the table of rooms and the rooms of the cells."""
    table = facts.grid.stated_rooms
    if table is None:
        return
    described = {(room.level, room.index) for room in table}
    for number, level in enumerate(facts.levels):
        num_cells = np.bincount(level.room_index.ravel())
        centers = find_room_centers(level)
        for index in centers:
            if (number, index) not in described:
                text = f"{num_cells[index]} cells are in room {index}, which no entry describes"
                place = facts.first_place(number, level.room_index == index)
                yield Finding(ERROR, number, place, text)
        for room in table:
            if room.level != number:
                continue
            name = repr(room.name or room.id)
            center = centers.get(room.index)
            if center is None:
                yield Finding(ERROR, number, room.centroid, f"room {name} has no cells")
                continue
            area = num_cells[room.index] * level.lattice.cell_size**2
            num_axes = 3 if level.uses_cell_floors else 2  # else its z isn't that of the floors
            offset = math.dist(center[:num_axes], room.centroid[:num_axes])
            if abs(area - room.area) > AREA_TOLERANCE * max(area, room.area):
                text = f"room {name} has {area:.2f} m², not {room.area:.2f}"
                yield Finding(ERROR, number, room.centroid, text)
            elif offset > CENTER_TOLERANCE * level.lattice.cell_size:
                text = f"room {name} lies {offset:.2f} m from where its entry says"
                yield Finding(ERROR, number, center, text)


def find_room_centers(level: SceneGrid2D) -> dict[int, Vector3]:
    """Return the mean position of the cells of each room.

    Args:
        level: a level of a grid.

    Returns:
        Index of a room -> world x, y, z [m], rounded to micrometres as in the table of rooms.
    """
    rooms, room_of_cell, num_cells = np.unique(
        level.room_index, return_inverse=True, return_counts=True
    )
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    z = np.where(np.isnan(level.floor), level.ground, level.floor)
    means = [np.bincount(room_of_cell.ravel(), axis.ravel()) / num_cells for axis in (x, y, z)]
    centers = (np.round(means, 6) + 0.0).T.tolist()  # no -0.0
    return {
        room: (center[0], center[1], center[2])
        for room, center in zip(rooms.tolist(), centers, strict=True)
        if room
    }


def check_rooms_without_way_out(facts: Facts) -> Iterator[Finding]:
    """Finds: rooms that nothing leads out of, even with all doors open."""
    names = {(room.level, room.index): room.name or room.id for room in facts.rooms or ()}
    for number, level in enumerate(facts.levels):
        room_index = level.room_index
        passable = facts.passable[number]
        has_exit = np.zeros(int(room_index.max()) + 1, dtype=np.bool_)
        num_cells = np.bincount(room_index[passable], minlength=len(has_exit))
        if np.count_nonzero(num_cells) < 2:
            continue  # there is nothing to lead to
        # cells connect if they are at most a step apart, or if a step of `step_array` joins them
        room = room_index.ravel()
        can_pass = passable.ravel()
        floor = facts.floors[number].ravel()
        for cells, offset in pairs_across(room_index, 1):
            neighbors = cells + offset
            with np.errstate(invalid="ignore"):
                is_connected = ~(np.abs(floor[cells] - floor[neighbors]) > facts.step_limit)
            is_connected &= can_pass[cells] & can_pass[neighbors]
            has_exit[room[cells[is_connected]]] = True
            has_exit[room[neighbors[is_connected]]] = True
        for link_ends in (facts.links[:, :2], facts.links[:, 2:]):
            has_exit[room[link_ends[link_ends[:, 0] == number, 1]]] = True
        area = num_cells * level.lattice.cell_size**2
        for index in np.flatnonzero(~has_exit & (area >= MIN_ROOM_AREA)).tolist():
            if index:
                name = repr(names[number, index]) if (number, index) in names else str(index)
                text = f"nothing leads out of room {name} ({area[index]:.1f} m²)"
                place = facts.first_place(number, (room_index == index) & passable)
                yield Finding(REMARK, number, place, text)


def check_doors(facts: Facts) -> Iterator[Finding]:
    """Finds: doors between a room and itself, doors of missing rooms, and wrong cells of doors.

    A door's cells are wrong where their occupancy contradicts the door's state.
    """
    room_ids = None if facts.rooms is None else {room.id for room in facts.rooms}
    doors = facts.grid.doors
    door_cells = facts.cells_of([(door, door.state) for door in doors])
    for door in doors:
        level, place = _middle_of_door(facts, door)
        rooms = [room for room in door.rooms if room is not None]
        if len(rooms) == 2 and rooms[0] == rooms[1]:
            text = f"door {door.id!r} joins room {rooms[0]!r} to itself"
            yield Finding(REMARK, level, place, text)
        if room_ids is not None:
            for room in sorted(set(rooms) - room_ids):
                text = f"door {door.id!r} joins room {room!r}, which there isn't"
                yield Finding(ERROR, level, place, text)
        num_open, num_occupied = _count_wrong_cells(facts, door, door_cells)
        state = "stands as modelled" if door.state == "modelled" else f"is {door.state}"
        if num_open:
            text = f"door {door.id!r} {state}, but {num_open} of its cells aren't occupied"
            yield Finding(ERROR, level, place, text)
        if num_occupied:
            verb = "is" if num_occupied == 1 else "are"
            cells_are = f"{count_of(num_occupied, 'cell')} {verb}"
            text = f"door {door.id!r} {state}, but {cells_are} occupied"
            text += " that it blocks in other states only"
            yield Finding(ERROR, level, place, text)


def _middle_of_door(facts: Facts, door: Door) -> tuple[int | None, Vector3 | None]:
    """Return the level and the position of a door; both are None if it has no cells.

    It is the middle one of the door's cells, in the first state in which it has any.
    """
    for state in door.cells:
        for number, door_cells in enumerate(door.cells_in(state, len(facts.levels))):
            if len(door_cells):
                middle = int(door_cells[len(door_cells) // 2])
                row, col = divmod(middle, facts.levels[number].width)
                return number, facts.place(number, row, col)
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
    present_cells = door.cells_in(door.state, num_levels)
    num_open = 0
    num_occupied = 0
    for number, level in enumerate(facts.levels):
        occupied = level.occupancy.ravel() != 0
        present = present_cells[number]
        in_any_state = np.concatenate([by_level[number] for by_level in cells_by_state])
        absent = np.setdiff1d(in_any_state, present)
        absent = absent[~door_cells[number].ravel()[absent]]
        num_open += int(np.count_nonzero(~occupied[present]))
        num_occupied += int(np.count_nonzero(occupied[absent]))
    return num_open, num_occupied


def check_named_links(facts: Facts) -> Iterator[Finding]:
    """Finds: links with blocked stops, stops in dead spots, and lifts within one level.

    A dead spot is a small piece of floor that only this link leads to. Links for agents that the
    grid doesn't list are found, too.
    """
    links = facts.grid.links
    agents = facts.grid.agents
    islands = facts.islands_without_links if links else []
    num_cells = np.bincount(np.concatenate([[0], *(island.ravel() for island in islands)]))
    area = num_cells * facts.levels[0].lattice.cell_size ** 2
    for link in links:
        label = f"{link.kind} {link.name!r}"
        for stop in link.stops:
            row, col = divmod(stop.cell, facts.levels[stop.level].width)
            place = facts.place(stop.level, row, col)
            island = int(islands[stop.level][row, col])
            if not facts.free[stop.level][row, col]:
                is_door = bool(facts.passable[stop.level][row, col])
                may_be_meant = is_door or facts.inflation_reach is not None
                cause = "a door blocks" if is_door else "blocked is"
                severity = REMARK if may_be_meant else ERROR
                yield Finding(severity, stop.level, place, f"{cause} a stop of {label}")
            elif area[island] < MIN_ROOM_AREA:
                text = f"{label} leads to {area[island]:.2f} m² of floor, and nothing else does"
                yield Finding(REMARK, stop.level, place, text)
        if link.kind == "lift" and len({stop.level for stop in link.stops}) == 1:
            first = link.stops[0]
            text = f"all {count_of(len(link.stops), 'stop')} of {label} are on one level"
            yield Finding(REMARK, first.level, first.position, text)
        for name in sorted(set(link.agents or ()) - set(agents)):
            text = f"{label} is for agent {name!r}, whom the grid doesn't list"
            yield Finding(ERROR, None, None, text)


def check_areas(facts: Facts) -> Iterator[Finding]:
    """Finds: areas without cells, areas for unknown agents, and cells of unlisted areas."""
    areas = facts.grid.areas
    agents = facts.grid.agents
    if not areas:
        return
    num_cells = np.zeros(256, dtype=np.int64)
    for number, level in enumerate(facts.levels):
        layer = level.attributes.get("area", np.zeros(1, dtype=np.uint8))
        is_unlisted = (layer < 0) | (layer > len(areas))
        text = "in an area that the table doesn't list"
        yield from facts.error_on_cells(number, is_unlisted, text)
        num_cells += np.bincount(level.area_index.ravel(), minlength=256)
    for number, area in enumerate(areas, 1):
        if not num_cells[number]:
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
    "cells have no size, or no place": ("levels", check_lattices),
    "levels are out of order": ("levels", check_order),
    "boxes exclude their own cells": ("boxes", check_boxes),
    "links lead nowhere": ("links", check_links),
    "links are missing": ("no link", check_missing_links),
    "a link stops where it can't": ("named links", check_named_links),
    "an area is nowhere": ("areas", check_areas),
    "the agent can't be": ("agent", check_agent),
}
"""What a check looks for -> the `check` of its remarks, and its function."""


def run_check(check: Callable[[Facts], Iterator[Finding]], facts: Facts) -> Iterator[Finding]:
    """Run a check, and report metadata that it can't read as an error.

    Args:
        check: one of the functions of `CHECKS`.
        facts: the facts about the grid.

    Yields:
        The findings of the check. If it raises a FormatError, the last finding is that error.
    """
    try:
        yield from check(facts)
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
        content: GridBase = grid
    elif isinstance(grid, str | PathLike):
        content = read_navgrid(grid)
    else:
        raise FormatError(f"expected a grid or the path of its file, got {describe_type(grid)}")
    facts = Facts(content)
    remarks = []
    for name, check in CHECKS.values():
        for finding in run_check(check, facts):
            place = finding.place
            if place is not None and not all(map(math.isfinite, place)):
                place = None  # the grid's corner may have infinite coordinates
            remarks.append(Remark(name, finding.severity, finding.level, place, finding.text))
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(content.scene_id, remarks, list(CHECKS))
