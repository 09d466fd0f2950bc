"""Numbers the cells of all levels of a grid one after the other, as kernels need them.

The number of a cell in this order is its flat id. Arrays "by flat id" have one entry for each cell
of the grid, such as its weight or the numbers of its room and its island.

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
from navbake.lengths import format_position
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
    """The cells of all levels in one array, and the steps that the floors alone don't give.

    The flat id of a cell is ``start[level] + row * width[level] + col``. A step joins two free
    neighbours whose floors differ by at most `max_step`, or two free cells of the grid's `steps`.
    Cells of areas that bar the agent aren't free.

    Attributes:
        layout: where the cells of each level lie.
        steps: the steps of the grid's table, each in both directions: those from level to level,
            and those between cells of one level that floors alone don't give.
        arcs: the arcs over named links, for agents of any size; an arc leads over a link from one
            stop to another.
        floors: heights of the cells' floors [m], and `max_step`.
        free: where the agent can stand, by flat id, shape (n,).
        weight: the cost of each cell, by flat id, inf where it isn't free.
        area_factor: the factor by which the area of a cell multiplies its weight, inf where the
            area bars the agent; by flat id, or one number for all cells.
        pace: the seconds that the agent takes for a metre [s/m]; by flat id, or one number for all
            cells.
        slope_bits: by flat id, whether one of `steps` joins the cell to its neighbour in the next
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
    slope_bits: NDArray[np.uint8]

    @property
    def num_levels(self) -> int:
        """Number of levels."""
        return len(self.layout.width)

    @property
    def num_cells(self) -> int:
        """Number of cells on all levels."""
        return int(self.layout.start[-1])

    def cells_of(self, level: int) -> slice:
        """Return the range of the flat ids of a level's cells, to slice arrays by flat id."""
        return slice(int(self.layout.start[level]), int(self.layout.start[level + 1]))

    def level_of(self, cells: Int | int) -> Int:
        """Return the number of each cell's level, in the shape of `cells`, which are flat ids."""
        return np.searchsorted(self.layout.start, cells, side="right") - 1

    def to_cells(self, cells: Int | int) -> Cells:
        """Convert flat ids to level, row and column, each of the same shape; -1 stays -1."""
        cells = np.asarray(cells, dtype=np.int64)
        level = self.level_of(cells)
        row, col = np.divmod(cells - self.layout.start[level], self.layout.width[level])
        return Cells(
            level=level,
            row=np.where(level < 0, -1, row),
            col=np.where(level < 0, -1, col),
        )

    def to_cell(self, cell: int) -> Cell:
        """Convert one flat id to level, row and column."""
        level = int(self.level_of(cell))
        if level < 0:
            return Cell(-1, -1, -1)
        row, col = divmod(int(cell) - int(self.layout.start[level]), int(self.layout.width[level]))
        return Cell(level, row, col)

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
        checked_positions = check_positions(positions, self.num_levels, level)
        kernel_level, kernel_positions = to_kernel_positions(checked_positions, level)
        cells: Int = place_kernels.locate(self.layout, self.floors, kernel_level, kernel_positions)
        return cells.reshape(checked_positions.shape[:-1])

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
        kernel_level, kernel_positions = to_kernel_positions(checked_position, level)
        cells = place_kernels.locate(self.layout, self.floors, kernel_level, kernel_positions)
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
        level, row, col = self.to_cells(cells)
        cell_size = self.layout.cell_size[level]
        x = self.layout.x_min[level] + (col + 0.5) * cell_size
        y = self.layout.y_max[level] - (row + 0.5) * cell_size
        return np.stack([x, y, self._floor_heights(cells, level)], axis=-1)

    def floor_heights(self, cells: Int | int) -> Float:
        """Look up the floors of cells.

        Args:
            cells: flat ids, shape (...).

        Returns:
            World z, the level's ground where a cell has no floor [m], shape (...).
        """
        return self._floor_heights(cells, self.level_of(cells))

    def _floor_heights(self, cells: Int | int, levels: Int) -> Float:
        """Look up the floors of cells on levels, see `floor_heights`."""
        floor_z = self.floors.z[cells]
        return np.where(np.isnan(floor_z), self.floors.ground[levels], floor_z)

    def step_ends(self) -> tuple[Int, Int]:
        """List the two cells that each of `steps` joins; a step is listed in both directions.

        Returns:
            The flat ids of the cells that the steps lead from, shape (n,); and of those that they
            lead to, shape (n,).
        """
        sources = np.repeat(self.steps.cell, np.diff(self.steps.start))
        return sources, self.steps.target

    def weights_for_agent(self, weight: Float, cells: Int | slice = np.s_[:]) -> Float:
        """Multiply the weights of cells by the cost factors of the areas that the cells are in.

        Args:
            weight: the grid's weights of the cells, inf where they aren't free.
            cells: the cells' flat ids, of the shape of `weight`; all unless given.

        Returns:
            The weights times the areas' factors; inf where a cell isn't free for the agent.
        """
        area_factor = self.area_factor[cells] if len(self.area_factor) > 1 else self.area_factor
        is_free = np.isfinite(weight) & np.isfinite(area_factor)
        return np.where(is_free, weight * np.where(is_free, area_factor, 1.0), np.inf)

    def costs_between_stops(
        self, radius: float, least_weight: float, *, by_time: bool
    ) -> tuple[Float, Float]:
        """Compute a lower bound of the cost of a route between any two stops of links.

        Over the floor, a route between two stops costs at least their octile distance times the
        smallest weight. Over a link, it costs the link's cost. The bound is the cost of the
        cheapest sequence of such passages.

        Args:
            radius: the agent's radius [m].
            least_weight: the smallest weight of a free cell, >= 0.
            by_time: whether links cost seconds; if False, metres.

        Returns:
            World x, y of the k stops [m], shape (k, 2); and the bound from stop i to stop j,
            shape (k, k). If no link makes a route cheaper than over the floor, k is 0.
        """
        is_passable = self.arcs.fits_radius(radius)
        stop_cells, stop_pairs = np.unique(self.arcs.ends[is_passable], return_inverse=True)
        stop_positions = self.positions(stop_cells)[:, :2]
        stop_pairs = stop_pairs.reshape(-1, 2)
        floor_costs = least_weight * octile_length(stop_positions[:, None] - stop_positions)
        costs = floor_costs.copy()
        arc_costs = self.arcs.seconds if by_time else self.arcs.cost
        np.minimum.at(costs, tuple(stop_pairs.T), arc_costs[is_passable])
        for middle_stop in range(len(stop_cells)):  # all shortest paths: Floyd (1962)
            costs = np.minimum(costs, costs[:, middle_stop, None] + costs[middle_stop])
        if (costs < floor_costs).any():
            return stop_positions, costs
        return stop_positions[:0], costs

    def links(self, radius: float, *, by_time: bool = False, are_reversed: bool = False) -> Links:
        """List the steps, and the arcs over links that are wide enough for an agent.

        Args:
            radius: the agent's radius [m].
            by_time: whether arcs cost seconds; if False, metres.
            are_reversed: whether each arc leads from its end to its start.

        Returns:
            Steps and arcs, in the arrays that kernels take.
        """
        is_passable = self.arcs.fits_radius(radius)
        if not is_passable.any():
            return self.steps
        step_pairs = np.stack(self.step_ends(), axis=1)
        cell_pairs = np.concatenate([step_pairs, self.arcs.ends[is_passable]])
        arc_costs = (self.arcs.seconds if by_time else self.arcs.cost)[is_passable]
        step_lengths = self.steps.length
        lengths = np.append(step_lengths, np.zeros(len(arc_costs)))
        costs = np.append(np.zeros(len(step_lengths)), arc_costs)
        return sort_links(
            cell_pairs[:, ::-1] if are_reversed else cell_pairs, lengths, costs, self.num_cells
        )


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


def sort_links(cell_pairs: Int, lengths: Float, costs: Float, num_cells: int) -> Links:
    """Sort steps and arcs by the cell that each leads from, and put them into `Links` for kernels.

    Args:
        cell_pairs: the flat ids that each step or arc leads from and to, shape (n, 2), steps first.
        lengths: the length of each step [m], 0 for an arc, shape (n,).
        costs: the cost of each arc, 0 for a step, shape (n,).
        num_cells: number of cells of the grid.
    """
    sort_indices = np.lexsort((cell_pairs[:, 1], cell_pairs[:, 0]))  # stable: steps before arcs
    sources, targets = cell_pairs[sort_indices].T
    end_cells = np.unique(cell_pairs)
    first_link_indices = np.append(np.searchsorted(sources, end_cells), len(sources))
    is_end = np.zeros(num_cells if len(end_cells) else 0, dtype=np.bool_)
    is_end[end_cells] = True
    links: Links = arrays.Links(
        cell=end_cells,
        start=first_link_indices,
        target=np.ascontiguousarray(targets),
        length=lengths[sort_indices],
        cost=costs[sort_indices],
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


def check_positive(number: float, name: str) -> None:
    """Check that a number that a user passes is finite and > 0.

    Args:
        number: expected to be a finite number > 0.
        name: the argument's name in the error.

    Raises:
        QueryError: the number is anything else.
    """
    is_number = isinstance(number, RealNumber) and not isinstance(number, bool)
    if not is_number or not 0 < number < math.inf:
        expected = f"a {name} > 0"
        raise QueryError(
            f"expected {expected}, got {number!r}", key=name, value=number, expected=expected
        )


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
        penalty: None to keep the agent off links and areas that bar it. A number lets it use them
            at a high cost: it is added to the cost of such a link [m], and multiplies the weights
            of cells in such an area.

    Returns:
        The flat grid.
    """
    compiled.ensure_compiled("runtime.")
    levels = grid.levels
    x_min, y_max, cell_size, width, height = np.array([level.lattice for level in levels]).T.copy()
    width = width.astype(np.int64)
    height = height.astype(np.int64)
    first_cells = np.append(0, np.cumsum(width * height))
    layout: Layout = arrays.Layout(
        start=first_cells, width=width, height=height, x_min=x_min, y_max=y_max, cell_size=cell_size
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
    step_cells = first_cells[step_array[:, ::2]] + step_array[:, 1::2]
    step_pairs = np.unique(np.concatenate([step_cells, step_cells[:, ::-1]]), axis=0)
    step_pairs = step_pairs[step_pairs[:, 0] != step_pairs[:, 1]]
    steps = sort_links(
        step_pairs, np.empty(len(step_pairs)), np.zeros(len(step_pairs)), int(first_cells[-1])
    )

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
        arcs=find_arcs(grid.links, first_cells, agent, penalty),
        floors=floors,
        free=np.isfinite(weight),
        weight=weight,
        area_factor=_shorten_if_equal(area_factor),
        pace=_shorten_if_equal(pace),
        slope_bits=_mark_slopes(step_array, step_cells, layout),
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


def _shorten_if_equal(value_of_cell: Float) -> Float:
    """Return only the first of the values of all cells if they are all equal."""
    return value_of_cell[:1] if (value_of_cell == value_of_cell[0]).all() else value_of_cell


def _mark_slopes(step_array: Int, step_cells: Int, layout: Layout) -> NDArray[np.uint8]:
    """Mark the cells that a step of the table joins to the next cell in their row or column.

    The result is `FlatGrid.slope_bits`.


    Args:
        step_array: level, cell, level, cell of each step, shape (n, 4).
        step_cells: the flat ids of these cells, shape (n, 2).
        layout: where the cells lie.
    """
    if not (step_array[:, 0] == step_array[:, 2]).any():
        return np.zeros(0, dtype=np.uint8)
    slope_bits = np.zeros(layout.start[-1], dtype=np.uint8)
    levels = step_array[:, 0]
    widths = layout.width[levels]
    smaller_ids = step_cells.min(axis=1)
    id_differences = np.ptp(step_cells, axis=1)
    is_on_level = levels == step_array[:, 2]
    rows = (step_cells - layout.start[levels, None]) // widths[:, None]
    is_same_row = np.diff(rows)[:, 0] == 0
    leads_east = is_on_level & (id_differences == 1) & is_same_row
    leads_south = is_on_level & (id_differences == widths)
    slope_bits[smaller_ids[leads_east]] |= np.uint8(arrays.EAST)
    slope_bits[smaller_ids[leads_south]] |= np.uint8(arrays.SOUTH)
    return slope_bits


# ---------------------------------------------------------------- rooms


@dataclass(frozen=True, eq=False)
class RoomMap:
    """The rooms of a grid, and the number of each cell's room.

    Number 1 is the first of `rooms`; 0 stands for no room.

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
        number_by_id = {room.id: number for number, room in enumerate(self.rooms, start=1)}
        if isinstance(name, str) and name in number_by_id:
            return number_by_id[name]
        matching_ids = [room.id for room in self.rooms if room.name and room.name == name]
        if len(matching_ids) == 1:
            return number_by_id[matching_ids[0]]
        if matching_ids:
            rooms_text = f"{len(matching_ids)} rooms in {self.scene_id!r} have the name {name!r}"
            expected = f"one of the ids {', '.join(matching_ids)}"
            raise QueryError(
                f"{rooms_text}: expected {expected}", key="room", value=name, expected=expected
            )
        names = [*number_by_id, *(room.name for room in self.rooms if room.name)]
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
    """Number the rooms of a grid, and find the number of each cell's room.

    A room that cells have but the grid's table lacks gets the id ``level:index``, such as ``0:2``.
    """
    rooms = list(grid.rooms)
    room_numbers_by_level = []
    for level_number, level in enumerate(grid.levels):
        room_index = level.room_index
        room_number_by_index = np.zeros(
            int(room_index.max(initial=0)) + 1, dtype=np.int32
        )  # by room index
        for room_number, room in enumerate(rooms, start=1):
            if room.level == level_number and room.index < len(room_number_by_index):
                room_number_by_index[room.index] = room_number
        # measuring rooms is slow: only where cells name a room that the table lacks
        if ((room_number_by_index[room_index] == 0) & (room_index > 0)).any():
            for room in level.measure_rooms(level_number):
                if not room_number_by_index[room.index]:
                    rooms.append(room)
                    room_number_by_index[room.index] = len(rooms)
        room_numbers_by_level.append(room_number_by_index[room_index].ravel())
    return RoomMap(grid.scene_id, rooms, np.concatenate(room_numbers_by_level))


# ---------------------------------------------------------------- doors and stairs


DoorMap = dict[int, list[str]]
"""For each cell in a door, by flat id: the ids of its doors."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Find the doors that each cell is in.

    A cell is in a door if the door blocks it when closed or in its current state. In a file of
    another program without a table of doors, the user data of cells name their doors.

    Args:
        grid: the grid whose doors are found.
        flat: the same grid, or one of the same cells.

    Returns:
        Flat id of a cell -> the ids of the doors that it is in, for the cells that are in any.
    """
    doors_by_cell: DoorMap = {}
    first_cells = flat.layout.start.tolist()
    for door in grid.doors:
        door_cells = []
        for state in ("closed", door.state):
            for level, cell_ids in enumerate(door.cells_in(state, flat.num_levels)):
                door_cells.append(first_cells[level] + cell_ids)
        for cell in np.unique(np.concatenate(door_cells)).tolist():
            doors_by_cell.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level_number, level_grid in enumerate(grid.levels):
            for cell, cell_data in level_grid.user_data.items():
                door_names = cell_data.get("doors")
                if isinstance(door_names, list):
                    door_ids = [name for name in door_names if isinstance(name, str)]
                    doors_by_cell[first_cells[level_number] + cell] = door_ids
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
    list_cells_in = door.solid_in if door.solid else door.cells_in
    cells_by_level = list_cells_in("closed", flat.num_levels)
    first_cells = flat.layout.start[:-1]
    return np.concatenate(
        [
            first_cell + cell_ids
            for first_cell, cell_ids in zip(first_cells, cells_by_level, strict=True)
        ]
    )


def list_doors_along(doors: DoorMap, cells: Int) -> list[str]:
    """List the ids of the doors along a route, in order.

    A door that the route enters twice is listed twice.

    Args:
        doors: the doors by flat id.
        cells: the route's flat ids.
    """
    door_ids: list[str] = []
    previous_door_ids: Iterable[str] = ()
    for cell in cells.tolist():
        cell_door_ids = doors.get(cell, ())
        door_ids += [name for name in cell_door_ids if name not in previous_door_ids]
        previous_door_ids = cell_door_ids
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
    step_rows = grid.step_array
    leads_upwards = (step_rows[:, 0] <= step_rows[:, 2])[:, None]
    step_rows = np.where(leads_upwards, step_rows, step_rows[:, [2, 3, 0, 1]])
    stairs = []
    for stair_steps in group_steps(grid, step_rows[step_rows[:, 0] < step_rows[:, 2]]):
        step_cells = flat.layout.start[stair_steps[:, ::2]] + stair_steps[:, 1::2]
        rise = np.abs(np.diff(flat.positions(step_cells)[..., 2], axis=1)).max()
        lower_level, upper_level = stair_steps[0, ::2].tolist()
        kind = "stairs" if rise > STAIRS_RISE else "ramp"
        stairs.append(LevelStairs(lower_level, upper_level, kind, step_cells))
    return stairs


# ---------------------------------------------------------------- islands


@dataclass(frozen=True, eq=False)
class IslandMap:
    """The islands of a grid: the connected parts of its free cells.

    They are numbered from 1 by their size; island 1 is the largest.
    """

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
        numbers_text = f"1 to {self.count}, 1 the largest" if self.count else "none"
        raise QueryError(
            f"no island {island!r}: there are {numbers_text}",
            key="island",
            value=island,
            expected=numbers_text,
        )

    def reached_from(self, island: int) -> tuple[int, ...]:
        """List the islands to which paths lead from an island, also over one-way links.

        Returns:
            The numbers of the islands: the given one first, then the others, ascending.
        """
        reached_islands = np.array([island])
        while True:
            leads_from_reached = np.isin(self.one_way_links[:, 0], reached_islands)
            next_islands = np.unique(self.one_way_links[leads_from_reached, 1])
            next_islands = next_islands[~np.isin(next_islands, reached_islands)]
            if not len(next_islands):
                return island, *np.sort(reached_islands[1:]).tolist()
            reached_islands = np.append(reached_islands, next_islands)


def map_islands(flat: FlatGrid, radius: float, moves: NDArray[np.uint8] | None = None) -> IslandMap:
    """Number the islands of a flat grid, like `navbake.navgrid.islands.find_islands`.

    Args:
        flat: the grid.
        radius: the agent's radius [m]; links that are too narrow for it don't count.
        moves: for an agent that may cut corners: by flat id, a bit for each direction that it can
            move in from the cell, see `navbake.runtime.grid_arrays.Graph`. Cells that a diagonal
            move joins are then connected, too. None to connect cells over their edges only.
    """
    layout = flat.layout
    floors = flat.floors
    step_pair_arrays = [np.stack(flat.step_ends(), axis=1)]
    arc_ends = flat.arcs.ends[flat.arcs.fits_radius(radius)]
    if moves is not None:
        for bit, col_step in ((arrays.SOUTH_WEST, -1), (arrays.SOUTH_EAST, 1)):
            cells = np.flatnonzero(moves & bit)
            diagonal_cells = cells + layout.width[flat.level_of(cells)] + col_step
            step_pair_arrays.append(np.stack([cells, diagonal_cells], axis=1))
    number = label_islands(
        first_cells=layout.start,
        widths=layout.width,
        is_free=flat.free,
        floor=floors.z,
        max_rise=floors.max_step,
        steps=np.concatenate(step_pair_arrays),
        arcs=arc_ends,
    )
    # in a few files, levels have cells of different sizes
    areas = np.zeros(int(number.max(initial=0)) + 1)
    for level, cell_size in enumerate(layout.cell_size):
        cells_by_island = np.bincount(number[flat.cells_of(level)], minlength=len(areas))
        areas[1:] += cells_by_island[1:] * cell_size**2
    island_pairs = number[arc_ends]
    joins_two_islands = (island_pairs > 0).all(axis=1) & (island_pairs[:, 0] != island_pairs[:, 1])
    one_way_links = np.unique(island_pairs[joins_two_islands], axis=0)
    return IslandMap(number, areas, one_way_links.astype(np.int64))
