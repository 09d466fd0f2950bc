"""Temporarily blocks cells of a grid, a disc or a box, for moving things."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.block_state import NUM_LAYERS, Block, Layers
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import step_limit
from navbake.runtime.inflation import Margins, check_radius, margins_of
from navbake.types import Float, Int

NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Shape:
    """An upright obstacle, seen from above: a rectangle grown by a radius.

    Attributes:
        x_min, y_min, x_max, y_max: the rectangle, a point for a disc, world [m].
        radius: by how much it is grown [m], >= 0.
        bottom, top: world z [m]; infinite if it fills the level.
    """

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    radius: float
    bottom: float = -math.inf
    top: float = math.inf


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
    """See `SceneGrid2D.block`."""
    if sum(thing is not None for thing in (cells, disc, box)) != 1:
        raise QueryError("expected one of cells, disc and box to block")
    check_level(level, len(grid.levels))
    if cells is not None:
        number, row, col = check_cells(grid, cells)
        return Block(
            grid,
            [_alone((row * part.width + col)[number == k]) for k, part in enumerate(grid.levels)],
        )
    shape = _disc(grid, disc, level, height) if disc is not None else _box(grid, box, level)
    margins = margins_of(grid, margin)
    step, tall = step_limit(grid) * grid.unit, grid.agent_height
    return Block(
        grid,
        [
            _cells_of(part, shape, margins, step, tall) if level in (None, k) else _alone(NONE)
            for k, part in enumerate(grid.levels)
        ],
    )


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
    x, y, *z = (float(v) for v in p)
    if not z:
        return Shape(x, y, x, y, float(radius))
    top = z[0] + (grid.agent_height if height is None else height)
    return Shape(x, y, x, y, float(radius), z[0], top)


def _box(grid: NavGrid, box: Any, level: int | None) -> Shape:
    """A box between two corners; with x, y only, as high as the level."""
    corners = _two(box, "a box's lower and upper corner")
    low, high = (check_positions(corner, len(grid.levels), level) for corner in corners)
    if low.ndim != 1 or low.shape != high.shape or (low > high).any():
        raise QueryError(f"expected a box's lower and upper corner, got {low} and {high}")
    # not grown: radius 0; bottom and top if the corners have a z
    return Shape(*(float(v) for v in (*low[:2], *high[:2], 0.0, *low[2:], *high[2:])))


def _two(things: Any, name: str) -> tuple[Any, Any]:
    try:
        one, other = things
    except (TypeError, ValueError):
        raise QueryError(f"expected {name}, got {things!r}") from None
    return one, other


def _cells_of(
    level: SceneGrid2D, shape: Shape, margins: Margins, step: float, height: float
) -> Layers:
    """Find the cells that an obstacle blocks for an agent of a height that steps over `step` [m].

    There the obstacle reaches into the heights from `step` to `height` above the floor, and meets
    the cell's square or the disc of a margin round its centre.
    """
    lattice = level.lattice
    size = lattice.cell_size
    reach = shape.radius + max(margins.off_center, size)
    rows, cols = lattice.rows_cols(
        [[shape.x_min - reach, shape.y_max + reach], [shape.x_max + reach, shape.y_min - reach]]
    )
    row0, row1 = max(int(rows[0]), 0), min(int(rows[1]) + 1, level.height)
    col0, col1 = max(int(cols[0]), 0), min(int(cols[1]) + 1, level.width)
    if row0 >= row1 or col0 >= col1:
        return _alone(NONE)
    x = lattice.center_x()[col0:col1]
    y = lattice.center_y()[row0:row1, None]
    floor = level.floor_of(slice(row0, row1), slice(col0, col1))
    floor = np.where(np.isnan(floor), level.ground, floor)
    in_band = (shape.bottom < floor + height) & (shape.top > floor + step)
    to_square, gap = _distance(shape, x, y, size / 2), _distance(shape, x, y, 0.0)
    # a disc is open: it may touch a square. A box is closed, so that a flat one has cells, too.
    meets = in_band & (to_square < shape.radius if shape.radius > 0 else to_square <= 0)
    ids = np.arange(row0, row1)[:, None] * level.width + np.arange(col0, col1)
    return [
        ids[meets | (in_band & (gap < shape.radius + margin))]
        for margin in (0.0, margins.center, margins.diagonal, margins.off_center)
    ]


def _alone(cells: Int) -> Layers:
    """Cells that are blocked by themselves, without an agent's margin around them."""
    return [np.unique(cells)] * NUM_LAYERS


def _distance(shape: Shape, x: Float, y: Float, half: float) -> Float:
    """From the shape's rectangle to squares round points, of half an edge."""
    dx = np.maximum(np.maximum(shape.x_min - x, x - shape.x_max) - half, 0.0)
    dy = np.maximum(np.maximum(shape.y_min - y, y - shape.y_max) - half, 0.0)
    return np.asarray(np.hypot(dx, dy))
