"""Finds the cells of a level that are blocked for an agent of a radius, by cells of all levels.

An agent's centre is on a cell's centre. The rules:

- Occupied cells: the agent must not overlap their squares, in which all baked geometry lies. The
  radius replaces the baked one: where the baked disc reaches beyond a square, the squares that
  geometry itself overlaps (`SceneGrid2D.solid`) replace the occupied ones, and a cell that only
  the baked disc blocked may become free.
- Higher floors in the disc: at most a step above the agent's. A ledge is a wall from below, and so
  is the step after the next one for an agent too large for the stair. Files that only have the
  occupancy of a larger radius follow the bake up to that radius.
- Lower floors in the disc: at most a step below the agent's, unless `ledges` is ``ignore``. In each
  column, the highest floor of all levels counts that isn't more than a step above the agent's. So
  the room under a gallery is no drop, but the stair beside it is.
- Slopes: a floor reached in a straight line over steps and at least one link between neighbours
  more than a step apart, as the bake finds on ramps, is neither higher nor lower.
- Other levels: the cells of both levels count where their floors are less than the body's height
  from the agent's. So an object under a landing does not block the stair to it.
- Outside the grid: beyond a single level, nothing blocks. Each of several levels is cut to the
  cells with a floor; the area beyond has no floor and counts as occupied.
- Cells without floor that are not occupied, in files of other programs: as in the original client,
  at least 0.7 of the cells in the disc must have a floor. Here this must hold for every smaller
  radius too, so that a larger agent is never free where a smaller one isn't.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import step_limit
from navbake.types import Bool, Int, Int32

if TYPE_CHECKING:
    from navbake.runtime.inflation_kernels import LevelStack

arrays = lazy("navbake.runtime.grid_arrays")  # numba loads slowly
compiled = lazy("navbake.compiled")
kernels = lazy("navbake.runtime.inflation_kernels")
ndimage = lazy("scipy.ndimage")

LEAST_FLOOR = 0.7  # share of the cells that a disc covers that must have a floor
ALIGNED = 1e-3  # of a cell: levels offset by less share one lattice
TOUCH = 1e-9  # share of a radius by which a disc may overlap a square


def find_blocked(
    grid: NavGrid, number: int, radius: float, ledges: str = "avoid", *, by_own: bool = True
) -> Bool:
    """Find the cells of a level where an agent of a radius [m] can't stand; see the module's head.

    With `by_own` False, the level's own occupied cells don't block, and all others with a floor do.
    """
    compiled.ensure_compiled("runtime.kernels.inflation.")
    cells = radius / grid.levels[number].lattice.cell_size
    stack, inside = find_surroundings(grid, number, math.ceil(cells) + 1)
    occupied = stack.occupied[stack.level]
    offsets, _, widths = disc(cells, occupied.shape)
    if by_own:
        blocked: Bool = kernels.dilate(occupied, widths)
        others = stack
    else:
        blocked = np.zeros(occupied.shape, dtype=np.bool_)
        others = stack._replace(occupied=np.ones_like(stack.occupied))
        others.occupied[stack.level] = 0
    if cells > 0:
        block_by_others(grid, number, others, radius, offsets, ledges, blocked)
        # holes that are not occupied and leave too little floor in a disc
        has_floor = ~np.isnan(stack.floor[stack.level])
        holes = ~has_floor & (occupied == 0)
        if holes.any():
            offsets, squares, widths = disc(cells, holes.shape, of_squares=False)
            near = kernels.dilate(holes.view(np.uint8), widths) & has_floor & ~blocked
            kernels.block_near_holes(has_floor, near, offsets, squares, LEAST_FLOOR, blocked)
    return blocked[inside]


def free_for(grid: NavGrid, radius: float, ledges: str) -> Bool:
    """The free cells of ``grid.inflate(radius)``, by flat id, without inflating the grid."""
    levels = enumerate(grid.levels)
    free = [v.free_for_point & ~find_blocked(grid, k, radius, ledges) for k, v in levels]
    return np.concatenate([mask.ravel() for mask in free])


def block_by_others(
    grid: NavGrid,
    number: int,
    stack: LevelStack,
    radius: float,
    offsets: Int,
    ledges: str,
    blocked: Bool,
) -> None:
    """Update `blocked` by other levels and floors, within `offsets` of an agent's cell."""
    level = grid.levels[number]
    # up to the baked radius, `occupied` has the higher floors; a layer `solid` has none
    has_solid = bool(level.navbake) and "solid" in level.attributes
    counts_higher = radius > (0.0 if has_solid else grid.agent_radius)
    least = np.fmin.reduce(stack.floor, axis=None)
    most = np.fmax.reduce(stack.floor, axis=None)
    if len(stack.floor) == 1 and not most - least > stack.step:
        return  # neither higher nor lower floors
    # the lowest and the highest floors in the tiles that offsets lead to from each tile
    tile = kernels.TILE
    ranges = []
    window = 2 * -(-int(np.abs(offsets).max()) // tile) + 1
    pads = [(0, 0), *((0, -size % tile) for size in blocked.shape)]
    floor = np.pad(stack.floor, pads, constant_values=np.nan)
    for extreme, of_window, beyond in (
        (np.fmin, ndimage.minimum_filter, np.float32(np.inf)),
        (np.fmax, ndimage.maximum_filter, np.float32(-np.inf)),
    ):
        # slice by slice, in a tenth of the time of `reduceat`
        tiles = reduce(extreme, [floor[:, k::tile] for k in range(tile)])
        tiles = reduce(extreme, [tiles[:, :, k::tile] for k in range(tile)])
        tiles = np.where(np.isnan(tiles), beyond, tiles)
        size = (1, window, window)
        ranges.append(of_window(tiles, size=size, mode="constant", cval=beyond))
    avoids = ledges == "avoid"
    kernels.block_by_floors(stack, *ranges, offsets, counts_higher, avoids, blocked)


def disc(
    radius: float, shape: tuple[int, int], *, of_squares: bool = True
) -> tuple[Int, Int, Int32]:
    """Steps from a cell to the cells whose squares, or centres, an open disc round it reaches.

    Returns rows and columns within `shape`, (n, 2), nearest first; their squared distances in half
    cells; and the disc's half widths by row for `dilate`. The radius is in cells.
    """
    rows, cols = (np.arange(-n, n + 1) for n in (min(math.ceil(radius) + 1, s) for s in shape))
    # squared half cells along an axis to the near side, or to the centre, of squares
    along = [2 * np.abs(steps) for steps in (rows, cols)]
    down, across = (np.maximum(v - 1, 0) ** 2 if of_squares else v**2 for v in along)
    squares = down[:, None] + across
    reached = squares < (2 * radius) ** 2 * (1 - TOUCH)  # touching is not reaching
    row, col = np.nonzero(reached)
    found = squares[row, col]
    order = np.argsort(found, kind="stable")
    width = np.count_nonzero(reached[len(rows) // 2 :], axis=1) // 2
    width = np.append(width[reached[len(rows) // 2 :].any(axis=1)], -1).astype(np.int32)
    return np.stack([rows[row], cols[col]], axis=1)[order], found[order], width


def find_surroundings(
    grid: NavGrid, number: int, reach: int
) -> tuple[LevelStack, tuple[slice, slice]]:
    """The cells near an agent on a level, and the level's own rectangle among them."""
    level = grid.levels[number]
    agent = (step_limit(grid) * grid.unit, grid.agent_height)
    placed = dict[int, tuple[int, int]]()
    x_min, y_max, size, *_ = level.lattice
    for k, other in enumerate(part.lattice for part in grid.levels):
        # row and column of its cell (0, 0) in the level's lattice, whose cells must coincide
        row = (y_max - other.y_max) / size
        col = (other.x_min - x_min) / size
        growth = abs(other.cell_size / size - 1) * max(*level.shape, *other.shape)
        if max(abs(row - round(row)), abs(col - round(col)), growth) < ALIGNED:
            placed[k] = round(row), round(col)
    top = left = 0
    if len(grid.levels) == 1:
        floor = _floor(level)[None]
        occupied = np.ascontiguousarray(level.solid)[None]
    else:
        ends = np.array([[*at, *np.add(at, grid.levels[k].shape)] for k, at in placed.items()])
        top, left = (max(-reach, int(least)) - 1 for least in ends[:, :2].min(axis=0))
        most = ends[:, 2:].max(axis=0)
        bottom, right = (min(n + reach, int(m)) + 1 for n, m in zip(level.shape, most, strict=True))
        shape = (len(placed), bottom - top, right - left)
        floor = np.full(shape, np.nan, dtype=np.float32)
        occupied = np.ones(shape, dtype=np.uint8)
        for i, (k, (row, col)) in enumerate(placed.items()):
            part = grid.levels[k]
            _paste(floor[i], _floor(part), row - top, col - left)
            _paste(occupied[i], part.solid, row - top, col - left)
    at = {k: (i, row - top, col - left) for i, (k, (row, col)) in enumerate(placed.items())}
    slopes = _find_slopes(grid, at, floor, agent[0])
    stack = kernels.LevelStack(floor, occupied, slopes, at[number][0], *agent)
    return stack, (slice(-top, level.height - top), slice(-left, level.width - left))


def _find_slopes(
    grid: NavGrid, at: dict[int, tuple[int, int, int]], floor: NDArray[np.float32], step: float
) -> NDArray[np.uint8]:
    """The `slopes` of LevelStack; `at` has each level's index, row and column in them."""
    links = grid.step_array
    none = np.zeros((0, 0, 0), dtype=np.uint8)
    links = links[np.isin(links[:, ::2], list(at)).all(axis=1)]
    if not len(links):
        return none
    place = np.array([at.get(k, (0, 0, 0)) for k in range(len(grid.levels))])
    width = np.array([level.width for level in grid.levels])
    one, other = (
        (place[level] + np.stack([0 * cell, *np.divmod(cell, width[level])], axis=1)).T
        for level, cell in (links[:, :2].T, links[:, 2:].T)
    )
    size = np.array(floor.shape)[:, None]
    inside = ((one >= 0) & (one < size) & (other >= 0) & (other < size)).all(axis=0)
    one = one[:, inside]
    other = other[:, inside]
    is_slope = np.abs(floor[tuple(one)] - floor[tuple(other)]) > step
    is_slope &= np.abs(other - one)[1:].sum(axis=0) == 1
    if not is_slope.any():
        return none
    slopes = np.zeros(floor.shape, dtype=np.uint8)
    toward = np.zeros((3, 3), dtype=np.uint8)  # by step down and across, the middle is none
    toward[[1, 0, 1, 2], [2, 1, 0, 1]] = arrays.EAST, arrays.NORTH, arrays.WEST, arrays.SOUTH
    one = one[:, is_slope]
    other = other[:, is_slope]
    for here, there in ((one, other), (other, one)):
        np.bitwise_or.at(slopes, tuple(here), toward[tuple((there - here)[1:] + 1)])
    return slopes


def _floor(level: SceneGrid2D) -> NDArray[np.float32]:
    """World z of the level's floor [m]."""
    floor = np.ascontiguousarray(level.floor_height)
    return floor if level.unit == 1 else floor * np.float32(level.unit)


def _paste(canvas: NDArray, piece: NDArray, row: int, col: int) -> None:  # type: ignore[type-arg]
    """Copy a piece to a position on a canvas; only the overlap is copied."""
    height, width = canvas.shape
    inside = piece[max(-row, 0) : max(height - row, 0), max(-col, 0) : max(width - col, 0)]
    row = max(row, 0)
    col = max(col, 0)
    canvas[row : row + inside.shape[0], col : col + inside.shape[1]] = inside
