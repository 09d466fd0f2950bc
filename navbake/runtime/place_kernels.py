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
    """Cells of a level's row: each `stride`-th column from `first_col` to `last_col`, inclusive."""

    level: int
    row: int
    first_col: int
    last_col: int
    stride: int


@kernel
def locate(layout, floors, level, positions):
    """Find the cell that each position is in.

    With a level, it is that level's cell at x, y. Otherwise, it is the highest of all levels' cells
    at x, y whose floor is at most `max_step` above the position. If there is no such cell, the
    grounds of the levels that have no floor there count as floors.

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
    floor_z = np.empty(BATCH_SIZE)
    for batch_start in range(0, len(positions), BATCH_SIZE):
        batch_stop = min(batch_start + BATCH_SIZE, len(positions))
        _locate_batch(
            layout,
            floors,
            positions[batch_start:batch_stop],
            cells[batch_start:batch_stop],
            floor_z,
        )
    return cells


@kernel
def mark_standing(layout, floors, is_free, max_drop, positions):
    """Mark the positions that are in a free cell, at most `max_drop` [m] above its floor.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_free: by cell, bool.
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
        position_z = positions[batch_start:batch_stop, 2]
        for i in range(batch_stop - batch_start):
            is_near = position_z[i] - floor_z[i] <= max_drop
            is_standing[batch_start + i] = (cells[i] >= 0) & is_free[max(cells[i], 0)] & is_near
    return is_standing


@subkernel
def _locate_batch(layout, floors, positions, cells, cell_floor_z):
    """Locate at most `BATCH_SIZE` positions.

    Writes the flat ids of their cells to `cells`, and z of these cells' floors to `cell_floor_z`.
    If no floor is at or below a position (up to a step above it), its cell is one without a floor,
    on the level whose ground is the highest of those at or below it.
    """
    level_cells = np.empty(BATCH_SIZE, dtype=np.int64)
    fallback_cells = np.full(BATCH_SIZE, -1, dtype=np.int64)
    highest_ground = np.full(BATCH_SIZE, -np.inf)
    floor = floors.z
    ground = floors.ground
    max_step = floors.max_step
    num_positions = len(positions)
    cells[:num_positions] = -1
    cell_floor_z[:num_positions] = -np.inf
    for level in range(len(layout.width)):
        _locate_on_level(layout, level, positions, level_cells)
        for i in range(num_positions):  # few branches: where positions are can't be predicted
            cell = level_cells[i]
            floor_z = floor[max(cell, 0)]
            max_floor_z = positions[i, 2] + max_step
            is_nearer = (cell >= 0) & (floor_z > cell_floor_z[i]) & (floor_z <= max_floor_z)
            cells[i] = cell if is_nearer else cells[i]
            cell_floor_z[i] = floor_z if is_nearer else cell_floor_z[i]
            if (
                cell >= 0
                and math.isnan(floor_z)
                and highest_ground[i] < ground[level] <= max_floor_z
            ):
                fallback_cells[i] = cell
                highest_ground[i] = ground[level]
    for i in range(num_positions):
        if cells[i] < 0:
            cells[i] = fallback_cells[i]
            cell_floor_z[i] = highest_ground[i]


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
def snap_positions(layout, floors, is_allowed, level, same_level, max_distance, positions):
    """Find the places in allowed cells nearest to positions, see `PathFinder.snap`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_allowed: by cell, bool.
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
        if cell_below >= 0 and is_allowed[cell_below]:
            z = floor_at(floors, position_level, cell_below)
            if level >= 0 or point[2] - z <= MAX_DROP:
                places[i, 0] = point[0]
                places[i, 1] = point[1]
                places[i, 2] = z
                continue
        nearest_distance = max_distance
        nearest_cell = np.int64(-1)
        is_on_one_level = same_level and position_level >= 0
        levels = (
            range(position_level, position_level + 1)
            if is_on_one_level
            else range(len(layout.width))
        )
        for candidate_level in levels:
            distance_kind = CENTER_ON_MAP if is_on_one_level else CENTER_IN_SPACE
            ground = floors.ground[candidate_level]
            height_tolerance = 0.0  # counts for `TO_OBSTACLE` only
            cell, distance = find_nearest_cell(
                layout,
                is_allowed,
                floors.z,
                distance_kind,
                ground,
                height_tolerance,
                candidate_level,
                point,
                nearest_distance,
            )
            if cell >= 0 and (nearest_cell < 0 or distance < nearest_distance):
                nearest_cell = cell
                nearest_distance = distance
        cells[i] = nearest_cell
        if nearest_cell >= 0:
            places[i, 0], places[i, 1] = cell_center(layout, nearest_cell)
            places[i, 2] = floor_at(floors, level_of(layout.start, nearest_cell), nearest_cell)
    return places, cells


@kernel
def find_nearest_obstacles(
    layout, floors, is_occupied, height_tolerance, level, max_distance, positions
):
    """Find the squares of occupied cells nearest to positions, see `PathFinder.nearest_obstacle`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_occupied: by cell, bool.
        height_tolerance: floors whose heights differ by less than this count as equally high [m].
        level: the level of all positions; -1 to find each one's level by its z.
        max_distance: largest distance to an obstacle [m].
        positions: world x, y, z [m], shape (n, 3), or (n, 2) with a level.

    Returns:
        The positions' own cells and the obstacles' cells, flat ids, shape (n,), -1 for none; and
        the distances [m], shape (n,).
    """
    position_cells = locate(layout, floors, level, positions)
    obstacle_cells = np.full(len(position_cells), -1, dtype=np.int64)
    distances = np.empty(len(position_cells))
    for i in range(len(position_cells)):
        if position_cells[i] >= 0:
            position_level = level_of(layout.start, position_cells[i])
            z = floor_at(floors, position_level, position_cells[i])
            point = (positions[i, 0], positions[i, 1], z)
            obstacle_cells[i], distances[i] = find_nearest_cell(
                layout,
                is_occupied,
                floors.z,
                TO_OBSTACLE,
                0.0,  # the ground counts for `CENTER_IN_SPACE` only
                height_tolerance,
                position_level,
                point,
                max_distance,
            )
    return position_cells, obstacle_cells, distances


@subkernel
def find_nearest_cell(
    layout, mask, floor, distance_kind, ground, height_tolerance, level, point, max_distance
):
    """Find the cell of a mask that is nearest to a point, on one level.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        mask: by cell, bool.
        floor: world z of the floor by cell, NaN for none [m].
        distance_kind: which distance from the point is measured: `CENTER_ON_MAP` and
            `CENTER_IN_SPACE` for the distance to a cell's centre in 2D or 3D, or `TO_OBSTACLE` for
            the distance to the square of an occupied cell.
        ground: for `CENTER_IN_SPACE`, z of cells without a floor [m].
        height_tolerance: for `TO_OBSTACLE`, floors whose heights differ by less than this count as
            equally high [m].
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
    nearest_cell = np.int64(-1)
    ring_number = 0
    last_ring = max(center_row, num_rows - 1 - center_row, center_col, num_cols - 1 - center_col)
    # the point is up to half a cell nearer to a ring's centres than its own cell's centre is, and
    # a whole cell nearer to the squares
    ring_slack = 1.0 if distance_kind == TO_OBSTACLE else 0.5
    while (
        ring_number <= last_ring
        and (max(0.0, ring_number - ring_slack) ** 2 + squared_gap) * cell_size * cell_size
        <= least_squared_distance
    ):
        first_row = max(0, center_row - ring_number)
        last_row = min(num_rows - 1, center_row + ring_number)
        for row in range(first_row, last_row + 1):
            first_col = center_col - ring_number
            last_col = center_col + ring_number
            stride = 2 * ring_number
            if (
                abs(row - center_row) == ring_number
            ):  # the top or the bottom row of the ring: all of it
                first_col = max(0, first_col)
                stride = 1
            elif first_col < 0:
                first_col = last_col
            row_cells = RowCells(level, row, first_col, min(num_cols - 1, last_col), stride)
            least_squared_distance, nearest_cell = _search_row(
                layout,
                mask,
                floor,
                distance_kind,
                ground,
                height_tolerance,
                point,
                row_cells,
                least_squared_distance,
                nearest_cell,
            )
        ring_number += 1
    return nearest_cell, math.sqrt(least_squared_distance)


@subkernel
def _search_row(
    layout,
    mask,
    floor,
    distance_kind,
    ground,
    height_tolerance,
    point,
    row_cells,
    least_squared_distance,
    nearest_cell,
):
    """Compare the nearest cell so far with cells of a row.

    The first arguments are those of `find_nearest_cell`; `row_cells` is a `RowCells`. Returns the
    squared distance [m²] and the flat id of the nearer cell of the two.
    """
    level, row, first_col, last_col, stride = row_cells
    cell_size = layout.cell_size[level]
    x_min = layout.x_min[level]
    y_max = layout.y_max[level]
    row_start_id = layout.start[level] + row * layout.width[level]
    for col in range(first_col, last_col + 1, stride):
        cell = row_start_id + col
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
            squared_distance == least_squared_distance and (nearest_cell < 0 or cell < nearest_cell)
        ):
            if distance_kind == TO_OBSTACLE and _is_clear_on_another_level(
                layout, mask, floor, height_tolerance, level, cell, point[2]
            ):
                continue
            least_squared_distance = squared_distance
            nearest_cell = cell
    return least_squared_distance, nearest_cell


@subkernel
def _is_clear_on_another_level(layout, mask, floor, height_tolerance, level, cell, z):
    """Whether another level continues a level at a cell: its cell has a floor near z, unmasked.

    Near means less than `height_tolerance` above or below [m]. False if the cell's own floor is
    near z.
    """
    if abs(floor[cell] - z) < height_tolerance:  # False for NaN
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
            if not mask[other_cell] and abs(floor[other_cell] - z) < height_tolerance:
                return True
    return False
