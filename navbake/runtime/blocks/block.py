"""Temporarily blocks cells of a grid, a disc or a box, for moving things."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.block_state import BLOCKED, BlockState, Layers
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.islands import step_limit
from navbake.runtime.blocks.shape import Shape, cells_alone, cells_of_shape
from navbake.runtime.inflation.inflate import check_radius
from navbake.runtime.inflation.margins import margins_of

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import NavGrid, SceneGrid2D


class Block:
    """Cells that are blocked until `free` is called, or as a context manager, until its end.

    Attributes:
        cells: flat ids of the cells where an agent can't stand because of the block, by level,
            each ascending, int64; including cells that were not free before.
    """

    def __init__(self, grid: NavGrid, layers: list[Layers]) -> None:
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, BlockState, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                if level.block_state is None:
                    level.block_state = BlockState(level)
                level.block_state.hold(level, of_level)
                self._held.append((level, level.block_state, of_level))

    def free(self) -> None:
        """Free the cells, except those that other blocks hold. Further calls do nothing."""
        for level, state, of_level in self._held:
            state.release(level, of_level)
        self._held.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


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
        return Block(grid, _given_cells(grid, cells))
    shape = _disc(grid, disc, level, height) if disc is not None else _box(grid, box, level)
    margins = margins_of(grid, margin)
    step, tall = step_limit(grid) * grid.unit, grid.agent_height
    layers = [cells_alone(np.empty(0, dtype=np.int64)) for _ in grid.levels]
    for number, part in enumerate(grid.levels):
        if level in (None, number):
            layers[number] = cells_of_shape(part, shape, margins, step, tall)
    return Block(grid, layers)


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
