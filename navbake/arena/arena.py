"""A level's obstacles in the squares of an arena, as map descriptors have them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from navbake.arena.map_descriptor import MOST, SQUARE
from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.lattice import CELL_SLACK, Lattice, num_cells
from navbake.types import Bool, Float, Int
from navbake.voxels.placement import finite_array


def check_squares(square: float, corner: ArrayLike) -> Float:
    """The corner as an array, shape (2,); a QueryError if it or the edge of squares is wrong."""
    if not (np.isfinite(square) and square > 0):
        raise QueryError(f"expected squares with an edge > 0 m, got {square:g}")
    place = finite_array(corner, (2,))
    if place is None:
        raise QueryError(f"expected the arena's lower left corner as x, y [m], got {corner!r}")
    return place


def place_squares(
    level: SceneGrid2D,
    *,
    square: float = SQUARE,
    corner: ArrayLike | None = None,
    shape: Sequence[int] | None = None,
) -> Lattice:
    """Lay the squares of an arena over a level; they may reach beyond it.

    Args:
        square: edge of a square [m], > 0.
        corner: the arena's lower left corner, x and y, world frame [m]; the level's if None.
        shape: rows and columns, >= 1 each; as many as cover the rest of the level if None.

    Raises:
        QueryError: a number is wrong, or the arena lies beside the level.
    """
    x0, y0, x1, y1 = level.lattice.bounds
    left, bottom = check_squares(square, (x0, y0) if corner is None else corner).tolist()
    if shape is None:
        if not (left < x1 and bottom < y1):
            raise QueryError(
                f"the corner ({left:g}, {bottom:g}) leaves nothing of the level, which ends "
                f"at ({x1:g}, {y1:g})"
            )
        if max(x1 - left, y1 - bottom) > MOST * square:
            raise QueryError(f"expected larger squares: the level has over {MOST} of {square:g} m")
        shape = num_cells(y1 - bottom, square), num_cells(x1 - left, square)
    rows, cols = shape
    if rows < 1 or cols < 1:
        raise QueryError(f"expected rows and columns >= 1, got {rows} and {cols}")
    if rows * cols > MOST:
        raise QueryError(
            f"expected at most {MOST} squares, got {rows} × {cols} of {square:g} m: "
            f"take larger squares, or a part of the level"
        )
    squares = Lattice(left, bottom + rows * square, square, cols, rows)
    left, bottom, right, top = squares.bounds
    if left >= x1 or bottom >= y1 or right <= x0 or top <= y0:
        raise QueryError(
            f"the arena, x {left:g} to {right:g}, y {bottom:g} to {top:g} m, lies beside the "
            f"level: it spans x {x0:g} to {x1:g}, y {y0:g} to {y1:g} m"
        )
    return squares


def find_obstacles(level: SceneGrid2D, squares: Lattice) -> Bool:
    """Mark the squares that hold an obstacle in any part: (rows, cols), bool, row 0 at the top.

    Obstacles are occupied cells, and what lies beside the level. A cell that only touches a
    square isn't in it.
    """
    lattice = level.lattice
    filled = np.pad(level.occupancy != 0, 1, constant_values=True)  # beside the level, too
    # a summed-area table (Crow 1984): the sum over any rectangle from its four corners
    sums = np.pad(filled.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    def spans(first: float, count: int, limit: int) -> tuple[Int, Int]:
        """The cells under each square along an axis, from and to, in the padded array."""
        edges = (first + np.arange(count + 1) * squares.cell_size) / lattice.cell_size
        start = np.floor(edges[:-1] + CELL_SLACK).astype(np.int64) + 1
        end = np.ceil(edges[1:] - CELL_SLACK).astype(np.int64) + 1
        start = np.clip(start, 0, limit + 1)
        return start, np.clip(np.maximum(end, start + 1), 1, limit + 2)

    row0, row1 = spans(lattice.y_max - squares.y_max, squares.height, lattice.height)
    col0, col1 = spans(squares.x_min - lattice.x_min, squares.width, lattice.width)
    row0, row1 = row0[:, None], row1[:, None]
    inside: Int = sums[row1, col1] - sums[row0, col1] - sums[row1, col0] + sums[row0, col0]
    return inside > 0
