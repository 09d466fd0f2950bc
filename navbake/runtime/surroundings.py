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
from typing import TYPE_CHECKING, NamedTuple

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
ALIGNMENT_TOLERANCE = 1e-3  # of a cell: levels offset by less share one lattice
RADIUS_SLACK = 1e-9  # share of a radius by which a disc may overlap a square, for rounding


class DiscOffsets(NamedTuple):
    """Offsets from a cell to the cells that an open disc round its centre reaches.

    Attributes:
        offsets: steps to them, rows and columns, shape (n, 2), nearest first.
        squares: the squared distances to them, in half cells, shape (n,).
        half_widths: the disc by row, as `navbake.runtime.inflation_kernels.dilate` takes it.
    """

    offsets: Int
    squares: Int
    half_widths: Int32


class StackPlace(NamedTuple):
    """Where a level's cells lie in the arrays of a `LevelStack`.

    Attributes:
        layer: the level's index in the arrays.
        row: row of the level's cell (0, 0).
        col: column of the level's cell (0, 0).
    """

    layer: int
    row: int
    col: int


def find_blocked(
    grid: NavGrid,
    level_number: int,
    radius: float,
    ledges: str = "avoid",
    *,
    by_own_level: bool = True,
) -> Bool:
    """Mark the cells of a level where an agent can't stand; the module's docstring has the rules.

    Args:
        grid: the grid; its weights don't count.
        level_number: the level.
        radius: of the agent [m], >= 0.
        ledges: ``avoid`` or ``ignore``, see `navbake.runtime.inflation.inflate`.
        by_own_level: if False, the level's own occupied cells don't block, and all its other cells
            with a floor do.

    Returns:
        bool, shape (height, width) of the level.
    """
    compiled.ensure_compiled("runtime.inflation_kernels.")
    radius_in_cells = radius / grid.levels[level_number].lattice.cell_size
    stack, inside = stack_levels(grid, level_number, math.ceil(radius_in_cells) + 1)
    occupied = stack.occupied[stack.level]
    disc = find_disc_offsets(radius_in_cells, occupied.shape)
    if by_own_level:
        blocked: Bool = kernels.dilate(occupied, disc.half_widths)
    else:
        blocked = np.zeros(occupied.shape, dtype=np.bool_)
        stack = stack._replace(occupied=np.ones_like(stack.occupied))
        stack.occupied[stack.level] = 0
    if radius_in_cells > 0:
        block_by_floors(grid, level_number, stack, radius, disc.offsets, ledges, blocked)
        # holes that are not occupied and leave too little floor in a disc
        has_floor = ~np.isnan(stack.floor[stack.level])
        is_hole = ~has_floor & (occupied == 0)
        if is_hole.any():
            disc = find_disc_offsets(radius_in_cells, is_hole.shape, of_squares=False)
            near_hole = kernels.dilate(is_hole.view(np.uint8), disc.half_widths)
            near_hole = near_hole & has_floor & ~blocked
            kernels.block_near_holes(
                has_floor, near_hole, disc.offsets, disc.squares, LEAST_FLOOR, blocked
            )
    return blocked[inside]


def find_free(grid: NavGrid, radius: float, ledges: str) -> Bool:
    """Mark the cells that would be free in ``grid.inflate(radius)``, without inflating the grid.

    Args:
        grid: a grid of one or several levels.
        radius: of the agent [m], >= 0.
        ledges: ``avoid`` or ``ignore``.

    Returns:
        bool, by flat id.
    """
    free_by_level = [
        level.free_for_point & ~find_blocked(grid, number, radius, ledges)
        for number, level in enumerate(grid.levels)
    ]
    return np.concatenate([free.ravel() for free in free_by_level])


def block_by_floors(
    grid: NavGrid,
    level_number: int,
    stack: LevelStack,
    radius: float,
    offsets: Int,
    ledges: str,
    blocked: Bool,
) -> None:
    """Update `blocked` by the floors and the other levels within `offsets` of an agent's cell.

    Args:
        grid: the grid.
        level_number: the agent's level.
        stack: the cells near it, of `stack_levels`.
        radius: of the agent [m].
        offsets: steps to the cells that the agent meets, shape (n, 2).
        ledges: ``avoid`` or ``ignore``.
        blocked: cells of the stack, bool, shape (rows, cols), written.
    """
    level = grid.levels[level_number]
    # up to the baked radius, `occupied` has the higher floors; a layer `solid` has none
    has_solid = bool(level.navbake) and "solid" in level.attributes
    counts_higher = radius > (0.0 if has_solid else grid.agent_radius)
    lowest_floor = np.fmin.reduce(stack.floor, axis=None)
    highest_floor = np.fmax.reduce(stack.floor, axis=None)
    if len(stack.floor) == 1 and not highest_floor - lowest_floor > stack.step:
        return  # neither higher nor lower floors
    # the lowest and the highest floors in the patches that offsets lead to from each patch
    patch_size = kernels.PATCH_SIZE
    window = 2 * -(-int(np.abs(offsets).max()) // patch_size) + 1
    padding = [(0, 0), *((0, -size % patch_size) for size in blocked.shape)]
    floor = np.pad(stack.floor, padding, constant_values=np.nan)
    lowest = _extremes_of_windows(np.fmin, floor, patch_size, window)
    highest = _extremes_of_windows(np.fmax, floor, patch_size, window)
    counts_lower = ledges == "avoid"
    kernels.block_by_floors(stack, lowest, highest, offsets, counts_higher, counts_lower, blocked)


def _extremes_of_windows(
    extreme: np.ufunc, floor: NDArray[np.float32], patch_size: int, window: int
) -> NDArray[np.float32]:
    """Compute the lowest or highest floors in the patches of a window round each patch.

    `extreme` is `numpy.fmin` or `numpy.fmax`; `window` is a number of patches. Patches without
    floor, and beyond the array, count as infinitely high or low.
    """
    is_lowest = extreme is np.fmin
    beyond = np.float32(np.inf if is_lowest else -np.inf)
    # slice by slice, in a tenth of the time of `reduceat`
    patches = reduce(extreme, [floor[:, k::patch_size] for k in range(patch_size)])
    patches = reduce(extreme, [patches[:, :, k::patch_size] for k in range(patch_size)])
    patches = np.where(np.isnan(patches), beyond, patches)
    filter_patches = ndimage.minimum_filter if is_lowest else ndimage.maximum_filter
    extremes: NDArray[np.float32] = filter_patches(
        patches, size=(1, window, window), mode="constant", cval=beyond
    )
    return extremes


def find_disc_offsets(
    radius: float, shape: tuple[int, int], *, of_squares: bool = True
) -> DiscOffsets:
    """List the steps from a cell to the cells that an open disc round its centre reaches.

    Args:
        radius: of the disc, in cells.
        shape: rows and columns of the array; longer steps are left out.
        of_squares: whether the disc has to reach the cells' squares, else their centres.
    """
    row_reach = min(math.ceil(radius) + 1, shape[0])
    col_reach = min(math.ceil(radius) + 1, shape[1])
    rows = np.arange(-row_reach, row_reach + 1)
    cols = np.arange(-col_reach, col_reach + 1)
    squares = _half_cells(rows, of_squares)[:, None] ** 2 + _half_cells(cols, of_squares) ** 2
    is_reached = squares < (2 * radius) ** 2 * (1 - RADIUS_SLACK)  # touching is not reaching
    row, col = np.nonzero(is_reached)
    reached_squares = squares[row, col]
    order = np.argsort(reached_squares, kind="stable")
    rows_down = is_reached[len(rows) // 2 :]
    half_widths = np.count_nonzero(rows_down, axis=1) // 2
    half_widths = np.append(half_widths[rows_down.any(axis=1)], -1).astype(np.int32)
    offsets = np.stack([rows[row], cols[col]], axis=1)
    return DiscOffsets(offsets[order], reached_squares[order], half_widths)


def _half_cells(steps: Int, of_squares: bool) -> Int:
    """Compute distances along an axis to squares' near sides or centres, in half cells."""
    half_cells = 2 * np.abs(steps)
    return np.maximum(half_cells - 1, 0) if of_squares else half_cells


def stack_levels(
    grid: NavGrid, level_number: int, reach: int
) -> tuple[LevelStack, tuple[slice, slice]]:
    """Stack the cells of a level and of the levels around it into arrays of one lattice.

    Args:
        grid: a grid of one or several levels.
        level_number: the agent's level.
        reach: how far beyond the level's cells the arrays go at most [cells].

    Returns:
        The stack; and the rows and columns of the level's own rectangle in it.
    """
    level = grid.levels[level_number]
    step = step_limit(grid) * grid.unit
    corners = _find_aligned_levels(grid, level_number)
    first_row = 0
    first_col = 0
    if len(grid.levels) == 1:
        floor = _floor_in_metres(level)[None]
        occupied = np.ascontiguousarray(level.solid)[None]
    else:
        rectangles = np.array([
            [row, col, row + grid.levels[k].height, col + grid.levels[k].width]
            for k, (row, col) in corners.items()
        ])  # fmt: skip
        least = rectangles[:, :2].min(axis=0)
        greatest = rectangles[:, 2:].max(axis=0)
        first_row = max(-reach, int(least[0])) - 1
        first_col = max(-reach, int(least[1])) - 1
        end_row = min(level.height + reach, int(greatest[0])) + 1
        end_col = min(level.width + reach, int(greatest[1])) + 1
        shape = (len(corners), end_row - first_row, end_col - first_col)
        floor = np.full(shape, np.nan, dtype=np.float32)
        occupied = np.ones(shape, dtype=np.uint8)
        for index, (k, (row, col)) in enumerate(corners.items()):
            stacked_level = grid.levels[k]
            stacked_floor = _floor_in_metres(stacked_level)
            _paste(floor[index], stacked_floor, row - first_row, col - first_col)
            _paste(occupied[index], stacked_level.solid, row - first_row, col - first_col)
    places = {
        k: StackPlace(index, row - first_row, col - first_col)
        for index, (k, (row, col)) in enumerate(corners.items())
    }
    stack: LevelStack = kernels.LevelStack(
        floor=floor,
        occupied=occupied,
        slopes=_mark_slopes(grid, places, floor, step),
        level=places[level_number].layer,
        step=step,
        height=grid.agent_height,
    )
    rows = slice(-first_row, level.height - first_row)
    cols = slice(-first_col, level.width - first_col)
    return stack, (rows, cols)


def _find_aligned_levels(grid: NavGrid, level_number: int) -> dict[int, tuple[int, int]]:
    """Find the levels whose cells coincide with those of a level.

    Returns row and column of each one's cell (0, 0) in the level's lattice, by the level's number.
    """
    level = grid.levels[level_number]
    x_min, y_max, size, *_ = level.lattice
    corners = dict[int, tuple[int, int]]()
    for number, neighbor in enumerate(grid.levels):
        lattice = neighbor.lattice
        row = (y_max - lattice.y_max) / size
        col = (lattice.x_min - x_min) / size
        # by how many cells the levels drift apart where the sizes of their cells differ
        drift = abs(lattice.cell_size / size - 1) * max(*level.shape, *neighbor.shape)
        if max(abs(row - round(row)), abs(col - round(col)), drift) < ALIGNMENT_TOLERANCE:
            corners[number] = (round(row), round(col))
    return corners


def _mark_slopes(
    grid: NavGrid, places: dict[int, StackPlace], floor: NDArray[np.float32], step: float
) -> NDArray[np.uint8]:
    """Make the `slopes` of a LevelStack from the grid's steps; `places` are by level."""
    links = grid.step_array
    no_slopes = np.zeros((0, 0, 0), dtype=np.uint8)
    links = links[np.isin(links[:, ::2], list(places)).all(axis=1)]
    if not len(links):
        return no_slopes
    starts = _stack_indices(grid, places, level=links[:, 0], cell=links[:, 1])
    ends = _stack_indices(grid, places, level=links[:, 2], cell=links[:, 3])
    size = np.array(floor.shape)[:, None]
    is_inside = ((starts >= 0) & (starts < size) & (ends >= 0) & (ends < size)).all(axis=0)
    starts = starts[:, is_inside]
    ends = ends[:, is_inside]
    is_slope = np.abs(floor[tuple(starts)] - floor[tuple(ends)]) > step
    is_slope &= np.abs(ends - starts)[1:].sum(axis=0) == 1
    if not is_slope.any():
        return no_slopes
    slopes = np.zeros(floor.shape, dtype=np.uint8)
    # the bit of a direction by steps down and across, from -1 to 1; the middle is no direction
    direction_bits = np.zeros((3, 3), dtype=np.uint8)
    direction_bits[1, 2] = arrays.EAST
    direction_bits[0, 1] = arrays.NORTH
    direction_bits[1, 0] = arrays.WEST
    direction_bits[2, 1] = arrays.SOUTH
    starts = starts[:, is_slope]
    ends = ends[:, is_slope]
    for cells, neighbors in ((starts, ends), (ends, starts)):
        bits = direction_bits[tuple((neighbors - cells)[1:] + 1)]
        np.bitwise_or.at(slopes, tuple(cells), bits)
    return slopes


def _stack_indices(grid: NavGrid, places: dict[int, StackPlace], level: Int, cell: Int) -> Int:
    """Compute index, row and column in a LevelStack of cells by level and id, shape (3, n)."""
    no_place = StackPlace(0, 0, 0)
    corners = np.array([places.get(k, no_place) for k in range(len(grid.levels))])
    widths = np.array([level.width for level in grid.levels])
    rows, cols = np.divmod(cell, widths[level])
    indices: Int = (corners[level] + np.stack([np.zeros_like(cell), rows, cols], axis=1)).T
    return indices


def _floor_in_metres(level: SceneGrid2D) -> NDArray[np.float32]:
    """Compute world z of the level's floor [m], float32, contiguous."""
    floor = np.ascontiguousarray(level.floor_height)
    return floor if level.unit == 1 else floor * np.float32(level.unit)


def _paste(canvas: NDArray[np.generic], piece: NDArray[np.generic], row: int, col: int) -> None:
    """Copy a piece to a position on a canvas; only the overlap is copied."""
    height, width = canvas.shape
    rows = slice(max(-row, 0), max(height - row, 0))
    cols = slice(max(-col, 0), max(width - col, 0))
    overlap = piece[rows, cols]
    row = max(row, 0)
    col = max(col, 0)
    canvas[row : row + overlap.shape[0], col : col + overlap.shape[1]] = overlap
