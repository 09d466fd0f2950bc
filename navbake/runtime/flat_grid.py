"""The flat view of a grid for kernels: cells, rooms, doors and islands by flat id.

Of `navbake.runtime`, this module imports only arrays and kernels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import Cell, Cells, check_positions
from navbake.navgrid.islands import group_steps, label_islands, step_limit, values_by_area
from navbake.navgrid.links import DEFAULT_SPEED, Agent, Arcs, find_arcs
from navbake.navgrid.rooms import Door, Room
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.grid_arrays import FloorHeights, Layout, Links

arrays = lazy("navbake.runtime.grid_arrays")  # numba loads slowly
compiled = lazy("navbake.compiled")
place_kernels = lazy("navbake.runtime.place_kernels")

STAIRS_RISE = 0.05  # [m]: if a step between levels rises by more, it is called stairs, else a ramp
RealNumber = int | float | np.integer | np.floating
"""The types of numbers that arguments may have."""


@dataclass(frozen=True, eq=False)
class FlatGrid:
    """The cells of all levels in one array, and the steps between levels.

    The flat id of a cell is ``start[level] + row * width[level] + col``. A step joins two free
    neighbours whose floors differ by at most `max_step`, or two free cells of the grid's `steps`.
    Cells of areas that bar the agent aren't free.

    Attributes:
        layout: where the cells of each level lie.
        steps: links between cells that are not neighbours on one level, in both directions.
        arcs: passages over named links, for agents of any size.
        floors: heights of the cells' floors [m], and `max_step`.
        free: where the agent can stand, by flat id, shape (n,).
        weight: the cost of each cell, by flat id, inf where it isn't free.
        area_factor: the factor by which the area of a cell multiplies its weight, inf where the
            area bars the agent; by flat id, or one number for all cells.
        pace: the seconds that the agent takes for a metre [s/m]; by flat id, or one number for all
            cells.
        slopes: by flat id, whether one of `steps` joins the cell to its neighbour in the next
            column (bit EAST of `navbake.runtime.grid_arrays`) or in the next row (bit SOUTH),
            uint8; empty if there is no such step.
    """

    layout: Layout
    steps: Links
    arcs: Arcs
    floors: FloorHeights
    free: Bool
    weight: Float
    area_factor: Float
    pace: Float
    slopes: NDArray[np.uint8]

    @property
    def num_levels(self) -> int:
        """Number of levels."""
        return len(self.layout.width)

    @property
    def num_cells(self) -> int:
        """Number of cells on all levels."""
        return int(self.layout.start[-1])

    def cells_of(self, level: int) -> slice:
        """Return the range of the flat ids of a level's cells."""
        return slice(int(self.layout.start[level]), int(self.layout.start[level + 1]))

    def level_of(self, cells: Int | int) -> Int:
        """Return the number of each cell's level, in the shape of `cells`, which are flat ids."""
        return np.searchsorted(self.layout.start, cells, side="right") - 1

    def split(self, cells: Int | int) -> Cells:
        """Convert flat ids to level, row and column, each of the same shape; -1 stays -1."""
        cells = np.asarray(cells, dtype=np.int64)
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.layout.start[level], self.layout.width[level])
        return Cells(
            level=level,
            row=np.where(level < 0, -1, row),
            col=np.where(level < 0, -1, col),
        )

    def cell(self, cell: int) -> Cell:
        """Convert one flat id to level, row and column."""
        level, row, col = self.split(cell)
        return Cell(int(level), int(row), int(col))

    def cells_at(self, positions: ArrayLike, level: int | None = None) -> Int:
        """Find the cells of positions, like `navbake.navgrid.cells.cells_at` but faster.

        Args:
            positions: world x, y, z [m], shape (..., 3); x, y are enough with a level, or on a grid
                of one level.
            level: the level of all positions; None finds the level of each position by its z.

        Returns:
            Flat ids, shape (...), int64; -1 for no cell.

        Raises:
            QueryError: a position is not valid, or there is no such level.
        """
        checked_position = check_positions(positions, self.num_levels, level)
        kernel_level, points = to_kernel_positions(checked_position, level)
        cells: Int = place_kernels.locate(self.layout, self.floors, kernel_level, points)
        return cells.reshape(checked_position.shape[:-1])

    def locate(
        self, position: ArrayLike, level: int | None = None, position_name: str = "position"
    ) -> tuple[Float, int]:
        """Check one position, and find its cell.

        Args:
            position: world x, y, z [m]; x, y are enough with a level, or on a grid of one level.
            level: its level; None finds the level by z.
            position_name: the position's name in errors.

        Returns:
            The position as float64, shape (2,) or (3,); and the flat id of its cell, -1 for none.

        Raises:
            QueryError: the position is not valid, or there is no such level.
        """
        checked_position = self.check_position(position, level, position_name)
        kernel_level, points = to_kernel_positions(checked_position, level)
        cells = place_kernels.locate(self.layout, self.floors, kernel_level, points)
        return checked_position, int(cells[0])

    def check_position(
        self, position: ArrayLike, level: int | None = None, position_name: str = "position"
    ) -> Float:
        """Check one position, and convert it to an array.

        Args:
            position: world x, y, z [m]; x, y are enough with a level, or on a grid of one level.
            level: its level; None if the position has a z.
            position_name: the position's name in errors.

        Returns:
            The position as float64, shape (2,) or (3,).

        Raises:
            QueryError: the position is not valid, or there is no such level.
        """
        checked_position = check_positions(position, self.num_levels, level)
        if checked_position.ndim != 1:
            expected = f"one {position_name}"
            raise QueryError(
                f"expected {expected}, got an array of shape {checked_position.shape}",
                key=position_name,
                value=position,
                expected=expected,
            )
        return checked_position

    def free_cell_at(self, position: ArrayLike, level: int | None = None) -> tuple[Float, int]:
        """Check one position, and find its cell, which must be free.

        Args:
            position: world x, y, z [m]; x, y are enough with a level, or on a grid of one level.
            level: its level; None finds the level by z.

        Returns:
            The position as float64, shape (2,) or (3,); and the flat id of its cell.

        Raises:
            QueryError: the cell isn't free, the position is not valid, or there is no such level.
        """
        checked_position, cell = self.locate(position, level)
        if cell < 0 or not self.free[cell]:
            hint = "snap it to the nearest place first"
            raise QueryError(
                f"no agent can stand at {format_position(checked_position)}: {hint}",
                key="position",
                value=tuple(checked_position.tolist()),
                hint=hint,
            )
        return checked_position, cell

    def positions(self, cells: Int | int) -> Float:
        """Compute the centres of cells.

        Args:
            cells: flat ids, shape (...).

        Returns:
            World x, y and floor z [m], shape (..., 3); z is the level's ground where a cell has no
            floor.
        """
        level, row, col = self.split(cells)
        size = self.layout.cell_size[level]
        x = self.layout.x_min[level] + (col + 0.5) * size
        y = self.layout.y_max[level] - (row + 0.5) * size
        floor = self.floors.z[cells]
        z = np.where(np.isnan(floor), self.floors.ground[level], floor)
        return np.stack([x, y, z], axis=-1)

    def step_ends(self) -> tuple[Int, Int]:
        """List both ends of each of `steps`, in both directions.

        Returns:
            The flat ids that the steps lead from, shape (n,); and those that they lead to, (n,).
        """
        sources = np.repeat(self.steps.cell, np.diff(self.steps.start))
        return sources, self.steps.target

    def weights_for_agent(self, weight: Float, cells: Int | slice = np.s_[:]) -> Float:
        """Multiply the weights of cells by the factors of the areas that the cells are in.

        Args:
            weight: the grid's weights of the cells, inf where they aren't free.
            cells: the cells' flat ids, of the shape of `weight`; all unless given.

        Returns:
            The weights times the areas' factors; inf where a cell isn't free for the agent.
        """
        factor = self.area_factor[cells] if len(self.area_factor) > 1 else self.area_factor
        free = np.isfinite(weight) & np.isfinite(factor)
        return np.where(free, weight * np.where(free, factor, 1.0), np.inf)

    def costs_between_stops(
        self, radius: float, least_weight: float, *, by_time: bool
    ) -> tuple[Float, Float]:
        """Compute lower bounds of the costs of routes between the stops of links.

        On the floor, the bound is the octile distance times the smallest weight. Over links, it is
        their cost.

        Args:
            radius: the agent's radius [m].
            least_weight: the smallest weight of a free cell, >= 0.
            by_time: whether the cost of passages is in seconds; if False, in metres.

        Returns:
            x, y of the k stops [m], shape (k, 2); and the bound from stop i to stop j, shape
            (k, k). k is 0 if no link costs less than the bound over the floor.
        """
        is_passable = self.arcs.fits_radius(radius)
        cells, ends = np.unique(self.arcs.ends[is_passable], return_inverse=True)
        stops = self.positions(cells)[:, :2]
        ends = ends.reshape(-1, 2)
        floor_costs = least_weight * octile_length(stops[:, None] - stops)
        costs = floor_costs.copy()
        passage_costs = self.arcs.seconds if by_time else self.arcs.cost
        np.minimum.at(costs, tuple(ends.T), passage_costs[is_passable])
        for k in range(len(cells)):  # all shortest paths: Floyd (1962)
            costs = np.minimum(costs, costs[:, k, None] + costs[k])
        if (costs < floor_costs).any():
            return stops, costs
        return stops[:0], costs

    def links(self, radius: float, *, by_time: bool = False, are_reversed: bool = False) -> Links:
        """List the steps, and the passages that an agent of a radius fits through.

        Args:
            radius: the agent's radius [m].
            by_time: whether the cost of passages is in seconds; if False, in metres.
            are_reversed: whether each link leads from its end to its start.
        """
        is_passable = self.arcs.fits_radius(radius)
        if not is_passable.any():
            return self.steps
        step_ends = np.stack(self.step_ends(), axis=1)
        ends = np.concatenate([step_ends, self.arcs.ends[is_passable]])
        passage_costs = (self.arcs.seconds if by_time else self.arcs.cost)[is_passable]
        step_lengths = self.steps.length
        length = np.append(step_lengths, np.zeros(len(passage_costs)))
        cost = np.append(np.zeros(len(step_lengths)), passage_costs)
        return make_links(ends[:, ::-1] if are_reversed else ends, length, cost, self.num_cells)


def octile_length(vectors: Float) -> Float:
    """Compute the lengths of the shortest walks along rows, columns and diagonals.

    Args:
        vectors: x and y from the start to the end of each walk, shape (..., 2 or more).

    Returns:
        Octile lengths, in the unit of `vectors`, shape (...).
    """
    x = np.abs(vectors[..., 0])
    y = np.abs(vectors[..., 1])
    return np.asarray(np.maximum(x, y) + (math.sqrt(2.0) - 1.0) * np.minimum(x, y))


def make_links(ends: Int, length: Float, cost: Float, num_cells: int) -> Links:
    """Sort links by the cell that each leads from.

    Args:
        ends: the flat ids that each link leads from and to, shape (n, 2), steps before passages.
        length: the length of each step [m], 0 for a passage, shape (n,).
        cost: the cost of each passage, 0 for a step, shape (n,).
        num_cells: number of cells of the grid.

    Returns:
        The links, as kernels take them.
    """
    order = np.lexsort((ends[:, 1], ends[:, 0]))  # stable: steps before passages
    source, target = ends[order].T
    cell = np.unique(ends)
    start = np.append(np.searchsorted(source, cell), len(source))
    is_end = np.zeros(num_cells if len(cell) else 0, dtype=np.bool_)
    is_end[cell] = True
    links: Links = arrays.Links(
        cell=cell,
        start=start,
        target=np.ascontiguousarray(target),
        length=length[order],
        cost=cost[order],
        is_end=is_end,
    )
    return links


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Check that a distance that a user passes is a number >= 0.

    Args:
        distance: expected to be a number >= 0 [m]; inf is allowed.
        name: the argument's name in the error.

    Raises:
        QueryError: the distance is anything else.
    """
    if not (isinstance(distance, RealNumber) and distance >= 0):
        expected = f"a {name} >= 0 m"
        raise QueryError(
            f"expected {expected}, got {distance!r}", key=name, value=distance, expected=expected
        )


def format_position(position: Float) -> str:
    """Format a position for a message: its numbers with commas in between."""
    return ", ".join(f"{v:g}" for v in position)


def to_kernel_positions(positions: Float, level: int | None) -> tuple[int, Float]:
    """Convert checked positions to arguments of kernels.

    Args:
        positions: world x, y, z [m], shape (..., 3); or x, y, shape (..., 2).
        level: the level of all positions. None to find it by z, or on a grid of one level.

    Returns:
        The level, -1 to find each position's level; and the positions, shape (n, 2 or 3),
        contiguous.
    """
    if level is not None:
        kernel_level = int(level)
    elif positions.shape[-1] == 2:
        kernel_level = 0
    else:
        kernel_level = -1
    return kernel_level, np.ascontiguousarray(positions.reshape(-1, positions.shape[-1]))


def flatten(grid: NavGrid, agent: Agent | None = None, penalty: float | None = None) -> FlatGrid:
    """Copy the levels of a grid into a flat grid; later changes of the grid don't affect it.

    Args:
        grid: a grid of one or several levels.
        agent: the agent: its speed counts, and which areas and links it may use. None for an agent
            at 1 m/s that may use all open links, and all areas except areas of infinite cost.
        penalty: if given, the agent may use all links and areas, but at a high cost: passages that
            it may not use cost this much more [m], and areas that bar it multiply weights by it.

    Returns:
        The flat grid.
    """
    compiled.ensure_compiled("runtime.")
    levels = grid.levels
    x_min, y_max, cell_size, width, height = np.array([level.lattice for level in levels]).T.copy()
    width = width.astype(np.int64)
    height = height.astype(np.int64)
    start = np.append(0, np.cumsum(width * height))
    layout: Layout = arrays.Layout(
        start=start, width=width, height=height, x_min=x_min, y_max=y_max, cell_size=cell_size
    )
    floors_by_level = [
        level.floor if level.uses_cell_floors else np.full(level.shape, level.ground)
        for level in levels
    ]
    floors: FloorHeights = arrays.FloorHeights(
        z=np.concatenate([floor.ravel() for floor in floors_by_level]),
        ground=np.array([level.ground for level in levels], dtype=np.float64),
        max_step=step_limit(grid) * grid.unit,
    )
    weight = np.concatenate([level.weights.ravel() for level in levels]).astype(np.float64)

    # each step in both directions, once
    step_array = grid.step_array
    ends = start[step_array[:, ::2]] + step_array[:, 1::2]
    pairs = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    steps = make_links(pairs, np.empty(len(pairs)), np.zeros(len(pairs)), int(start[-1]))

    speed = DEFAULT_SPEED if agent is None else agent.speed
    area_factors = []
    area_paces = []
    for area in grid.areas:
        area_factors.append((penalty or np.inf) if area.bars(agent) else area.cost)
        area_paces.append(1.0 / min(speed, area.speed or speed))
    area_factor = values_by_area(grid, area_factors, 1.0)
    pace = values_by_area(grid, area_paces, 1.0 / speed)
    flat = FlatGrid(
        layout=layout,
        steps=steps,
        arcs=find_arcs(grid.links, start, agent, penalty),
        floors=floors,
        free=np.isfinite(weight),
        weight=weight,
        area_factor=area_factor[:1] if (area_factor == area_factor[0]).all() else area_factor,
        pace=pace[:1] if (pace == pace[0]).all() else pace,
        slopes=_mark_slopes(step_array, ends, layout),
    )
    weight[:] = flat.weights_for_agent(weight)
    flat.free[:] = np.isfinite(weight)
    # The length of a step is the octile distance between the centres of its cells, from above, and
    # at least a cell: between neighbours on one lattice, as navbake links them, exactly a cell.
    sources, targets = flat.step_ends()
    smaller_size = np.minimum(cell_size[flat.level_of(sources)], cell_size[flat.level_of(targets)])
    lengths = octile_length(flat.positions(sources) - flat.positions(targets))
    steps.length[:] = np.maximum(lengths, smaller_size)
    return flat


def _mark_slopes(step_array: Int, ends: Int, layout: Layout) -> NDArray[np.uint8]:
    """Make `FlatGrid.slopes`.

    Args:
        step_array: level, cell, level, cell of each step, shape (n, 4).
        ends: the flat ids of these cells, shape (n, 2).
        layout: where the cells lie.
    """
    if not (step_array[:, 0] == step_array[:, 2]).any():
        return np.zeros(0, dtype=np.uint8)
    slopes = np.zeros(layout.start[-1], dtype=np.uint8)
    level = step_array[:, 0]
    width = layout.width[level]
    lower_end = ends.min(axis=1)
    difference = np.ptp(ends, axis=1)
    is_on_level = level == step_array[:, 2]
    rows = (ends - layout.start[level, None]) // width[:, None]
    is_same_row = np.diff(rows)[:, 0] == 0
    leads_east = is_on_level & (difference == 1) & is_same_row
    leads_south = is_on_level & (difference == width)
    slopes[lower_end[leads_east]] |= np.uint8(arrays.EAST)
    slopes[lower_end[leads_south]] |= np.uint8(arrays.SOUTH)
    return slopes


# ---------------------------------------------------------------- rooms


@dataclass(frozen=True, eq=False)
class RoomMap:
    """The room of each cell, by number: 1 is the first of `rooms`, 0 is no room.

    Attributes:
        scene_id: scene id of the grid, for messages.
        rooms: the rooms of the grid's table, then the rooms that cells have but the table lacks.
        number: the number of each cell's room, by flat id, shape (n,).
    """

    scene_id: str | None
    rooms: list[Room]
    number: Int32

    def find(self, name: str) -> int:
        """Find the number of a room by its id, or by its name where only one room has it.

        Raises:
            QueryError: there is no such room, or several rooms have the name.
        """
        by_id = {room.id: number for number, room in enumerate(self.rooms, start=1)}
        if isinstance(name, str) and name in by_id:
            return by_id[name]
        ids = [room.id for room in self.rooms if room.name and room.name == name]
        if len(ids) == 1:
            return by_id[ids[0]]
        if ids:
            rooms = f"{len(ids)} rooms in {self.scene_id!r} have the name {name!r}"
            expected = f"one of the ids {', '.join(ids)}"
            raise QueryError(
                f"{rooms}: expected {expected}", key="room", value=name, expected=expected
            )
        names = [*by_id, *(room.name for room in self.rooms if room.name)]
        hint = suggest(name, names)
        raise QueryError(
            f"no room {name!r} in {self.scene_id!r}: {hint}", key="room", value=name, hint=hint
        )

    def id_of(self, number: int) -> str | None:
        """Return the id of a room by its number; None for 0."""
        return self.rooms[number - 1].id if number else None

    def cells(self, name: str) -> Int:
        """List the flat ids of a room's cells, free or not; ascending, int64."""
        return np.flatnonzero(self.number == self.find(name))


def map_rooms(grid: NavGrid) -> RoomMap:
    """Number the rooms of a grid; rooms missing in its table get the id ``level:index``."""
    rooms = list(grid.rooms)
    numbers_by_level = []
    for level_number, level in enumerate(grid.levels):
        index = level.room_index
        numbers = np.zeros(int(index.max(initial=0)) + 1, dtype=np.int32)  # by index on the level
        for number, room in enumerate(rooms, start=1):
            if room.level == level_number and room.index < len(numbers):
                numbers[room.index] = number
        # measuring rooms is slow: only where cells name a room that the table lacks
        if ((numbers[index] == 0) & (index > 0)).any():
            for room in level.measure_rooms(level_number):
                if not numbers[room.index]:
                    rooms.append(room)
                    numbers[room.index] = len(rooms)
        numbers_by_level.append(numbers[index].ravel())
    return RoomMap(grid.scene_id, rooms, np.concatenate(numbers_by_level))


# ---------------------------------------------------------------- doors and stairs


DoorMap = dict[int, list[str]]
"""For each cell in a door, by flat id: the ids of its doors."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Find the doors that each cell is in.

    A cell is in a door if the door blocks it when closed or in its current state. In a file of
    another program without a table of doors, the user data of cells name their doors.
    """
    doors_by_cell: DoorMap = {}
    start = flat.layout.start.tolist()
    for door in grid.doors:
        door_cells = []
        for state in ("closed", door.state):
            for level, ids in enumerate(door.cells_in(state, flat.num_levels)):
                door_cells.append(start[level] + ids)
        for cell in np.unique(np.concatenate(door_cells)).tolist():
            doors_by_cell.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level_number, level_grid in enumerate(grid.levels):
            for cell, entry in level_grid.user_data.items():
                names = entry.get("doors")
                if isinstance(names, list):
                    door_ids = [name for name in names if isinstance(name, str)]
                    doors_by_cell[start[level_number] + cell] = door_ids
    return doors_by_cell


def find_leaf_cells(door: Door, flat: FlatGrid) -> Int:
    """List the cells that a door's leaf covers when closed.

    Args:
        door: a door of the grid.
        flat: the grid.

    Returns:
        Flat ids. If the file doesn't tell which cells the leaf itself covers, all cells that the
        closed door blocks.
    """
    cells_in = door.solid_in if door.solid else door.cells_in
    cells_by_level = cells_in("closed", flat.num_levels)
    starts = flat.layout.start[:-1]
    return np.concatenate([start + ids for start, ids in zip(starts, cells_by_level, strict=True)])


def list_doors_along(doors: DoorMap, cells: Int) -> list[str]:
    """List the ids of the doors along a route, in order.

    A door that the route enters twice is listed twice.

    Args:
        doors: the doors by flat id.
        cells: the route's flat ids.
    """
    door_ids: list[str] = []
    current: Iterable[str] = ()
    for cell in cells.tolist():
        cell_doors = doors.get(cell, ())
        door_ids += [name for name in cell_doors if name not in current]
        current = cell_doors
    return door_ids


class LevelStairs(NamedTuple):
    """Stairs or a ramp between two levels: a group of steps whose cells touch on the lower level.

    Attributes:
        lower_level: number of the lower level.
        upper_level: number of the upper level.
        kind: ``stairs`` or ``ramp``.
        steps: for each step, the flat ids of its cells on the lower and the upper level, shape
            (n, 2).
    """

    lower_level: int
    upper_level: int
    kind: str
    steps: Int


def find_stairs(grid: NavGrid, flat: FlatGrid) -> list[LevelStairs]:
    """Find the stairs and ramps between levels.

    Args:
        grid: the grid whose `step_array` lists the steps.
        flat: the same grid, or one of the same cells.
    """
    steps = grid.step_array
    is_upwards = (steps[:, 0] <= steps[:, 2])[:, None]
    steps = np.where(is_upwards, steps, steps[:, [2, 3, 0, 1]])
    stairs = []
    for group in group_steps(grid, steps[steps[:, 0] < steps[:, 2]]):
        ends = flat.layout.start[group[:, ::2]] + group[:, 1::2]
        rise = np.abs(np.diff(flat.positions(ends)[..., 2], axis=1)).max()
        lower_level, upper_level = group[0, ::2].tolist()
        kind = "stairs" if rise > STAIRS_RISE else "ramp"
        stairs.append(LevelStairs(lower_level, upper_level, kind, ends))
    return stairs


# ---------------------------------------------------------------- islands


@dataclass(frozen=True, eq=False)
class IslandMap:
    """The islands of a grid: connected parts of its free cells, numbered from 1, the largest."""

    number: Int32  #: Number of each cell's island, by flat id, shape (n,); 0 where it isn't free.
    areas: Float  #: Area of each island, by its number [m²], shape (count + 1,); 0 for number 0.
    #: Pairs of islands, shape (k, 2): links lead from the first to the second, none lead back.
    one_way_links: Int

    @property
    def count(self) -> int:
        """Number of islands."""
        return len(self.areas) - 1

    def check(self, island: int) -> int:
        """Check an island's number, and return it as an int.

        Raises:
            QueryError: there is no such island.
        """
        if isinstance(island, int | np.integer) and 1 <= island <= self.count:
            return int(island)
        numbers = f"1 to {self.count}, 1 the largest" if self.count else "none"
        raise QueryError(
            f"no island {island!r}: there are {numbers}",
            key="island",
            value=island,
            expected=numbers,
        )

    def reached_from(self, island: int) -> tuple[int, ...]:
        """List the islands reachable from one: itself first, then the others, ascending."""
        reached = np.array([island])
        while True:
            is_from_reached = np.isin(self.one_way_links[:, 0], reached)
            next_islands = np.unique(self.one_way_links[is_from_reached, 1])
            next_islands = next_islands[~np.isin(next_islands, reached)]
            if not len(next_islands):
                return island, *np.sort(reached[1:]).tolist()
            reached = np.append(reached, next_islands)


def map_islands(flat: FlatGrid, radius: float, moves: NDArray[np.uint8] | None = None) -> IslandMap:
    """Number the islands of a flat grid, like `navbake.navgrid.islands.find_islands`.

    Args:
        flat: the grid.
        radius: the agent's radius [m]; links that are too narrow for it don't count.
        moves: by flat id, see `navbake.runtime.grid_arrays.Graph`; if given, cells that a diagonal
            move joins are connected, too.
    """
    layout = flat.layout
    floors = flat.floors
    steps = [np.stack(flat.step_ends(), axis=1)]
    passages = flat.arcs.ends[flat.arcs.fits_radius(radius)]
    if moves is not None:
        for bit, col_step in ((arrays.SOUTH_WEST, -1), (arrays.SOUTH_EAST, 1)):
            cells = np.flatnonzero(moves & bit)
            diagonal_cells = cells + layout.width[flat.level_of(cells)] + col_step
            steps.append(np.stack([cells, diagonal_cells], axis=1))
    number = label_islands(
        start=layout.start,
        width=layout.width,
        free=flat.free,
        floor=floors.z,
        limit=floors.max_step,
        steps=np.concatenate(steps),
        arcs=passages,
    )
    # in a few files, levels have cells of different sizes
    areas = np.zeros(int(number.max(initial=0)) + 1)
    for level, size in enumerate(layout.cell_size):
        cells_by_island = np.bincount(number[flat.cells_of(level)], minlength=len(areas))
        areas[1:] += cells_by_island[1:] * size**2
    links = number[passages]
    is_between = (links > 0).all(axis=1) & (links[:, 0] != links[:, 1])
    one_way_links = np.unique(links[is_between], axis=0)
    return IslandMap(number, areas, one_way_links.astype(np.int64))
