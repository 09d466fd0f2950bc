"""Checks of rooms and doors."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import mean

from navbake.auditor.facts import Facts
from navbake.auditor.report import ERROR, REMARK, Remark, count_of
from navbake.errors import FormatError
from navbake.navgrid.doors import Door
from navbake.navgrid.grid import SceneGrid2D
from navbake.types import Int, Vector3

AREA_OFF = 0.01  # share of a room's area that its entry may be off
PLACE_OFF = 0.1  # cells that a room's entry may lie beside its cells
MIN_FREE = 1.0  # area of a room that one can stand on, if it is to need a door [m²]

Indices = NDArray[np.uint16]  # of rooms


def check_room_table(facts: Facts) -> Iterator[Remark]:
    """The table of rooms and the cells contradict each other."""
    try:
        stated = facts.grid.stated_rooms
    except FormatError as error:
        yield Remark("room table", ERROR, None, None, str(error))
        return
    if stated is None:
        return
    known = {(room.level, room.index) for room in stated}
    for number, level in enumerate(facts.levels):
        count = np.bincount(level.room_index.ravel())
        middles = find_middles(level)
        for index in np.flatnonzero(count).tolist():
            if index and (number, index) not in known:
                text = f"{count[index]} cells are in room {index}, which no entry describes"
                place = facts.first(number, level.room_index == index)
                yield Remark("room table", ERROR, number, place, text)
        for room in (room for room in stated if room.level == number):
            name = repr(room.name or room.id)
            cells = int(count[room.index]) if room.index < len(count) else 0
            if not cells:
                text = f"room {name} has no cells"
                yield Remark("room table", ERROR, number, room.centroid, text)
                continue
            area, middle = cells * level.lattice.cell_size**2, middles[room.index]
            axes = 3 if level.uses_cell_floors else 2  # else its z isn't that of the floors
            off = math.dist(middle[:axes], room.centroid[:axes])
            if abs(area - room.area) > AREA_OFF * max(area, room.area):
                text = f"room {name} has {area:.2f} m², not {room.area:.2f}"
                yield Remark("room table", ERROR, number, room.centroid, text)
            elif off > PLACE_OFF * level.lattice.cell_size:
                text = f"room {name} lies {off:.2f} m from where its entry says"
                yield Remark("room table", ERROR, number, middle, text)


def find_middles(level: SceneGrid2D) -> dict[int, Vector3]:
    """The mean of the cells of each room, by its index; to a micrometre, as the table states it."""
    index, floor = level.room_index, level.floor
    rooms = np.flatnonzero(np.bincount(index.ravel())[1:]) + 1
    x = np.broadcast_to(level.lattice.center_x(), index.shape)
    y = np.broadcast_to(level.lattice.center_y()[:, None], index.shape)
    z = np.where(np.isnan(floor), level.ground, floor)
    means = np.stack([np.asarray(mean(values, index, rooms)) for values in (x, y, z)], axis=1)
    middles = (np.round(means, 6) + 0.0).tolist()  # no -0.0
    return {room: (x, y, z) for room, (x, y, z) in zip(rooms.tolist(), middles, strict=True)}


def check_rooms_without_way_out(facts: Facts) -> Iterator[Remark]:
    """Nothing leads out of a room, be all doors open."""
    for number, level in enumerate(facts.levels):
        index, passable = level.room_index, facts.passable[number]
        leads = np.zeros(int(index.max()) + 1, dtype=np.bool_)
        count = np.bincount(index[passable], minlength=len(leads))
        if np.count_nonzero(count) < 2:
            continue  # there is nothing to lead to
        for one, other in _neighbours_across(facts, number):
            leads[one] = leads[other] = True
        for level_of, cell in ((0, 1), (2, 3)):
            here = facts.links[facts.links[:, level_of] == number]
            leads[index.ravel()[here[:, cell]]] = True
        size = count * level.lattice.cell_size**2
        for room in np.flatnonzero(~leads & (size >= MIN_FREE)).tolist():
            if room:
                name = _name(facts, number, room)
                text = f"nothing leads out of room {name} ({size[room]:.1f} m²)"
                place = facts.first(number, (index == room) & passable)
                yield Remark("no way out", REMARK, number, place, text)


def _neighbours_across(facts: Facts, number: int) -> Iterator[tuple[Indices, Indices]]:
    """The rooms of passable neighbours of a level that are in two, with a step between at most."""
    index, passable = facts.levels[number].room_index, facts.passable[number].ravel()
    floor, room, width = facts.floors[number].ravel(), index.ravel(), index.shape[1]
    ways = (1, index[:, :-1] != index[:, 1:]), (width, index[:-1] != index[1:])
    for step, differ in ways:
        rows, cols = np.nonzero(differ)  # few do, so that the rest is asked of few
        one = rows * width + cols
        other = one + step
        with np.errstate(invalid="ignore"):
            too_high = np.abs(floor[one] - floor[other]) > facts.step_limit
        joined = passable[one] & passable[other] & ~too_high
        yield room[one[joined]], room[other[joined]]


def check_doors(facts: Facts) -> Iterator[Remark]:
    """A door joins a room to itself, or to none that there is; or its cells aren't as it says."""
    try:
        doors = facts.grid.doors
    except FormatError as error:
        yield Remark("doors", ERROR, None, None, str(error))
        return
    rooms = facts.rooms
    for door in doors:
        place, level = _place_of(facts, [door.cells_in(s, len(facts.levels)) for s in door.cells])
        pair = [room for room in door.rooms if room is not None]
        if len(pair) == 2 and pair[0] == pair[1]:
            text = f"door {door.id!r} joins room {pair[0]!r} to itself"
            yield Remark("doors", REMARK, level, place, text)
        for room in sorted(set(pair) - {r.id for r in rooms}) if rooms is not None else ():
            text = f"door {door.id!r} joins room {room!r}, which there isn't"
            yield Remark("doors", ERROR, level, place, text)
        num_open, num_full = _contradictions(facts, door)
        stands = "stands as modelled" if door.state == "modelled" else f"is {door.state}"
        if num_open:
            text = f"door {door.id!r} {stands}, but {num_open} of its cells aren't occupied"
            yield Remark("doors", ERROR, level, place, text)
        if num_full:
            cells = f"{count_of(num_full, 'cell')} {'is' if num_full == 1 else 'are'} occupied"
            text = f"door {door.id!r} {stands}, but {cells} that it blocks in other states only"
            yield Remark("doors", ERROR, level, place, text)


def _contradictions(facts: Facts, door: Door) -> tuple[int, int]:
    """How many cells of a door contradict its state: free ones that it blocks, and others.

    A door lists the cells that nothing else blocks but other doors. So those that it blocks in
    other states only have to be free, unless another door stands there.
    """
    num_open = num_full = 0
    for number, level in enumerate(facts.levels):
        occupied = level.occupancy.ravel() != 0
        of_states = [door.cells_in(state, len(facts.levels))[number] for state in door.cells]
        stands = door.cells_in(door.state, len(facts.levels))[number]
        away = np.setdiff1d(np.concatenate([stands, *of_states]), stands)
        away = away[~facts.standing_doors[number].ravel()[away]]
        num_open += int(np.count_nonzero(~occupied[stands]))
        num_full += int(np.count_nonzero(occupied[away]))
    return num_open, num_full


def _place_of(facts: Facts, states: list[list[Int]]) -> tuple[Vector3 | None, int | None]:
    for levels in states:
        for number, cells in enumerate(levels):
            if len(cells):
                row, col = divmod(int(cells[len(cells) // 2]), facts.levels[number].width)
                return facts.place(number, row, col), number
    return None, None


def _name(facts: Facts, level: int, index: int) -> str:
    found = [room for room in facts.rooms or () if (room.level, room.index) == (level, index)]
    return repr(found[0].name or found[0].id) if found else str(index)
