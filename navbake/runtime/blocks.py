"""Temporarily blocks cells of a grid, a disc or a box, for moving things."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.block import Block
from navbake.navgrid.block_state import NUM_LAYERS, Layers
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import step_limit
from navbake.runtime.inflation import check_radius, margins_of
from navbake.types import Float, Int


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
    """Block cells of a grid for a moving thing until they are freed.

    The grid's weights, occupancy and ``clearance`` layer change in place, and each
    `PathFinder` on it takes the change over, those of agents of other sizes with the margin of
    theirs. Blocks may overlap. A disc or box blocks the cells
    where an agent on the floor would collide with it: their square overlaps it, or a disc of
    `margin` round their centre does. Grids derived from this one keep its current blocks.

    Free the cells by `free` of the returned block, or use the block as a context manager.

    Args:
        cells: level, row and column, as `cell_at` and `cells_at` return them; without the rest.
        disc: centre and radius [m]; blocks all levels that it reaches into from the centre's z
            up, or the level's whole height if the centre is x, y.
        box: lower and upper corner, world frame [m]; of the level's height if x, y.
        level: block this level only; then a position needs no z.
        height: of the disc [m]; the agent's if None.
        margin: the agent's radius [m]; if None, that of the inflation, else of the bake.

    Raises:
        QueryError: not exactly one of cells, disc and box is given, or it is not valid.
    """
    given: dict[str, Any] = {
        "cells": cells, "disc": disc, "box": box, "level": level, "height": height, "margin": margin
    }  # fmt: skip
    made = Block(grid, _find_layers(grid, **given), given)
    made.copies += [block(fitted, **given) for fitted in grid.fitted or ()]
    return made


def _find_layers(
    grid: NavGrid,
    cells: Cell | Cells | None,
    disc: tuple[ArrayLike, float] | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    level: int | None,
    height: float | None,
    margin: float | None,
) -> list[Layers]:
    """The cells of each layer of a block's, by level."""
    if sum(thing is not None for thing in (cells, disc, box)) != 1:
        raise QueryError("expected one of cells, disc and box to block")
    check_level(level, len(grid.levels))
    if cells is not None:
        number, row, col = check_cells(grid, cells)
        ids = [(row * part.width + col)[number == k] for k, part in enumerate(grid.levels)]
        return [[np.unique(of_level)] * NUM_LAYERS for of_level in ids]
    # an upright obstacle; from above, a rectangle dilated by a radius
    radius, tall, levels = 0.0, 0.0, len(grid.levels)
    wanted = "a disc's centre and radius" if disc else "a box's lower and upper corner"
    things: Any = disc or box
    try:
        one, other = things
    except (TypeError, ValueError):
        raise QueryError(f"expected {wanted}, got {things!r}") from None
    if disc is not None:
        low = high = check_positions(one, levels, level)
        if low.ndim != 1:
            raise QueryError(f"expected one centre of a disc, got an array of shape {low.shape}")
        check_radius(radius := other, "radius of a disc")
        if height is not None:
            check_radius(height, "height of a disc")
        tall = grid.agent_height if height is None else height
    else:
        low, high = check_positions(one, levels, level), check_positions(other, levels, level)
        if low.ndim != 1 or low.shape != high.shape or (low > high).any():
            raise QueryError(f"expected {wanted}, got {low} and {high}")
    bottom, top = (low[2], high[2] + tall) if len(low) == 3 else (-math.inf, math.inf)
    margins, step = (0.0, *margins_of(grid, margin)), step_limit(grid) * grid.unit

    def away(x: Float, y: Float, half: float) -> Float:
        """Distances from the rectangle to squares of half edge `half` round points."""
        dx = np.maximum(np.maximum(low[0] - x, x - high[0]) - half, 0.0)
        dy = np.maximum(np.maximum(low[1] - y, y - high[1]) - half, 0.0)
        return np.asarray(np.hypot(dx, dy))

    layers: list[Layers] = []
    for k, part in enumerate(grid.levels):
        size = part.lattice.cell_size
        reach = radius + max(margins[-1], size)
        window = part.lattice.window(np.array([low[:2], high[:2]]), reach)
        if level not in (None, k) or window is None:
            layers.append([np.empty(0, dtype=np.int64)] * NUM_LAYERS)
            continue
        rows, cols = window
        x, y = part.lattice.center_x()[cols], part.lattice.center_y()[rows, None]
        floor = part.floor_of(rows, cols)
        floor = np.where(np.isnan(floor), part.ground, floor)
        in_band = (bottom < floor + grid.agent_height) & (top > floor + step)
        to_square, gap = away(x, y, size / 2), away(x, y, 0.0)
        # a disc is open: it may touch a square. A box is closed, so that a flat one blocks cells.
        meets = in_band & (to_square < radius if radius > 0 else to_square <= 0)
        held = [meets | (in_band & (gap < radius + more)) for more in margins]
        first = np.arange(rows.start, rows.stop)[:, None] * part.width
        inside: Int = first + np.arange(cols.start, cols.stop)
        layers.append([inside[mask] for mask in held])
    return layers
