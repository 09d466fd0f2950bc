"""The flat view of a grid for kernels: cells, rooms, doors and islands by flat id."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import Cell, Cells, check_positions
from navbake.navgrid.islands import cells_of_areas, group_steps, label_islands, step_limit
from navbake.navgrid.links import SPEED, Agent, Arcs, find_arcs
from navbake.navgrid.rooms import Door, Room
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.grid_arrays import FloorHeights, Layout, Links

arrays = lazy("navbake.runtime.grid_arrays")  # numba loads slowly
compiled = lazy("navbake.compiled")
places = lazy("navbake.runtime.place_kernels")

RISE = 0.05  # [m]: ways between levels that rise by more are called stairs
REAL = int | float | np.integer | np.floating


@dataclass(frozen=True, eq=False)
class FlatGrid:
    """The cells of all levels in one array, and the steps between levels.

    The flat id of a cell is ``start[level] + row * width[level] + col``. A step joins two free
    neighbours whose floors differ by at most `max_step`, or two free cells of the grid's `steps`.
    Cells of areas that bar the agent aren't free.
    """

    layout: Layout  # where the cells of each level lie
    steps: Links  # between cells that are not neighbours on one level, both ways
    arcs: Arcs  # passages over named links, for agents of any size
    floors: FloorHeights  # heights of the cells' floors [m], and `max_step`
    free: Bool  # by flat id, shape (n,)
    weight: Float  # cost of a cell, by flat id, inf where it isn't free
    price: Float  # by which areas multiply weights, inf where they bar; by flat id, or one for all
    pace: Float  # [s/m] of the agent; by flat id, or one for all
    # by flat id, to which neighbours a link leads on the same level: bits EAST and SOUTH of
    # `navbake.runtime.grid_arrays`; empty where none does
    slopes: NDArray[np.uint8]

    @property
    def num_levels(self) -> int:
        return len(self.layout.width)

    @property
    def num_cells(self) -> int:
        return int(self.layout.start[-1])

    def cells_of(self, level: int) -> slice:
        """The flat ids of a level's cells."""
        return slice(int(self.layout.start[level]), int(self.layout.start[level + 1]))

    def level_of(self, cells: Int | int) -> Int:
        """Levels of cells by flat id, same shape."""
        return np.searchsorted(self.layout.start, cells, side="right") - 1

    def split(self, cells: Int | int) -> Cells:
        """Level, row and column of cells by their flat ids, of the same shape; -1 stays -1."""
        cells = np.asarray(cells, dtype=np.int64)
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.layout.start[level], self.layout.width[level])
        return Cells(level, *(np.where(level < 0, -1, v) for v in (row, col)))

    def cell(self, cell: int) -> Cell:
        """Level, row and column of one cell by its flat id."""
        return Cell(*(int(v) for v in self.split(cell)))

    def cells_at(self, positions: ArrayLike, level: int | None = None) -> Int:
        """`navbake.navgrid.cells.cells_at`, faster: flat ids, shape (...), -1 for no cell."""
        p = check_positions(positions, self.num_levels, level)
        cells: Int = places.locate(self.layout, self.floors, *as_points(p, level))
        return cells.reshape(p.shape[:-1])

    def locate(
        self, position: ArrayLike, level: int | None = None, what: str = "position"
    ) -> tuple[Float, int]:
        """One position as float64, and the flat id of its cell, -1 for none."""
        p = self.check_one(position, level, what)
        return p, int(places.locate(self.layout, self.floors, *as_points(p, level))[0])

    def check_one(
        self, position: ArrayLike, level: int | None = None, what: str = "position"
    ) -> Float:
        """One position as float64, shape (2,) or (3,)."""
        p = check_positions(position, self.num_levels, level)
        if p.ndim != 1:
            raise QueryError(f"expected one {what}, got an array of shape {p.shape}")
        return p

    def free_cell_at(self, position: ArrayLike, level: int | None = None) -> tuple[Float, int]:
        """As `locate`; raises QueryError where the cell isn't free."""
        p, cell = self.locate(position, level)
        if cell < 0 or not self.free[cell]:
            hint = "snap it to the nearest place first"
            raise QueryError(f"no agent can stand at {text_of(p)}: {hint}")
        return p, cell

    def positions(self, cells: Int | int) -> Float:
        """Centres of cells on the floor, or else the level's ground: world [m], shape (..., 3)."""
        level, row, col = self.split(cells)
        size = self.layout.cell_size[level]
        x = self.layout.x_min[level] + (col + 0.5) * size
        y = self.layout.y_max[level] - (row + 0.5) * size
        floor = self.floors.z[cells]
        z = np.where(np.isnan(floor), self.floors.ground[level], floor)
        return np.stack([x, y, z], axis=-1)

    def step_ends(self) -> tuple[Int, Int]:
        """The flat ids that each of `steps` leads from and to; each is listed both ways."""
        return np.repeat(self.steps.cell, np.diff(self.steps.start)), self.steps.target

    def priced(self, weight: Float, where: Any = np.s_[:]) -> Float:
        """The weights of cells for the agent, by those of the grid; inf where they aren't free."""
        price = self.price[where] if len(self.price) > 1 else self.price
        free = np.isfinite(weight) & np.isfinite(price)
        return np.where(free, weight * np.where(free, price, 1.0), np.inf)

    def ways_by_links(self, radius: float, least: float, *, by_time: bool) -> tuple[Float, Float]:
        """Where links have stops, x, y, and what ways from each to each cost at least, (k, k).

        On the floor these are octile distances times the smallest weight, `least`. Without links
        that cost less than that there are none.
        """
        wide = self.arcs.fits_radius(radius)
        cells, ends = np.unique(self.arcs.ends[wide], return_inverse=True)
        stops = self.positions(cells)[:, :2]
        ends = ends.reshape(-1, 2)
        direct = least * octile(stops[:, None] - stops)
        ways = direct.copy()
        spent = (self.arcs.seconds if by_time else self.arcs.cost)[wide]
        np.minimum.at(ways, tuple(ends.T), spent)
        for k in range(len(cells)):  # Floyd (1962)
            ways = np.minimum(ways, ways[:, k, None] + ways[k])
        return (stops, ways) if (ways < direct).any() else (stops[:0], ways)

    def links(self, radius: float, *, by_time: bool = False, backwards: bool = False) -> Links:
        """Steps, and the passages that an agent of a radius fits through, from or to each cell."""
        wide = self.arcs.fits_radius(radius)
        if not wide.any():
            return self.steps
        ends = np.concatenate([np.stack(self.step_ends(), axis=1), self.arcs.ends[wide]])
        of_arcs = (self.arcs.seconds if by_time else self.arcs.cost)[wide]
        of_steps = self.steps.length
        length = np.append(of_steps, np.zeros(len(of_arcs)))
        cost = np.append(np.zeros(len(of_steps)), of_arcs)
        return list_links(ends[:, ::-1] if backwards else ends, length, cost, self.num_cells)


def octile(apart: Float) -> Float:
    """Octile lengths of vectors along x and y, shape (..., 2 or more)."""
    x = np.abs(apart[..., 0])
    y = np.abs(apart[..., 1])
    return np.asarray(np.maximum(x, y) + (math.sqrt(2.0) - 1.0) * np.minimum(x, y))


def list_links(ends: Int, length: Float, cost: Float, num_cells: int) -> Links:
    """The links of a list of ends, the flat ids that each leads from and to, shape (n, 2)."""
    order = np.lexsort((ends[:, 1], ends[:, 0]))  # stable: steps before passages
    source, target = ends[order].T
    cell = np.unique(ends)
    start = np.append(np.searchsorted(source, cell), len(source))
    is_end = np.zeros(num_cells if len(cell) else 0, dtype=np.bool_)
    is_end[cell] = True
    listed: Links = arrays.Links(
        cell, start, np.ascontiguousarray(target), length[order], cost[order], is_end
    )
    return listed


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Raise QueryError for anything but a number >= 0."""
    if not (isinstance(distance, REAL) and distance >= 0):
        raise QueryError(f"expected a {name} >= 0 m, got {distance!r}")


def text_of(position: Float) -> str:
    return ", ".join(f"{v:g}" for v in position)


def as_points(p: Float, level: int | None) -> tuple[int, Float]:
    """The level, -1 for any, and positions (n, 2 or 3), as kernel arguments."""
    on = 0 if level is None and p.shape[-1] == 2 else -1 if level is None else int(level)
    return on, np.ascontiguousarray(p.reshape(-1, p.shape[-1]))


def flatten(grid: NavGrid, agent: Agent | None = None, penalty: float | None = None) -> FlatGrid:
    """Copy the levels of a grid into a flat grid; later changes of the grid don't affect it.

    `agent` is whose rights and speed count. With a `penalty` it may use all links and areas: it
    is what passages cost more [m] that aren't allowed, and the price of cells that aren't.
    """
    compiled.ensure_compiled("runtime.")
    levels = grid.levels
    x_min, y_max, cell_size, width, height = np.array([level.lattice for level in levels]).T.copy()
    width = width.astype(np.int64)
    height = height.astype(np.int64)
    start = np.append(0, np.cumsum(width * height))
    layout = arrays.Layout(start, width, height, x_min, y_max, cell_size)
    floor = [v.floor if v.uses_cell_floors else np.full(v.shape, v.ground) for v in levels]
    z = np.concatenate([layer.ravel() for layer in floor])
    ground = np.array([level.ground for level in levels], dtype=np.float64)
    floors = arrays.FloorHeights(z, ground, step_limit(grid) * grid.unit)
    weight = np.concatenate([level.weights.ravel() for level in levels]).astype(np.float64)
    given = grid.step_array
    # each step both ways and once, and to which neighbours one leads on the same level
    ends = start[given[:, ::2]] + given[:, 1::2]
    pairs = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    slopes = np.zeros(0, dtype=np.uint8)
    if (given[:, 0] == given[:, 2]).any():
        slopes = np.zeros(start[-1], dtype=np.uint8)
        on = given[:, 0]
        low = ends.min(axis=1)
        step = np.ptp(ends, axis=1)
        own = on == given[:, 2]
        of_row = (ends - start[on, None]) // width[on, None]
        slopes[low[own & (step == 1) & (np.diff(of_row)[:, 0] == 0)]] |= np.uint8(arrays.EAST)
        slopes[low[own & (step == width[on])]] |= np.uint8(arrays.SOUTH)
    steps = list_links(pairs, np.empty(len(pairs)), np.zeros(len(pairs)), int(start[-1]))
    speed = SPEED if agent is None else agent.speed
    bars = [area.bars(agent) for area in grid.areas]
    prices = [(penalty or np.inf) if no else v.cost for no, v in zip(bars, grid.areas, strict=True)]
    paces = [1.0 / min(speed, area.speed or speed) for area in grid.areas]
    price = cells_of_areas(grid, prices, 1.0)
    pace = cells_of_areas(grid, paces, 1.0 / speed)
    price = price[:1] if (price == price[0]).all() else price
    pace = pace[:1] if (pace == pace[0]).all() else pace
    arcs = find_arcs(grid.links, start, agent, penalty)
    flat = FlatGrid(layout, steps, arcs, floors, np.isfinite(weight), weight, price, pace, slopes)
    weight[:] = flat.priced(weight)
    flat.free[:] = np.isfinite(weight)
    # The length of a step is the octile distance between the centres of its cells, from above, and
    # at least a cell: between neighbours on one lattice, as navbake links them, exactly a cell.
    sources, targets = flat.step_ends()
    least = np.minimum(cell_size[flat.level_of(sources)], cell_size[flat.level_of(targets)])
    steps.length[:] = np.maximum(octile(flat.positions(sources) - flat.positions(targets)), least)
    return flat


@dataclass(frozen=True, eq=False)
class RoomMap:
    """Rooms by number, from 1 in the order of `rooms`; 0 is no room."""

    scene_id: str | None  # the grid's, for messages
    rooms: list[Room]  # those of the grid, then those that only its cells name
    number: Int32  # of each cell, by flat id, shape (n,)

    def find(self, name: str) -> int:
        """The number of a room by its id, or by its name where only one room has it."""
        by_id = {room.id: number for number, room in enumerate(self.rooms, start=1)}
        if isinstance(name, str) and name in by_id:
            return by_id[name]
        named = [room.id for room in self.rooms if room.name and room.name == name]
        if len(named) == 1:
            return by_id[named[0]]
        if named:
            rooms = f"{len(named)} rooms in {self.scene_id!r} have the name {name!r}"
            raise QueryError(f"{rooms}: expected one of the ids {', '.join(named)}")
        names = [*by_id, *(room.name for room in self.rooms if room.name)]
        raise QueryError(f"no room {name!r} in {self.scene_id!r}: {suggest(name, names)}")

    def id_of(self, number: int) -> str | None:
        """The id of a room by its number; None for 0."""
        return self.rooms[number - 1].id if number else None

    def cells(self, name: str) -> Int:
        """Flat ids of a room's cells, free or not; ascending, int64."""
        return np.flatnonzero(self.number == self.find(name))


def map_rooms(grid: NavGrid) -> RoomMap:
    """Number the rooms of a grid; rooms missing in its table get the id ``level:index``."""
    rooms = list(grid.rooms)
    parts = []
    for number, level in enumerate(grid.levels):
        index = level.room_index
        numbers = np.zeros(int(index.max(initial=0)) + 1, dtype=np.int32)  # by index on the level
        for position, room in enumerate(rooms, start=1):
            if room.level == number and room.index < len(numbers):
                numbers[room.index] = position
        # measuring rooms is slow: only where cells name a room that the table lacks
        if ((numbers[index] == 0) & (index > 0)).any():
            for room in level.measure_rooms(number):
                if not numbers[room.index]:
                    rooms.append(room)
                    numbers[room.index] = len(rooms)
        parts.append(numbers[index].ravel())
    return RoomMap(grid.scene_id, rooms, np.concatenate(parts))


DoorMap = dict[int, list[str]]
"""The ids of the doors of each cell that is in one, by flat id."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Find each door's cells: those it blocks, closed or as it is, and those named in user data."""
    found: DoorMap = {}
    start = flat.layout.start.tolist()
    for door in grid.doors:
        states = (door.cells_in(state, flat.num_levels) for state in ("closed", door.state))
        cells = [start[k] + ids for by_level in states for k, ids in enumerate(by_level)]
        for cell in np.unique(np.concatenate(cells)).tolist():
            found.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level, part in enumerate(grid.levels):
            for cell, entry in part.user_data.items():
                if isinstance(stored := entry.get("doors"), list):
                    names = [name for name in stored if isinstance(name, str)]
                    found[start[level] + cell] = names
    return found


def find_leaf_cells(door: Door, flat: FlatGrid) -> Int:
    """The flat ids of the cells that a door's leaf takes when closed."""
    cells = door.solid_in if door.solid else door.cells_in
    pairs = zip(flat.layout.start, cells("closed", flat.num_levels), strict=False)
    return np.concatenate([start + ids for start, ids in pairs])


def doors_on(doors: DoorMap, cells: Int) -> list[str]:
    """The doors along a route, in order; a door that is entered again is repeated."""
    passed: list[str] = []
    current: Iterable[str] = ()
    for cell in cells.tolist():
        here = doors.get(cell, ())
        passed += [name for name in here if name not in current]
        current = here
    return passed


def find_stairs(grid: NavGrid, flat: FlatGrid) -> list[tuple[int, int, str, Int]]:
    """Find the stairs and ramps between levels: steps whose cells touch on the lower level.

    Returns the lower and the upper level of each, ``stairs`` or ``ramp``, and the flat ids of the
    cells of each step, the lower level's first, shape (n, 2).
    """
    steps = grid.step_array
    found = []
    steps = np.where((steps[:, 0] <= steps[:, 2])[:, None], steps, steps[:, [2, 3, 0, 1]])
    for own in group_steps(grid, steps[steps[:, 0] < steps[:, 2]]):
        ends = flat.layout.start[own[:, ::2]] + own[:, 1::2]
        rise = np.abs(np.diff(flat.positions(ends)[..., 2], axis=1)).max()
        low, high = own[0, ::2].tolist()
        found.append((low, high, "stairs" if rise > RISE else "ramp", ends))
    return found


@dataclass(frozen=True, eq=False)
class IslandMap:
    """The parts of a grid as it is now whose cells reach each other, from 1, the largest."""

    number: Int32  #: Of each cell, by flat id, shape (n,); 0 where it isn't free.
    areas: Float  #: Of each island [m²], shape (count + 1,); 0 for number 0.
    ways: Int  #: Pairs of islands of which links lead from the first to the second only, (k, 2).

    @property
    def count(self) -> int:
        return len(self.areas) - 1

    def check(self, island: int) -> int:
        """Raise QueryError for an unknown island's number."""
        if isinstance(island, int | np.integer) and 1 <= island <= self.count:
            return int(island)
        there_are = f"1 to {self.count}, 1 the largest" if self.count else "none"
        raise QueryError(f"no island {island!r}: there are {there_are}")

    def reached_from(self, island: int) -> tuple[int, ...]:
        """The islands that one leads to: itself, then others in ascending order."""
        found = np.array([island])
        while True:
            onward = np.unique(self.ways[np.isin(self.ways[:, 0], found), 1])
            onward = onward[~np.isin(onward, found)]
            if not len(onward):
                return island, *np.sort(found[1:]).tolist()
            found = np.append(found, onward)


def map_islands(flat: FlatGrid, radius: float, moves: NDArray[np.uint8] | None = None) -> IslandMap:
    """As `navbake.navgrid.islands.find_islands`; with `moves`, diagonal moves join cells, too."""
    layout = flat.layout
    floors = flat.floors
    steps = [np.stack(flat.step_ends(), axis=1)]
    passages = flat.arcs.ends[flat.arcs.fits_radius(radius)]
    if moves is not None:
        for bit, across in ((arrays.SOUTH_WEST, -1), (arrays.SOUTH_EAST, 1)):
            cells = np.flatnonzero(moves & bit)
            others = cells + layout.width[flat.level_of(cells)] + across
            steps.append(np.stack([cells, others], axis=1))
    number = label_islands(
        layout.start, layout.width, flat.free, floors.z, floors.max_step, np.concatenate(steps),
        passages,
    )  # fmt: skip
    # cells count by the area of their level's, which is the same on all levels but in few files
    areas = np.zeros(int(number.max(initial=0)) + 1)
    for level, size in enumerate(layout.cell_size):
        of_level = np.bincount(number[flat.cells_of(level)], minlength=len(areas))
        areas[1:] += of_level[1:] * size**2
    ways = number[passages]
    ways = np.unique(ways[(ways > 0).all(axis=1) & (ways[:, 0] != ways[:, 1])], axis=0)
    return IslandMap(number, areas, ways.astype(np.int64))
