"""The cells of a level and of the levels around it that can block an agent on it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import step_limit
from navbake.navgrid.lattice import Lattice

SLAB = 0.3  # [m] how thick the floor of a level above may be
ALIGNED = 1e-3  # of a cell: levels offset by less share one lattice


@dataclass(frozen=True)
class Surroundings:
    """A window of the scene's lattice around one level, with the cells of all levels in it.

    Attributes:
        level: index of the level in the arrays.
        rows, cols: the level's own rectangle in the arrays.
        floor: world z of the floor [m], NaN for none, shape (levels, rows, cols).
        occupied: `SceneGrid2D.solid`, and 1 beyond a level's rectangle, shape (levels, rows, cols).
        step: by how much floors of neighbours may differ [m].
        height: of the agent [m].
        slopes: which neighbours, on any level, links join that are more than a step apart: bits
            EAST, NORTH, WEST and SOUTH of `navbake.runtime.kernels.moves`, uint8, shape (levels,
            rows, cols); (0, 0, 0) where there are none.
        baked_radius: of the disc that is part of `occupied` [m]; 0 where the file has none, or
            the squares alone in a layer ``solid``.
    """

    level: int
    rows: slice
    cols: slice
    floor: NDArray[np.float32]
    occupied: NDArray[np.uint8]
    slopes: NDArray[np.uint8]
    step: float
    height: float
    baked_radius: float


def find_surroundings(grid: NavGrid, number: int, reach: int) -> Surroundings:
    """Collect the cells that an agent on a level may meet, which reaches some cells from its own.

    A single level is its own surroundings: nothing was baked beyond it. Several levels are pasted
    into one window, in which cells beyond a level count as occupied; levels on other lattices are
    left out.
    """
    level = grid.levels[number]
    has_solid = bool(level.navbake) and "solid" in level.attributes
    baked_radius = 0.0 if has_solid else grid.agent_radius
    agent = step_limit(grid) * grid.unit, grid.agent_height, baked_radius
    if len(grid.levels) == 1:
        inside = slice(0, level.height), slice(0, level.width)
        floor, occupied = _floor(level)[None], np.ascontiguousarray(level.solid)[None]
        slopes = _find_slopes(grid, [(0, 0)], floor, agent[0])
        return Surroundings(0, *inside, floor, occupied, slopes, *agent)
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
    return Surroundings(together.index(number), rows, cols, floor, occupied, slopes, *agent)


def _find_slopes(
    grid: NavGrid, at: list[tuple[int, int] | None], floor: NDArray[np.float32], step: float
) -> NDArray[np.uint8]:
    """The `slopes` of Surroundings; `at` has each level's row and column there, None for left out.

    The levels that are not left out are those of `floor`, in their order.
    """
    from navbake.runtime.kernels.moves import EAST, NORTH, SOUTH, WEST  # saves numba at start-up

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
