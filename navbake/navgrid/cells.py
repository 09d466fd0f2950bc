"""Converts positions to cells and cells to positions, and looks up values of layers there.

A position belongs to the level with the highest floor that is at most a step above the position. So
a position under a bridge belongs to the level below, and a position on the bridge to the level
above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lengths import format_bounds, format_coordinate
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.islands import STEP_SLACK, islands_of, measure_clearance
from navbake.navgrid.lattice import Cell as Cell
from navbake.navgrid.lattice import Cells as Cells
from navbake.navgrid.obstacle_state import BLOCKED
from navbake.types import Bool, Float, Int

FLOAT32_ROUNDING = 1e-6  # relative error of the floors in files, which are float32
CellsLike = Cell | Cells | tuple[ArrayLike, ArrayLike, ArrayLike]
"""Level, row and column of one cell; or of several cells, as three arrays."""


class Layer(NamedTuple):
    """A layer that `values_at` looks up, such as ``floor``.

    Attributes:
        compute: Computes the layer of a grid: an array for each level, shape (height, width).
        value_outside: The value of positions outside the grid.
    """

    compute: Callable[[NavGrid], list[NDArray[Any]]]
    value_outside: float


LAYERS = {
    "floor": Layer(lambda grid: [level.floor for level in grid.levels], np.nan),
    "free": Layer(lambda grid: [level.free for level in grid.levels], False),
    "occupancy": Layer(lambda grid: [level.occupancy for level in grid.levels], 1),
    "weight": Layer(
        lambda grid: [level.weights.astype(np.float64) for level in grid.levels], np.inf
    ),
    "room": Layer(lambda grid: [level.room_index for level in grid.levels], 0),
    "island": Layer(lambda grid: list(islands_of(grid)), 0),
    "clearance": Layer(lambda grid: [measure_clearance(level) for level in grid.levels], 0),
}
"""The layers by name. `values_at` takes any other name for the name of an attribute in the file."""


def cell_at(grid: GridBase, position: ArrayLike, level: int | None = None) -> Cell | None:
    """Return the cell of a position; see `GridBase.cell_at`.

    Args:
        grid: The grid.
        position: World x, y, z [m], shape (3,), or x, y.
        level: The level of the cell, 0 is the lowest; None to find it by z.

    Returns:
        Level, row and column; None if there is no cell.

    Raises:
        QueryError: The level does not exist, or the position is not valid.
    """
    if isinstance(position, int | float) and level is not None:
        expected = "a position in one argument, as in (1.5, -2.0)"
        raise QueryError(
            f"expected {expected}, got {position!r}, {level!r}",
            key="position",
            value=position,
            expected=expected,
        )
    cells = cells_at(grid, position, level)
    if cells.level.ndim:
        shape = np.shape(position)
        raise QueryError(
            f"expected one position, got an array of shape {shape}",
            key="position",
            value=position,
            expected="one position",
        )
    cell = Cell(int(cells.level), int(cells.row), int(cells.col))
    return cell if cell.level >= 0 else None


def describe_outside(grid: NavGrid, position: ArrayLike) -> str:
    """Say where a position lies that is in no cell: beside the grid, or below its floors.

    Args:
        grid: The grid.
        position: World x, y and maybe z [m], a position for which `cell_at` returns None.

    Returns:
        A clause whose subject is the position.
    """
    coordinates = np.asarray(position, dtype=np.float64)
    level_bounds = np.array([level.lattice.bounds for level in grid.levels])
    x_min, y_min = level_bounds[:, :2].min(axis=0)
    x_max, y_max = level_bounds[:, 2:].max(axis=0)
    if not (x_min <= coordinates[0] <= x_max and y_min <= coordinates[1] <= y_max):
        return f"lies beside the grid, {format_bounds((x_min, y_min, x_max, y_max))}"
    lowest_ground = min(level.ground for level in grid.levels)
    if len(coordinates) == 3 and coordinates[2] < lowest_ground:
        floor_text = f"lies below every floor, the lowest at z {format_coordinate(lowest_ground)}"
        return f"{floor_text}: positions are x, y, z with z up [m]"
    return "has no floor below it"


def cells_at(grid: GridBase, positions: ArrayLike, level: int | None = None) -> Cells:
    """Return the cells of positions; see `GridBase.cells_at`.

    Args:
        grid: The grid.
        positions: World x, y, z [m], shape (..., 3), or x, y.
        level: The level of all cells, 0 is the lowest; None to find each by z.

    Returns:
        Level, row and column, each of shape (...), int64; -1 for no cell.

    Raises:
        QueryError: The level does not exist, or a position is not valid.
    """
    checked_positions = check_positions(positions, len(grid.levels), level)
    flat_positions = checked_positions.reshape(-1, checked_positions.shape[-1])
    if level is None and checked_positions.shape[-1] == 3:
        cells = _find_cells_below(grid, flat_positions)
    else:
        cells = _find_cells_on_level(grid, level or 0, flat_positions)
    shape = checked_positions.shape[:-1]
    return Cells(cells[0].reshape(shape), cells[1].reshape(shape), cells[2].reshape(shape))


def position_of(grid: GridBase, cells: CellsLike) -> Float:
    """Return the centres of cells, on the floor; see `GridBase.position_of`.

    Args:
        grid: The grid.
        cells: Level, row and column, of shape (...).

    Returns:
        World x, y, z [m], shape (..., 3), float64.

    Raises:
        QueryError: A cell does not exist.
    """
    checked_cells = check_cells(grid, cells)
    positions = np.empty((*checked_cells.level.shape, 3), dtype=np.float64)
    for level_number, level in enumerate(grid.levels):
        is_on_level = checked_cells.level == level_number
        rows = checked_cells.row[is_on_level]
        cols = checked_cells.col[is_on_level]
        floor_z = _floors_of_cells(level, rows, cols)
        positions[is_on_level, :2] = level.lattice.positions(rows, cols)
        positions[is_on_level, 2] = np.where(np.isnan(floor_z), level.ground, floor_z)
    return positions


def check_cells(grid: GridBase, cells: CellsLike) -> Cells:
    """Check that cells exist, and broadcast them to one shape, int64.

    Args:
        grid: The grid.
        cells: Level, row and column, of shapes that can be broadcast.

    Raises:
        QueryError: A value is not an integer, the shapes do not fit, or a cell does not exist.
    """
    try:
        arrays = np.broadcast_arrays(*(np.asarray(axis) for axis in cells))
    except (TypeError, ValueError):
        arrays = ()
    if len(arrays) != 3 or any(array.dtype.kind not in "iu" and array.size for array in arrays):
        expected = "cells as (level, row, col), whole numbers"
        raise QueryError(
            f"expected {expected}, got {cells!r}", key="cells", value=cells, expected=expected
        )
    checked_cells = Cells(*(array.astype(np.int64) for array in arrays))
    level, row, col = checked_cells
    is_existing = (level >= 0) & (level < len(grid.levels)) & (row >= 0) & (col >= 0)
    # a level that does not exist gets the shape of level 0; its cells are faulty anyway
    level_shapes = np.array([level_grid.shape for level_grid in grid.levels])
    shapes_of_levels = level_shapes[np.where(is_existing, level, 0)]
    is_existing &= (row < shapes_of_levels[..., 0]) & (col < shapes_of_levels[..., 1])
    if not is_existing.all():
        missing_cell = tuple(int(axis[~is_existing].ravel()[0]) for axis in checked_cells)
        raise QueryError(
            f"no cell (level, row, col) = {missing_cell} in {grid.scene_id!r}",
            key="cells",
            value=missing_cell,
        )
    return checked_cells


def check_positions(positions: ArrayLike, num_levels: int, level: int | None = None) -> Float:
    """Check world positions, and return them as an array.

    Args:
        positions: World x, y, z [m], shape (..., 3); (..., 2) with a level or on one level.
        num_levels: Number of levels of the grid.
        level: The level of all positions, 0 is the lowest; None to find each by z.

    Returns:
        The positions, shape (..., 3) or (..., 2), float64.

    Raises:
        QueryError: The level does not exist, or a position is not valid.
    """
    check_level(level, num_levels)
    try:
        checked_positions = np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        expected = "world positions x, y, z [m]"
        hint = None
        message = f"expected {expected}, got {positions!r}"
        if isinstance(positions, str):
            hint = "names like room:NAME are goals, not places"
            message += f"; {hint}"
        raise QueryError(
            message, key="position", value=positions, expected=expected, hint=hint
        ) from error
    if checked_positions.ndim == 0 or checked_positions.shape[-1] not in (2, 3):
        expected = "world positions of shape (..., 3) [m]"
        raise QueryError(
            f"expected {expected}, got {checked_positions.shape}",
            key="position",
            value=positions,
            expected=expected,
        )
    if checked_positions.shape[-1] == 2 and num_levels > 1 and level is None:
        raise QueryError(
            f"expected x, y, z or a level, got x, y: the grid has {num_levels} levels, 0 to "
            f"{num_levels - 1}",
            key="position",
            value=positions,
            expected="x, y, z or a level",
        )
    is_finite = np.isfinite(checked_positions)
    if not is_finite.all():
        faulty_position = (
            checked_positions[~is_finite.all(axis=-1)][0]
            if checked_positions.ndim > 1
            else checked_positions
        )
        position_text = ", ".join(f"{coordinate:g}" for coordinate in faulty_position)
        expected = "a position of finite numbers"
        raise QueryError(
            f"expected {expected}, got {position_text}",
            key="position",
            value=tuple(faulty_position.tolist()),
            expected=expected,
        )
    return checked_positions


def check_level(level: int | None, num_levels: int) -> None:
    """Check that a level exists.

    Args:
        level: Number of the level, 0 is the lowest; None is valid.
        num_levels: Number of levels of the grid.

    Raises:
        QueryError: There is no such level.
    """
    if level is None:
        return
    if not isinstance(level, int | np.integer) or not 0 <= level < num_levels:
        expected = f"0 to {num_levels - 1}"
        raise QueryError(
            f"no level {level!r}: expected {expected}", key="level", value=level, expected=expected
        )


def _find_cells_below(grid: GridBase, positions: Float) -> Int:
    """Find for each position the cell with the highest floor at most a step above it.

    Where no level has such a floor, the levels' grounds count as floors.

    Args:
        grid: The grid.
        positions: World x, y, z [m], shape (n, 3).

    Returns:
        Level, row and column, shape (3, n); -1 for no cell.
    """
    z = positions[:, 2]
    # float32 moved the floors of files, in proportion to their height
    max_floor_z = z + grid.max_step + STEP_SLACK + np.abs(z) * FLOAT32_ROUNDING
    num_positions = len(positions)
    cells_on_floor = np.full((3, num_positions), -1, dtype=np.int64)
    cells_on_ground = np.full((3, num_positions), -1, dtype=np.int64)
    highest_floor_z = np.full(num_positions, -np.inf)
    highest_ground_z = np.full(num_positions, -np.inf)
    # the highest floor that is allowed counts; a ground counts only if there is no such floor
    for level_number, level in enumerate(grid.levels):
        cells = _find_cells_on_level(grid, level_number, positions)
        is_inside = cells[0] >= 0
        floor_z = np.full(num_positions, np.nan)
        floor_z[is_inside] = _floors_of_cells(level, cells[1, is_inside], cells[2, is_inside])
        is_higher = (floor_z <= max_floor_z) & (floor_z > highest_floor_z)  # False for NaN
        highest_floor_z[is_higher] = floor_z[is_higher]
        cells_on_floor[:, is_higher] = cells[:, is_higher]
        has_ground_only: Bool = is_inside & np.isnan(floor_z)
        is_higher = (
            has_ground_only & (level.ground <= max_floor_z) & (level.ground > highest_ground_z)
        )
        highest_ground_z[is_higher] = level.ground
        cells_on_ground[:, is_higher] = cells[:, is_higher]
    return np.where(cells_on_floor[0] >= 0, cells_on_floor, cells_on_ground)


def _find_cells_on_level(grid: GridBase, level_number: int, positions: Float) -> Int:
    """Return level, row and column of positions on one level, shape (3, n); -1 outside it."""
    x_min, y_max, cell_size, width, height = grid.levels[level_number].lattice
    row = np.floor((y_max - positions[:, 1]) / cell_size)
    col = np.floor((positions[:, 0] - x_min) / cell_size)
    # compared as floats: far positions overflow int64
    is_inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    level = np.full(len(positions), level_number)
    return np.where(is_inside, (level, row, col), -1.0).astype(np.int64)


def _floors_of_cells(level: SceneGrid2D, rows: Int, cols: Int) -> Float:
    """Return world z of the cells' floors [m], NaN for no floor.

    It is the level's ground if the level has no floors of single cells.
    """
    if not level.uses_cell_floors:
        return np.full(rows.shape, level.ground)
    return level.attributes["floorHeight"][rows, cols].astype(np.float64) * level.unit


# ---------------------------------------------------------------- layers


@dataclass(frozen=True)
class Place:
    """The values of all layers of a grid in one cell.

    Attributes:
        cell: Level, row and column.
        floor: World z of the floor [m]; None where there is none.
        free: Whether an agent can stand in the cell.
        occupied: Whether something stands in the agent's way.
        weight: Cost of the cell, inf where it is not free.
        room: Id of the room in the grid's `rooms`; None for no room.
        area: Name of the area in the grid's `areas`; None for no area.
        grid: The grid.
    """

    cell: Cell
    floor: float | None
    free: bool
    occupied: bool
    weight: float
    room: str | None
    area: str | None
    grid: NavGrid = field(repr=False, compare=False)

    @property
    def island(self) -> int | None:
        """Number of the cell's island, 1 is the largest; None where the cell is not free."""
        if not self.free:
            return None
        level, row, col = self.cell
        return int(islands_of(self.grid)[level][row, col]) or None

    @property
    def is_blocked(self) -> bool:
        """Whether an obstacle of `grid.block` currently blocks the cell."""
        level, row, col = self.cell
        obstacle_state = self.grid.levels[level].obstacle_state
        return obstacle_state is not None and bool(obstacle_state.mask_of(BLOCKED)[row, col])


def place_at(grid: NavGrid, position: ArrayLike, level: int | None = None) -> Place | None:
    """Return the values of all layers in the cell of a position; see `GridBase.at`.

    Args:
        grid: The grid.
        position: World x, y, z [m], shape (3,), or x, y.
        level: The level of the cell, 0 is the lowest; None to find it by z.

    Returns:
        The values; None if there is no cell.
    """
    cell = cell_at(grid, position, level)
    return None if cell is None else place_in(grid, cell)


def place_in(grid: NavGrid, cell: Cell) -> Place:
    """Return the values of all layers in a cell.

    Args:
        grid: The grid.
        cell: A cell that exists.
    """
    level = grid.levels[cell.level]
    floor = float(level.floor_height[cell.row, cell.col])
    weight = float(level.weights[cell.row, cell.col])
    is_free = math.isfinite(weight)
    area_number = int(level.area_index[cell.row, cell.col])
    return Place(
        cell=cell,
        floor=None if math.isnan(floor) else floor * level.unit,
        free=is_free,
        occupied=bool(level.occupancy[cell.row, cell.col]),
        weight=weight if is_free else math.inf,
        room=_find_room_id(grid, cell),
        area=grid.areas[area_number - 1].name if 0 < area_number <= len(grid.areas) else None,
        grid=grid,
    )


def _find_room_id(grid: NavGrid, cell: Cell) -> str | None:
    """Return the id of a cell's room; ``level:index`` if no table lists it; None for no room."""
    index = int(grid.levels[cell.level].room_index[cell.row, cell.col])
    if not index:
        return None
    for room in grid.stated_rooms or ():
        if room.level == cell.level and room.index == index:
            return room.id
    return f"{cell.level}:{index}"


def values_at(
    grid: NavGrid, layer: str, positions: ArrayLike, level: int | None = None
) -> NDArray[Any]:
    """Return the values of one layer at many positions; see `GridBase.values_at`.

    Args:
        grid: The grid.
        layer: A name of `LAYERS`, or of an attribute as the file stores it.
        positions: World x, y, z [m], shape (..., 3), or x, y.
        level: The level of all cells, 0 is the lowest; None to find each by z.

    Returns:
        The values, shape (...).

    Raises:
        QueryError: The layer or the level does not exist, or a position is not valid.
    """
    cells = cells_at(grid, positions, level)
    value_outside: float | None = None
    array_by_level: dict[int, NDArray[Any]] = {}  # level -> array; a level may lack the attribute
    if layer in LAYERS:
        value_outside = LAYERS[layer].value_outside
        array_by_level = dict(enumerate(LAYERS[layer].compute(grid)))
    else:
        for level_number, level_grid in enumerate(grid.levels):
            if layer in level_grid.attributes:
                array_by_level[level_number] = level_grid.attributes[layer]
    if not array_by_level:
        layer_names = [*LAYERS]
        for level_grid in grid.levels:
            layer_names += level_grid.attributes
        hint = suggest(layer, layer_names, max_listed=len(layer_names))
        raise QueryError(
            f"no layer {layer!r} in {grid.scene_id!r}: {hint}", key="layer", value=layer, hint=hint
        )
    dtype = np.result_type(*array_by_level.values())
    if value_outside is None:
        value_outside = np.nan if dtype.kind == "f" else 0
    values = np.full(cells.level.shape, value_outside, dtype=dtype)
    for level_number, array in array_by_level.items():
        is_on_level = cells.level == level_number
        values[is_on_level] = array[cells.row[is_on_level], cells.col[is_on_level]]
    return values
