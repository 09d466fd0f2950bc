"""Finds the cells of a level where an agent of a given radius can't stand.

The agent is a disc whose centre is on a cell's centre. The rules:

- Occupied cells: the disc must not overlap their squares. If the file has a layer ``solid``, only
  the squares that geometry itself overlaps are occupied (`SceneGrid2D.solid`). So the given radius
  replaces the baked one, and a cell that only the baked disc blocked may become free.
- Higher floors: no floor in the disc may be more than a step above the agent's floor. So a ledge
  blocks the agents below it. The next-but-one tread of a stair blocks an agent whose disc overlaps
  it. Two kinds of floors may be so high over the agent that they don't block:

  - a floor of another level, if it is above the agent's floor by the agent's height and a slab's
    thickness or more;
  - a floor of the agent's own level, if it is higher by a step more than that, and another level
    has a floor under it within a step of the agent's. So the next flight of a stair doesn't close
    the flight below.

  Files without ``solid`` have an occupancy that already includes this for the baked radius; there,
  the rule applies to larger radii only.
- Lower floors: no floor in the disc may be more than a step below the agent's floor, unless
  `ledges` is ``ignore``. Where several levels have a floor in a cell, the highest one that isn't
  more than a step above the agent's floor decides. So for an agent on a gallery, the room under it
  is no drop, but a stair beside it is.
- Slopes: on steep ramps, the bake joins neighbours whose floors differ by more than a step. A floor
  is neither too high nor too low if the agent can walk there straight over such a slope.
- Other levels: their occupied cells block where their floors are less than the agent's height,
  minus a step, above or below the agent's floor. So an object under a landing doesn't block the
  stair to it.
- The edge of the grid: nothing is known beyond the rectangle that encloses all levels, so nothing
  blocks there. Each level of several is cut to the cells with a floor; within that rectangle, the
  area beyond a level's own cells has no floor on the level and counts as occupied.
- Cells without a floor that are not occupied, in files of other programs: at least 0.7 of the cells
  in the disc must have a floor, as in MINOS's client. Here this must hold for every smaller radius
  too, so that a larger agent is never free where a smaller one isn't.
"""

from __future__ import annotations

import math
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
threads = lazy("navbake.threads")

LEAST_FLOOR = 0.7  # least share of the cells in an agent's disc that must have a floor
ALIGNMENT_TOLERANCE = 1e-3  # share of a cell: levels that are offset by less have the same lattice
RADIUS_SLACK = 1e-9  # share of a radius by which a disc may overlap a square, for rounding


class DiscOffsets(NamedTuple):
    """The cells that a disc round a cell's centre overlaps; touching is not overlapping.

    Attributes:
        offsets: rows and columns from the cell to these cells, shape (n, 2), nearest first.
        squared_distances: the squared distances to these cells, shape (n,), in half cells, so that
            they are whole numbers.
        half_widths: for each row from the disc's middle up, how many columns the disc covers to
            each side, then -1; see `navbake.runtime.inflation_kernels.dilate_along_rows`.
    """

    offsets: Int
    squared_distances: Int
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


def find_blocked(grid: NavGrid, level_number: int, radius: float, ledges: str = "avoid") -> Bool:
    """Mark the cells of a level where an agent can't stand, by the rules that the module lists.

    Args:
        grid: the grid; its weights don't count.
        level_number: number of the level.
        radius: the agent's radius [m], >= 0.
        ledges: ``avoid`` or ``ignore``, see `navbake.runtime.inflation.inflate`.

    Returns:
        bool, shape (height, width) of the level.
    """
    margin = find_margin(radius, grid.levels[level_number].lattice.cell_size)
    stack, level_window = stack_levels(grid, level_number, margin)
    return find_blocked_in_stack(grid, level_number, stack, level_window, radius, ledges)


def find_margin(radius: float, cell_size: float) -> int:
    """Return by how many cells an agent's surroundings extend beyond its own cell.

    Args:
        radius: the agent's radius [m], >= 0.
        cell_size: edge of a cell [m].
    """
    return math.ceil(radius / cell_size) + 1


def find_blocked_in_stack(
    grid: NavGrid,
    level_number: int,
    stack: LevelStack,
    level_window: tuple[slice, slice],
    radius: float,
    ledges: str = "avoid",
    *,
    counts_own_occupied: bool = True,
) -> Bool:
    """Mark the cells of a level where an agent can't stand, as `find_blocked` does.

    Args:
        grid: the grid; its weights don't count.
        level_number: number of the level.
        stack: the cells of this level and those around it, from `stack_levels`, with the margin
            for the radius or a larger one, see `find_margin`.
        level_window: rows and columns of the level's own cells in the stack.
        radius: the agent's radius [m], >= 0.
        ledges: ``avoid`` or ``ignore``, see `navbake.runtime.inflation.inflate`.
        counts_own_occupied: whether the level's own occupied cells block, as the rules say. If
            False, they don't; all other rules hold, and all cells of other levels count as
            occupied. So the cells that are marked are an upper bound, whatever stands on those
            levels.

    Returns:
        bool, shape (height, width) of the level.
    """
    compiled.ensure_compiled("runtime.inflation_kernels.")
    radius_in_cells = radius / grid.levels[level_number].lattice.cell_size
    occupied = stack.occupied[stack.level]
    disc_offsets = find_disc_offsets(radius_in_cells, occupied.shape)
    if counts_own_occupied:
        is_blocked: Bool = _dilate(occupied, disc_offsets.half_widths)
    else:
        occupied_beyond_level = occupied.copy()
        occupied_beyond_level[level_window] = 0
        is_blocked = _dilate(occupied_beyond_level, disc_offsets.half_widths)
        stack = stack._replace(occupied=np.ones_like(stack.occupied))
        stack.occupied[stack.level] = occupied_beyond_level
    if radius_in_cells > 0:
        block_by_floors(grid, level_number, stack, radius, disc_offsets.offsets, ledges, is_blocked)
        # holes that are not occupied and leave too little floor in a disc
        is_hole = np.isnan(stack.floor[stack.level])
        is_hole &= occupied == 0
        if is_hole.any():
            has_floor = ~np.isnan(stack.floor[stack.level])
            disc_offsets = find_disc_offsets(radius_in_cells, is_hole.shape, to_squares=False)
            is_near_hole = _dilate(is_hole.view(np.uint8), disc_offsets.half_widths)
            is_near_hole = is_near_hole & has_floor & ~is_blocked
            kernels.block_near_holes(
                has_floor,
                is_near_hole,
                disc_offsets.offsets,
                disc_offsets.squared_distances,
                LEAST_FLOOR,
                is_blocked,
            )
    return is_blocked[level_window]


def find_free(grid: NavGrid, radius: float, ledges: str) -> Bool:
    """Mark the cells that would be free in ``grid.inflate(radius)``, without inflating the grid.

    Args:
        grid: a grid of one or several levels.
        radius: the agent's radius [m], >= 0.
        ledges: ``avoid`` to keep agents away from drops, or ``ignore``.

    Returns:
        bool, by flat id.
    """
    free_masks = [
        level.free_for_point & ~find_blocked(grid, level_number, radius, ledges)
        for level_number, level in enumerate(grid.levels)
    ]
    return np.concatenate([is_free.ravel() for is_free in free_masks])


def block_by_floors(
    grid: NavGrid,
    level_number: int,
    stack: LevelStack,
    radius: float,
    cell_offsets: Int,
    ledges: str,
    is_blocked: Bool,
) -> None:
    """Apply the rules about floors and about other levels to the cells of a stack.

    Cells get blocked near floors that are too high or too low, and near cells that are occupied on
    other levels. Cells become free where only another level has a floor.

    Args:
        grid: the grid.
        level_number: number of the agent's level.
        stack: the cells of this level and those around it, from `stack_levels`.
        radius: the agent's radius [m].
        cell_offsets: rows and columns from an agent's cell to the cells that it overlaps, shape
            (n, 2).
        ledges: ``avoid`` to keep agents away from drops, or ``ignore``.
        is_blocked: whether each cell of the stack is blocked, bool, shape (rows, cols), written.
    """
    level = grid.levels[level_number]
    # `occupied` includes higher floors up to the baked radius, but a layer `solid` doesn't
    has_solid = bool(level.navbake) and "solid" in level.attributes
    higher_floors_block = radius > (0.0 if has_solid else grid.agent_radius)
    patch_min_z, patch_max_z = _find_patch_extremes(stack)
    if len(stack.floor) == 1 and not patch_max_z.max() - patch_min_z.min() > stack.max_step:
        return  # no floor is higher or lower than another by more than a step
    patch_min_z, patch_max_z = _find_extremes_near(patch_min_z, patch_max_z, cell_offsets)
    lower_floors_block = ledges == "avoid"
    kernels.block_by_floors(
        stack,
        patch_min_z,
        patch_max_z,
        cell_offsets,
        higher_floors_block,
        lower_floors_block,
        is_blocked,
    )


def look_up_by_distance(
    grid: NavGrid, level_number: int, cost_of_square: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Look up a cost for each cell by its distance to the nearest occupied cell.

    Distances are measured between the centres of cells. As in `find_blocked`, the cells that
    `SceneGrid2D.solid` marks count as occupied; it also marks cells without a floor.

    A floor may go on at about the same height on another level. There, the cells of that level
    count instead of those of the given level.

    Args:
        grid: the grid; its weights don't count.
        level_number: number of the level.
        cost_of_square: the cost by squared distance in cells, shape (n,); larger distances cost 0.

    Returns:
        Costs, uint8, shape (height, width) of the level.
    """
    max_distance = math.ceil(math.sqrt(len(cost_of_square)))
    stack, level_window = stack_levels(grid, level_number, max_distance + 1)
    compiled.ensure_compiled("runtime.inflation_kernels.")
    occupied = stack.occupied[stack.level]
    costs = np.empty(occupied.shape, dtype=np.uint8)
    threads.run_in_chunks(
        kernels.look_up_along_rows,
        len(occupied),
        kernels.measure_along_columns(occupied, max_distance),
        cost_of_square,
        costs,
        min_chunk_size=max(1, threads.LEAST_CELLS // occupied.shape[1]),
    )
    if len(stack.floor) > 1:
        disc_offsets = find_disc_offsets(max_distance + 1.0, occupied.shape, to_squares=False)
        patch_min_z, patch_max_z = _find_patch_extremes(stack)
        patch_min_z, patch_max_z = _find_extremes_near(
            patch_min_z, patch_max_z, disc_offsets.offsets
        )
        kernels.look_up_near_levels(
            stack,
            patch_min_z,
            patch_max_z,
            disc_offsets.offsets,
            disc_offsets.squared_distances // 4,  # of half cells
            cost_of_square,
            costs,
        )
    return costs[level_window]


def _dilate(is_occupied: NDArray[np.uint8], half_widths: Int32) -> Bool:
    """Mark the cells that a shape covers when it is centred on any occupied cell.

    Args:
        is_occupied: shape (rows, cols).
        half_widths: the shape, see `DiscOffsets`.
    """
    is_covered = np.empty(is_occupied.shape, dtype=np.bool_)
    threads.run_in_chunks(
        kernels.dilate_along_rows,
        len(is_occupied),
        kernels.measure_along_columns(is_occupied, len(half_widths) - 1),
        half_widths,
        is_covered,
        min_chunk_size=max(1, threads.LEAST_CELLS // is_occupied.shape[1]),
    )
    return is_covered


def _find_patch_extremes(stack: LevelStack) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Find the lowest and the highest floor of each patch of cells.

    Args:
        stack: the cells of a level and those around it.

    Returns:
        z of the lowest floors, inf for none, and of the highest ones, -inf for none [m], each of
        shape (levels, patch rows, patch columns); see `kernels.find_patch_extremes`.
    """
    num_levels, num_rows, num_cols = stack.floor.shape
    num_patch_rows = -(-num_rows // kernels.PATCH_SIZE)
    num_patch_cols = -(-num_cols // kernels.PATCH_SIZE)
    patch_min_z = np.empty((num_levels, num_patch_rows, num_patch_cols), dtype=np.float32)
    patch_max_z = np.empty_like(patch_min_z)
    cells_in_patch_row = num_levels * num_cols * kernels.PATCH_SIZE
    threads.run_in_chunks(
        kernels.find_patch_extremes,
        num_patch_rows,
        stack.floor,
        patch_min_z,
        patch_max_z,
        min_chunk_size=max(1, threads.LEAST_CELLS // cells_in_patch_row),
    )
    return patch_min_z, patch_max_z


def _find_extremes_near(
    patch_min_z: NDArray[np.float32], patch_max_z: NDArray[np.float32], cell_offsets: Int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Find the lowest and highest floors in the patches that offsets lead to from each patch.

    Args:
        patch_min_z: z of the lowest floor of each patch, from `_find_patch_extremes` [m].
        patch_max_z: z of its highest floor [m].
        cell_offsets: rows and columns from a cell to others, shape (n, 2).

    Returns:
        z of the lowest and of the highest floors [m], each of the shape of `patch_min_z`.
    """
    window_size = 2 * -(-int(np.abs(cell_offsets).max()) // kernels.PATCH_SIZE) + 1
    window = (1, window_size, window_size)
    min_z = ndimage.minimum_filter(patch_min_z, window, mode="constant", cval=np.inf)
    max_z = ndimage.maximum_filter(patch_max_z, window, mode="constant", cval=-np.inf)
    return min_z, max_z


def find_disc_offsets(
    radius: float, shape: tuple[int, int], *, to_squares: bool = True
) -> DiscOffsets:
    """List the offsets from a cell to the cells that a disc round its centre overlaps.

    Args:
        radius: the disc's radius, in cells.
        shape: rows and columns of the array that the offsets are for; longer offsets are left out.
        to_squares: True for cells whose squares the disc overlaps, False for those whose centres
            lie in it.
    """
    max_row_offset = min(math.ceil(radius) + 1, shape[0])
    max_col_offset = min(math.ceil(radius) + 1, shape[1])
    rows = np.arange(-max_row_offset, max_row_offset + 1)
    cols = np.arange(-max_col_offset, max_col_offset + 1)
    squared_distances = (
        _distances_in_half_cells(rows, to_squares)[:, None] ** 2
        + _distances_in_half_cells(cols, to_squares) ** 2
    )
    is_reached = squared_distances < (2 * radius) ** 2 * (
        1 - RADIUS_SLACK
    )  # touching is not reaching
    row_indices, col_indices = np.nonzero(is_reached)
    reached_squared_distances = squared_distances[row_indices, col_indices]
    sort_indices = np.argsort(reached_squared_distances, kind="stable")
    reached_below = is_reached[len(rows) // 2 :]
    half_widths = np.count_nonzero(reached_below, axis=1) // 2
    half_widths = np.append(half_widths[reached_below.any(axis=1)], -1).astype(np.int32)
    cell_offsets = np.stack([rows[row_indices], cols[col_indices]], axis=1)
    return DiscOffsets(
        cell_offsets[sort_indices], reached_squared_distances[sort_indices], half_widths
    )


def _distances_in_half_cells(cell_distances: Int, to_squares: bool) -> Int:
    """Compute distances along an axis in half cells, from a cell's centre to other cells.

    Args:
        cell_distances: numbers of cells from the cell to the others, shape (n,).
        to_squares: whether to measure to the near sides of their squares, else to their centres.
    """
    half_cells = 2 * np.abs(cell_distances)
    return np.maximum(half_cells - 1, 0) if to_squares else half_cells


def stack_levels(
    grid: NavGrid, level_number: int, margin: int
) -> tuple[LevelStack, tuple[slice, slice]]:
    """Stack the cells of a level and of the levels around it into arrays of one lattice.

    Args:
        grid: a grid of one or several levels.
        level_number: the agent's level.
        margin: by how many cells the arrays extend beyond the level's own cells, where other levels
            have cells there.

    Returns:
        The stack, and the rows and columns of the level's own cells in it. Its arrays may be the
        level's own: they must not be changed.
    """
    level = grid.levels[level_number]
    max_step = step_limit(grid) * grid.unit
    corner_by_level = _find_aligned_levels(grid, level_number)
    rectangles = np.array([
        [row, col, row + grid.levels[k].height, col + grid.levels[k].width]
        for k, (row, col) in corner_by_level.items()
    ])  # fmt: skip
    first_corner = rectangles[:, :2].min(axis=0)
    stop_corner = rectangles[:, 2:].max(axis=0)
    first_row = max(-margin, int(first_corner[0]))
    first_col = max(-margin, int(first_corner[1]))
    stop_row = min(level.height + margin, int(stop_corner[0]))
    stop_col = min(level.width + margin, int(stop_corner[1]))
    shape = (len(corner_by_level), stop_row - first_row, stop_col - first_col)
    if len(corner_by_level) == 1:  # a level fills its own rectangle; kernels take writeable arrays
        floor = np.require(_floor_in_metres(level), requirements=["C", "W"]).reshape(shape)
        occupied = np.require(level.solid, requirements=["C", "W"]).reshape(shape)
    else:
        floor = np.full(shape, np.nan, dtype=np.float32)
        occupied = np.ones(shape, dtype=np.uint8)
        for layer, (k, (row, col)) in enumerate(corner_by_level.items()):
            stacked_level = grid.levels[k]
            stacked_floor = _floor_in_metres(stacked_level)
            _paste(floor[layer], stacked_floor, row - first_row, col - first_col)
            _paste(occupied[layer], stacked_level.solid, row - first_row, col - first_col)
    place_by_level = {
        k: StackPlace(layer, row - first_row, col - first_col)
        for layer, (k, (row, col)) in enumerate(corner_by_level.items())
    }
    stack: LevelStack = kernels.LevelStack(
        floor=floor,
        occupied=occupied,
        slope_bits=_mark_slopes(grid, place_by_level, floor, max_step),
        level=place_by_level[level_number].layer,
        max_step=max_step,
        height=grid.agent_height,
    )
    rows = slice(-first_row, level.height - first_row)
    cols = slice(-first_col, level.width - first_col)
    return stack, (rows, cols)


def _find_aligned_levels(grid: NavGrid, level_number: int) -> dict[int, tuple[int, int]]:
    """Find the levels whose cells have the same size and lie in the same lattice as a level's.

    Returns:
        For each of them, by number: row and column of its cell (0, 0) in the level's lattice.
    """
    level = grid.levels[level_number]
    x_min, y_max, cell_size, *_ = level.lattice
    corner_by_level = dict[int, tuple[int, int]]()
    for number, other_level in enumerate(grid.levels):
        lattice = other_level.lattice
        row = (y_max - lattice.y_max) / cell_size
        col = (lattice.x_min - x_min) / cell_size
        # by how many cells the levels drift apart where the sizes of their cells differ
        drift = abs(lattice.cell_size / cell_size - 1) * max(*level.shape, *other_level.shape)
        if max(abs(row - round(row)), abs(col - round(col)), drift) < ALIGNMENT_TOLERANCE:
            corner_by_level[number] = (round(row), round(col))
    return corner_by_level


def _mark_slopes(
    grid: NavGrid,
    place_by_level: dict[int, StackPlace],
    floor: NDArray[np.float32],
    max_step: float,
) -> NDArray[np.uint8]:
    """Mark the directions in which links lead up or down a slope: `LevelStack.slope_bits`.


    Args:
        grid: the grid, whose steps are used.
        place_by_level: where each stacked level lies in the arrays, by the level's number.
        floor: `LevelStack.floor`.
        max_step: largest difference of neighbours' floors that an agent can step over [m].
    """
    step_rows = grid.step_array
    no_slope_bits = np.zeros((0, 0, 0), dtype=np.uint8)
    step_rows = step_rows[np.isin(step_rows[:, ::2], list(place_by_level)).all(axis=1)]
    if not len(step_rows):
        return no_slope_bits
    start_indices = _stack_indices(
        grid, place_by_level, level=step_rows[:, 0], cell=step_rows[:, 1]
    )
    end_indices = _stack_indices(grid, place_by_level, level=step_rows[:, 2], cell=step_rows[:, 3])
    stack_shape = np.array(floor.shape)[:, None]
    is_inside = (
        (start_indices >= 0)
        & (start_indices < stack_shape)
        & (end_indices >= 0)
        & (end_indices < stack_shape)
    ).all(axis=0)
    start_indices = start_indices[:, is_inside]
    end_indices = end_indices[:, is_inside]
    is_slope = np.abs(floor[tuple(start_indices)] - floor[tuple(end_indices)]) > max_step
    is_slope &= np.abs(end_indices - start_indices)[1:].sum(axis=0) == 1
    if not is_slope.any():
        return no_slope_bits
    slope_bits = np.zeros(floor.shape, dtype=np.uint8)
    # the bit of each direction, at [1 + row step, 1 + column step]; the middle is no direction
    direction_bits = np.zeros((3, 3), dtype=np.uint8)
    direction_bits[1, 2] = arrays.EAST
    direction_bits[0, 1] = arrays.NORTH
    direction_bits[1, 0] = arrays.WEST
    direction_bits[2, 1] = arrays.SOUTH
    start_indices = start_indices[:, is_slope]
    end_indices = end_indices[:, is_slope]
    for cells, neighbors in ((start_indices, end_indices), (end_indices, start_indices)):
        cell_bits = direction_bits[tuple((neighbors - cells)[1:] + 1)]
        np.bitwise_or.at(slope_bits, tuple(cells), cell_bits)
    return slope_bits


def _stack_indices(
    grid: NavGrid, place_by_level: dict[int, StackPlace], level: Int, cell: Int
) -> Int:
    """Compute where cells lie in the arrays of a LevelStack: layer, row and column, shape (3, n).

    Args:
        grid: the grid.
        place_by_level: where each stacked level lies, by the level's number.
        level: level numbers of the cells, shape (n,).
        cell: ids of the cells on their levels, shape (n,).
    """
    no_place = StackPlace(0, 0, 0)
    corners = np.array([place_by_level.get(k, no_place) for k in range(len(grid.levels))])
    widths = np.array([level.width for level in grid.levels])
    rows, cols = np.divmod(cell, widths[level])
    indices: Int = (corners[level] + np.stack([np.zeros_like(cell), rows, cols], axis=1)).T
    return indices


def _floor_in_metres(level: SceneGrid2D) -> NDArray[np.float32]:
    """Compute world z of the level's floor [m], float32, contiguous."""
    floor = np.ascontiguousarray(level.floor_height)
    return floor if level.unit == 1 else floor * np.float32(level.unit)


def _paste(canvas: NDArray[np.generic], piece: NDArray[np.generic], row: int, col: int) -> None:
    """Copy an array into a canvas; what lies outside of the canvas is left out.

    Args:
        canvas: the array that is written.
        piece: the array that is copied.
        row: row of the canvas at which the piece's first row lies; may be outside.
        col: column of the canvas at which the piece's first column lies; may be outside.
    """
    height, width = canvas.shape
    rows = slice(max(-row, 0), max(height - row, 0))
    cols = slice(max(-col, 0), max(width - col, 0))
    inner_piece = piece[rows, cols]
    row = max(row, 0)
    col = max(col, 0)
    canvas[row : row + inner_piece.shape[0], col : col + inner_piece.shape[1]] = inner_piece
