"""Which cells of a walk positions are in."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, Cells, check_positions

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk

Ints: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
Place: TypeAlias = tuple[Ints, Ints, Ints, Floats, Floats, Floats]


def flat_cells(walk: Walk, positions: ArrayLike, level: int | None = None) -> NDArray[np.int64]:
    """Find the cells of a walk that positions are in; fast, and the same as `cells_at`.

    Args:
        walk: the grid, as `navbake.runtime.flat_grid.make_walk` lays it out.
        positions: as of `cells_at`.
        level: as of `cells_at`.

    Returns:
        Flat ids, shape (...), int64; -1 where there is no cell.

    Raises:
        QueryError: there is no such level, or a position is none.
    """
    from navbake.runtime.kernels.locate import locate, locate_on

    p = check_positions(positions, walk.num_levels, level)
    flat = np.ascontiguousarray(p.reshape(-1, p.shape[-1]))
    if level is not None or p.shape[-1] == 2:
        cells = np.empty(len(flat), dtype=np.int64)
        locate_on(place_of(walk), level or 0, flat, cells)
    else:
        cells, _ = locate(place_of(walk), walk.ground, walk.floor, walk.max_step, flat)
    found: NDArray[np.int64] = cells.reshape(p.shape[:-1])
    return found


def place_of(walk: Walk) -> Place:
    """Where the cells of a walk lie: what kernels take as `place`."""
    return walk.start, walk.width, walk.height, walk.x_min, walk.y_max, walk.cell_size


def links_of(walk: Walk) -> tuple[Ints, Ints, Ints]:
    """Where links of a walk lead: what kernels take as `links`."""
    return walk.link_cell, walk.link_start, walk.link_target


def flat_cell(walk: Walk, position: ArrayLike, level: int | None = None) -> int | None:
    """Find the cell of a walk that one position is in; None for none. See `flat_cells`."""
    cells = flat_cells(walk, position, level)
    if cells.ndim:
        raise QueryError(f"expected one position, got an array of shape {np.shape(position)}")
    return int(cells) if cells >= 0 else None


def split_cells(walk: Walk, cells: NDArray[np.int64]) -> Cells:
    """Level, row and column of cells by their flat ids; -1 stays -1."""
    cells = np.asarray(cells, dtype=np.int64)
    level = walk.level_of(cells)
    row, col = np.divmod(cells - walk.start[level], walk.width[level])
    return Cells(*(np.where(cells < 0, -1, v) for v in (level, row, col)))


def split_cell(walk: Walk, cell: int) -> Cell:
    """Level, row and column of one cell by its flat id."""
    return Cell(*(int(v) for v in split_cells(walk, np.array(cell))))
