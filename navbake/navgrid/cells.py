"""Finds the cell and level of a position, and the position of a cell.

A position is on the level with the nearest floor below it, or at most a step above. So a position
under a bridge is on the level below, one on the bridge on the level above.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.islands import STEP_SLACK
from navbake.navgrid.lattice import Cell as Cell
from navbake.navgrid.lattice import Cells as Cells
from navbake.types import Float, Int

ROUNDING = 1e-6  # relative rounding of float32


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


def position_of(grid: GridBase, cells: Cell | Cells) -> Float:
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


def check_cells(grid: GridBase, cells: Cell | Cells) -> Cells:
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
        highest[nearer], found[:, nearer] = floor[nearer], cells[:, nearer]
        nearer = inside & np.isnan(floor) & (part.ground <= limit) & (part.ground > highest_ground)
        highest_ground[nearer], on_ground[:, nearer] = part.ground, cells[:, nearer]
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
