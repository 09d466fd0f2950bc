"""Measures walls, for dividing floors into rooms.

Functions of this module measure how far cells are from walls, in which directions walls run, where
rays meet the geometry of walls, and which sills and parapets continue walls.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import TiledShapes, cast_points, tile_shapes
from navbake.baker.core.arrays import Facets
from navbake.baker.core.blocks import join_arrays
from navbake.baker.core.components import find_row_runs
from navbake.baker.core.windows import Window, grow_window, window_of_cells
from navbake.baker.geometry.shapes import Shapes, boxes_in_batches
from navbake.baker.rooms import gap_kernels as kernels
from navbake.baker.rooms.gap_limits import MAX_JAMB_DISTANCE, MAX_WALL_DISTANCE
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_beside, run_in_chunks
from navbake.types import Bool, Float, Int, Int32, ScalarT

MIN_CHUNK_COLUMNS = 64  # the fewest columns that one thread sweeps
NODES_PER_PIECE = 1 << 12  # nodes whose distances are measured together, to save memory
ROWS_PER_COPY = 64  # rows that are copied together to Fortran order
NO_ROWS = np.empty((0, 0), dtype=np.int32)  # `squared` in the first call of `sweep_distances`

# ------------------------------------------------------------ directions of walls

# If walls have geometry, their directions are taken from points on it, about this far apart [m]
POINT_SPACING = 0.1
# Points on geometry are exact: they are counted in bins of angles of this size [°], and in parallel
# strips of this width [m]
GEOMETRY_BIN_WIDTH = 1.0
GEOMETRY_STRIP_WIDTH = 0.01
# Directions from geometry are used if at least this share of the points lies on walls that run in
# one of these directions
MIN_EXPLAINED_SHARE = 0.5
# Otherwise directions are taken from the cells: from the slope of the distance to the nearest
# closed cell, at this distance from walls [m]
SLOPE_DISTANCE = 0.3
# The slope is measured at least this far from walls, as the lattice's steps disturb what is nearer
# [cells]
MIN_SLOPE_DISTANCE = 5
# Points that slopes lead to are counted in bins of angles of this size [°], and in parallel strips
# of this width [cells]
CELL_BIN_WIDTH = 5.0
CELL_STRIP_WIDTH = 0.5
# The least change of the distance over four cells at which one wall is the nearest: beside a single
# wall it is 4; where two walls are about as near, it is less [cells]
MIN_DISTANCE_CHANGE = 3.2
# A direction counts if walls along it have this length in all [m], and this share of all points
MIN_WALL_LENGTH = 1.2
MIN_POINT_SHARE = 0.01
# The points in a strip are on a wall if there are as many as on a wall of this length [m]
MIN_LENGTH_ON_LINE = 0.8
# A direction that is not one of the whole building is used only this near to its own walls [m]
NEAR_WALL_DISTANCE = 1.5
# A direction is refined in steps of this size [bins of angles], with about this many points
REFINEMENT_STEP = 0.05
NUM_REFINEMENT_POINTS = 2000
# An axis of the lattice is preferred to the best angle if its sharpness, see `_refine_angle`, is at
# least this share of the best angle's
MIN_AXIS_SHARPNESS_SHARE = 0.9
# A direction is one of the whole building if it is the first one, or parallel or at right angles to
# the first one, within this tolerance [°]
RIGHT_ANGLE_TOLERANCE = 1.0
# The lattice is padded by this many cells, so that slopes can be measured at its edge
EDGE_PADDING = 2

# ------------------------------------------------------------ rays to walls

# The height over the floor at which walls are measured, below the sills of windows [m]
RAY_HEIGHT = 0.6
# Triangles at heights without rays are skipped; heights are compared in bins of this size [m]
HEIGHT_BIN = 0.01
# Fewer triangles than this are not worth a call on another thread
MIN_CHUNK_TRIANGLES = 1 << 14
# From a cell, rays begin at its centre and this far to both sides of it, because a thin piece of
# wall in the cells ahead may lie beside their centres [cells]
RAY_OFFSETS = np.array([-0.5, 0.0, 0.5])
# The height of rays from cells without a floor, which meet nothing [m]
NO_FLOOR_HEIGHT = -1e9
# Rays from at least MANY_RAYS cells are first cast this far, where most of them end [cells]; those
# that meet nothing are cast once more, at full length
SHORT_RAY = 2.5
MANY_RAYS = 200
# Rays are at least this long: MAX_WALL_DISTANCE columns, √2 cells each on a line at 45° [cells]
MIN_RAY_LENGTH = math.sqrt(2) * MAX_WALL_DISTANCE
# Geometry is widened by this, so that rays between two tiles find it in both [m]
TILE_MARGIN = 1e-6

# ------------------------------------------------------------ sills

# A sill is at most this thick [m]; it fills every cell that it touches, one more on each side
MAX_SILL_THICKNESS = 0.5


# ---------------------------------------------------------------- distances


def measure_squared_distances(is_target: Bool, reach: int) -> Int32:
    """Measure how far each cell is from the nearest target cell.

    Args:
        is_target: a mask of the target cells, shape (rows, cols). It may also be a mask of nodes,
            see `mark_wall_nodes`; distances are then in half cells.
        reach: the largest distance that is measured, >= 0 [cells].

    Returns:
        The squared distances, ``(reach + 1) ** 2`` for all distances greater than `reach`, shape
        (rows, cols), int32 [cells squared].
    """
    is_target = np.ascontiguousarray(is_target)
    num_rows, num_cols = is_target.shape
    column_distance = np.empty(is_target.shape, dtype=np.int16)
    run_in_chunks(
        kernels.sweep_distances,
        num_cols,
        is_target,
        reach,
        column_distance,
        NO_ROWS,
        min_chunk_size=MIN_CHUNK_COLUMNS,
    )
    squared_distance = np.empty(is_target.shape, dtype=np.int32)
    run_in_chunks(
        kernels.sweep_distances, num_rows, is_target, reach, column_distance, squared_distance
    )
    return squared_distance


def measure_squared_distances_at(is_open: Bool, reach: int, node_row: Int, node_col: Int) -> Int:
    """Measure how far some nodes are from the nearest closed cell or the lattice's edge.

    Nodes are the centres, the corners and the middles of edges of cells, see `mark_wall_nodes`. The
    result equals that of ``measure_squared_distances(mark_wall_nodes(is_open), reach)`` at these
    nodes, but takes less time: distances are computed for cells, a quarter as many as nodes.

    Args:
        is_open: a mask of the open cells, shape (height, width).
        reach: the largest distance that is measured, >= 0 [half cells].
        node_row: the nodes' rows, shape (n,).
        node_col: the nodes' columns, shape (n,).

    Returns:
        The squared distances, ``(reach + 1) ** 2`` for all distances greater than `reach`, shape
        (n,) [half cells squared].
    """
    is_closed = np.pad(~is_open, 1, constant_values=True)
    num_cols = is_closed.shape[1]
    column_distance = np.empty(is_closed.shape, dtype=np.int16)
    cell_reach = reach // 2 + 1
    run_in_chunks(
        kernels.sweep_distances,
        num_cols,
        is_closed,
        cell_reach,
        column_distance,
        NO_ROWS,
        min_chunk_size=MIN_CHUNK_COLUMNS,
    )
    squared_distance = np.empty(len(node_row), dtype=np.int64)
    col_shifts = np.arange(-(reach // 2) - 1, reach // 2 + 3)
    for first_node in range(0, len(node_row), NODES_PER_PIECE):
        nodes = slice(first_node, first_node + NODES_PER_PIECE)
        row = node_row[nodes, None]
        col = node_col[nodes, None]
        cell_col = np.clip(col // 2 + col_shifts, 0, num_cols - 1)
        # from the cells above and below each node; the same cell where the node is at its middle
        rows_away = np.minimum(
            column_distance[(row + 1) // 2, cell_col], column_distance[(row + 2) // 2, cell_col]
        )
        nodes_down = np.maximum(2 * rows_away.astype(np.int64) - row % 2, 0)
        nodes_right = np.maximum(np.abs(2 * cell_col - 1 - col) - 1, 0)  # cells: two nodes wide
        squared_distance[nodes] = (nodes_down**2 + nodes_right**2).min(axis=1)
    return np.minimum(squared_distance, (reach + 1) ** 2)


def mark_wall_nodes(is_open: Bool) -> Bool:
    """Mark the nodes that are on a closed cell or the lattice's edge.

    Nodes are points half a cell apart, so that distances can be measured to half a cell. Node
    (2 r + 1, 2 c + 1) is the centre of cell (r, c); the other nodes are the corners of cells and
    the middles of their edges.

    Args:
        is_open: a mask of the open cells, shape (height, width).

    Returns:
        A mask of the nodes, shape (2 height + 1, 2 width + 1).
    """
    is_closed = np.pad(~is_open, 1, constant_values=True)
    is_closed_row = is_closed.repeat(2, axis=0)[1:-1]
    # each row's upper edge, its centre, …, the last row's lower edge
    is_closed_row = is_closed_row[:-1] | is_closed_row[1:]
    is_closed_node = is_closed_row.repeat(2, axis=1)[:, 1:-1]
    return is_closed_node[:, :-1] | is_closed_node[:, 1:]


# ---------------------------------------------------------------- directions of walls


class WallDirection(NamedTuple):
    """A direction that walls run in, and how a lattice is scanned along it.

    The scan follows parallel lines of cells in this direction, from column to column.

    Attributes:
        is_swapped: whether rows and columns are swapped for the scan, because the direction is
            steeper than 45° to the rows.
        shift: for each column of the scan, how many rows lower a line of cells is than in the first
            column, (cols,), int64.
        slope: how many rows the direction goes down from one column of the scan to the next, -1 to
            1.
        length_per_column: the length of a line from one column to the next, 1 to √2 [cells].
        window: the rows and columns of the lattice, not swapped, outside of which no cell is near
            walls in this direction.
        is_near_wall: a mask of the window's cells that are near such walls, shape (rows, cols), not
            swapped.
    """

    is_swapped: bool
    shift: Int
    slope: float
    length_per_column: float
    window: Window
    is_near_wall: Bool


class WallPoints(NamedTuple):
    """Points on walls, from which the directions of the walls are found.

    Attributes:
        position: the row and the column of each point, with fractions, shape (2, n) [cells].
        angle: the direction of the wall at each point, 0 to 180, shape (n,) [°]: 0 along a row of
            the lattice, 45 where it goes one row down per column, 90 along a column.
        spacing: the distance between neighbouring points on a wall [m].
        bin_width: the width of the bins in which angles are counted [°].
        strip_width: the width of the parallel strips in which points are counted [cells].
    """

    position: Float
    angle: Float
    spacing: float
    bin_width: float
    strip_width: float


def find_directions(
    is_open: Bool, cell_size: float, rays: WallRays | None = None
) -> list[WallDirection]:
    """Find the directions that walls run in.

    They are found from the walls' geometry. If there is none, or if it is rough, like a scan's,
    they are found from the gradient of the distance to closed cells.

    Args:
        is_open: a mask of the cells without a wall, shape (height, width).
        cell_size: the side of a cell, > 0 [m].
        rays: rays to the walls' geometry; None without geometry.

    Returns:
        The directions, starting with the most common one.
    """
    shape = is_open.shape
    if rays is not None:
        points, num_rays = rays.find_points(is_open)
        directions, num_points_on_walls = _list_directions(points, shape, cell_size)
        if num_rays and num_points_on_walls >= MIN_EXPLAINED_SHARE * num_rays:
            return directions
    directions, _ = _list_directions(_find_cell_points(is_open, cell_size), shape, cell_size)
    return directions


def _list_directions(
    points: WallPoints, shape: tuple[int, ...], cell_size: float
) -> tuple[list[WallDirection], int]:
    """List the directions of walls, and count the points that lie on walls with such a direction.

    The most common angle of all points is refined. Points with about this angle that lie in a
    straight line are on walls of that direction. Then this is repeated with the remaining points.

    Args:
        points: points on walls.
        shape: the shape of the lattice, (height, width).
        cell_size: the side of a cell, > 0 [m].

    Returns:
        The directions, starting with the most common one; and the number of points on such walls.
    """
    position, angle, spacing, bin_width, strip_width = points
    num_bins = round(180 / bin_width)
    bin_of_point = np.rint(angle / bin_width).astype(np.int64) % num_bins
    # about this many points of every angle are at corners of walls, where slopes point everywhere
    num_corner_points = 2.0 * float(
        np.median(_add_neighbor_bins(np.bincount(bin_of_point, minlength=num_bins)))
    )
    min_points = max(MIN_WALL_LENGTH / spacing, MIN_POINT_SHARE * len(bin_of_point))
    min_points_in_strips = MIN_LENGTH_ON_LINE / spacing
    directions = list[WallDirection]()
    main_angle = 0.0
    num_points_on_walls = 0
    is_remaining = np.ones(len(bin_of_point), dtype=np.bool_)
    while True:
        bin_counts = _add_neighbor_bins(np.bincount(bin_of_point[is_remaining], minlength=num_bins))
        best_bin = int(bin_counts.argmax())
        if bin_counts[best_bin] < min_points + num_corner_points:
            return directions, num_points_on_walls
        angle_difference = np.abs((angle - best_bin * bin_width + 90.0) % 180.0 - 90.0)
        is_near_angle = is_remaining & (angle_difference <= 1.5 * bin_width)
        wall_angle = _refine_angle(position[:, is_near_angle], best_bin, bin_width, strip_width)
        # points on walls of this direction count for no other direction, a few degrees off
        is_near_angle = is_remaining & (angle_difference <= 2.5 * bin_width)
        near_position = position[:, is_near_angle]
        is_on_wall = _mark_on_walls(near_position, wall_angle, strip_width, min_points_in_strips)
        if is_on_wall.sum() < min_points:
            is_remaining[is_near_angle] = False
            continue
        direction = make_direction(wall_angle, shape)
        if not directions:
            main_angle = wall_angle
        if abs((wall_angle - main_angle + 45.0) % 90.0 - 45.0) > RIGHT_ANGLE_TOLERANCE:
            window, is_near_wall = _mark_near_points(near_position[:, is_on_wall], shape, cell_size)
            direction = direction._replace(window=window, is_near_wall=is_near_wall)
        directions.append(direction)
        is_remaining[is_near_angle] = ~is_on_wall
        num_points_on_walls += int(is_on_wall.sum())


def _mark_near_points(
    position: Float, shape: tuple[int, ...], cell_size: float
) -> tuple[Window, Bool]:
    """Mark the cells within `NEAR_WALL_DISTANCE` of points.

    Args:
        position: rows and columns of the points, shape (2, n) [cells].
        shape: the shape of the lattice, (height, width).
        cell_size: the side of a cell, > 0 [m].

    Returns:
        A window that holds all of these cells, and a mask of them in the window.
    """
    row, col = np.rint(position).astype(np.int64)
    is_inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    row = row[is_inside]
    col = col[is_inside]
    if not len(row):
        return (slice(0, 0), slice(0, 0)), np.zeros((0, 0), dtype=np.bool_)
    reach = round(NEAR_WALL_DISTANCE / cell_size)
    window = grow_window(window_of_cells(row, col), reach, reach, shape)
    row_slice, col_slice = window
    is_point: Bool = np.zeros(
        (row_slice.stop - row_slice.start, col_slice.stop - col_slice.start), dtype=np.bool_
    )
    is_point[row - row_slice.start, col - col_slice.start] = True
    return window, np.asarray(measure_squared_distances(is_point, reach) <= reach**2)


def _find_cell_points(is_open: Bool, cell_size: float) -> WallPoints:
    """Find points on walls from the cells alone, without the walls' geometry.

    At each cell that is about `SLOPE_DISTANCE` from a wall, the distance to closed cells falls
    straight towards the wall. The point on the wall is that far away in this direction.
    """
    reach = max(MIN_SLOPE_DISTANCE, round(SLOPE_DISTANCE / cell_size))
    # the edge of the lattice is no wall: what is at it goes on beyond it
    is_closed = np.pad(~is_open, EDGE_PADDING, mode="edge")
    squared_distance = measure_squared_distances(is_closed, reach + 2)
    is_at_slope_distance = (squared_distance >= (reach - 1) ** 2) & (squared_distance < reach**2)
    is_at_slope_distance[[0, 1, -2, -1]] = False
    is_at_slope_distance[:, [0, 1, -2, -1]] = False
    cells = np.flatnonzero(is_at_slope_distance)
    width = is_closed.shape[1]
    neighbor_cells = cells + np.array([[2 * width], [-2 * width], [2], [-2], [0]])
    neighbor_distances = np.sqrt(squared_distance.ravel()[neighbor_cells], dtype=np.float32)
    distance_below, distance_above, distance_after, distance_before, wall_distance = (
        neighbor_distances
    )
    slope_down = distance_below - distance_above
    slope_right = distance_after - distance_before
    # a wall runs across the slope; between two walls that are equally near, the slope is less steep
    has_clear_slope = np.hypot(slope_down, slope_right) > MIN_DISTANCE_CHANGE
    cells = cells[has_clear_slope]
    wall_distance = wall_distance[has_clear_slope]
    slope_down = slope_down[has_clear_slope]
    slope_right = slope_right[has_clear_slope]
    angle = np.mod(np.rad2deg(np.arctan2(slope_down, slope_right)) + 90.0, 180.0)
    slope = np.hypot(slope_down, slope_right)
    wall_position = (
        np.array(np.divmod(cells, width))
        - wall_distance * np.stack([slope_down, slope_right]) / slope
    )
    return WallPoints(
        position=wall_position - EDGE_PADDING,
        angle=angle,
        spacing=cell_size,
        bin_width=CELL_BIN_WIDTH,
        strip_width=CELL_STRIP_WIDTH,
    )


def _add_neighbor_bins(bin_counts: Int) -> Int:
    """Add to each bin's count those of its two neighbours; the last bin is beside the first."""
    return bin_counts + np.roll(bin_counts, 1) + np.roll(bin_counts, -1)


def _find_strips(position: Float, angles: Float, strip_width: float) -> Float:
    """Find for each angle in which of many parallel strips, side by side, each point lies.

    Args:
        position: rows and columns of the points, shape (2, n) [cells].
        angles: the directions of the strips, see `WallPoints.angle` [°].
        strip_width: the width of a strip [cells].

    Returns:
        The number of each point's strip, from 0; its fraction is the place across the strip. Shape
        (angles, n).
    """
    radians = np.deg2rad(angles)[:, None]
    distance_across = position[0] * np.cos(radians) - position[1] * np.sin(radians)
    return np.asarray((distance_across - distance_across.min(axis=1, keepdims=True)) / strip_width)


def _mark_on_walls(position: Float, angle: float, strip_width: float, min_points: float) -> Bool:
    """Mark the points on walls: points in two neighbouring strips that contain many points.

    Args:
        position: rows and columns of the points, shape (2, n) [cells].
        angle: the direction of the strips [°].
        strip_width: the width of a strip [cells].
        min_points: the least number of points that two strips with a wall contain together.
    """
    strip_of_point = _find_strips(position, np.array([angle]), strip_width)[0].astype(np.int64)
    num_points_in_strip = np.pad(np.bincount(strip_of_point), 1)
    # each strip with the one before
    num_points_in_pair = num_points_in_strip[1:] + num_points_in_strip[:-1]
    is_on_wall: Bool = (
        np.maximum(num_points_in_pair[strip_of_point], num_points_in_pair[strip_of_point + 1])
        >= min_points
    )
    return is_on_wall


def _refine_angle(position: Float, bin_number: int, bin_width: float, strip_width: float) -> float:
    """Find more exactly the angle of the walls that points lie on [°].

    It is the angle at which the points lie the most densely in parallel strips, like the sharpest
    projection of a Radon transform. Angles within 1.5 bins are tried. If an axis of the lattice is
    among them, and about as sharp, it is taken.

    Args:
        position: rows and columns of the points, shape (2, n) [cells].
        bin_number: the number of the bin that the angle is near.
        bin_width: the width of a bin [°].
        strip_width: the width of a strip [cells].
    """
    position = position[:, :: max(1, position.shape[1] // NUM_REFINEMENT_POINTS)]
    num_steps = round(1.5 / REFINEMENT_STEP)
    refinement_steps = np.arange(-num_steps, num_steps + 1, dtype=np.float64)
    angles = bin_width * (bin_number + REFINEMENT_STEP * refinement_steps)
    strip_of_point = _find_strips(position, angles, strip_width)
    # the second with other bounds of strips, so that no wall falls between two strips
    wait_for_second = run_beside(_measure_sharpness, (strip_of_point + 0.5).astype(np.int32))
    sharpness = np.maximum(_measure_sharpness(strip_of_point.astype(np.int32)), wait_for_second())
    is_axis = angles % 90.0 == 0.0
    if (sharpness[is_axis] >= MIN_AXIS_SHARPNESS_SHARE * sharpness.max()).any():
        return float(angles[is_axis][0])
    return float(angles[sharpness.argmax()])


def _measure_sharpness(strip_of_point: Int32) -> Int:
    """Measure for each angle how densely points lie in strips and in pairs of strips.

    Args:
        strip_of_point: the number of each point's strip at each angle, from 0, shape (angles, n);
            at least one point.

    Returns:
        The sum over all strips of the squared number of points, and of that number times the next
        strip's, shape (angles,). These are whole numbers, so the result is exact.
    """
    num_angles, num_points = strip_of_point.shape
    # the strips of all angles in one row; between those of two angles is one without points
    first_strips = np.arange(num_angles) * (int(strip_of_point.max()) + 2)
    strips = (np.sort(strip_of_point, axis=1) + first_strips[:, None]).ravel()
    first_points = np.flatnonzero(np.append(True, strips[1:] != strips[:-1]))  # in each strip
    strips = strips[first_points]
    num_in_strip = np.diff(first_points, append=strip_of_point.size)
    density = num_in_strip**2
    is_beside_next = strips[1:] == strips[:-1] + 1
    density[:-1] += num_in_strip[:-1] * num_in_strip[1:] * is_beside_next
    return np.add.reduceat(
        density, np.searchsorted(first_points, np.arange(num_angles) * num_points)
    )


def make_direction(angle: float, shape: tuple[int, ...]) -> WallDirection:
    """Make a direction of walls from its angle; all cells are marked as near to such walls.

    Args:
        angle: the angle, 0 to 180 [°]: 0 along a row of the lattice, 90 along a column, and 45
            where the direction goes one row down per column.
        shape: the shape of the lattice, (height, width).
    """
    is_swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if is_swapped else angle))
    num_cols = shape[0] if is_swapped else shape[1]
    return WallDirection(
        is_swapped=is_swapped,
        shift=np.rint(np.arange(num_cols) * slope).astype(np.int64),
        slope=float(slope),
        length_per_column=float(np.hypot(1.0, slope)),
        window=(slice(0, shape[0]), slice(0, shape[1])),
        is_near_wall=np.broadcast_to(np.True_, shape),
    )


def both_scan_orders(array: NDArray[ScalarT]) -> tuple[NDArray[ScalarT], NDArray[ScalarT]]:
    """Arrange an array of the lattice as it is scanned along directions of walls.

    Rows and columns are swapped if the direction needs it, and each column is contiguous in memory.
    All directions that are swapped, or that are not, share one array.

    Args:
        array: an array with an entry for each cell, shape (height, width).

    Returns:
        The array in Fortran order, a view or a copy, for directions that aren't swapped, and for
        those that are: ``both_scan_orders(array)[direction.is_swapped]``. `from_scan_order` is the
        inverse.
    """
    return _to_fortran_order(array), _to_fortran_order(array.T)


def _to_fortran_order(array: NDArray[ScalarT]) -> NDArray[ScalarT]:
    """Return an array in Fortran order, a view or a copy.

    It is copied a few rows at a time. All rows of a large lattice at once take numpy three times as
    long: neighbors in a row are then far from each other in the copy, so hardly any entry that is
    written is in the cache.
    """
    if array.flags.f_contiguous:
        return array
    array_in_order = np.empty_like(array, order="F")

    def copy_rows(begin: int, end: int) -> None:
        for first_row in range(begin, end, ROWS_PER_COPY):
            rows = slice(first_row, min(first_row + ROWS_PER_COPY, end))
            array_in_order[rows] = array[rows]

    run_in_chunks(copy_rows, len(array), min_chunk_size=ROWS_PER_COPY)
    return array_in_order


def from_scan_order(array: NDArray[ScalarT], direction: WallDirection) -> NDArray[ScalarT]:
    """Turn an array that `both_scan_orders` arranged back into the lattice's rows and columns.

    The array that is returned is C-contiguous; it may be a view. In Fortran order, operations with
    other arrays would take several times as long as the copy does.

    Args:
        array: an array in a direction's scan order.
        direction: the direction that the array was arranged for.
    """
    array_in_lattice = array.T if direction.is_swapped else array
    return _to_fortran_order(array_in_lattice.T).T


# ---------------------------------------------------------------- rays to walls


class CastRays:
    """The distances that rays measured so far from cells to walls, in one direction.

    Rays are cast from one cell in a thousand, so the distances have a table of their own.

    Attributes:
        rays_of_cell: for each cell of the direction's scan, the index of its two rays in
            `coded_distance`; 0 if none was cast from the cell, shape (cells,), int32.
        coded_distance: for each pair of rays, that backward and that forward along the direction,
            the distance in columns of the scan, plus 1; 0 where it has not been measured; inf for
            no wall; shape (pairs, 2). The first pair is that of all cells without rays. Some pairs
            at the end may be of no cell yet.
    """

    def __init__(self, num_cells: int) -> None:
        """Begin without rays.

        Args:
            num_cells: the number of cells in the scan.
        """
        self.rays_of_cell = np.zeros(num_cells, dtype=np.int32)
        self.coded_distance = np.zeros((1, 2))
        self._num_pairs = 1

    def is_unmeasured(self, cells: Int, ray_ends: Int) -> Bool:
        """Return which rays have not been cast yet.

        Args:
            cells: the cells that the rays begin in, shape (n,).
            ray_ends: 0 for a ray backward, 1 for one forward, shape (n,).
        """
        is_unmeasured: Bool = self.coded_distance[self.rays_of_cell[cells], ray_ends] == 0.0
        return is_unmeasured

    def add(self, cells: Int, ray_ends: Int, coded_distance: Float) -> None:
        """Add what rays measured.

        Args:
            cells: the cells that the rays began in, shape (n,).
            ray_ends: 0 for a ray backward, 1 for one forward, shape (n,).
            coded_distance: what they measured, as in `coded_distance`, shape (n,).
        """
        new_cells = np.unique(cells[self.rays_of_cell[cells] == 0])
        num_pairs = self._num_pairs + len(new_cells)
        self.rays_of_cell[new_cells] = np.arange(self._num_pairs, num_pairs)
        self._num_pairs = num_pairs
        num_missing_pairs = num_pairs - len(self.coded_distance)
        if num_missing_pairs > 0:
            # at least twice as many, so that many small additions copy it a few times only
            extra_pairs = np.zeros((max(num_missing_pairs, len(self.coded_distance)), 2))
            self.coded_distance = np.concatenate([self.coded_distance, extra_pairs])
        self.coded_distance[self.rays_of_cell[cells], ray_ends] = coded_distance


class RotatedWalls(NamedTuple):
    """Walls, rotated so that a horizontal direction of walls becomes the z axis.

    Horizontal rays along that direction can then be cast like the vertical lines through cells.

    Attributes:
        axes: the frame's axes x, y and z as rows, in the world frame, shape (3, 3).
        tiled_walls: the walls in this frame, by tiles of the lattice.
        cast_rays: the distances from cells to walls that were measured so far.
    """

    axes: Float
    tiled_walls: TiledShapes
    cast_rays: CastRays


class WallRays:
    """Measures horizontal distances from cells to walls, at `RAY_HEIGHT` over the cells' floor.

    Rays are cast at the exact geometry of walls. Distances that were measured once are kept.
    """

    def __init__(self, walls: Shapes, lattice: Lattice, floor: Float) -> None:
        """Choose and tile the geometry that rays can meet.

        Args:
            walls: the geometry that rays meet, world frame.
            lattice: the cells that rays begin in.
            floor: heights of these cells' floors, NaN for none, shape (height, width) [m].
        """
        self._lattice = lattice
        self._floor = floor
        # of floors side by side at one height, one is enough
        is_listed = np.ones(floor.shape, dtype=np.bool_)
        np.not_equal(floor[:, 1:], floor[:, :-1], out=is_listed[:, 1:])
        heights = floor[is_listed]
        heights = heights[~np.isnan(heights)] + RAY_HEIGHT
        # most walls of a tower are on other levels
        is_box_at_rays = (walls.boxes[:, 2] <= heights.max() + TILE_MARGIN) & (
            walls.boxes[:, 5] >= heights.min() - TILE_MARGIN
        )
        is_at_rays = np.zeros(len(walls.is_endless), dtype=np.bool_)
        is_at_rays[walls.geom_of_box[is_box_at_rays]] = True
        walls = walls.only(is_at_rays)
        triangles_by_batch = [
            _choose_triangles(facets, heights) for facets in walls.facets_in_batches()
        ]
        geom, part, closed, corners = join_arrays(triangles_by_batch)
        vertices = corners.reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        triangles = Facets(vertices, faces, geom, part, closed)
        # rays from cells at the lattice's edge reach beyond it
        self._reach = max(MIN_RAY_LENGTH, MAX_JAMB_DISTANCE / lattice.cell_size)  # [cells]
        self._margin = math.ceil(self._reach) + 1
        rows = slice(-self._margin, lattice.height + self._margin)
        cols = slice(-self._margin, lattice.width + self._margin)
        self._tiled = tile_shapes(walls, lattice.cut(rows, cols), TILE_MARGIN, triangles)
        self._rotated_walls = dict[tuple[bool, float], RotatedWalls]()

    def measure(self, direction: WallDirection, cells: Int) -> CastRays:
        """Measure distances from cells' centres to walls, backward and forward in a direction.

        Args:
            direction: the direction along which rays are cast.
            cells: pairs of cell ids in the direction's scan, shape (…, 2). A ray goes backward from
                the first cell of a pair, and forward from the second; -1 for no ray.

        Returns:
            All distances that were measured in this direction so far. Later calls for the direction
            add to them.
        """
        walls = self._rotate(direction)
        ray_indices = np.nonzero(cells >= 0)
        ray_cells = cells[ray_indices]
        ray_ends = ray_indices[-1]
        is_unmeasured = walls.cast_rays.is_unmeasured(ray_cells, ray_ends)
        ray_cells = ray_cells[is_unmeasured]
        ray_ends = ray_ends[is_unmeasured]
        if len(ray_cells):
            if direction.is_swapped:
                cols, rows = np.divmod(ray_cells, self._floor.shape[0])
            else:
                rows, cols = np.divmod(ray_cells, self._floor.shape[1])
            distance, _ = self._cast(walls, rows, cols, ray_ends == 1, RAY_OFFSETS)
            column_length = direction.length_per_column * self._lattice.cell_size
            walls.cast_rays.add(ray_cells, ray_ends, distance / column_length + 1.0)
        return walls.cast_rays

    def find_points(self, is_open: Bool) -> tuple[WallPoints, int]:
        """Find points on walls by rays along the lattice's axes.

        Rays are cast from open cells that are next to closed cells, towards these.

        Args:
            is_open: a mask of the cells without a wall, shape (height, width).

        Returns:
            The points; and the number of rays. Rays that meet no wall are counted, rays that meet a
            wall at less than 45° are not.
        """
        is_closed = np.pad(~is_open, 1, mode="edge")
        has_floor = is_open & ~np.isnan(self._floor)
        cell_size = self._lattice.cell_size
        cells_per_ray = max(1, int(POINT_SPACING / cell_size))  # one of this many cells has a ray
        wait_for_points_along_cols = run_beside(
            self._find_points_along, (1, 0), is_closed, has_floor, cells_per_ray
        )
        points_along_rows = self._find_points_along((0, 1), is_closed, has_floor, cells_per_ray)
        points_by_axis = [wait_for_points_along_cols(), points_along_rows]
        points = WallPoints(
            position=np.concatenate([position for position, _, _ in points_by_axis], axis=1),
            angle=np.concatenate([angle for _, angle, _ in points_by_axis]),
            spacing=cells_per_ray * cell_size,
            bin_width=GEOMETRY_BIN_WIDTH,
            strip_width=GEOMETRY_STRIP_WIDTH / cell_size,
        )
        return points, sum(num_rays for _, _, num_rays in points_by_axis)

    def _find_points_along(
        self, axis: tuple[int, int], is_closed: Bool, has_floor: Bool, cells_per_ray: int
    ) -> tuple[Float, Float, int]:
        """Find points on walls by rays along an axis of the lattice, in both directions.

        Args:
            axis: the step along the axis: rows down and columns to the right, (1, 0) or (0, 1).
            is_closed: a mask of the cells with a wall, with a border of one cell, shape (height +
                2, width + 2).
            has_floor: a mask of the cells with a floor and without a wall, shape (height, width).
            cells_per_ray: rays are cast from one of so many cells next to closed cells.

        Returns:
            The points' rows and columns, shape (2, n) [cells]; the walls' angles there, shape (n,),
            see `WallPoints.angle` [°]; and the number of rays, see `find_points`.
        """
        down, right = axis
        num_rows, num_cols = has_floor.shape
        rows = list[Int]()
        cols = list[Int]()
        for sign in (1, -1):
            first_row = 1 + sign * down
            first_col = 1 + sign * right
            is_before_closed = is_closed[
                first_row : first_row + num_rows, first_col : first_col + num_cols
            ]
            row, col = np.divmod(np.flatnonzero(has_floor & is_before_closed), num_cols)
            has_ray = (row + col) % cells_per_ray == 0
            rows.append(row[has_ray])
            cols.append(col[has_ray])
        rows_of_rays = np.concatenate(rows)
        cols_of_rays = np.concatenate(cols)
        ray_sign = np.repeat([1, -1], [len(row) for row in rows])
        walls = self._rotate(make_direction(90.0 * down, has_floor.shape))
        distance, normal = self._cast(walls, rows_of_rays, cols_of_rays, ray_sign > 0, np.zeros(1))
        # walls at less than 45° to the ray are met by rays along the other axis
        faces_ray = np.abs(normal[:, 2]) >= np.abs(normal[:, 0])
        meets_wall = faces_ray & np.isfinite(distance)
        cells_ahead = ray_sign[meets_wall] * (distance[meets_wall] / self._lattice.cell_size)
        position = np.stack(
            [
                rows_of_rays[meets_wall] + down * cells_ahead,
                cols_of_rays[meets_wall] + right * cells_ahead,
            ]
        )
        x, y, _ = walls.axes.T @ normal[meets_wall].T
        angle = np.mod(np.rad2deg(np.arctan2(-y, x)) + 90.0, 180.0)
        return position, angle, int(faces_ray.sum())

    def _cast(
        self, walls: RotatedWalls, row: Int, col: Int, is_forward: Bool, ray_offsets: Float
    ) -> tuple[Float, Float]:
        """Cast rays from cells along a direction, forward or backward.

        Args:
            walls: the walls, rotated so that rays along the direction are vertical.
            row, col: rows and columns of the cells, shape (n,).
            is_forward: whether the ray of each cell goes forward, else backward, shape (n,).
            ray_offsets: how far beside the cell's centre its rays begin, across the direction
                [cells].

        Returns:
            The distance from each cell to the nearest wall that any of its rays meets, inf for
            none, shape (n,) [m]; and the wall's normal there in the rotated frame, 0 for none,
            shape (n, 3).
        """
        lattice = self._lattice
        axes = walls.axes
        tiled_walls = walls.tiled_walls
        num_offsets = len(ray_offsets)
        floor = self._floor[row, col]
        height = np.where(np.isnan(floor), NO_FLOOR_HEIGHT, floor + RAY_HEIGHT)
        centers = np.column_stack([lattice.positions(row, col), height]) @ axes.T
        # cells of the lattice with its margin
        start_cells = np.stack([row, col]) + (self._margin + 0.5)
        ray_sign = np.where(is_forward, 1.0, -1.0)
        # how a step across a ray and one along it change the row and the column
        across_step, along_step = axes[[0, 2]][:, [1, 0]] * (-1.0, 1.0)
        distance = np.full(len(row), np.inf)
        normal = np.zeros((len(row), 3))
        unfinished_cell_indices = np.arange(len(row))
        # most rays end near their cells, where there is little geometry
        ray_lengths = [self._reach] if len(row) < MANY_RAYS else [SHORT_RAY, self._reach]
        for ray_length in ray_lengths:
            cell_index_of_ray = unfinished_cell_indices.repeat(num_offsets)
            offset_of_ray = np.tile(ray_offsets, len(unfinished_cell_indices))
            points = centers[cell_index_of_ray, :2]
            points[:, 0] += offset_of_ray * lattice.cell_size
            ray_ends = np.empty((2, len(cell_index_of_ray), 2))
            ray_ends[..., 0] = (
                start_cells[:, cell_index_of_ray] + across_step[:, None] * offset_of_ray
            )
            ray_ends[..., 1] = ray_ends[..., 0] + along_step[:, None] * (
                ray_sign[cell_index_of_ray] * ray_length
            )
            rows, cols = ray_ends.astype(np.int64)
            hits = cast_points(tiled_walls, rows * tiled_walls.lattice.width + cols, points, axes)
            cell_index_of_hit = np.repeat(cell_index_of_ray, np.diff(hits.start))
            distance_ahead = ray_sign[cell_index_of_hit] * (hits.z - centers[cell_index_of_hit, 2])
            distance_ahead[~(distance_ahead >= 0.0)] = np.inf
            np.minimum.at(distance, cell_index_of_hit, distance_ahead)
            is_nearest_hit = np.isfinite(distance_ahead) & (
                distance_ahead == distance[cell_index_of_hit]
            )
            normal[cell_index_of_hit[is_nearest_hit]] = hits.normal[is_nearest_hit]
            unfinished_cell_indices = unfinished_cell_indices[
                distance[unfinished_cell_indices] > ray_length * lattice.cell_size
            ]
            if not len(unfinished_cell_indices):
                break
        return distance, normal

    def _rotate(self, direction: WallDirection) -> RotatedWalls:
        """Return the walls in a frame in which the direction points up.

        The first call for a direction rotates the walls; later calls return the same walls.
        """
        key = direction.is_swapped, direction.slope
        if key not in self._rotated_walls:
            ray_direction = np.array([1.0, -direction.slope]) / direction.length_per_column
            x, y = -ray_direction[::-1] if direction.is_swapped else ray_direction
            axes = np.array([[-y, x, 0.0], [0.0, 0.0, 1.0], [x, y, 0.0]])
            tiled_walls = replace(self._tiled, shapes=self._tiled.shapes.solids_in_frame(axes))
            self._rotated_walls[key] = RotatedWalls(axes, tiled_walls, CastRays(self._floor.size))
        return self._rotated_walls[key]


def _choose_triangles(triangles: Facets, heights: Float) -> list[NDArray[Any]]:
    """Choose the triangles at heights of rays; heights are compared in bins of `HEIGHT_BIN`.

    Args:
        triangles: the triangles.
        heights: the heights of the rays, at least one [m].

    Returns:
        Of the chosen triangles, in the order of `triangles`: geom, part, closed, as in `Facets`;
        and the corners, (n, 3, 3) [m].
    """
    lowest_ray_z = heights.min()
    highest_ray_z = heights.max()
    has_ray = np.zeros(int((highest_ray_z - lowest_ray_z) / HEIGHT_BIN) + 1, dtype=np.int64)
    has_ray[((heights - lowest_ray_z) / HEIGHT_BIN).astype(np.int64)] = 1
    num_ray_bins_before = np.append(0, np.cumsum(has_ray))  # of each bin, those with a ray
    triangle_ids_by_first = dict[int, Int]()  # index of a batch's first triangle -> chosen ones

    def choose_in_range(first_triangle: int, end_triangle: int) -> None:
        for batch, boxes in boxes_in_batches(triangles, first_triangle, end_triangle):
            bottom_z = boxes[:, 2]
            top_z = boxes[:, 5]
            ids_in_range = np.flatnonzero((bottom_z <= highest_ray_z) & (top_z >= lowest_ray_z))
            relative_heights = (
                np.stack([bottom_z[ids_in_range] - TILE_MARGIN, top_z[ids_in_range] + TILE_MARGIN])
                - lowest_ray_z
            )
            first_bin, last_bin = (
                (relative_heights / HEIGHT_BIN).astype(np.int64).clip(0, len(has_ray) - 1)
            )
            meets_ray = num_ray_bins_before[last_bin + 1] > num_ray_bins_before[first_bin]
            triangle_ids_by_first[batch.start] = batch.start + ids_in_range[meets_ray]

    run_in_chunks(choose_in_range, len(triangles.faces), min_chunk_size=MIN_CHUNK_TRIANGLES)
    triangle_ids_by_batch = [
        triangle_ids_by_first[first_triangle] for first_triangle in sorted(triangle_ids_by_first)
    ]
    triangle_ids = np.concatenate([np.empty(0, np.int64), *triangle_ids_by_batch])
    return [
        triangles.geom[triangle_ids],
        triangles.part[triangle_ids],
        triangles.closed[triangle_ids],
        # `take` needs half the time of an index in brackets here
        triangles.vertices.take(triangles.faces.take(triangle_ids, axis=0), axis=0),
    ]


# ---------------------------------------------------------------- sills


def find_windows(is_low: Bool, is_wall: Bool, cell_size: float) -> Bool:
    """Mark the cells of a building's mesh where a wall goes on as a sill or a parapet.

    Sills and furniture both block cells, but don't reach as high as walls: these are low cells. A
    sill, unlike furniture, leads from one piece of wall to the next along the wall's direction
    without a break, and is as thin as a wall.

    Args:
        is_low: low cells, which the mesh blocks, but without reaching into the heights of 1.5 to
            1.8 m over the floor, shape (height, width).
        is_wall: cells that a wall blocks.
        cell_size: the side of a cell, > 0 [m].

    Returns:
        The cells of sills, shape (height, width).
    """
    is_window = np.zeros(is_low.shape, dtype=np.bool_)
    if not is_low.any():
        return is_window
    scans = []
    scanned_is_low = both_scan_orders(is_low)
    scanned_is_wall = both_scan_orders(is_wall)
    for direction in find_directions(~is_wall, cell_size):
        # drawn sills are as wide as their wall, so that each line of theirs ends at it
        is_low_in_scan = scanned_is_low[direction.is_swapped]
        is_wall_in_scan = scanned_is_wall[direction.is_swapped]
        is_sill = np.zeros_like(is_low_in_scan)
        wait_for_sills = run_beside(
            kernels.mark_sills, is_low_in_scan, is_wall_in_scan, direction.shift, is_sill
        )
        scans.append((direction, is_sill, wait_for_sills))
    for direction, is_sill, wait_for_sills in scans:
        wait_for_sills()
        max_sill_rows = int(MAX_SILL_THICKNESS * direction.length_per_column / cell_size) + 2
        runs = find_row_runs(is_sill.T)  # along columns
        for run in np.flatnonzero(runs.end_col - runs.first_col > max_sill_rows).tolist():
            is_sill[runs.first_col[run] : runs.end_col[run], runs.row[run]] = False
        is_window |= from_scan_order(is_sill, direction)
    return is_window
