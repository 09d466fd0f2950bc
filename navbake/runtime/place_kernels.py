"""Finds the cells that positions are in, and the nearest cells of a mask, in batches.

Positions are located in batches, level by level: a look-up at a random address waits for the
memory, and in a batch many such waits overlap.

The nearest cell is searched in square rings round the point's cell, until no cell of the next ring
can be nearer than the best so far. Most points have free and occupied cells near them. There, this
is quicker than an index, and needs no update when an obstacle is added.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import cell_center, floor_at, level_of, to_cell_units

BATCH_SIZE = 512  # positions; the data of a batch stays in the processor's first cache
MAX_DROP = 0.5  # [m]: a position may be this far above the floor of an agent that stands there
# Which distance `find_nearest_cell` measures: on the map to a cell's centre; in space to the centre
# at the floor's height; or on the map to the cell's square. The last one leaves out cells where
# another level continues this one at the point's height.
CENTER_ON_MAP = 0
CENTER_IN_SPACE = 1
TO_OBSTACLE = 2


class RowCells(NamedTuple):
    """Every `stride`-th cell of a level's row, from `first_col` up to and including `last_col`."""

    level: int
    row: int
    first_col: int
    last_col: int
    stride: int


@kernel
def locate(layout, floors, level, positions):
    """Find the cell that each position is in.

    With a level, it is that level's cell at x, y. Otherwise it is the cell at x, y, of all levels,
    with the highest floor that is at most `max_step` above the position. If no level has such a
    floor, the grounds of the levels that have no floor there count as floors.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        level: the level of all positions, for which x, y are enough; -1 to find each one's level.
        positions: world x, y, z [m], shape (n, 3), or (n, 2) with a level.

    Returns:
        Flat ids, shape (n,), int64, -1 for no cell.
    """
    cells = np.empty(len(positions), dtype=np.int64)
    if level >= 0:
        _locate_on_level(layout, level, positions, cells)
        return cells
    z = np.empty(BATCH_SIZE)
    for batch_start in range(0, len(positions), BATCH_SIZE):
        batch_stop = min(batch_start + BATCH_SIZE, len(positions))
        _locate_batch(
            layout, floors, positions[batch_start:batch_stop], cells[batch_start:batch_stop], z
        )
    return cells


@kernel
def mark_standing(layout, floors, free, max_drop, positions):
    """Mark the positions that are in a free cell, at most `max_drop` [m] above its floor.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        free: by cell, bool.
        max_drop: largest height of a position above the floor [m].
        positions: world x, y, z [m], shape (n, 3).

    Returns:
        bool, shape (n,).
    """
    is_standing = np.zeros(len(positions), dtype=np.bool_)
    cells = np.empty(BATCH_SIZE, dtype=np.int64)
    floor_z = np.empty(BATCH_SIZE)
    for batch_start in range(0, len(positions), BATCH_SIZE):
        batch_stop = min(batch_start + BATCH_SIZE, len(positions))
        _locate_batch(layout, floors, positions[batch_start:batch_stop], cells, floor_z)
        heights = positions[batch_start:batch_stop, 2]
        for i in range(batch_stop - batch_start):
            is_near = heights[i] - floor_z[i] <= max_drop
            is_standing[batch_start + i] = (cells[i] >= 0) & free[max(cells[i], 0)] & is_near
    return is_standing


@subkernel
def _locate_batch(layout, floors, positions, cells, z):
    """Locate at most `BATCH_SIZE` positions: write their cells to `cells`, the floors' z to `z`."""
    level_cells = np.empty(BATCH_SIZE, dtype=np.int64)
    ground_cells = np.full(BATCH_SIZE, -1, dtype=np.int64)
    highest_ground = np.full(BATCH_SIZE, -np.inf)
    floor = floors.z
    ground = floors.ground
    max_step = floors.max_step
    num_positions = len(positions)
    cells[:num_positions] = -1
    z[:num_positions] = -np.inf
    for level in range(len(layout.width)):
        _locate_on_level(layout, level, positions, level_cells)
        for i in range(num_positions):  # few branches: where positions are can't be predicted
            cell = level_cells[i]
            floor_z = floor[max(cell, 0)]
            highest_floor_allowed = positions[i, 2] + max_step
            is_nearer = (cell >= 0) & (floor_z > z[i]) & (floor_z <= highest_floor_allowed)
            cells[i] = cell if is_nearer else cells[i]
            z[i] = floor_z if is_nearer else z[i]
            if (
                cell >= 0
                and math.isnan(floor_z)
                and highest_ground[i] < ground[level] <= highest_floor_allowed
            ):
                ground_cells[i] = cell
                highest_ground[i] = ground[level]
    for i in range(num_positions):
        if cells[i] < 0:
            cells[i] = ground_cells[i]
            z[i] = highest_ground[i]


@subkernel
def _locate_on_level(layout, level, positions, cells):
    """Write the flat ids of a level's cells that positions are in to `cells`, -1 outside the level.

    The positions are finite, world x, y [m].
    """
    first_cell = layout.start[level]
    num_rows = layout.height[level]
    num_cols = layout.width[level]
    x_min = layout.x_min[level]
    y_max = layout.y_max[level]
    cell_size = layout.cell_size[level]
    for i in range(len(positions)):
        col = np.floor((positions[i, 0] - x_min) / cell_size)
        row = np.floor((y_max - positions[i, 1]) / cell_size)
        is_inside = 0 <= row < num_rows and 0 <= col < num_cols
        cells[i] = first_cell + np.int64(row) * num_cols + np.int64(col) if is_inside else -1


@kernel
def snap_positions(layout, floors, allowed, level, same_level, max_distance, positions):
    """Find the places in allowed cells nearest to positions, see `PathFinder.snap`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        allowed: by cell, bool.
        level: the level of all positions; -1 to find each one's level by its z.
        same_level: whether a place must be on its position's level.
        max_distance: largest distance to a place [m].
        positions: world x, y, z [m], shape (n, 3).

    Returns:
        World x, y, z of the places [m], shape (n, 3), NaN for none; and the flat ids of their
        cells, shape (n,), -1 for none.
    """
    cells = locate(layout, floors, level, positions)
    places = np.full((len(positions), 3), np.nan)
    for i in range(len(positions)):
        cell_below = cells[i]
        point = (positions[i, 0], positions[i, 1], positions[i, 2])
        position_level = level_of(layout.start, cell_below) if cell_below >= 0 else level
        if cell_below >= 0 and allowed[cell_below]:
            z = floor_at(floors, position_level, cell_below)
            if level >= 0 or point[2] - z <= MAX_DROP:
                places[i, 0] = point[0]
                places[i, 1] = point[1]
                places[i, 2] = z
                continue
        nearest_distance = max_distance
        nearest = np.int64(-1)
        on_one_level = same_level and position_level >= 0
        levels = (
            range(position_level, position_level + 1) if on_one_level else range(len(layout.width))
        )
        for candidate_level in levels:
            distance_kind = CENTER_ON_MAP if on_one_level else CENTER_IN_SPACE
            ground = floors.ground[candidate_level]
            overlap = 0.0  # counts for `TO_OBSTACLE` only
            cell, distance = find_nearest_cell(
                layout,
                allowed,
                floors.z,
                distance_kind,
                ground,
                overlap,
                candidate_level,
                point,
                nearest_distance,
            )
            if cell >= 0 and (nearest < 0 or distance < nearest_distance):
                nearest = cell
                nearest_distance = distance
        cells[i] = nearest
        if nearest >= 0:
            places[i, 0], places[i, 1] = cell_center(layout, nearest)
            places[i, 2] = floor_at(floors, level_of(layout.start, nearest), nearest)
    return places, cells


@kernel
def find_nearest_obstacles(layout, floors, occupied, overlap, level, max_distance, positions):
    """Find the squares of occupied cells nearest to positions, see `PathFinder.nearest_obstacle`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        occupied: by cell, bool.
        overlap: floors whose heights differ by less than this count as equally high [m].
        level: the level of all positions; -1 to find each one's level by its z.
        max_distance: largest distance to an obstacle [m].
        positions: world x, y, z [m], shape (n, 3), or (n, 2) with a level.

    Returns:
        The positions' own cells and the obstacles' cells, flat ids, shape (n,), -1 for none; and
        the distances [m], shape (n,).
    """
    own_cells = locate(layout, floors, level, positions)
    obstacles = np.full(len(own_cells), -1, dtype=np.int64)
    distances = np.empty(len(own_cells))
    for i in range(len(own_cells)):
        if own_cells[i] >= 0:
            own_level = level_of(layout.start, own_cells[i])
            z = floor_at(floors, own_level, own_cells[i])
            point = (positions[i, 0], positions[i, 1], z)
            obstacles[i], distances[i] = find_nearest_cell(
                layout,
                occupied,
                floors.z,
                TO_OBSTACLE,
                0.0,  # the ground counts for `CENTER_IN_SPACE` only
                overlap,
                own_level,
                point,
                max_distance,
            )
    return own_cells, obstacles, distances


@subkernel
def find_nearest_cell(
    layout, mask, floor, distance_kind, ground, overlap, level, point, max_distance
):
    """Find the cell of a mask that is nearest to a point, on one level.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        mask: by cell, bool.
        floor: world z of the floor by cell, NaN for none [m].
        distance_kind: what is measured from the point: `CENTER_ON_MAP` and `CENTER_IN_SPACE` for
            the distance to a cell's centre in 2D or 3D, or `TO_OBSTACLE` for the distance to the
            square of an occupied cell.
        ground: for `CENTER_IN_SPACE`, z of cells without a floor [m].
        overlap: for `TO_OBSTACLE`, floors whose heights differ by less than this count as equally
            high [m].
        level: number of the level.
        point: world x, y, z [m]; for `TO_OBSTACLE`, z is the floor's height at the point.
        max_distance: largest distance [m].

    Returns:
        The flat id, the lowest one of equally near cells, -1 if no cell is within `max_distance`;
        and the distance [m].
    """
    num_rows = layout.height[level]
    num_cols = layout.width[level]
    cell_size = layout.cell_size[level]
    col_position, row_position = to_cell_units(layout, level, point[0], point[1])
    # in rings round the level's cell that is nearest to the point
    center_row = int(min(max(row_position, 0.0), num_rows - 1.0))
    center_col = int(min(max(col_position, 0.0), num_cols - 1.0))
    squared_gap = (
        max(0.0, -col_position, col_position - num_cols) ** 2
        + max(0.0, -row_position, row_position - num_rows) ** 2
    )  # to the level [cells²]
    least_squared_distance = max_distance * max_distance
    nearest = np.int64(-1)
    ring = 0
    last_ring = max(center_row, num_rows - 1 - center_row, center_col, num_cols - 1 - center_col)
    # the point is up to half a cell nearer to a ring's centres than its own cell's centre is, and
    # a whole cell nearer to the squares
    nearer_by = 1.0 if distance_kind == TO_OBSTACLE else 0.5
    while (
        ring <= last_ring
        and (max(0.0, ring - nearer_by) ** 2 + squared_gap) * cell_size * cell_size
        <= least_squared_distance
    ):
        first_row = max(0, center_row - ring)
        last_row = min(num_rows - 1, center_row + ring)
        for row in range(first_row, last_row + 1):
            first_col = center_col - ring
            last_col = center_col + ring
            stride = 2 * ring
            if abs(row - center_row) == ring:  # the top or the bottom row of the ring: all of it
                first_col = max(0, first_col)
                stride = 1
            elif first_col < 0:
                first_col = last_col
            row_cells = RowCells(level, row, first_col, min(num_cols - 1, last_col), stride)
            least_squared_distance, nearest = _search_row(
                layout,
                mask,
                floor,
                distance_kind,
                ground,
                overlap,
                point,
                row_cells,
                least_squared_distance,
                nearest,
            )
        ring += 1
    return nearest, math.sqrt(least_squared_distance)


@subkernel
def _search_row(
    layout,
    mask,
    floor,
    distance_kind,
    ground,
    overlap,
    point,
    row_cells,
    least_squared_distance,
    nearest,
):
    """Compare the nearest cell so far with cells of a row.

    The first arguments are those of `find_nearest_cell`; `row_cells` is a `RowCells`. Returns the
    squared distance [m²] and the flat id of the nearer cell of the two.
    """
    level, row, first_col, last_col, stride = row_cells
    cell_size = layout.cell_size[level]
    x_min = layout.x_min[level]
    y_max = layout.y_max[level]
    row_start = layout.start[level] + row * layout.width[level]
    for col in range(first_col, last_col + 1, stride):
        cell = row_start + col
        if not mask[cell]:
            continue
        x_distance = abs(x_min + (col + 0.5) * cell_size - point[0])
        y_distance = abs(y_max - (row + 0.5) * cell_size - point[1])
        if distance_kind == TO_OBSTACLE:
            x_distance = max(0.0, x_distance - 0.5 * cell_size)
            y_distance = max(0.0, y_distance - 0.5 * cell_size)
        squared_distance = x_distance * x_distance + y_distance * y_distance
        if distance_kind == CENTER_IN_SPACE:
            z = ground if math.isnan(floor[cell]) else floor[cell]
            squared_distance += (z - point[2]) ** 2
        if squared_distance < least_squared_distance or (
            squared_distance == least_squared_distance and (nearest < 0 or cell < nearest)
        ):
            if distance_kind == TO_OBSTACLE and _is_clear_on_another_level(
                layout, mask, floor, overlap, level, cell, point[2]
            ):
                continue
            least_squared_distance = squared_distance
            nearest = cell
    return least_squared_distance, nearest


@subkernel
def _is_clear_on_another_level(layout, mask, floor, overlap, level, cell, z):
    """Whether another level continues a level at a cell: its cell has a floor near z, unmasked.

    Near means less than `overlap` above or below [m]. False if the cell's own floor is near z.
    """
    if abs(floor[cell] - z) < overlap:  # False for NaN
        return False
    x, y = cell_center(layout, cell)
    for other_level in range(len(layout.width)):
        width = layout.width[other_level]
        col_position, row_position = to_cell_units(layout, other_level, x, y)
        if (
            other_level != level
            and 0 <= row_position < layout.height[other_level]
            and 0 <= col_position < width
        ):
            other_cell = (
                layout.start[other_level] + np.int64(row_position) * width + np.int64(col_position)
            )
            if not mask[other_cell] and abs(floor[other_cell] - z) < overlap:
                return True
    return False
