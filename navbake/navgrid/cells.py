"""Which cell a position is in, on which level, and where a cell is.

A position stands on the level whose floor is the nearest one below it, or at most a step above;
not on the first level whose box holds it. So what is under a bridge is on the level below, what
is on it, on the one above.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.islands import STEP_SLACK
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from navbake.navgrid.grid import SceneGrid2D
    from navbake.navgrid.grid_base import GridBase

ROUNDING = 1e-6  # share of a height by which float32 may have moved it


class Cell(NamedTuple):
    """One cell of a grid: its level (0 is the lowest), row and column."""

    level: int
    row: int
    col: int


class Cells(NamedTuple):
    """Cells of a grid: level, row and column of each, int64, of one shape; -1 for none."""

    level: Int
    row: Int
    col: Int


def cell_at(grid: GridBase, position: ArrayLike, level: int | None = None) -> Cell | None:
    """Find the cell that a position is in.

    Its level is the one whose floor in that column is the nearest at or below the position, a
    step (`traversableFloorHeight`) above it included. Where no level has such a floor, it is the
    one whose ground is.

    Args:
        grid: the grid.
        position: world x, y, z [m]; x, y will do on one level.
        level: which level, 0 is the lowest; then z does not count.

    Returns:
        None beside the grid, and below all of its floors.

    Raises:
        QueryError: there is no such level, or the position is none.
    """
    p = check_positions(position, len(grid.levels), level)
    if p.ndim != 1:
        raise QueryError(f"expected one position, got an array of shape {p.shape}")
    found = cells_at(grid, p, level)
    cell = Cell(*(int(v) for v in found))
    return cell if cell.level >= 0 else None


def cells_at(grid: GridBase, positions: ArrayLike, level: int | None = None) -> Cells:
    """Find the cells that positions are in; `cell_at` of each.

    Args:
        grid: the grid.
        positions: world x, y, z [m], shape (..., 3); (..., 2) will do on one level.
        level: which level all are on; then z does not count.

    Returns:
        Level, row and column, each of shape (...), int64; -1 where there is no cell.

    Raises:
        QueryError: as `cell_at`.
    """
    p = check_positions(positions, len(grid.levels), level)
    flat = p.reshape(-1, p.shape[-1])
    if level is None and p.shape[-1] == 3:
        found = _cells_under(grid, flat)
    else:
        found = _no_cells(len(flat))
        _keep(found, level or 0, *_cells_of_level(grid.levels[level or 0], flat))
    return Cells(*(v.reshape(p.shape[:-1]) for v in found))


def position_of(grid: GridBase, cells: Cell | Cells) -> Float:
    """World positions of cells' centres, on the floor.

    Args:
        grid: the grid.
        cells: one, or many of shape (...); (level, row, col) will do.

    Returns:
        x, y, z [m], shape (..., 3), float64; z is the level's ground where there is no floor.

    Raises:
        QueryError: there is no such cell.
    """
    level, row, col = check_cells(cells)
    positions = np.empty((*level.shape, 3), dtype=np.float64)
    known = np.zeros(level.shape, dtype=np.bool_)
    for number, part in enumerate(grid.levels):
        here = (level == number) & (row >= 0) & (row < part.height)
        here &= (col >= 0) & (col < part.width)
        floor = _floors(part, row[here], col[here])
        positions[here, :2] = part.lattice.positions(row[here], col[here])
        positions[here, 2] = np.where(np.isnan(floor), part.ground, floor)
        known |= here
    if not known.all():
        first = tuple(int(v[~known].ravel()[0]) for v in (level, row, col))
        raise QueryError(f"no cell (level, row, col) = {first} in {grid.scene_id!r}")
    return positions


def check_cells(cells: Cell | Cells) -> Cells:
    """Check the form of cells; whether the grid has them is not checked.

    Args:
        cells: level, row and column, whole numbers or arrays of them.

    Returns:
        The three, int64, of one shape.

    Raises:
        QueryError: they are not three, no whole numbers, or of shapes that don't go together.
    """
    try:
        arrays = np.broadcast_arrays(*(np.asarray(v) for v in cells))
    except (TypeError, ValueError):
        arrays = ()
    if len(arrays) != 3 or any(v.dtype.kind not in "iu" and v.size for v in arrays):
        raise QueryError(f"expected cells as (level, row, col), whole numbers, got {cells!r}")
    return Cells(*(v.astype(np.int64) for v in arrays))


def check_positions(positions: ArrayLike, num_levels: int, level: int | None = None) -> Float:
    """Check the form of positions.

    Args:
        positions: world x, y, z [m], shape (..., 3); (..., 2) on one level or a given one.
        num_levels: how many levels the grid has.
        level: the level that they are all on, if given.

    Returns:
        The positions, float64.

    Raises:
        QueryError: there is no such level, a number is missing or not finite, or z is missing
            where it decides the level.
    """
    check_level(level, num_levels)
    try:
        p = np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise QueryError(f"expected world positions x, y, z [m], got {positions!r}") from error
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
    """Raise for an unknown level.

    Raises:
        QueryError: there is none of this number.
    """
    if level is not None and not (isinstance(level, int | np.integer) and 0 <= level < num_levels):
        raise QueryError(f"no level {level!r}: expected 0 to {num_levels - 1}")


def _cells_under(grid: GridBase, p: Float) -> Cells:
    """The cells of the nearest floors at or below positions, shape (n, 3)."""
    z = p[:, 2]
    # float32 moved the floors, in proportion to their height
    limit = z + grid.max_step + STEP_SLACK + np.abs(z) * ROUNDING
    found, on_ground = _no_cells(len(p)), _no_cells(len(p))
    highest, highest_ground = np.full(len(p), -np.inf), np.full(len(p), -np.inf)
    # of each position the highest floor so far that is not above the limit; grounds count only
    # where no level has such a floor
    for number, part in enumerate(grid.levels):
        inside, rows, cols = _cells_of_level(part, p)
        floor = np.full(len(p), np.nan)
        floor[inside] = _floors(part, rows[inside], cols[inside])
        nearer = (floor <= limit) & (floor > highest)  # False for NaN
        highest[nearer] = floor[nearer]
        _keep(found, number, nearer, rows, cols)
        nearer = inside & np.isnan(floor) & (part.ground <= limit) & (part.ground > highest_ground)
        highest_ground[nearer] = part.ground
        _keep(on_ground, number, nearer, rows, cols)
    has_floor = found.level >= 0
    return Cells(*(np.where(has_floor, a, b) for a, b in zip(found, on_ground, strict=True)))


def _cells_of_level(part: SceneGrid2D, p: Float) -> tuple[Bool, Int, Int]:
    """Which positions are over a level's rectangle, and rows and columns of these; else 0."""
    lattice = part.lattice
    row = np.floor((lattice.y_max - p[..., 1]) / lattice.cell_size)
    col = np.floor((p[..., 0] - lattice.x_min) / lattice.cell_size)
    # compared as floats: int64 could not hold what is far away
    inside = (row >= 0) & (row < part.height) & (col >= 0) & (col < part.width)
    rows, cols = (np.where(inside, v, 0.0).astype(np.int64) for v in (row, col))
    return np.asarray(inside), rows, cols


def _floors(part: SceneGrid2D, rows: Int, cols: Int) -> Float:
    """Floors of cells [m]; without the layer, the ground everywhere."""
    stored = part.attributes.get("floorHeight")
    if stored is None:
        return np.full(rows.shape, part.ground)
    return stored[rows, cols].astype(np.float64) * part.unit


def _no_cells(count: int) -> Cells:
    return Cells(*(np.full(count, -1, dtype=np.int64) for _ in range(3)))


def _keep(found: Cells, level: int, mask: Bool, rows: Int, cols: Int) -> None:
    found.level[mask] = level
    found.row[mask] = rows[mask]
    found.col[mask] = cols[mask]
