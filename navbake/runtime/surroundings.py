"""Which cells of a level are blocked for an agent of a radius, by the cells of all levels near it.

What counts for an agent whose centre is on a cell's centre:

- Occupied cells: the agent must not meet their squares. The bake has made a cell occupied where
  something meets its square or the disc of the baked radius round its centre, so all baked
  geometry lies in occupied squares. The baked radius is replaced, not added to: where its disc
  reaches beyond the square, the squares that something meets themselves (`SceneGrid2D.solid`)
  stand in for the occupied ones, and a cell that only the baked disc closed may become free.
- Higher floors that the agent meets: at most a step above its own. A ledge is a wall from below,
  and so is the step after the next one for an agent too large for the stair. In files that have
  but the occupancy of a larger radius, the bake has decided this up to that radius.
- Lower floors that the agent meets: at most a step below its own, unless `ledges` is ``ignore``.
  Of the floors of all levels in a column, the highest that isn't more than a step above the
  agent's counts. So the room under a gallery is no drop for an agent on the gallery, but the
  stair beside it is. Columns without any floor count as they do otherwise, see below.
- Slopes: a floor to which cells lead in a straight line, over steps and at least one link between
  neighbours more than a step apart, is neither a higher nor a lower one. The bake has found such
  links where a ramp within the slope rises more than a step over a cell.
- Other levels: the cells of both levels count, each where its floor is as high as the agent's
  (less than the body's height apart). So a thing under a landing does not block the stair to it.
- Outside of the grid: beyond a single level nothing was baked, and nothing blocks. Each of several
  levels is cut to the cells with a floor; beyond these is no floor, which counts as occupied.
- Cells without floor that are not occupied, in files of other programs: as in the original client,
  at least 0.7 of the cells that the disc covers must have a floor. Here this must hold for every
  smaller radius too, so that a larger agent is never free where a smaller one isn't.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import step_limit
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int, Int32

if TYPE_CHECKING:
    from navbake.runtime.kernels.inflation import Storeys

# Functions import kernels when they run: numba takes long to load.

LEAST_FLOOR = 0.7  # share of the cells that a disc covers that must have a floor
ALIGNED = 1e-3  # of a cell: levels offset by less share one lattice
TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


@dataclass(frozen=True)
class Surroundings:
    """A window of the scene's lattice around one level, with the cells of all levels in it.

    Attributes:
        rows, cols: the level's own rectangle in the arrays.
        storeys: the arrays.
        baked_radius: of the disc that is part of ``storeys.occupied`` [m]; 0 where the file has
            none, or the squares alone in a layer ``solid``.
    """

    rows: slice
    cols: slice
    storeys: Storeys
    baked_radius: float


def find_blocked(grid: NavGrid, number: int, radius: float, ledges: str = "avoid") -> Bool:
    """Find the cells of a level where an agent of a radius [m] can't stand; see the module's head.

    Cells that are not free before may be either.
    """
    from navbake.runtime.kernels.inflation import dilate

    cells = radius / grid.levels[number].lattice.cell_size
    around = find_surroundings(grid, number, math.ceil(cells) + 1)
    occupied = around.storeys.occupied[around.storeys.level]
    blocked: Bool = dilate(occupied, half_widths(cells, occupied.shape))
    if cells > 0:
        block_by_others(around, radius, disc_offsets(cells, occupied.shape)[0], ledges, blocked)
        _block_by_holes(around, cells, blocked)
    return blocked[around.rows, around.cols]


def find_blocked_by_others(
    grid: NavGrid, number: int, radius: float, ledges: str = "avoid"
) -> Bool:
    """Find the cells of a level within a radius [m] of anything but its own occupied cells.

    That is what `find_blocked` finds without them, and wherever another level's cells count.
    """
    cells = radius / grid.levels[number].lattice.cell_size
    around = find_surroundings(grid, number, math.ceil(cells) + 1)
    storeys = around.storeys
    blocked: Bool = np.zeros(storeys.occupied.shape[1:], dtype=np.bool_)
    _block_by_holes(around, cells, blocked)
    # as if only other levels were occupied, and these wherever they have a floor
    others = np.ones_like(storeys.occupied)
    others[storeys.level] = 0
    offsets = disc_offsets(cells, blocked.shape)[0]
    elsewhere = replace(around, storeys=storeys._replace(occupied=others))
    block_by_others(elsewhere, radius, offsets, ledges, blocked)
    return blocked[around.rows, around.cols]


def block_by_others(
    around: Surroundings, radius: float, offsets: Int, ledges: str, blocked: Bool
) -> None:
    """Add what other levels and floors block to `blocked`, and free what other levels free.

    `blocked` holds what the level's own occupied cells block, `offsets` the steps from an agent's
    cell to those that it meets; the radius [m] is the agent's, or of a circle around it.
    """
    from navbake.runtime.kernels.inflation import block_by_floors

    counts_higher = radius > around.baked_radius
    block_by_floors(around.storeys, offsets, counts_higher, ledges == "avoid", blocked)


def _block_by_holes(around: Surroundings, cells: float, blocked: Bool) -> None:
    """Block cells round which holes that are not occupied leave too little floor."""
    from navbake.runtime.kernels.inflation import block_near_holes, dilate

    storeys = around.storeys
    has_floor = ~np.isnan(storeys.floor[storeys.level])
    holes = ~has_floor & (storeys.occupied[storeys.level] == 0)
    if not holes.any():
        return
    table = half_widths(cells, holes.shape, of_squares=False)
    todo = dilate(holes.view(np.uint8), table) & has_floor
    offsets, squares = disc_offsets(cells, holes.shape, of_squares=False)
    block_near_holes(has_floor, todo, offsets, squares, LEAST_FLOOR, blocked)


def half_widths(radius: float, shape: tuple[int, int], *, of_squares: bool = True) -> Int32:
    """How wide a disc is, row by row, as `dilate` takes it.

    Args:
        radius: [cells].
        shape: (rows, cols) of the cells that it is for; it need not be wider.
        of_squares: whether it reaches a cell when it meets its square, or covers its centre.
    """
    reaches = [min(math.ceil(radius) + 1, size) for size in shape]
    rows, cols = (_squares(np.arange(reach + 1), of_squares) for reach in reaches)
    widths = np.searchsorted(cols, _square_limit(radius) - rows, side="left") - 1
    return np.append(widths[widths >= 0], -1).astype(np.int32)


def disc_offsets(
    radius: float, shape: tuple[int, int], *, of_squares: bool = True
) -> tuple[Int, Int]:
    """Steps from a cell to those that a disc round its centre reaches, as in `half_widths`.

    Returns:
        Rows and columns, (n, 2) int64, the nearest first; and their squares in half cells.
    """
    rows, cols = (np.arange(-n, n + 1) for n in (min(math.ceil(radius) + 1, s) for s in shape))
    squares = _squares(rows, of_squares)[:, None] + _squares(cols, of_squares)
    row, col = np.nonzero(squares < _square_limit(radius))
    found = squares[row, col]
    order = np.argsort(found, kind="stable")
    return np.stack([rows[row], cols[col]], axis=1)[order], found[order]


def _square_limit(radius: float) -> float:
    return (2 * radius) ** 2 * (1 - TOUCH)  # the disc is open: what only touches is not reached


def _squares(steps: Int, of_squares: bool) -> Int:
    """Squared half cells along an axis to the near side, or to the centre, of squares."""
    half_cells: Int = 2 * np.abs(steps)
    return np.maximum(half_cells - 1, 0) ** 2 if of_squares else half_cells**2


def find_surroundings(grid: NavGrid, number: int, reach: int) -> Surroundings:
    """Collect the cells that an agent on a level may meet, which reaches some cells from its own.

    A single level is its own surroundings: nothing was baked beyond it. Several levels are pasted
    into one window, in which cells beyond a level count as occupied; levels on other lattices are
    left out.
    """
    from navbake.runtime.kernels.inflation import Storeys

    level = grid.levels[number]
    has_solid = bool(level.navbake) and "solid" in level.attributes
    baked_radius = 0.0 if has_solid else grid.agent_radius
    agent = step_limit(grid) * grid.unit, grid.agent_height
    if len(grid.levels) == 1:
        inside = slice(0, level.height), slice(0, level.width)
        floor, occupied = _floor(level)[None], np.ascontiguousarray(level.solid)[None]
        slopes = _find_slopes(grid, [(0, 0)], floor, agent[0])
        return Surroundings(*inside, Storeys(floor, occupied, slopes, 0, *agent), baked_radius)
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
        _paste(occupied[i], part.solid, row - top, col - left)
    rows, cols = slice(-top, level.height - top), slice(-left, level.width - left)
    at = dict(zip(together, ((row - top, col - left) for _, row, col in placed), strict=True))
    slopes = _find_slopes(grid, [at.get(i) for i in range(len(grid.levels))], floor, agent[0])
    storeys = Storeys(floor, occupied, slopes, together.index(number), *agent)
    return Surroundings(rows, cols, storeys, baked_radius)


def _find_slopes(
    grid: NavGrid, at: list[tuple[int, int] | None], floor: NDArray[np.float32], step: float
) -> NDArray[np.uint8]:
    """The `slopes` of Storeys; `at` has each level's row and column there, None for left out.

    The levels that are not left out are those of `floor`, in their order.
    """
    from navbake.runtime.kernels.arrays import EAST, NORTH, SOUTH, WEST

    links, none = grid.link_array, np.zeros((0, 0, 0), dtype=np.uint8)
    links = links[np.array([place is not None for place in at])[links[:, ::2]].all(axis=1)]
    if not len(links):
        return none
    index = np.cumsum([place is not None for place in at]) - 1
    corner = np.array([place or (0, 0) for place in at])
    width = np.array([level.width for level in grid.levels])
    ends = []
    for level, cell in (links[:, :2].T, links[:, 2:].T):
        row, col = np.divmod(cell, width[level])
        ends.append((index[level], row + corner[level, 0], col + corner[level, 1]))
    one, other = np.array(ends[0]), np.array(ends[1])
    size = np.array(floor.shape)[:, None]
    inside = ((one >= 0) & (one < size) & (other >= 0) & (other < size)).all(axis=0)
    one, other = one[:, inside], other[:, inside]
    down, across = (other - one)[1:]
    is_slope = np.abs(floor[tuple(one)] - floor[tuple(other)]) > step
    is_slope &= np.abs(down) + np.abs(across) == 1
    if not is_slope.any():
        return none
    slopes = np.zeros(floor.shape, dtype=np.uint8)
    for way, there, back in (
        (across == 1, EAST, WEST),
        (across == -1, WEST, EAST),
        (down == 1, SOUTH, NORTH),
        (down == -1, NORTH, SOUTH),
    ):
        np.bitwise_or.at(slopes, tuple(one[:, way & is_slope]), np.uint8(there))
        np.bitwise_or.at(slopes, tuple(other[:, way & is_slope]), np.uint8(back))
    return slopes


def _floor(level: SceneGrid2D) -> NDArray[np.float32]:
    """The level's floor, world z [m]."""
    floor = np.ascontiguousarray(level.floor_height)
    return floor if level.unit == 1 else floor * np.float32(level.unit)


def _shift(a: Lattice, b: Lattice) -> tuple[int, int] | None:
    """Row and column in lattice a of b's cell (0, 0); None if the cells do not coincide."""
    col, row = (b.x_min - a.x_min) / a.cell_size, (a.y_max - b.y_max) / a.cell_size
    size = abs(b.cell_size / a.cell_size - 1) * max(*a.shape, *b.shape)
    off = max(abs(row - round(row)), abs(col - round(col)), size)
    return (round(row), round(col)) if off < ALIGNED else None


def _paste(canvas: NDArray, piece: NDArray, row: int, col: int) -> None:  # type: ignore[type-arg]
    """Copy a piece to a position on a canvas, as far as they overlap."""
    height, width = canvas.shape
    inside = piece[max(-row, 0) : max(height - row, 0), max(-col, 0) : max(width - col, 0)]
    row, col = max(row, 0), max(col, 0)
    canvas[row : row + inside.shape[0], col : col + inside.shape[1]] = inside
