"""Batched queries: layers at positions, surroundings of agents, paths to goals, random places.

Each function takes the tensors `t` of one or several grids, and positions, world x, y, z [m], of
any shape (..., 3) in the tensors' dtype, and returns values of shape (...). With several grids,
`scene_id` selects one: an integer, or integers of shape (...). For a position that is not finite or
outside the grid, the value is NaN, False, 0 or -1. QueryError is raised for an array of another
shape or dtype, and for an unknown scene or goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal, overload

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import (
    Array,
    ArrayT,
    FloatT,
    GridTensors,
    Ids,
    apply_in_chunks,
    as_array,
    broadcast,
    check_number,
    check_numbers,
    check_positions,
    check_scenes,
    clip,
    device_of,
    find_first_level,
    locate_in_scenes,
    to_level_row_col,
)
from navbake.types import Bool, Int32

# Of numpy's arrays, type checkers know the dtype: the overloads say it where an answer has another
# dtype than the positions. Arrays of other libraries have one type for all dtypes.

INTERPOLATIONS = ("nearest", "bilinear")
# Of `ranges`: how many lines between cells are looked up at once. More need more memory, fewer need
# more operations.
LINES_PER_BLOCK = 32
# How many roundings of a crossing's place, at most, make an edge touch a beam that runs beside it
ROUNDINGS_OF_CROSSING = 16


@overload
def level_at(t: GridTensors, positions: NDArray[np.floating], scene_id: Ids = None) -> Int32: ...
@overload
def level_at(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT: ...
def level_at(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Find the level of each position, by the rule of `PathFinder.cell_at`.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        int32, shape (...): 0 is the lowest, -1 for none.
    """

    def find_levels(points: Array, scenes: Array) -> Array:
        _, level, is_in_cell = locate_in_scenes(t, points, scenes)
        return t.xp.astype(t.xp.where(is_in_cell, level, -1), t.xp.int32)

    return _apply(t, find_levels, positions, scene_id)


def floor(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT:
    """Look up the height of the floor under each position.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        World z, shape (...), NaN for none [m].
    """
    return _values_at(t, t.floor, t.xp.nan, positions, scene_id)


@overload
def room(t: GridTensors, positions: NDArray[np.floating], scene_id: Ids = None) -> Int32: ...
@overload
def room(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT: ...
def room(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Look up the number of each position's room.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        int32, shape (...), 0 for none; ``t.rooms[scene][number - 1]`` is a room's id.
    """
    return _values_at(t, t.room, 0, positions, scene_id)


@overload
def area(t: GridTensors, positions: NDArray[np.floating], scene_id: Ids = None) -> Int32: ...
@overload
def area(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT: ...
def area(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Look up the number of each position's area.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        int32, shape (...), 0 for none; ``t.areas[scene][number - 1]`` is an area's name.
    """
    return _values_at(t, t.area, 0, positions, scene_id)


@overload
def island(t: GridTensors, positions: NDArray[np.floating], scene_id: Ids = None) -> Int32: ...
@overload
def island(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT: ...
def island(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Look up the number of each position's island, a connected part of the free cells.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        int32, shape (...), numbered from 1 through all scenes in order, 0 for none. In tensors of
        one grid, the numbers are those of `PathFinder.island_at`.
    """
    return _values_at(t, t.island, 0, positions, scene_id)


@overload
def is_navigable(t: GridTensors, positions: NDArray[np.floating], scene_id: Ids = None) -> Bool: ...
@overload
def is_navigable(t: GridTensors, positions: ArrayT, scene_id: Ids = None) -> ArrayT: ...
def is_navigable(t: GridTensors, positions: Array, scene_id: Ids = None) -> Array:
    """Return whether an agent can stand at each position.

    It can if the position's cell is free, and its floor at most `max_drop` below the position, see
    `make_tensors`.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        bool, shape (...).
    """

    def is_standable(points: Array, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(t, points, scenes)
        return is_in_cell & (points[..., 2] <= t.highest_z[cell])

    return _apply(t, is_standable, positions, scene_id)


def clearance(
    t: GridTensors, positions: ArrayT, scene_id: Ids = None, mode: str = "bilinear"
) -> ArrayT:
    """Return the distance from each position to the nearest cell that isn't free.

    `PathFinder.clearance` measures from the position to obstacles. This function looks up the
    distance of the position's cell instead, see `navbake.navgrid.islands.measure_clearance`: from
    the cell's centre to the nearest centre of a cell that isn't free, minus half a cell. It is 0 in
    cells that aren't free.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        scene_id: each position's scene; needed where the tensors have several grids.
        mode: ``"nearest"`` for the value of the position's cell, as ``grid.values_at`` returns it;
            ``"bilinear"`` interpolates between the centres of the four cells round the position on
            its level, and is differentiable. Beyond the centres of the outermost cells, their
            values are used.

    Returns:
        Distances, shape (...), NaN outside [m].
    """
    if mode not in INTERPOLATIONS:
        raise QueryError(f"expected a mode of {', '.join(INTERPOLATIONS)}, got {mode!r}")
    if mode == "nearest":
        return _values_at(t, t.clearance, t.xp.nan, positions, scene_id)
    xp = t.xp
    shape = t.shape

    def interpolate(points: Array, scenes: Array) -> Array:
        _, level_of_scene, is_in_cell = locate_in_scenes(t, points, scenes)
        level = find_first_level(t, scenes) + level_of_scene
        # keep positions outside the grid out of the gradient
        x = xp.where(is_in_cell, points[..., 0], t.x_first[level])
        y = xp.where(is_in_cell, points[..., 1], t.y_first[level])
        # in cells, from the centre of the level's first cell
        cols_from_first = (x - t.x_first[level]) * t.cells_per_metre[level] - 0.5
        rows_from_first = (t.y_first[level] - y) * t.cells_per_metre[level] - 0.5
        last_col = t.num_cols[level] - 1
        last_row = t.num_rows[level] - 1
        west_col = clip(xp, xp.astype(xp.floor(cols_from_first), t.index_dtype), 0, last_col)
        north_row = clip(xp, xp.astype(xp.floor(rows_from_first), t.index_dtype), 0, last_row)
        east_col = xp.minimum(west_col + 1, last_col)
        south_row = xp.minimum(north_row + 1, last_row)
        fraction_x = clip(xp, cols_from_first - xp.astype(west_col, t.dtype), 0.0, 1.0)
        fraction_y = clip(xp, rows_from_first - xp.astype(north_row, t.dtype), 0.0, 1.0)

        def interpolate_in_row(row: Array) -> Array:
            row_start = level * (shape.rows * shape.cols) + row * shape.cols
            return (
                t.clearance[row_start + west_col] * (1 - fraction_x)
                + t.clearance[row_start + east_col] * fraction_x
            )

        north_part = interpolate_in_row(north_row) * (1 - fraction_y)
        value = north_part + interpolate_in_row(south_row) * fraction_y
        return xp.where(is_in_cell, value, xp.nan)

    return _apply(t, interpolate, positions, scene_id)


def _values_at(
    tensors: GridTensors, layer: Array, value_outside: float, positions: ArrayT, scene_id: Ids
) -> ArrayT:
    """Look up a layer in the cells of positions; the value is `value_outside` for no cell."""

    def look_up_values(points: Array, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(tensors, points, scenes)
        return tensors.xp.where(is_in_cell, layer[cell], value_outside)

    return _apply(tensors, look_up_values, positions, scene_id)


def _apply(
    tensors: GridTensors, function: Callable[..., Array], positions: ArrayT, scene_id: Ids
) -> ArrayT:
    """Check positions and scenes, and apply a function to them."""
    points = check_positions(tensors, positions)
    scenes = check_scenes(tensors, scene_id, points.shape[:-1])
    values: ArrayT = apply_in_chunks(tensors, function, points, scenes)
    return values


LAYERS: dict[str, Callable[..., Array]] = {
    "floor": floor,
    "free": is_navigable,
    "room": room,
    "area": area,
    "island": island,
    "clearance": partial(clearance, mode="nearest"),
}
"""The function behind each layer of `patch`."""


def heights(
    t: GridTensors, positions: ArrayT, yaw: Array, pattern: Array, scene_id: Ids = None
) -> ArrayT:
    """Make a height scan: floor heights at points round each agent, rotated with the agent.

    Each point's floor is the nearest below the agent, by the rule of `level_at`.

    Args:
        t: the tensors.
        positions: positions of the agents, world x, y, z, shape (..., 3) [m].
        yaw: headings of the agents, 0 along x, counted towards y, shape (...) [rad].
        pattern: points in the agents' frames, x ahead, y to the left, shape (k, 2) [m].
        scene_id: each agent's scene; needed where the tensors have several grids.

    Returns:
        World z, shape (..., k), NaN for no floor [m].
    """
    points, scenes = _pattern_points(t, positions, yaw, pattern, scene_id)
    floor_z: ArrayT = floor(t, points, scenes)
    return floor_z


@overload
def patch(
    t: GridTensors,
    positions: NDArray[np.floating],
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: Literal["free"] = "free",
    scene_id: Ids = None,
) -> Bool: ...
@overload
def patch(
    t: GridTensors,
    positions: NDArray[FloatT],
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    *,
    layer: Literal["floor", "clearance"],
    scene_id: Ids = None,
) -> NDArray[FloatT]: ...
@overload
def patch(
    t: GridTensors,
    positions: NDArray[np.floating],
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    *,
    layer: Literal["room", "area", "island"],
    scene_id: Ids = None,
) -> Int32: ...
@overload
def patch(
    t: GridTensors,
    positions: NDArray[np.floating],
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: str = "free",
    scene_id: Ids = None,
) -> NDArray[np.generic]: ...
@overload
def patch(
    t: GridTensors,
    positions: ArrayT,
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: str = "free",
    scene_id: Ids = None,
) -> ArrayT: ...
def patch(
    t: GridTensors,
    positions: Array,
    yaw: Array,
    shape: tuple[int, int] = (64, 64),
    cell: float = 0.05,
    layer: str = "free",
    scene_id: Ids = None,
) -> Array:
    """Make an egocentric map of a layer round each agent, with the agent's heading up.

    The agent is in the middle. Each pixel has the value of the cell at its middle, on the level
    that `level_at` finds there for the agent's z.

    Args:
        t: the tensors.
        positions: positions of the agents, world x, y, z, shape (..., 3) [m].
        yaw: headings of the agents, as in `heights` [rad].
        shape: rows and columns of the map.
        cell: edge of a pixel [m].
        layer: ``free``, ``floor``, ``clearance``, ``room``, ``area`` or ``island``.
        scene_id: each agent's scene; needed where the tensors have several grids.

    Returns:
        Shape (..., rows, columns): ``free`` as bool, False outside; ``floor`` and ``clearance``,
        NaN outside [m]; the others as int32, 0 outside.
    """
    if layer not in LAYERS:
        raise QueryError(f"no layer {layer!r}: expected one of {', '.join(LAYERS)}")
    is_sequence = isinstance(shape, Sequence)
    if not is_sequence or [isinstance(number, int) for number in shape] != [True, True]:
        raise QueryError(f"expected a shape (rows, columns), whole numbers, got {shape!r}")
    rows, cols = shape
    if rows < 1 or cols < 1 or not 0 < cell < math.inf:
        raise QueryError(f"expected rows, columns and a cell > 0, got {shape} and {cell!r}")
    xp = t.xp
    device = device_of(t)
    cell = float(cell)
    distance_ahead = (xp.arange(rows, dtype=t.dtype, device=device) - (rows - 1) / 2) * -cell
    distance_left = (xp.arange(cols, dtype=t.dtype, device=device) - (cols - 1) / 2) * -cell
    pixel_middles = xp.stack(xp.meshgrid(distance_ahead, distance_left, indexing="ij"), axis=-1)
    pattern = xp.reshape(pixel_middles, (-1, 2))
    points, scenes = _pattern_points(t, positions, yaw, pattern, scene_id)
    values = LAYERS[layer](t, points, scenes)
    return xp.reshape(values, (*values.shape[:-1], rows, cols))


def ranges(
    t: GridTensors,
    positions: ArrayT,
    yaw: Array,
    angles: Array,
    max_range: float,
    scene_id: Ids = None,
) -> ArrayT:
    """Make a scan of a planar lidar: distances along beams to the squares of occupied cells.

    The beams are horizontal and see the cells that block `PathFinder.line_of_sight` on the agent's
    level: those that something occupies in the height of the grid's agent, and those without a
    floor. Squares count with their edges and corners, so no beam passes between two squares that
    share a corner. On an inflated grid, these are the squares as they were baked. Beyond the
    level's cells there is nothing to see.

    Args:
        t: the tensors.
        positions: positions of the lidars, world x, y, z, shape (..., 3) [m]; z selects the level.
        yaw: headings of the lidars, as in `heights` [rad].
        angles: directions of the beams in the lidars' frames, 0 ahead, counted to the left, shape
            (k,) [rad].
        max_range: the greatest distance that a lidar measures, one number > 0 [m].
        scene_id: each lidar's scene; needed where the tensors have several grids.

    Returns:
        Distances, shape (..., k): 0 in an occupied cell, inf for nothing within `max_range`, NaN
        outside the grid [m].

    Example:
        >>> angles = torch.linspace(-math.pi, math.pi, 360, device="cuda")
        >>> scan = tensors.ranges(t, places, yaw, angles, max_range=8.0)
    """
    is_number = isinstance(max_range, int | float)
    if not is_number or not 0 < max_range < math.inf:
        raise QueryError(f"expected a max_range > 0, one number [m], got {max_range!r}")
    xp = t.xp
    lidar_positions: Array = check_positions(t, positions)
    beam_angles = as_array(t, angles)
    if beam_angles.ndim != 1:
        raise QueryError(f"expected angles of shape (k,), got {tuple(beam_angles.shape)}")
    shape = tuple(lidar_positions.shape[:-1])
    beam_shape = (*shape, int(beam_angles.shape[0]))
    directions = _check_yaw(t, yaw, shape)[..., None] + beam_angles
    origins = xp.broadcast_to(lidar_positions[..., None, :], (*beam_shape, 3))
    scenes = check_scenes(t, scene_id, shape)
    if scenes is not None:
        scenes = xp.broadcast_to(scenes[..., None], beam_shape)
    measure = partial(_measure_beams, t, max_range=float(max_range))
    distances_to_squares: ArrayT = apply_in_chunks(t, measure, origins, directions, scenes)
    return distances_to_squares


def _measure_beams(
    tensors: GridTensors, origins: Array, directions: Array, scenes: Array, *, max_range: float
) -> Array:
    """Measure how far beams get, see `ranges`.

    A beam enters a cell where it crosses the line between two columns or two rows. Where it crosses
    the n-th line follows from n alone, so many crossings are looked up at once, in blocks that
    bound the memory.

    Args:
        tensors: the tensors.
        origins: where beams begin, world x, y, z, shape (..., 3) [m].
        directions: where they lead to, 0 along x, counted towards y, shape (...) [rad].
        scenes: the scenes of beams, shape (...), or None.
        max_range: the greatest distance [m].

    Returns:
        Distances, shape (...) [m].
    """
    xp = tensors.xp
    shape = tensors.shape
    first_cell, _, is_in_cell = locate_in_scenes(tensors, origins, scenes)
    is_valid = is_in_cell & xp.isfinite(directions)
    directions = xp.where(is_valid, directions, 0.0)
    level, first_row, first_col = to_level_row_col(tensors, first_cell)
    cells_per_metre = tensors.cells_per_metre[level]
    # where the beam begins, in columns and rows from the first corner of the level
    west_edge = tensors.x_edge[level * (shape.cols + 1) + first_col]
    north_edge = tensors.y_edge[level * (shape.rows + 1) + first_row]
    x_in_cell = xp.where(is_valid, origins[..., 0] - west_edge, 0.0)
    y_in_cell = xp.where(is_valid, north_edge - origins[..., 1], 0.0)
    u = xp.astype(first_col, tensors.dtype) + clip(xp, x_in_cell * cells_per_metre, 0.0, 1.0)
    v = xp.astype(first_row, tensors.dtype) + clip(xp, y_in_cell * cells_per_metre, 0.0, 1.0)
    # columns and rows for each metre of the beam
    u_slope = xp.cos(directions) * cells_per_metre
    v_slope = -xp.sin(directions) * cells_per_metre
    float_spacing = float(xp.finfo(tensors.dtype).eps) * max(shape.rows, shape.cols)
    edge_width = ROUNDINGS_OF_CROSSING * float_spacing

    def is_solid(rows: Array, cols: Array) -> Array:
        is_on_level = (rows >= 0) & (rows < tensors.num_rows[level][..., None])
        is_on_level = is_on_level & (cols >= 0) & (cols < tensors.num_cols[level][..., None])
        cells = (level[..., None] * shape.rows + rows) * shape.cols + cols
        return is_on_level & tensors.solid[xp.where(is_on_level, cells, 0)]

    nearest = xp.where(tensors.solid[first_cell], 0.0, xp.full_like(u, xp.inf))
    num_lines = math.ceil(max_range * tensors.max_cells_per_metre) + 1

    def measure_to_lines(
        along: Array,
        along_slope: Array,
        first_line: Array,
        across: Array,
        across_slope: Array,
        max_lines: int,
        is_solid_beyond: Callable[[Array, Array], Array],
    ) -> Array:
        """Measure to the nearest solid cell that a beam enters over lines of one direction.

        Args:
            along: where the beam begins, in columns for the lines between these, or else in rows.
            along_slope: columns or rows for each metre of the beam.
            first_line: the column or row that it begins in.
            across: where it begins along these lines, in rows or else in columns.
            across_slope: rows or columns for each metre.
            max_lines: how many lines there are.
            is_solid_beyond: tells, by the column or row behind a line and the place along the line,
                whether the cell there is solid.
        """
        nearest_hit = xp.full_like(along, xp.inf)
        for line_numbers in _split_lines(tensors, min(num_lines, max_lines)):
            distance, beyond = _cross_lines(tensors, along, along_slope, first_line, line_numbers)
            is_near = distance <= max_range
            distance = xp.where(is_near, distance, 0.0)
            crossing = across[..., None] + distance * across_slope[..., None]
            before = xp.astype(xp.floor(crossing - edge_width), tensors.index_dtype)
            after = xp.astype(xp.floor(crossing + edge_width), tensors.index_dtype)
            is_hit = is_near & (is_solid_beyond(beyond, before) | is_solid_beyond(beyond, after))
            hit_distance = xp.min(xp.where(is_hit, distance, xp.inf), axis=-1)
            nearest_hit = xp.minimum(nearest_hit, hit_distance)
        return nearest_hit

    to_columns = measure_to_lines(
        along=u,
        along_slope=u_slope,
        first_line=first_col,
        across=v,
        across_slope=v_slope,
        max_lines=shape.cols,
        is_solid_beyond=lambda col, row: is_solid(row, col),
    )
    to_rows = measure_to_lines(
        along=v,
        along_slope=v_slope,
        first_line=first_row,
        across=u,
        across_slope=u_slope,
        max_lines=shape.rows,
        is_solid_beyond=is_solid,
    )
    nearest = xp.minimum(nearest, xp.minimum(to_columns, to_rows))
    return xp.where(is_valid, nearest, xp.nan)


def _split_lines(tensors: GridTensors, num_lines: int) -> list[Array]:
    """Return the numbers of lines, from 0, in blocks of at most `LINES_PER_BLOCK`."""
    xp = tensors.xp
    return [
        xp.arange(
            first_line,
            min(first_line + LINES_PER_BLOCK, num_lines),
            dtype=tensors.index_dtype,
            device=device_of(tensors),
        )
        for first_line in range(0, num_lines, LINES_PER_BLOCK)
    ]


def _cross_lines(
    tensors: GridTensors, start: Array, slope: Array, first_index: Array, line_numbers: Array
) -> tuple[Array, Array]:
    """Compute where beams cross the lines between columns, or between rows.

    Args:
        tensors: the tensors.
        start: where each beam begins, in columns, shape (...).
        slope: how many columns it goes for each metre, shape (...).
        first_index: the column that it begins in, shape (...).
        line_numbers: which of the lines ahead of it, from 0, shape (n,).

    Returns:
        The distances to the lines, inf for a beam along them [m]; and the columns behind them; both
        of shape (..., n).
    """
    xp = tensors.xp
    slopes = slope[..., None]
    is_forward = slopes > 0
    first_lines = first_index[..., None] + xp.astype(is_forward, tensors.index_dtype)
    lines = xp.where(is_forward, first_lines + line_numbers, first_lines - line_numbers)
    is_across = slopes != 0
    distances_in_cells = xp.astype(lines, tensors.dtype) - start[..., None]
    distance = xp.where(is_across, distances_in_cells / xp.where(is_across, slopes, 1.0), xp.inf)
    return distance, xp.where(is_forward, lines, lines - 1)


def _check_yaw(tensors: GridTensors, yaw: Array, shape: tuple[int, ...]) -> Array:
    """Check that there is a heading for each position, and return the headings as an array."""
    headings = as_array(tensors, yaw)
    if tuple(headings.shape) != shape:
        yaw_shape = tuple(headings.shape)
        raise QueryError(f"expected a yaw of shape {shape}, one for each position, got {yaw_shape}")
    return headings


def _pattern_points(
    tensors: GridTensors, positions: Array, yaw: Array, pattern: Array, scene_id: Ids
) -> tuple[Array, Array]:
    """Compute world positions of points round agents.

    Args:
        tensors: the tensors.
        positions: positions of the agents, world x, y, z, shape (..., 3) [m].
        yaw: headings of the agents, shape (...) [rad].
        pattern: points in the agents' frames, x ahead, y to the left, shape (k, 2) [m].
        scene_id: each agent's scene, or None.

    Returns:
        World x, y, z of the points, shape (..., k, 3); and their scenes, shape (..., 1), None for
        tensors of one scene.
    """
    xp = tensors.xp
    agent_positions = check_positions(tensors, positions)
    pattern_points = as_array(tensors, pattern)
    if pattern_points.ndim != 2 or pattern_points.shape[-1] != 2:
        raise QueryError(f"expected a pattern of shape (k, 2), got {tuple(pattern_points.shape)}")
    shape = tuple(agent_positions.shape[:-1])
    headings = _check_yaw(tensors, yaw, shape)
    cos = xp.cos(headings)[..., None]
    sin = xp.sin(headings)[..., None]
    x = agent_positions[..., 0, None] + cos * pattern_points[:, 0] - sin * pattern_points[:, 1]
    y = agent_positions[..., 1, None] + sin * pattern_points[:, 0] + cos * pattern_points[:, 1]
    z = xp.broadcast_to(agent_positions[..., 2, None], x.shape)
    scenes = check_scenes(tensors, scene_id, shape)
    return xp.stack([x, y, z], axis=-1), None if scenes is None else scenes[..., None]


def distance_to_goal(
    t: GridTensors, positions: ArrayT, goal: Ids = 0, scene_id: Ids = None
) -> ArrayT:
    """Look up the costs of the cheapest paths to a goal, like `PathFinder.distances`.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        goal: number of the goal, see `make_tensors`: an integer, or integers that broadcast to
            (...).
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        Metres times weights, shape (...); inf for no path, NaN outside the grid.
    """

    def look_up_costs(points: Array, first_index: Array | int, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(t, points, scenes)
        return t.xp.where(is_in_cell, t.cost[first_index + cell], t.xp.nan)

    return _apply_to_goal(t, look_up_costs, positions, goal, scene_id)


def distances(
    t: GridTensors, starts: ArrayT, goals: Array | None = None, scene_id: Ids = None
) -> ArrayT:
    """Compute `distance_to_goal` from each start to each of several goals.

    Args:
        t: the tensors.
        starts: world x, y, z, shape (..., 3) [m].
        goals: numbers of the goals, shape (m,); None for all goals of the tensors, in their order.
        scene_id: each start's scene; needed where the tensors have several grids.

    Returns:
        Metres times weights, shape (..., m); inf for no path, NaN outside the grid.
    """
    num_goals = _num_goals(t)
    num_cells = int(t.floor.shape[0])
    if goals is None:
        goals = list(range(num_goals))
    goal_numbers = check_numbers(t, goals, "goal", num_goals, (len(goals),))

    def look_up_costs(points: Array, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(t, points, scenes)
        first_indices = t.xp.where(goal_numbers >= 0, goal_numbers, 0) * num_cells
        has_cost = is_in_cell[..., None] & (goal_numbers >= 0)
        return t.xp.where(has_cost, t.cost[first_indices + cell[..., None]], t.xp.nan)

    return _apply(t, look_up_costs, starts, scene_id)


def path_step(t: GridTensors, positions: ArrayT, goal: Ids = 0, scene_id: Ids = None) -> ArrayT:
    """Compute the direction from each position to the next cell's centre on the cheapest path.

    Following it stays in the cells of that path, also over steps to other levels; at the stop of a
    link it points to the stop that the path leads to.

    Args:
        t: the tensors.
        positions: world x, y, z, shape (..., 3) [m].
        goal: number of the goal, see `make_tensors`: an integer, or integers that broadcast to
            (...).
        scene_id: each position's scene; needed where the tensors have several grids.

    Returns:
        World x, y of unit vectors, shape (..., 2): zeros in the goal's cell and in a lift whose
        stops lie over each other, NaN for no path.
    """
    xp = t.xp

    def find_directions(points: Array, first_index: Array | int, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(t, points, scenes)
        next_cell = xp.astype(t.next_cell[first_index + cell], t.index_dtype)
        has_path = is_in_cell & (next_cell >= 0)
        level, row, col = to_level_row_col(t, xp.where(has_path, next_cell, 0))
        cell_size = 1 / t.cells_per_metre[level]
        x = t.x_first[level] + (xp.astype(col, t.dtype) + 0.5) * cell_size
        y = t.y_first[level] - (xp.astype(row, t.dtype) + 0.5) * cell_size
        vectors_to_next = xp.stack([x, y], axis=-1) - points[..., :2]
        vectors_to_next = xp.where(
            (has_path & (next_cell != cell))[..., None], vectors_to_next, 0.0
        )
        lengths = xp.sqrt(vectors_to_next[..., 0] ** 2 + vectors_to_next[..., 1] ** 2)
        unit_vectors = vectors_to_next / xp.where(lengths > 0, lengths, 1.0)[..., None]
        return xp.where(has_path[..., None], unit_vectors, xp.nan)

    return _apply_to_goal(t, find_directions, positions, goal, scene_id)


def _apply_to_goal(
    tensors: GridTensors,
    function: Callable[..., Array],
    positions: ArrayT,
    goal: Ids,
    scene_id: Ids,
) -> ArrayT:
    """Check arguments, and apply a function of positions, first indices and scenes to them.

    A first index is where the cells of the position's goal begin in ``t.cost``.
    """
    xp = tensors.xp
    points = check_positions(tensors, positions)
    num_cells = int(tensors.floor.shape[0])
    shape = points.shape[:-1]
    if isinstance(goal, int | np.integer):
        first_index = check_number(goal, "goal", _num_goals(tensors)) * num_cells
    else:
        goals = check_numbers(tensors, goal, "goal", _num_goals(tensors), shape)
        points = xp.where((goals >= 0)[..., None], points, xp.nan)  # unknown goals
        first_index = xp.where(goals >= 0, goals, 0) * num_cells
    values: ArrayT = apply_in_chunks(
        tensors, function, points, first_index, check_scenes(tensors, scene_id, shape)
    )
    return values


def sample_stand(
    t: GridTensors, u: Array, target: Ids = 0, scene_id: Ids = None
) -> tuple[Array, Array]:
    """Turn uniform random numbers into poses of a base that reach a target, each equally likely.

    Args:
        t: tensors with targets, see `with_stands`.
        u: numbers in [0, 1), shape (...).
        target: number of the target, see `with_stands`: an integer, or integers that broadcast to
            (...).
        scene_id: each pose's scene; needed where the tensors have several grids.

    Returns:
        World x, y and floor z of the base's axis [m], shape (..., 3); and yaw, 0 along x, counted
        towards y [rad], shape (...). Both are NaN for an unknown target or scene, or a NaN.
    """
    xp = t.xp
    random_numbers = as_array(t, u)
    shape = tuple(random_numbers.shape)
    targets = _check_targets(t, target, shape)
    scenes = check_scenes(t, scene_id, shape)
    scene_numbers = xp.zeros_like(targets) if scenes is None else scenes
    is_valid = (targets >= 0) & (scene_numbers >= 0) & ~xp.isnan(random_numbers)
    group = xp.where(is_valid, targets * t.shape.scenes + scene_numbers, 0)
    first_index = xp.astype(t.stand_start[group], t.index_dtype)
    num_poses = xp.astype(t.stand_start[group + 1], t.index_dtype) - first_index
    fractions = xp.where(is_valid, random_numbers, 0.0)
    # the product may be rounded up to the number of poses
    pose_index = xp.astype(xp.floor(fractions * xp.astype(num_poses, t.dtype)), t.index_dtype)
    pose_index = first_index + clip(xp, pose_index, 0, num_poses - 1)
    positions = xp.stack(
        [t.stand_x[pose_index], t.stand_y[pose_index], t.stand_z[pose_index]], axis=-1
    )
    yaw = t.stand_yaw[pose_index]
    return xp.where(is_valid[..., None], positions, xp.nan), xp.where(is_valid, yaw, xp.nan)


def can_reach(
    t: GridTensors,
    positions: Array,
    yaw: Array,
    target: Ids = 0,
    scene_id: Ids = None,
    tolerance: float | None = math.pi / 8,
) -> Array:
    """Test whether a robot's base at each pose reaches a target, like `PathFinder.can_reach`.

    A footprint is tested at the heading of the cell's pose, and not at the base's own.

    Args:
        t: tensors with targets, see `with_stands`.
        positions: positions of the base's axis, world x, y, z, shape (..., 3) [m].
        yaw: headings of the bases, 0 along x, counted towards y, shape (...) [rad].
        target: number of the target, see `with_stands`: an integer, or integers that broadcast to
            (...).
        scene_id: each position's scene; needed where the tensors have several grids.
        tolerance: largest angle between a base's heading and that of the pose in its cell [rad],
            >= 0; None for any heading.

    Returns:
        bool, shape (...); False for an unknown target or scene.
    """
    xp = t.xp
    points = check_positions(t, positions)
    shape = tuple(points.shape[:-1])
    headings = _check_yaw(t, yaw, shape)
    targets = _check_targets(t, target, shape)
    num_cells = int(t.floor.shape[0])
    last_index = int(t.stand_key.shape[0]) - 1

    def test_poses(points: Array, headings: Array, targets: Array, scenes: Array) -> Array:
        cell, _, is_in_cell = locate_in_scenes(t, points, scenes)
        is_valid = is_in_cell & (targets >= 0)
        keys = xp.astype(xp.where(is_valid, targets * num_cells + cell, -1), t.stand_key.dtype)
        first_index = xp.searchsorted(t.stand_key, xp.reshape(keys, (-1,)), side="left")
        first_index = xp.reshape(xp.astype(first_index, t.index_dtype), keys.shape)
        is_reaching = xp.zeros_like(is_valid)
        for repeat in range(t.stand_repeats):
            pose_index = clip(xp, first_index + repeat, 0, last_index)
            is_pose = t.stand_key[pose_index] == keys
            if tolerance is not None:
                # the angle between the headings, as a number of whole turns
                turns = (headings - t.stand_yaw[pose_index]) / (2.0 * math.pi)
                is_pose = is_pose & (xp.abs(turns - xp.round(turns)) * (2.0 * math.pi) <= tolerance)
            is_reaching = is_reaching | is_pose
        return is_reaching

    scenes = check_scenes(t, scene_id, shape)
    return apply_in_chunks(t, test_poses, points, headings, targets, scenes)


def _check_targets(tensors: GridTensors, target: Ids, shape: tuple[int, ...]) -> Array:
    """Check numbers of targets, and broadcast them to a shape; -1 in place of unknown ones."""
    if not tensors.targets:
        raise QueryError("the tensors know no targets: with_stands(t, […]) adds them")
    num_targets = len(tensors.targets)
    if isinstance(target, int | np.integer):
        check_number(target, "target", num_targets)
    return check_numbers(tensors, target, "target", num_targets, shape)


def _num_goals(tensors: GridTensors) -> int:
    """Return the number of goals; raise an error if there are none."""
    if not tensors.goals:
        raise QueryError("the tensors know no goals: name them when they are made, goals=[…]")
    return len(tensors.goals)


def sample(
    t: GridTensors,
    u: ArrayT,
    room: Ids = None,
    min_clearance: Array | float | None = None,
    reachable_from: Array | None = None,
    scene_id: Ids = None,
) -> ArrayT:
    """Turn uniform random numbers into places where an agent can stand, each cell equally likely.

    The same numbers give the same places. A grid's levels must have cells of one size.

    Args:
        t: the tensors.
        u: numbers in [0, 1), shape (..., 3): the first chooses the cell, the others the x and y in
            it. 0.5 is the cell's centre, where the agent's radius fits for certain.
            Shape (..., 1) returns centres.
        room: take cells of this room only, by its number (see `room`), which is
            ``t.rooms[scene].index(ID) + 1``; an integer or integers of shape (...).
        min_clearance: take cells with at least this `clearance` only [m]; one number.
        reachable_from: take cells of the island that this position is on only, world x, y, z, shape
            (3,); or (..., 3), a position for each place [m].
        scene_id: each place's scene; needed where the tensors have several grids.

    Returns:
        World x, y and floor z [m], shape (..., 3); NaN if there is no such place.
    """
    xp = t.xp
    random_numbers: Array = as_array(t, u)
    if random_numbers.ndim == 0 or random_numbers.shape[-1] not in (1, 3):
        raise QueryError(
            f"expected u of shape (..., 3) or (..., 1), got {tuple(random_numbers.shape)}"
        )
    shape = tuple(random_numbers.shape[:-1])
    scenes = check_scenes(t, scene_id, shape)
    keys_per_group = t.num_rooms + 1
    is_valid = ~xp.isnan(random_numbers[..., 0])
    cell_fraction = xp.where(is_valid, random_numbers[..., 0], 0.0)
    # The cells are sorted by a key of group and room. Groups are scenes, or islands.
    if reachable_from is None:
        group_numbers = (
            xp.zeros_like(cell_fraction, dtype=t.index_dtype) if scenes is None else scenes
        )
        cells = t.cells_by_room
        keys = t.room_key
        is_valid = is_valid & (group_numbers >= 0)
    else:
        start_positions = as_array(t, reachable_from)
        if scenes is not None:
            start_positions = broadcast(t, start_positions, (*shape, 3), "reachable_from")
        start_island = broadcast(t, island(t, start_positions, scenes), shape, "reachable_from")
        group_numbers = xp.astype(start_island, t.index_dtype)
        cells = t.cells_by_island
        keys = t.island_key
        is_valid = is_valid & (group_numbers > 0)
    if cells.shape[0] == 0:
        no_places: ArrayT = xp.full((*shape, 3), xp.nan, dtype=t.dtype, device=device_of(t))
        return no_places
    first_key = group_numbers * keys_per_group
    stop_key = (group_numbers + 1) * keys_per_group
    if room is not None:
        room_number = check_numbers(t, room, "room", keys_per_group, shape)
        is_valid = is_valid & (room_number >= 0)
        first_key = group_numbers * keys_per_group + room_number
        stop_key = first_key + 1
    first_index = _count_below(t, keys, first_key)
    stop_index = _count_below(t, keys, stop_key)
    num_candidates = stop_index - first_index
    num_allowed_before = None  # for each of `cells`, how many before it are allowed; None for all
    if min_clearance is not None:
        if getattr(min_clearance, "ndim", 0) != 0:
            raise QueryError("expected one number as min_clearance [m], got an array of them")
        is_allowed = xp.astype(t.clearance[cells] >= min_clearance, t.index_dtype)
        num_allowed_before = xp.concat(
            [xp.zeros_like(is_allowed[:1]), xp.cumulative_sum(is_allowed)]
        )
        num_candidates = num_allowed_before[stop_index] - num_allowed_before[first_index]
    # index among the candidates; the product may be rounded up to their number
    candidate_index = xp.astype(
        xp.floor(cell_fraction * xp.astype(num_candidates, t.dtype)), t.index_dtype
    )
    candidate_index = clip(xp, xp.minimum(candidate_index, num_candidates - 1), 0, cells.shape[0])
    if num_allowed_before is None:
        cell_index = first_index + candidate_index
    else:
        # the first cell up to which as many are allowed
        num_allowed = num_allowed_before[first_index] + candidate_index + 1
        cell_index = _count_below(t, num_allowed_before[1:], num_allowed)
    cell = xp.astype(cells[clip(xp, cell_index, 0, cells.shape[0] - 1)], t.index_dtype)
    points = _place_in_cells(t, cell, random_numbers)
    has_place = is_valid & (num_candidates > 0) & ~xp.any(xp.isnan(points), axis=-1)
    places: ArrayT = xp.where(has_place[..., None], points, xp.nan)
    return places


def _count_below(t: GridTensors, sorted_keys: Array, limits: Array) -> Array:
    """Count the sorted keys that are smaller than each limit."""
    xp = t.xp
    flat_limits = xp.reshape(xp.astype(limits, sorted_keys.dtype), (-1,))
    counts = xp.searchsorted(sorted_keys, flat_limits, side="left")
    return xp.reshape(xp.astype(counts, t.index_dtype), limits.shape)


def _place_in_cells(t: GridTensors, cell: Array, random_numbers: Array) -> Array:
    """Place points in cells.

    Args:
        t: the tensors.
        cell: the cells, shape (...).
        random_numbers: numbers in [0, 1), shape (..., 3), of which the second and the third are the
            places along x and y; shape (..., 1) for the cells' centres.

    Returns:
        World x, y and floor z [m], shape (..., 3).
    """
    xp = t.xp
    level, row, col = to_level_row_col(t, cell)
    z = t.floor[cell]
    z = xp.where(xp.isnan(z), t.ground[level], z)
    column_edge_index = level * (t.shape.cols + 1) + col
    row_edge_index = level * (t.shape.rows + 1) + row
    west = t.x_edge[column_edge_index]
    east = t.x_edge[column_edge_index + 1]
    north = t.y_edge[row_edge_index]
    south = t.y_edge[row_edge_index + 1]
    if random_numbers.shape[-1] == 1:
        fraction_x = 0.5
        fraction_y = 0.5
    else:
        fraction_x = random_numbers[..., 1]
        fraction_y = random_numbers[..., 2]
    # the eastern and the southern edge belong to the next cells
    last_x = xp.nextafter(east, xp.full_like(east, -xp.inf))
    last_y = xp.nextafter(south, xp.full_like(south, xp.inf))
    x = xp.minimum(west + fraction_x * (east - west), last_x)
    y = xp.maximum(north - fraction_y * (north - south), last_y)
    return xp.stack([x, y, z], axis=-1)
