"""What `grid.block` takes: cells, a disc or a box."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.block_state import Layers
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.islands import step_limit
from navbake.runtime.blocks.block import Block
from navbake.runtime.blocks.shape import Shape, cells_alone, cells_of_shape
from navbake.runtime.inflation.inflate import check_radius
from navbake.runtime.inflation.margins import margins_of

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def block(
    grid: NavGrid,
    *,
    cells: Cell | Cells | None = None,
    disc: tuple[ArrayLike, float] | None = None,
    box: tuple[ArrayLike, ArrayLike] | None = None,
    level: int | None = None,
    height: float | None = None,
    margin: float | None = None,
) -> Block:
    """Block cells of a grid; see `navbake.navgrid.grid_base.GridBase.block`."""
    if sum(thing is not None for thing in (cells, disc, box)) != 1:
        raise QueryError("expected one of cells, disc and box to block")
    check_level(level, len(grid.levels))
    if cells is not None:
        return Block(grid, _given_cells(grid, cells))
    shape = _disc(grid, disc, level, height) if disc is not None else _box(grid, box, level)
    margins = margins_of(grid, margin)
    step, tall = step_limit(grid) * grid.unit, grid.agent_height
    return Block(
        grid,
        [
            cells_of_shape(part, shape, margins, step, tall)
            if level is None or number == level
            else cells_alone(np.empty(0, dtype=np.int64))
            for number, part in enumerate(grid.levels)
        ],
    )


def _given_cells(grid: NavGrid, cells: Cell | Cells) -> list[Layers]:
    level, row, col = check_cells(grid, cells)
    return [
        cells_alone((row * part.width + col)[level == number])
        for number, part in enumerate(grid.levels)
    ]


def _disc(
    grid: NavGrid, disc: tuple[ArrayLike, float], level: int | None, height: float | None
) -> Shape:
    """A disc that stands at a position; with x, y only, as high as the level."""
    center, radius = _two(disc, "a disc's centre and radius")
    p = check_positions(center, len(grid.levels), level)
    if p.ndim != 1:
        raise QueryError(f"expected one centre of a disc, got an array of shape {p.shape}")
    check_radius(radius, "radius of a disc")
    if height is not None:
        check_radius(height, "height of a disc")
    x, y = float(p[0]), float(p[1])
    bottom, top = -math.inf, math.inf
    if len(p) == 3:
        bottom, top = float(p[2]), float(p[2]) + (grid.agent_height if height is None else height)
    return Shape(x, y, x, y, float(radius), bottom, top)


def _box(grid: NavGrid, box: Any, level: int | None) -> Shape:
    """A box between two corners; with x, y only, as high as the level."""
    corners = _two(box, "a box's lower and upper corner")
    low, high = (check_positions(corner, len(grid.levels), level) for corner in corners)
    if low.ndim != 1 or low.shape != high.shape or (low > high).any():
        raise QueryError(f"expected a box's lower and upper corner, got {low} and {high}")
    bottom, top = (float(low[2]), float(high[2])) if len(low) == 3 else (-math.inf, math.inf)
    return Shape(float(low[0]), float(low[1]), float(high[0]), float(high[1]), 0.0, bottom, top)


def _two(things: Any, name: str) -> tuple[Any, Any]:
    try:
        one, other = things
    except (TypeError, ValueError):
        raise QueryError(f"expected {name}, got {things!r}") from None
    return one, other
