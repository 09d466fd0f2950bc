"""Queries about places: islands, rooms, free space, steps, lines of sight, obstacles and images.

Most functions do the work of the method of `navbake.runtime.path_finder.PathFinder` of the same
name. A position is world x, y, z [m], on the level of the nearest floor below, or on `level`;
QueryError is raised for a position that is not valid. Callers update their `search` to the grid's
present obstacles before the call.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.lengths import format_position
from navbake.navgrid.cells import check_level, check_positions
from navbake.navgrid.colors import FREE, NO_FLOOR, OCCUPIED, rgb_of
from navbake.runtime.flat_grid import (
    FlatGrid,
    RealNumber,
    check_distance,
    to_kernel_positions,
)
from navbake.runtime.paths import cells_with_name
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

place_kernels = lazy("navbake.runtime.place_kernels")  # numba loads slowly
walk_kernels = lazy("navbake.runtime.walk_kernels")

MAX_DROP = 0.5  # [m], equal to `navbake.runtime.place_kernels.MAX_DROP`, whose module loads numba
FIRST_SIGHT_RADIUS = 1.0  # [m], first radius of the search for a place in sight
DISTANCE_SLACK = 1e-9  # [m] by which rounding may change a distance
PIXEL_SLACK = 1e-6  # share of a pixel: if less than this is left at the edge, it gets no pixel


@dataclass(frozen=True, eq=False)
class NearestObstacle:
    """The nearest point of an obstacle."""

    distance: float  #: Distance seen from above [m].
    position: Float  #: World x, y, z [m], shape (3,); z is that of the queried position's floor.


# ---------------------------------------------------------------- islands and rooms


def find_bounds(search: Search) -> tuple[Float, Float]:
    """Compute the bounding box of all free cells' floors: `PathFinder.bounds`.

    Returns:
        The lower and the upper corner, world x, y, z [m], shape (3,) each.

    Raises:
        QueryError: no cell is free.
    """
    flat = search.flat
    cells = np.flatnonzero(flat.free)
    if not len(cells):
        raise QueryError(f"no cell of {search.grid.scene_id!r} is free: it has no bounds")
    centers = flat.positions(cells)
    half_edge = (flat.layout.cell_size[flat.level_of(cells)] / 2)[:, None] * [1.0, 1.0, 0.0]
    return (centers - half_edge).min(axis=0), (centers + half_edge).max(axis=0)


def islands_at(search: Search, positions: ArrayLike, level: int | None) -> Int:
    """Find the numbers of the islands of positions; 0 where a position's cell isn't free.

    Args:
        search: the search on the grid.
        positions: world x, y, z [m], shape (..., 3).
        level: the level of all positions; None finds each one's level by its z.

    Returns:
        The numbers, shape (...), int64.
    """
    cells = search.flat.cells_at(positions, level)
    island_numbers: Int = np.where(cells >= 0, search.islands.number[cells], 0).astype(np.int64)
    return island_numbers


def rooms_at(search: Search, positions: ArrayLike, level: int | None) -> NDArray[np.object_]:
    """Find the ids of the rooms of positions; None where a position is in no room.

    Args:
        search: the search on the grid.
        positions: world x, y, z [m], shape (..., 3).
        level: the level of all positions; None finds each one's level by its z.

    Returns:
        The ids, shape (...), of str or None.
    """
    cells = search.flat.cells_at(positions, level)
    room_numbers = np.where(cells >= 0, search.rooms.number[cells], 0)
    id_by_number = np.array([None, *(room.id for room in search.rooms.rooms)], dtype=np.object_)
    room_ids: NDArray[np.object_] = id_by_number[room_numbers]
    return room_ids


def island_at(search: Search, position: ArrayLike, level: int | None = None) -> int | None:
    """Find the number of the island of a position; None where it isn't free.

    Args:
        search: the search on the grid.
        position: world x, y, z [m].
        level: the position's level; None finds it by z.
    """
    _, cell = search.flat.locate(position, level)
    if cell < 0:
        return None
    return int(search.islands.number[cell]) or None


def room_at(search: Search, position: ArrayLike, level: int | None = None) -> str | None:
    """Find the id of a position's room; None if the position is in no room.

    Args:
        search: the search on the grid.
        position: world x, y, z [m].
        level: the position's level; None finds it by z.
    """
    _, cell = search.flat.locate(position, level)
    return search.rooms.id_of(int(search.rooms.number[cell])) if cell >= 0 else None


def room_near(
    search: Search, position: ArrayLike, max_distance: float, level: int | None
) -> str | None:
    """Find the id of the room nearest to a position, on the position's level.

    None if no room is within the distance, or the position is in no cell.

    Args:
        search: the search on the grid.
        position: world x, y, z [m].
        max_distance: largest distance to a cell's centre [m].
        level: the position's level; None finds it by z.
    """
    flat = search.flat
    room_numbers = search.rooms.number
    checked_position, position_cell = flat.locate(position, level)
    check_distance(max_distance)
    if position_cell < 0:
        return None
    position_level = int(flat.level_of(position_cell))
    _, cell = snap_to_cells(
        flat, room_numbers > 0, checked_position, position_level, max_distance=max_distance
    )
    return search.rooms.id_of(int(room_numbers[cell])) if cell >= 0 else None


def room_of_object(search: Search, name: str) -> str | None:
    """Find the id of the room that holds most cells of an object; None if none is in a room.

    Args:
        search: the search on the grid.
        name: name of the object, door or wall in the grid's user data.

    Raises:
        QueryError: the grid has no such name.
    """
    room_numbers = search.rooms.number[cells_with_name(search.grid, search.flat, name)]
    num_cells_by_room = np.bincount(room_numbers[room_numbers > 0], minlength=1)
    return search.rooms.id_of(int(np.argmax(num_cells_by_room)))


# ---------------------------------------------------------------- free space


def is_navigable(
    search: Search, position: ArrayLike, level: int | None, max_drop: float
) -> bool | Bool:
    """Whether an agent can stand at each position: `PathFinder.is_navigable`.

    It can if the position's cell is free and the cell's floor is at most `max_drop` below.

    Args:
        search: the search on the grid.
        position: world x, y, z [m], shape (3,) or (..., 3).
        level: the level of all positions; None finds each one's level by its z.
        max_drop: largest height of a position above its floor [m]; it doesn't count with `level`.

    Returns:
        bool for one position, an array of shape (...) for many.
    """
    check_distance(max_drop, "max_drop")
    flat = search.flat
    checked_positions = check_positions(position, flat.num_levels, level)
    kernel_level, kernel_positions = to_kernel_positions(checked_positions, level)
    if kernel_level >= 0:
        cells = place_kernels.locate(flat.layout, flat.floors, kernel_level, kernel_positions)
        is_free = (cells >= 0) & flat.free[cells]
    else:
        is_free = place_kernels.mark_standing(
            flat.layout, flat.floors, flat.free, float(max_drop), kernel_positions
        )
    return (
        bool(is_free[0])
        if checked_positions.ndim == 1
        else is_free.reshape(checked_positions.shape[:-1])
    )


def snap(
    search: Search,
    position: ArrayLike,
    *,
    level: int | None,
    same_level: bool,
    same_room: bool,
    room: str | None,
    island: int | None,
    in_sight: bool,
    max_distance: float,
) -> Float | None:
    """Find the nearest place where an agent can stand, for one position or each of many.

    `PathFinder.snap` describes the arguments after `search`.
    """
    flat = search.flat
    check_distance(max_distance)
    if same_room or in_sight:
        checked_position = flat.check_position(position, level)
    else:
        checked_position = check_positions(position, flat.num_levels, level)
    if same_room:
        position_room = room_at(search, checked_position, level)
        if position_room is None:
            return None
        if search.rooms.find(room or position_room) != search.rooms.find(position_room):
            return None
        room = position_room
    is_allowed = search.mark_allowed(room=room, islands=search.allowed_islands(island, None))
    if in_sight:
        return _snap_in_sight(search, is_allowed, checked_position, level, same_level, max_distance)
    places, cells = snap_to_cells(
        flat, is_allowed, checked_position, level, same_level=same_level, max_distance=max_distance
    )
    return None if checked_position.ndim == 1 and cells < 0 else places


def snap_to_cells(
    flat: FlatGrid,
    is_allowed: Bool,
    positions: Float,
    level: int | None = None,
    *,
    same_level: bool = True,
    max_distance: float = math.inf,
) -> tuple[Float, Int]:
    """Find the place nearest to each position where an agent can stand in an allowed cell.

    `PathFinder.snap` describes which place that is.

    Args:
        flat: the grid.
        is_allowed: mask of the allowed cells, by flat id.
        positions: checked positions, world x, y, z [m], shape (..., 3), or x, y, shape (..., 2).
        level: the level of all positions; None finds each one's level by its z.
        same_level: whether a place must be on its position's level.
        max_distance: largest distance to a place [m].

    Returns:
        World x, y, z of the places [m], shape (..., 3), NaN for none; and their cells, flat ids,
        shape (...), -1 for none.
    """
    kernel_level, kernel_positions = to_kernel_positions(positions, level)
    if kernel_positions.shape[1] == 2:
        same_level = True
        z = np.full(len(kernel_positions), flat.floors.ground[kernel_level])
        kernel_positions = np.column_stack([kernel_positions, z])
    places, cells = place_kernels.snap_positions(
        flat.layout,
        flat.floors,
        is_allowed,
        kernel_level,
        same_level,
        float(max_distance),
        kernel_positions,
    )
    return places.reshape(*positions.shape[:-1], 3), cells.reshape(positions.shape[:-1])


def _snap_in_sight(
    search: Search,
    is_allowed: Bool,
    position: Float,
    level: int | None,
    same_level: bool,
    max_distance: float,
) -> Float | None:
    """Find the nearest place in sight of a position; None if there is none.

    Lines of sight take longer to compute than distances. So only places within a radius are
    checked first, the nearest ones first; the radius doubles until one is in sight.
    """
    flat = search.flat
    position_cell = int(flat.cells_at(position, level))
    place, cell = snap_to_cells(
        flat, is_allowed, position, level, same_level=same_level, max_distance=max_distance
    )
    if position_cell < 0 or cell < 0:
        return None
    if cell == position_cell:
        return place
    num_dimensions = 2 if same_level or len(position) == 2 else 3
    levels = (
        [int(flat.level_of(position_cell))] if num_dimensions == 2 else list(range(flat.num_levels))
    )
    num_allowed = sum(np.count_nonzero(is_allowed[flat.cells_of(k)]) for k in levels)
    radius = min(FIRST_SIGHT_RADIUS, float(max_distance))
    while True:
        cells = np.concatenate(
            [cells_in_annulus(flat, k, position, 0.0, radius, is_allowed) for k in levels]
        )
        centers = flat.positions(cells)
        distances = np.linalg.norm(centers[:, :num_dimensions] - position[:num_dimensions], axis=1)
        # stable, so that of equally near cells the lowest id comes first
        sort_indices = np.argsort(distances, kind="stable")
        near_indices = sort_indices[: np.count_nonzero(distances <= radius)]
        visible_index = search.first_in_sight(
            position_cell, position, cells[near_indices], centers[near_indices], search.rooms.number
        )
        if visible_index >= 0:
            return np.asarray(centers[near_indices[visible_index]])
        if len(near_indices) == num_allowed or radius >= max_distance:
            return None
        radius = min(2.0 * radius, float(max_distance))


def cells_in_annulus(
    flat: FlatGrid,
    level: int,
    point: Float,
    min_distance: float,
    max_distance: float,
    is_allowed: Bool,
) -> Int:
    """List the allowed cells of a level whose centres are in an annulus round a point.

    Args:
        flat: the grid.
        level: number of the level.
        point: world x, y [m].
        min_distance: inner radius [m].
        max_distance: outer radius [m].
        is_allowed: mask of the allowed cells, by flat id.

    Returns:
        Flat ids, ascending.
    """
    layout = flat.layout
    cell_size = layout.cell_size[level]
    num_rows = layout.height[level]
    num_cols = layout.width[level]
    # from the point to the middles of the rows and columns, along the axes [m]
    row_offsets = (np.arange(num_rows) + 0.5) * cell_size - (layout.y_max[level] - point[1])
    col_offsets = (np.arange(num_cols) + 0.5) * cell_size - (point[0] - layout.x_min[level])
    outer_radius = max_distance + DISTANCE_SLACK
    inner_radius = max(min_distance - DISTANCE_SLACK, 0.0)
    rows = np.flatnonzero(np.abs(row_offsets) <= outer_radius)
    cols = np.flatnonzero(np.abs(col_offsets) <= outer_radius)
    squared_distances = (row_offsets[rows, None] ** 2) + col_offsets[cols] ** 2
    is_within = (squared_distances >= inner_radius**2) & (squared_distances <= outer_radius**2)
    cells: Int = (layout.start[level] + rows[:, None] * num_cols + cols)[is_within]
    return cells[is_allowed[cells]]


# ---------------------------------------------------------------- steps and lines


def try_step(
    search: Search, start: ArrayLike, end: ArrayLike, *, slide: bool, level: int | None
) -> Float:
    """Move agents from starts straight towards ends: `PathFinder.try_step`.

    Args:
        search: the search on the grid.
        start: world x, y, z [m], shape (..., 3).
        end: world x, y, z [m], shape (3,) or the shape of `start`.
        slide: whether to slide on from where the straight walk stops.
        level: the level of all starts; None finds each one's level by its z.

    Returns:
        World x, y and floor z [m], shape (..., 3).
    """
    flat = search.flat
    starts = check_positions(start, flat.num_levels, level)
    ends = check_positions(end, flat.num_levels, 0)  # the level follows from the walk
    if ends.shape[:-1] not in (starts.shape[:-1], ()):
        shapes_text = f"{starts.shape[:-1]} of them, got {ends.shape[:-1]}"
        raise QueryError(f"expected an end for each start, {shapes_text}")
    kernel_level, kernel_positions = to_kernel_positions(starts, level)
    end_points = np.broadcast_to(ends[..., :2], (*starts.shape[:-1], 2)).reshape(-1, 2)
    places, blocked_index = walk_kernels.step_each(
        flat.layout,
        flat.steps,
        flat.floors,
        flat.free,
        kernel_level,
        kernel_positions,
        np.ascontiguousarray(end_points),
        slide,
    )
    if blocked_index >= 0:
        flat.free_cell_at(
            kernel_positions[blocked_index], level
        )  # raises with the position and a remedy
    return np.asarray(places.reshape(*starts.shape[:-1], 3))


def line_of_sight(
    search: Search, first_position: ArrayLike, second_position: ArrayLike, level: int | None
) -> bool:
    """Whether the straight line between two positions crosses no occupied cell.

    Args:
        search: the search on the grid.
        first_position: world x, y, z [m].
        second_position: world x, y, z [m].
        level: the level of both; None finds each one's level by its z.
    """
    start, start_cell = search.flat.locate(first_position, level)
    end, end_cell = search.flat.locate(second_position, level)
    if start_cell < 0 or end_cell < 0:
        return False
    return search.first_in_sight(start_cell, start, np.array([end_cell]), end[None]) == 0


# ---------------------------------------------------------------- obstacles


def nearest_obstacle(
    search: Search, position: ArrayLike, level: int | None, max_distance: float
) -> NearestObstacle | None:
    """Find the nearest point of an occupied cell's square: `PathFinder.nearest_obstacle`.

    Args:
        search: the search on the grid.
        position: world x, y, z [m].
        level: the position's level; None finds it by z.
        max_distance: largest distance to the obstacle [m].
    """
    flat = search.flat
    checked_position = flat.check_position(position, level)
    position_cells, obstacle_cells, distances = _find_obstacles(
        search, checked_position, level, max_distance
    )
    position_cell = position_cells[0]
    obstacle_cell = obstacle_cells[0]
    if obstacle_cell < 0:
        return None
    half_edge = flat.layout.cell_size[flat.level_of(position_cell)] / 2
    center = flat.positions(obstacle_cell)[:2]
    nearest_point = np.clip(checked_position[:2], center - half_edge, center + half_edge)
    floor_z = flat.positions(position_cell)[2]
    return NearestObstacle(float(distances[0]), np.append(nearest_point, floor_z))


def clearance(
    search: Search, position: ArrayLike, level: int | None, max_distance: float
) -> float | Float:
    """Compute the distances to the nearest obstacles [m]: `PathFinder.clearance`.

    Args:
        search: the search on the grid.
        position: world x, y, z [m], shape (3,) or (..., 3).
        level: the level of all positions; None finds each one's level by its z.
        max_distance: largest distance [m].

    Returns:
        float for one position, an array of shape (...) for many.
    """
    checked_position = check_positions(position, search.flat.num_levels, level)
    _, obstacle_cells, distances = _find_obstacles(search, checked_position, level, max_distance)
    distances = np.where(obstacle_cells < 0, max_distance, distances)
    return (
        float(distances[0])
        if checked_position.ndim == 1
        else distances.reshape(checked_position.shape[:-1])
    )


def _find_obstacles(
    search: Search, positions: Float, level: int | None, max_distance: float
) -> tuple[Int, Int, Float]:
    """Find the obstacle nearest to each of several positions, which are checked before.

    Returns:
        The flat ids of the positions' cells; the flat ids of the nearest occupied cells, -1 for
        none; and the distances to these [m]; each of shape (n,).
    """
    check_distance(max_distance)
    flat = search.flat
    # floors whose heights differ by less count as equally high, like in `grid.inflate`
    height_tolerance = search.grid.agent_height - flat.floors.max_step
    kernel_level, kernel_positions = to_kernel_positions(positions, level)
    position_cells, obstacle_cells, distances = place_kernels.find_nearest_obstacles(
        flat.layout,
        flat.floors,
        search.occupied,
        height_tolerance,
        kernel_level,
        float(max_distance),
        kernel_positions,
    )
    if (position_cells < 0).any():
        outside_position = kernel_positions[int(np.argmax(position_cells < 0))]
        raise QueryError(f"{format_position(outside_position)} lies beside the grid: no obstacles")
    return position_cells, obstacle_cells, distances


# ---------------------------------------------------------------- images


def draw_top_down(
    search: Search, level: int | None, metres_per_pixel: float | None
) -> NDArray[np.uint8]:
    """Draw a level's free cells as an image: `PathFinder.top_down`.

    Args:
        search: the search on the grid.
        level: number of the level.
        metres_per_pixel: > 0; None for one pixel a cell.

    Returns:
        RGB, shape (rows, cols, 3).
    """
    flat = search.flat
    if level is None:
        raise QueryError(f"expected a level, 0 to {flat.num_levels - 1}, got None")
    check_level(level, flat.num_levels)
    cells = flat.cells_of(level)
    shape = search.grid.levels[level].shape
    has_floor = ~np.isnan(flat.floors.z[cells])
    colour_indices = np.where(flat.free[cells], 0, np.where(has_floor, 1, 2)).reshape(shape)
    if metres_per_pixel is not None:
        if not (isinstance(metres_per_pixel, RealNumber) and 0 < metres_per_pixel < math.inf):
            raise QueryError(f"expected metres_per_pixel > 0, got {metres_per_pixel!r}")
        cells_per_pixel = metres_per_pixel / float(flat.layout.cell_size[level])
        rows = _cells_at_pixels(shape[0], cells_per_pixel)
        cols = _cells_at_pixels(shape[1], cells_per_pixel)
        colour_indices = colour_indices[np.ix_(rows, cols)]
    palette = np.array([rgb_of(FREE), rgb_of(OCCUPIED), rgb_of(NO_FLOOR)], dtype=np.uint8)
    return palette[colour_indices]


def _cells_at_pixels(num_cells: int, cells_per_pixel: float) -> Int:
    """List the index of the cell at the middle of each pixel, along one axis of a level."""
    num_pixels = math.ceil(num_cells / cells_per_pixel - PIXEL_SLACK)
    pixel_middles = (np.arange(num_pixels) + 0.5) * cells_per_pixel
    cells: Int = np.minimum(pixel_middles.astype(int), num_cells - 1)
    return cells
