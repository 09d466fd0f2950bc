"""Looks at a grid, without its scene, for what a person would notice.

Here are the checks of levels, boxes, steps, rooms, doors, the agent, named links and areas, and the
list of all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from os import PathLike
from typing import Any

import numpy as np

from navbake.auditor import cells
from navbake.auditor.cells import pairs_across
from navbake.auditor.facts import (
    ERROR,
    REMARK,
    AuditReport,
    Facts,
    Found,
    Remark,
    find_wrong_sizes,
)
from navbake.errors import FormatError, count_of
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import shown_type
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.types import Bool, Vector3

ALIGNED = 1e-3  # share of a cell that lattices may be off
BOX_SLACK = 1e-4  # metres that a cell may lie beside its level's box
MOST_TAKEN = 0.5  # share of a level's free cells that may lie in lower levels' boxes
MAX_SLOPE = 45.0  # of ramps, where the bake states no other [degrees]
NEXT = 1.5  # cells that the ends of a link may be apart, seen from above
AREA_OFF = 0.01  # share of a room's area that its entry may be off
PLACE_OFF = 0.1  # cells that a room's entry may lie beside its cells
MIN_FREE = 1.0  # area of a room that one can stand on, if it is to need a door [m²]


def check_lattices(facts: Facts) -> Iterator[Found]:
    """A level lies nowhere, or its cells have no size."""
    for number, level in enumerate(facts.levels):
        lattice = level.lattice
        if not 0 < lattice.cell_size < math.inf:
            yield ERROR, number, None, f"its cells have a size of {lattice.cell_size:g} m"
        if not all(map(math.isfinite, (lattice.x_min, lattice.y_max, level.ground))):
            yield ERROR, number, None, "its corner is at no place"


def check_order(facts: Facts) -> Iterator[Found]:
    """Levels aren't in order, lie on different lattices, or are there twice."""
    first = facts.levels[0].lattice
    for number, level in enumerate(facts.levels[1:], start=1):
        below = facts.levels[number - 1]
        lattice = level.lattice
        if level.ground < below.ground:
            text = f"its ground, {level.ground:.2f} m, is below that of the level before"
            yield ERROR, number, None, text
        cells = (lattice.x_min - first.x_min) / first.cell_size
        rows = (first.y_max - lattice.y_max) / first.cell_size
        off = max(abs(cells - round(cells)), abs(rows - round(rows)))
        if off > ALIGNED or abs(lattice.cell_size / first.cell_size - 1) > 1e-6:
            text = f"its cells lie {off:.3f} of a cell beside those of the lowest level"
            yield ERROR, number, None, text
        same = np.array_equal(facts.floors[number], facts.floors[number - 1], equal_nan=True)
        if same and lattice == below.lattice:
            yield ERROR, number, None, "its floors are those of the level before, cell by cell"


def check_boxes(facts: Facts) -> Iterator[Found]:
    """A level's box leaves out free cells of its own, or another level's takes them."""
    boxes = [level.bbox_yup for level in facts.levels]
    for number, box in enumerate(boxes):
        free = facts.free[number]
        floor = facts.floors[number]
        if box is None:
            continue
        out = free & ~_in_box(facts, number, box)
        for other, floors in enumerate(facts.floors):
            # between the floors of another level no boxes are right
            known = floors[facts.free[other] & ~np.isnan(floors)]
            if out.any() and other != number and len(known):
                out &= ~((floor >= known.min()) & (floor <= known.max()))
        if out.any():
            text = f"{int(out.sum())} free cells lie outside of its box (`bbox`)"
            yield ERROR, number, facts.first(number, out), text
        lower = [_in_box(facts, number, box) for box in boxes[:number] if box is not None]
        taken = free & np.any([np.zeros_like(free), *lower], axis=0)
        # where levels interleave, some cells lie in two boxes, and no boxes are right for all
        if number and taken.sum() > MOST_TAKEN * free.sum():
            text = f"{int(taken.sum())} free cells lie in the box of a lower level, too"
            yield REMARK, number, facts.first(number, taken), text


def _in_box(facts: Facts, number: int, box: tuple[tuple[float, ...], ...]) -> Bool:
    """Which cells of a level have their centres in a box of the file (y up)."""
    level = facts.levels[number]
    floor = facts.floors[number]
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    at = np.stack([x, np.where(np.isnan(floor), level.ground, floor), -y], axis=-1)
    low, high, slack = *(np.array(box) * level.unit), np.array([BOX_SLACK, 1e-6, BOX_SLACK])
    return np.asarray(((at >= low - slack) & (at <= high + slack)).all(axis=-1))


def check_links(facts: Facts) -> Iterator[Found]:
    """Links lead to cells that there aren't, that have no floor, that are far away, or too high."""
    links = facts.grid.step_array
    one, other = places = np.full((2, len(links), 3), np.nan)
    for place, (level, cell) in zip(places, (links[:, :2].T, links[:, 2:].T), strict=True):
        for number, grid in enumerate(facts.levels):
            here = level == number
            rows, cols = np.divmod(cell[here], grid.width)
            place[here, :2] = grid.lattice.positions(rows, cols).reshape(-1, 2)
            place[here, 2] = facts.floors[number][rows, cols]
    # a bake links neighbours more than a step apart where a ramp leads on, which its own slope
    # tells within a step
    stated: Any = facts.grid.navbake.get("maxSlope")
    slope = stated if type(stated) in (int, float) and 0 <= stated < 90 else MAX_SLOPE
    cell_size = facts.levels[0].lattice.cell_size
    ramp = cell_size * math.tan(math.radians(slope))
    limit = facts.step_limit + (ramp if ramp > facts.step_limit else 0.0)
    rise = np.abs(one - other)[:, 2]
    far = np.hypot(*(one - other)[:, :2].T) > NEXT * cell_size
    for wrong, what in (
        (np.isnan(rise), "to cells without a floor"),
        (far, "to cells that aren't neighbours"),
        (rise > limit, f"up by more than {limit:.2f} m"),
    ):
        if wrong.any():
            k = int(np.nanargmax(np.where(wrong, np.nan_to_num(rise), -1.0)))
            x, y, z = one[k].tolist()
            number = int(links[k, 0])
            count = int(wrong.sum())
            text = f"{count_of(count, 'link')} lead{'s' if count == 1 else ''} {what}"
            text += f": {rise[k]:.2f} m" if what.startswith("up") else ""
            yield ERROR, number, (x, y, facts.levels[number].ground if np.isnan(z) else z), text


def check_missing_links(facts: Facts) -> Iterator[Found]:
    """Free neighbours on two levels lie within a step, but nothing joins their islands."""
    # files of other programs know no links
    for number, level in enumerate(facts.levels if facts.grid.navbake else ()):
        for other in range(number + 1, len(facts.levels)):
            beside = facts.levels[other]
            rows, cols = np.nonzero(facts.free[other])
            to_row, to_col = level.lattice.rows_cols(beside.lattice.positions(rows, cols))
            unlinked = np.zeros(len(rows), dtype=np.bool_)
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                r = to_row + down
                c = to_col + right
                inside = level.lattice.holds(r, c)
                r = np.where(inside, r, 0)
                c = np.where(inside, c, 0)
                rise = np.abs(facts.floors[number][r, c] - facts.floors[other][rows, cols])
                islands = facts.islands[number][r, c], facts.islands[other][rows, cols]
                is_walk = inside & facts.free[number][r, c] & (rise <= facts.step_limit)
                unlinked |= is_walk & (islands[0] != islands[1])
            if unlinked.any():
                k = int(np.argmax(unlinked))
                count = int(unlinked.sum())
                has = f"level {number} {'has' if count == 1 else 'have'}"
                text = f"{count_of(count, 'free cell')} a step away from {has} no link to it, "
                text += "and nothing else leads there"
                yield ERROR, other, facts.place(other, int(rows[k]), int(cols[k])), text


def check_agent(facts: Facts) -> Iterator[Found]:
    """The agent's sizes are none, or others than the settings', or it steps as high as itself."""
    grid = facts.grid
    settings = facts.settings.get("agent", {})
    wrong = find_wrong_sizes(grid)
    for key, taken, name, default in (
        ("agentHeight", grid.agent_height, "height", 1.14),
        ("agentRadius", grid.agent_radius, "radius", 0.05),
        ("traversableFloorHeight", grid.max_step, "traversable_floor_height", 0.25),
    ):
        baked: Any = settings.get(name, default) if isinstance(settings, dict) else None
        if key in wrong:
            yield ERROR, None, None, f"{wrong[key]}: it counts as {taken:g} m"
        elif facts.settings and type(baked) in (int, float) and not math.isclose(taken, baked):
            text = f"`{key}` is {taken:g} m, but its settings say that it was baked for {baked:g} m"
            yield ERROR, None, None, text
    if "step" in wrong:
        yield ERROR, None, None, wrong["step"]
    if grid.agent_radius > 5:
        text = f"the agent has a radius of {grid.agent_radius:g} m: is the unit right?"
        yield REMARK, None, None, text


def check_room_table(facts: Facts) -> Iterator[Found]:
    """The table of rooms and the cells contradict each other."""
    stated = facts.grid.stated_rooms
    if stated is None:
        return
    known = {(room.level, room.index) for room in stated}
    for number, level in enumerate(facts.levels):
        count = np.bincount(level.room_index.ravel())
        middles = find_middles(level)
        for index in middles:
            if (number, index) not in known:
                text = f"{count[index]} cells are in room {index}, which no entry describes"
                yield ERROR, number, facts.first(number, level.room_index == index), text
        for room in (room for room in stated if room.level == number):
            name = repr(room.name or room.id)
            middle = middles.get(room.index)
            if middle is None:
                yield ERROR, number, room.centroid, f"room {name} has no cells"
                continue
            area = count[room.index] * level.lattice.cell_size**2
            axes = 3 if level.uses_cell_floors else 2  # else its z isn't that of the floors
            off = math.dist(middle[:axes], room.centroid[:axes])
            if abs(area - room.area) > AREA_OFF * max(area, room.area):
                text = f"room {name} has {area:.2f} m², not {room.area:.2f}"
                yield ERROR, number, room.centroid, text
            elif off > PLACE_OFF * level.lattice.cell_size:
                text = f"room {name} lies {off:.2f} m from where its entry says"
                yield ERROR, number, middle, text


def find_middles(level: SceneGrid2D) -> dict[int, Vector3]:
    """The mean of the cells of each room, by its index; to a micrometre, as the table states it."""
    index = level.room_index
    rooms, which, count = np.unique(index, return_inverse=True, return_counts=True)
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    z = np.where(np.isnan(level.floor), level.ground, level.floor)
    means = [np.bincount(which.ravel(), values.ravel()) / count for values in (x, y, z)]
    middles = map(tuple, (np.round(means, 6) + 0.0).T.tolist())  # no -0.0
    return {room: middle for room, middle in zip(rooms.tolist(), middles, strict=True) if room}


def check_rooms_without_way_out(facts: Facts) -> Iterator[Found]:
    """Nothing leads out of a room, be all doors open."""
    names = {(room.level, room.index): room.name or room.id for room in facts.rooms or ()}
    for number, level in enumerate(facts.levels):
        index = level.room_index
        passable = facts.passable[number]
        floor = facts.floors[number]
        leads = np.zeros(int(index.max()) + 1, dtype=np.bool_)
        count = np.bincount(index[passable], minlength=len(leads))
        if np.count_nonzero(count) < 2:
            continue  # there is nothing to lead to
        # from cell to cell with a step between at most, or by a link
        room = index.ravel()
        can_pass = passable.ravel()
        height = floor.ravel()
        for one, step in pairs_across(index, 1):
            other = one + step
            with np.errstate(invalid="ignore"):
                joined = ~(np.abs(height[one] - height[other]) > facts.step_limit)
            joined &= can_pass[one] & can_pass[other]
            leads[room[one[joined]]] = leads[room[other[joined]]] = True
        for ends in (facts.links[:, :2], facts.links[:, 2:]):
            leads[room[ends[ends[:, 0] == number, 1]]] = True
        size = count * level.lattice.cell_size**2
        for which in np.flatnonzero(~leads & (size >= MIN_FREE)).tolist():
            if which:
                name = repr(names[number, which]) if (number, which) in names else str(which)
                text = f"nothing leads out of room {name} ({size[which]:.1f} m²)"
                yield REMARK, number, facts.first(number, (index == which) & passable), text


def check_doors(facts: Facts) -> Iterator[Found]:
    """A door joins a room to itself, or to none that there is; or its cells aren't as it says."""
    doors = facts.grid.doors
    known = None if facts.rooms is None else {room.id for room in facts.rooms}
    standing = facts.cells_of([(door, door.state) for door in doors])
    for door in doors:
        states = {state: door.cells_in(state, len(facts.levels)) for state in door.cells}
        level = None
        place = None
        for number, own in (pair for levels in states.values() for pair in enumerate(levels)):
            if len(own) and level is None:  # the middle of the first cells
                row, col = divmod(int(own[len(own) // 2]), facts.levels[number].width)
                level = number
                place = facts.place(number, row, col)
        pair = [room for room in door.rooms if room is not None]
        if len(pair) == 2 and pair[0] == pair[1]:
            yield REMARK, level, place, f"door {door.id!r} joins room {pair[0]!r} to itself"
        for room in sorted(set(pair) - known) if known is not None else ():
            text = f"door {door.id!r} joins room {room!r}, which there isn't"
            yield ERROR, level, place, text
        # a door lists the cells that nothing else blocks but other doors: so those that it blocks
        # in other states only have to be free, unless another door stands there
        num_open = num_full = 0
        for number, grid in enumerate(facts.levels):
            occupied = grid.occupancy.ravel() != 0
            stands = door.cells_in(door.state, len(facts.levels))[number]
            away = np.setdiff1d(np.concatenate([c[number] for c in states.values()]), stands)
            away = away[~standing[number].ravel()[away]]
            num_open += int(np.count_nonzero(~occupied[stands]))
            num_full += int(np.count_nonzero(occupied[away]))
        state = "stands as modelled" if door.state == "modelled" else f"is {door.state}"
        if num_open:
            text = f"door {door.id!r} {state}, but {num_open} of its cells aren't occupied"
            yield ERROR, level, place, text
        if num_full:
            cells = f"{count_of(num_full, 'cell')} {'is' if num_full == 1 else 'are'} occupied"
            text = f"door {door.id!r} {state}, but {cells} that it blocks in other states only"
            yield ERROR, level, place, text


def check_named_links(facts: Facts) -> Iterator[Found]:
    """A link's stop is blocked, a lift's stops are on one level, or one leads to a dead spot."""
    links = facts.grid.links
    agents = facts.grid.agents
    islands = facts.walks if links else []
    count = np.bincount(np.concatenate([[0], *(part.ravel() for part in islands)]))
    area = count * facts.levels[0].lattice.cell_size ** 2
    for link in links:
        what = f"{link.kind} {link.name!r}"
        for stop in link.stops:
            row, col = divmod(stop.cell, facts.levels[stop.level].width)
            place = facts.place(stop.level, row, col)
            island = int(islands[stop.level][row, col])
            if not facts.free[stop.level][row, col]:
                by_door = bool(facts.passable[stop.level][row, col])
                why = "a door blocks" if by_door else "blocked is"
                severity = REMARK if by_door or facts.reach is not None else ERROR
                yield severity, stop.level, place, f"{why} a stop of {what}"
            elif area[island] < MIN_FREE:
                text = f"{what} leads to {area[island]:.2f} m² of floor, and nothing else does"
                yield REMARK, stop.level, place, text
        if link.kind == "lift" and len({stop.level for stop in link.stops}) == 1:
            first = link.stops[0]
            text = f"all {count_of(len(link.stops), 'stop')} of {what} are on one level"
            yield REMARK, first.level, first.position, text
        for name in sorted(set(link.agents or ()) - set(agents)):
            yield ERROR, None, None, f"{what} is for agent {name!r}, whom the grid doesn't list"


def check_areas(facts: Facts) -> Iterator[Found]:
    """An area covers no cell of any level, is for an unknown agent, or cells are in none."""
    areas = facts.grid.areas
    agents = facts.grid.agents
    if not areas:
        return
    count = np.zeros(256, dtype=np.int64)
    for number, level in enumerate(facts.levels):
        stored = level.attributes.get("area", np.zeros(1, dtype=np.uint8))
        beyond = (stored < 0) | (stored > len(areas))
        yield from facts.on_cells(number, beyond, "in an area that the table doesn't list")
        count += np.bincount(level.area_index.ravel(), minlength=256)
    for place, area in enumerate(areas, 1):
        if not count[place]:
            yield REMARK, None, None, f"area {area.name!r} covers no cell of any level"
        for name in sorted(set(area.agents or ()) - set(agents)):
            text = f"area {area.name!r} is for agent {name!r}, whom the grid doesn't list"
            yield ERROR, None, None, text


CHECKS: dict[str, tuple[str, Callable[[Facts], Iterator[Found]]]] = {
    "all cells are free": ("all free", cells.check_all_free),
    "a level is empty or all blocked": ("empty level", cells.check_empty_levels),
    "hardly any cell is free": ("hardly free", cells.check_free_share),
    "weights contradict occupancy": ("weights", cells.check_weights),
    "an inflation can't be read": ("inflation", cells.check_inflation),
    "a free cell has no floor": ("floors", cells.check_floors),
    "the floor jumps": ("jumps", cells.check_jumps),
    "stored layers are wrong": ("layers", cells.check_layers),
    "one cell cuts off an island": ("cut off", cells.check_cut_off),
    "no link reaches a level": ("unreached", cells.check_unreached_levels),
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
"""The checks, by what each looks for: what its remarks are called, and its function."""


def run_check(check: Callable[[Facts], Iterator[Found]], facts: Facts) -> Iterator[Found]:
    """What a check finds; that the metadata which it is about are broken is an error."""
    try:
        yield from check(facts)
    except FormatError as error:
        yield ERROR, None, None, str(error)


def audit(grid: NavGrid | str | PathLike[str]) -> AuditReport:
    """Look at a grid of any program, or its file, for what a person would notice.

    Raises a FormatError if it is neither a grid nor a path, or the file can't be read.
    """
    if not isinstance(grid, GridBase | str | PathLike):
        raise FormatError(f"expected a grid or the path of its file, got {shown_type(grid)}")
    content: Any = grid if isinstance(grid, GridBase) else read_navgrid(grid)
    facts = Facts(content)
    remarks = []
    for name, check in CHECKS.values():
        for severity, level, place, text in run_check(check, facts):
            # the grid's own place may be no number
            is_place = place is not None and all(map(math.isfinite, place))
            remarks.append(Remark(name, severity, level, place if is_place else None, text))
    remarks.sort(key=lambda remark: remark.severity != ERROR)
    return AuditReport(content.scene_id, remarks, list(CHECKS))
