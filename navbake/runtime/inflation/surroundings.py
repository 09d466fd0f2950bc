"""What an agent on a level may run into: the level's cells and those of the levels around."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.islands import step_limit

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid, SceneGrid2D
    from navbake.navgrid.lattice import Lattice

SLAB = 0.3  # [m] how thick the floor of a level above may be
ALIGNED = 1e-3  # of a cell: levels this little off each other's cells share one lattice


@dataclass(frozen=True)
class Surroundings:
    """A piece of the scene's lattice around one level, with what all levels have in it.

    Attributes:
        level: which of the arrays' levels is meant.
        rows, cols: where the level's own rectangle is in the arrays.
        floor: shape (levels, rows, cols), float32: world z of the floor [m], NaN for none.
        occupied: likewise, uint8; 1 beyond a level's rectangle.
        step: by how much floors of neighbours may differ [m].
        height: of the agent [m].
        baked_radius: of the agent [m]; 0 where a file doesn't tell.
    """

    level: int
    rows: slice
    cols: slice
    floor: NDArray[np.float32]
    occupied: NDArray[np.uint8]
    step: float
    height: float
    baked_radius: float


def find_surroundings(grid: NavGrid, number: int, reach: int) -> Surroundings:
    """Collect what an agent on a level may run into.

    A single level is the whole lattice: beyond it the bake saw nothing. Each of several levels is
    cut to the cells with a floor; beyond these is no floor, which counts as occupied. Levels on
    other lattices are left out.

    Args:
        grid: the grid.
        number: which level.
        reach: how far an agent reaches from its cell, in cells.

    Returns:
        For a grid of one level, its own arrays.
    """
    level = grid.levels[number]
    agent = step_limit(grid) * grid.unit, grid.agent_height, grid.agent_radius
    if len(grid.levels) == 1:
        inside = slice(0, level.height), slice(0, level.width)
        floor, occupied = _floor(level)[None], np.ascontiguousarray(level.occupancy)[None]
        return Surroundings(0, *inside, floor, occupied, *agent)
    shifts = [_shift(level.lattice, other.lattice) for other in grid.levels]
    together = [i for i, shift in enumerate(shifts) if shift is not None]
    placed = [(grid.levels[i], *(shifts[i] or (0, 0))) for i in together]
    top = max(-reach, min(row for _, row, _ in placed)) - 1
    left = max(-reach, min(col for _, _, col in placed)) - 1
    bottom = min(level.height + reach, max(row + part.height for part, row, _ in placed)) + 1
    right = min(level.width + reach, max(col + part.width for part, _, col in placed)) + 1
    shape = (len(placed), bottom - top, right - left)
    floor = np.full(shape, np.nan, dtype=np.float32)
    occupied = np.ones(shape, dtype=np.uint8)
    for i, (part, row, col) in enumerate(placed):
        _paste(floor[i], _floor(part), row - top, col - left)
        _paste(occupied[i], part.occupancy, row - top, col - left)
    rows, cols = slice(-top, level.height - top), slice(-left, level.width - left)
    return Surroundings(together.index(number), rows, cols, floor, occupied, *agent)


def _floor(level: SceneGrid2D) -> NDArray[np.float32]:
    """The level's floor, world z [m]."""
    floor = np.ascontiguousarray(level.floor_height)
    return floor if level.unit == 1 else floor * np.float32(level.unit)


def _shift(a: Lattice, b: Lattice) -> tuple[int, int] | None:
    """Row and column in lattice a of lattice b's cell 0; None if they have no cells in common."""
    col, row = (b.x_min - a.x_min) / a.cell_size, (a.y_max - b.y_max) / a.cell_size
    size = abs(b.cell_size / a.cell_size - 1) * max(*a.shape, *b.shape)
    off = max(abs(row - round(row)), abs(col - round(col)), size)
    return (round(row), round(col)) if off < ALIGNED else None


def _paste(canvas: NDArray, piece: NDArray, row: int, col: int) -> None:  # type: ignore[type-arg]
    """Copy a piece to a place on a canvas, as far as they overlap."""
    rows = slice(max(row, 0), max(min(row + piece.shape[0], canvas.shape[0]), 0))
    cols = slice(max(col, 0), max(min(col + piece.shape[1], canvas.shape[1]), 0))
    if rows.start < rows.stop and cols.start < cols.stop:
        canvas[rows, cols] = piece[
            rows.start - row : rows.stop - row, cols.start - col : cols.stop - col
        ]
