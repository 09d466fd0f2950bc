"""Finds the cell and level of a position, the position of a cell, and the layers at both.

A position is on the level with the nearest floor below it, or at most a step above. So a position
under a bridge is on the level below, one on the bridge on the level above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.islands import STEP_SLACK, clearance, islands_of
from navbake.navgrid.lattice import Cell as Cell
from navbake.navgrid.lattice import Cells as Cells
from navbake.navgrid.obstacle_state import BLOCKED
from navbake.types import Float, Int

ROUNDING = 1e-6  # relative rounding of float32

LAYERS: dict[str, tuple[Callable[[NavGrid], list[NDArray[Any]]], float]] = {
    "floor": (lambda grid: [level.floor for level in grid.levels], np.nan),
    "free": (lambda grid: [level.free for level in grid.levels], False),
    "occupancy": (lambda grid: [level.occupancy for level in grid.levels], 1),
    "weight": (lambda grid: [level.weights.astype(np.float64) for level in grid.levels], np.inf),
    "room": (lambda grid: [level.room_index for level in grid.levels], 0),
    "island": (lambda grid: list(islands_of(grid)), 0),
    "clearance": (lambda grid: [clearance(level) for level in grid.levels], 0),
}
"""How each layer is made, one array a level, and its value where there is no cell."""


def cell_at(grid: GridBase, position: ArrayLike, level: int | None = None) -> Cell | None:
    """Find the cell of a position.

    Its level is the one whose floor in that column is the nearest at or below the position, a
    step (`traversableFloorHeight`) above it included. If no level has such a floor, the levels'
    grounds count instead.

    `position` is world x, y, z [m]; x, y are enough on one level. With a `level`, 0 is the lowest,
    z is ignored. Returns None outside the grid, and below all of its floors. Raises a QueryError
    if the level does not exist, or the position is invalid.
    """
    found = cells_at(grid, position, level)
    if found.level.ndim:
        raise QueryError(f"expected one position, got an array of shape {np.shape(position)}")
    cell = Cell(*(int(v) for v in found))
    return cell if cell.level >= 0 else None


def cells_at(grid: GridBase, positions: ArrayLike, level: int | None = None) -> Cells:
    """Find the cells of positions, shape (..., 3), or (..., 2) on one level; see `cell_at`.

    Returns level, row and column, each of shape (...), int64; -1 for no cell.
    """
    p = check_positions(positions, len(grid.levels), level)
    flat = p.reshape(-1, p.shape[-1])
    if level is None and p.shape[-1] == 3:
        found = _cells_under(grid, flat)
    else:
        found = _cells_on(grid, level or 0, flat)
    return Cells(*(v.reshape(p.shape[:-1]) for v in found))


def position_of(
    grid: GridBase, cells: Cell | Cells | tuple[ArrayLike, ArrayLike, ArrayLike]
) -> Float:
    """World positions of cells' centres, on the floor: x, y, z [m], shape (..., 3), float64.

    z is the level's ground where there is no floor. `cells` are one, or many of shape (...); a
    tuple (level, row, col) is enough. Raises a QueryError if one does not exist.
    """
    level, row, col = check_cells(grid, cells)
    positions = np.empty((*level.shape, 3), dtype=np.float64)
    for number, part in enumerate(grid.levels):
        here = level == number
        floor = _floors(part, row[here], col[here])
        positions[here, :2] = part.lattice.positions(row[here], col[here])
        positions[here, 2] = np.where(np.isnan(floor), part.ground, floor)
    return positions


def check_cells(
    grid: GridBase, cells: Cell | Cells | tuple[ArrayLike, ArrayLike, ArrayLike]
) -> Cells:
    """Check that cells exist, and broadcast them to one shape, int64."""
    try:
        arrays = np.broadcast_arrays(*(np.asarray(v) for v in cells))
    except (TypeError, ValueError):
        arrays = ()
    if len(arrays) != 3 or any(v.dtype.kind not in "iu" and v.size for v in arrays):
        raise QueryError(f"expected cells as (level, row, col), whole numbers, got {cells!r}")
    level, row, col = found = Cells(*(v.astype(np.int64) for v in arrays))
    known = (level >= 0) & (level < len(grid.levels)) & (row >= 0) & (col >= 0)
    shapes = np.array([part.shape for part in grid.levels])[np.where(known, level, 0)]
    known &= (row < shapes[..., 0]) & (col < shapes[..., 1])
    if not known.all():
        first = tuple(int(v[~known].ravel()[0]) for v in found)
        raise QueryError(f"no cell (level, row, col) = {first} in {grid.scene_id!r}")
    return found


def check_positions(positions: ArrayLike, num_levels: int, level: int | None = None) -> Float:
    """World positions [m] as float64, shape (..., 3); (..., 2) with one level or a given one."""
    check_level(level, num_levels)
    try:
        p = np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        hint = "; names like room:NAME are goals, not places" if isinstance(positions, str) else ""
        expected = "expected world positions x, y, z [m]"
        raise QueryError(f"{expected}, got {positions!r}{hint}") from error
    if p.ndim == 0 or p.shape[-1] not in (2, 3):
        raise QueryError(f"expected world positions of shape (..., 3) [m], got {p.shape}")
    if p.shape[-1] == 2 and num_levels > 1 and level is None:
        raise QueryError(
            f"expected x, y, z or a level, got x, y: the grid has {num_levels} levels, 0 to "
            f"{num_levels - 1}"
        )
    finite = np.isfinite(p)
    if not finite.all():
        first = p[~finite.all(axis=-1)][0] if p.ndim > 1 else p
        raise QueryError(
            f"expected a position of finite numbers, got {', '.join(f'{v:g}' for v in first)}"
        )
    return p


def check_level(level: int | None, num_levels: int) -> None:
    """Raise a QueryError for an unknown level."""
    if level is not None and not (isinstance(level, int | np.integer) and 0 <= level < num_levels):
        raise QueryError(f"no level {level!r}: expected 0 to {num_levels - 1}")


def _cells_under(grid: GridBase, p: Float) -> Int:
    """Cells of the nearest floors at or below positions, shape (n, 3); returns as `_cells_on`."""
    # float32 moved the floors, in proportion to their height
    limit = p[:, 2] + grid.max_step + STEP_SLACK + np.abs(p[:, 2]) * ROUNDING
    found, on_ground = np.full((2, 3, len(p)), -1, dtype=np.int64)
    highest, highest_ground = np.full((2, len(p)), -np.inf)
    # the highest floor so far below each position's limit; grounds count only without such a floor
    for number, part in enumerate(grid.levels):
        cells = _cells_on(grid, number, p)
        inside = cells[0] >= 0
        floor = np.full(len(p), np.nan)
        floor[inside] = _floors(part, *cells[1:, inside])
        nearer = (floor <= limit) & (floor > highest)  # False for NaN
        highest[nearer] = floor[nearer]
        found[:, nearer] = cells[:, nearer]
        nearer = inside & np.isnan(floor) & (part.ground <= limit) & (part.ground > highest_ground)
        highest_ground[nearer] = part.ground
        on_ground[:, nearer] = cells[:, nearer]
    return np.where(found[0] >= 0, found, on_ground)


def _cells_on(grid: GridBase, level: int, p: Float) -> Int:
    """Level, row and column of positions on a level, shape (3, n); -1 outside its rectangle."""
    x_min, y_max, cell_size, width, height = grid.levels[level].lattice
    row = np.floor((y_max - p[:, 1]) / cell_size)
    col = np.floor((p[:, 0] - x_min) / cell_size)
    # compare as floats: far positions overflow int64
    inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    return np.where(inside, (np.full(len(p), level), row, col), -1.0).astype(np.int64)


def _floors(level: SceneGrid2D, rows: Int, cols: Int) -> Float:
    """Floors of cells [m]; the ground if the level has no cell floors."""
    if not level.uses_cell_floors:
        return np.full(rows.shape, level.ground)
    return level.attributes["floorHeight"][rows, cols].astype(np.float64) * level.unit


# ---------------------------------------------------------------- layers


@dataclass(frozen=True)
class Place:
    """The layers of a grid in one cell."""

    cell: Cell  #: Level, row and column.
    floor: float | None  #: World z of the floor [m], None where there is none.
    free: bool  #: An agent can stand here.
    occupied: bool  #: Something stands in the agent's way.
    weight: float  #: Cost of the cell, infinite where it isn't free.
    room: str | None  #: Id of the room in the grid's `rooms`, None for none.
    area: str | None  #: Name of the area in the grid's `areas`, None for none.
    grid: NavGrid = field(repr=False, compare=False)  #: The grid.

    @property
    def island(self) -> int | None:
        """Number of the connected part, from 1, the largest; None where the cell isn't free."""
        level, row, col = self.cell
        return int(islands_of(self.grid)[level][row, col]) or None if self.free else None

    @property
    def is_blocked(self) -> bool:
        """Whether `grid.block` currently blocks the cell."""
        level, row, col = self.cell
        state = self.grid.levels[level].obstacle_state
        return state is not None and bool(state.mask_of(BLOCKED)[row, col])


def place_at(grid: NavGrid, position: ArrayLike, level: int | None = None) -> Place | None:
    """Look up all layers in the cell of a position; see `cell_at`."""
    cell = cell_at(grid, position, level)
    return None if cell is None else place_in(grid, cell)


def place_in(grid: NavGrid, cell: Cell) -> Place:
    part = grid.levels[cell.level]
    at = (cell.row, cell.col)
    floor = float(part.floor_height[at])
    weight = float(part.weights[at])
    free = math.isfinite(weight)
    index = int(part.room_index[at])
    area = int(part.area_index[at])
    of_table = (r.id for r in grid.stated_rooms or () if (r.level, r.index) == (cell.level, index))
    return Place(
        cell=cell,
        floor=None if math.isnan(floor) else floor * part.unit,
        free=free,
        occupied=bool(part.occupancy[at]),
        weight=weight if free else math.inf,
        room=next(of_table, f"{cell.level}:{index}") if index else None,
        area=grid.areas[area - 1].name if 0 < area <= len(grid.areas) else None,
        grid=grid,
    )


def values_at(
    grid: NavGrid, layer: str, positions: ArrayLike, level: int | None = None
) -> NDArray[Any]:
    """Look up one layer at positions as `cells_at` takes them.

    Layers are ``floor`` (world z [m], float64), ``free`` (bool), ``occupancy`` (uint8), ``weight``
    (float64), ``room`` (its number on its level, uint16), ``island`` (int32), ``clearance`` ([m],
    float32, as `navbake.navgrid.islands.clearance`), or a stored attribute by its name in the
    file. Shape (...). Outside the grid: NaN, False, 1, inf, 0, 0, 0; of an attribute NaN or 0,
    by its dtype. Raises QueryError for an unknown layer.
    """
    cells = cells_at(grid, positions, level)
    find, outside = LAYERS.get(layer, (None, None))
    # an attribute, of all levels in one dtype; some may not have it
    layers = find(grid) if find else [part.attributes.get(layer) for part in grid.levels]
    arrays = {number: array for number, array in enumerate(layers) if array is not None}
    if not arrays:
        known = [*LAYERS, *(key for part in grid.levels for key in part.attributes)]
        hint = suggest(layer, known, limit=len(known))
        raise QueryError(f"no layer {layer!r} in {grid.scene_id!r}: {hint}")
    dtype = np.result_type(*arrays.values())
    if outside is None:
        outside = np.nan if dtype.kind == "f" else 0
    values = np.full(cells.level.shape, outside, dtype=dtype)
    for number, array in arrays.items():
        here = cells.level == number
        values[here] = array[cells.row[here], cells.col[here]]
    return values
