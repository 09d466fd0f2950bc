"""Levels as the values of ROS's ``nav_msgs/OccupancyGrid``: -1 unknown, 0 free to 100 occupied.

Arrays have row 0 at the top (largest y), as everywhere in navbake; a message has it at the bottom.
Values from 1 to 98 stand for costs from 1 to 252, as when ``nav2_costmap_2d`` publishes a costmap.
99 is a cell where the robot's centre can't be.

Source: nav2's ``costmap_2d_publisher.cpp`` for the values of costs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.formats.allowance import MAX_PIXELS
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.runtime.inflation import NAV2_SCALING, count_covered_cells, nav2_costs
from navbake.runtime.surroundings import find_disc_offsets
from navbake.types import Bool, Float, Json

ndimage = lazy("scipy.ndimage")

UNKNOWN = -1
FREE = 0
INSCRIBED = 99  # the robot's inscribed circle would meet an obstacle
OCCUPIED = 100
# costs of a cell that isn't blocked
MIN_COST = 1
MAX_COST = 252
MIN_BLOCKED_COST = 253
QUARTER_TURN = math.pi / 2
# a yaw counts as whole quarter turns if a map's farthest corner moves by less [cells]
QUARTER_TOLERANCE = 0.1
# a new cell is occupied if occupied cells of the map cover this share of it
MIN_COVERED_SHARE = 0.01
CELLS_AT_ONCE = 1 << 18  # occupied cells that are compared with new cells at once, to limit memory

OccupancyValues: TypeAlias = NDArray[np.int8]
"""Values of ``nav_msgs/OccupancyGrid``, shape (height, width), row 0 at the top."""


def compute_occupancy_values(grid: NavGrid, level_number: int) -> OccupancyValues:
    """Compute the value of each cell of a level in a ``nav_msgs/OccupancyGrid``.

    A free cell is 0, or 1 to 98 if its weight is above 1. A blocked cell is unknown (-1) if it has
    no floor and the grid has floor heights. Otherwise it is occupied (100) if its occupancy isn't
    0. All other blocked cells are 99: only an inflation or an added obstacle blocks them.

    Args:
        grid: the grid.
        level_number: the level's number.

    Returns:
        The values, shape (height, width), int8.
    """
    level = grid.levels[level_number]
    with np.errstate(invalid="ignore"):
        costs = np.where(level.weights > 1, np.clip(level.weights, MIN_COST, MAX_COST), 0)
    values = _publish_costs(costs.astype(np.uint8))
    values[~level.free] = INSCRIBED
    values[~level.free & (level.occupancy != 0)] = OCCUPIED
    if "floorHeight" in level.attributes:
        values[~level.free & np.isnan(level.floor_height)] = UNKNOWN
    return values


def compute_costmap_values(
    grid: NavGrid, level_number: int, radius: float, inflation: float, scaling: float = NAV2_SCALING
) -> OccupancyValues:
    """Compute the values of a level's costmap: its obstacles inflated by nav2's formula.

    A cell where the robot can't stand for another reason (a drop, an obstacle on another level) has
    the same value as one within `radius` of an obstacle.

    Args:
        grid: the grid, not inflated.
        level_number: the level's number.
        radius: the robot's inscribed radius [m].
        inflation: nav2's ``inflation_radius`` [m], at least the radius.
        scaling: nav2's ``cost_scaling_factor`` [1/m].

    Returns:
        The values, shape (height, width), int8.

    Raises:
        QueryError: the inflation is below the radius, or a number is out of its range.
    """
    if not inflation >= radius:
        expected = f"an inflation of at least the radius {radius:g} m"
        raise QueryError(
            f"expected {expected}, got {inflation:g}",
            key="inflation",
            value=inflation,
            expected=expected,
        )
    inflated_grid = grid.inflate(radius, inflation - radius, costs="nav2", scaling=scaling)
    values = compute_occupancy_values(inflated_grid, level_number)
    costs = nav2_costs(grid, radius, inflation, scaling, level=level_number)
    is_free = (values >= FREE) & (values < INSCRIBED)
    values[is_free] = np.maximum(values, _publish_costs(costs))[is_free]
    return values


def _publish_costs(costs: NDArray[np.uint8]) -> OccupancyValues:
    """Convert nav2's costs, 0 to 255, to the values that nav2 publishes for them.

    Costs of 253 and more, which are those of blocked cells, all become 99.
    """
    value_of_cost = 1 + 97 * (np.arange(256) - 1) // 251
    value_of_cost[0] = FREE
    value_of_cost[MIN_BLOCKED_COST:] = INSCRIBED
    return value_of_cost.astype(np.int8)[costs]


def level_from_values(
    values: OccupancyValues, lattice: Lattice, ground: float, metadata: Json
) -> SceneGrid2D:
    """Make a level from occupancy values.

    Cells with the value 100 are occupied, those with 99 blocked, and those with -1 have no floor.
    Values from 1 to 98 become weights: the lowest cost that nav2 publishes as that value. All cells
    except unknown ones have a flat floor, also occupied ones.

    Args:
        values: the values, shape (height, width), int8.
        lattice: the lattice of their cells.
        ground: world z of the floor [m].
        metadata: the level's metadata.
    """
    # nav2 publishes a cost from 1 to 252 as 1 + 97 (cost - 1) / 251, cut to a whole number
    cost_of_value: Float = 1 + np.ceil(251 * (np.arange(OCCUPIED + 1) - 1) / 97)
    cost_of_value[0] = 1
    is_blocked = (values < FREE) | (values >= INSCRIBED)
    return SceneGrid2D(
        width=lattice.width,
        height=lattice.height,
        cell_size=lattice.cell_size,
        min_yup=(lattice.x_min, ground, 0.0 - lattice.y_max),
        weights=np.where(is_blocked, np.inf, cost_of_value[np.clip(values, 0, OCCUPIED)]),
        attributes={
            "floorHeight": np.where(values == UNKNOWN, np.float32(np.nan), np.float32(ground)),
            "occupancy": ((values == OCCUPIED) | (values == UNKNOWN)).astype(np.uint8),
        },
        metadata=metadata,
    )


def find_obstacles(is_blocked: Bool, radius: float) -> Bool:
    """Find the obstacles of a map whose cells are blocked for an agent of some radius.

    A geom blocks all cells whose centres lie within the radius. So where one is in a cell, all
    centres are blocked whose distance from the cell's centre is smaller by half a diagonal. All
    cells of which this is true count as obstacles: an inflation for a larger agent frees no cell
    where one of them stands.

    Args:
        is_blocked: the blocked cells, shape (height, width), bool.
        radius: the agent's radius, in cells.

    Returns:
        The cells with obstacles, of the same shape, bool.
    """
    certain_radius = radius - math.sqrt(0.5)
    if certain_radius <= 0.0:
        return is_blocked
    disc = find_disc_offsets(certain_radius, is_blocked.shape, to_squares=False)
    half_widths = disc.half_widths[:-1].tolist()
    max_row = len(half_widths) - 1
    runs = np.array(
        [
            (row, -half_widths[abs(row)], half_widths[abs(row)])
            for row in range(-max_row, max_row + 1)
        ]
    )
    is_obstacle: Bool = count_covered_cells(~is_blocked, runs) == 0
    is_explained: Bool = count_covered_cells(is_obstacle, runs) > 0
    return is_obstacle | (is_blocked & ~is_explained)


def level_from_rooms(
    is_free: Bool,
    room_numbers: NDArray[np.uint16],
    room_names: Mapping[int, str],
    lattice: Lattice,
    ground: float,
    scene_id: str,
) -> SceneGrid2D:
    """Make a flat level of a map's free cells and rooms.

    Args:
        is_free: where an agent can stand, shape (height, width), bool.
        room_numbers: the number of each cell's room from 1, 0 for none, of the same shape, uint16.
        room_names: number of a room -> its name; rooms without a name are missing.
        lattice: the lattice of the cells.
        ground: world z of the floor [m].
        scene_id: the name of the scene.

    Returns:
        The level, with a table of its rooms.
    """
    values = np.where(is_free, np.int8(FREE), np.int8(OCCUPIED))
    level = level_from_values(values, lattice, ground, {"sceneId": scene_id})
    level.attributes["roomIndex"] = room_numbers
    room_table = [
        {**room.to_json(), "name": room_names.get(room.index)} for room in level.measure_rooms()
    ]
    level.metadata["navbake"] = {"rooms": room_table}
    return level


def is_quarter_turn(yaw: float, shape: tuple[int, int]) -> bool:
    """Whether a map is turned by quarter turns, up to a tenth of a cell at its corners.

    Args:
        yaw: the map's yaw [rad].
        shape: its rows and columns.
    """
    offset = abs(yaw - round(yaw / QUARTER_TURN) * QUARTER_TURN)
    return offset * math.hypot(*shape) <= QUARTER_TOLERANCE


def align_with_axes(
    values: OccupancyValues, origin: tuple[float, float, float], resolution: float
) -> tuple[OccupancyValues, Lattice]:
    """Resample a map with any yaw onto cells along the world's axes.

    If the yaw is a whole number of quarter turns, the cells are only rearranged. That is also done
    for a yaw so near to one that no corner of the map is off by more than a tenth of a cell.
    Otherwise a new cell has the value of the map at its centre, or -1 outside of the map. But it is
    occupied if occupied cells of the map cover at least 1 % of it.

    Args:
        values: the map's values, shape (height, width), int8.
        origin: the outer corner of the map's lower left cell, world x, y [m], and the map's yaw,
            anticlockwise [rad].
        resolution: the edge of a cell [m].

    Returns:
        The values of the new cells, and their lattice.

    Raises:
        FormatError: the new map has too many cells.
    """
    x, y, yaw = origin
    height, width = values.shape
    num_quarter_turns = round(yaw / QUARTER_TURN)
    if is_quarter_turn(yaw, values.shape):
        # how far the turned map reaches left of its origin and below it [cells]
        extent_left, extent_below = ((0, 0), (height, 0), (width, height), (0, width))[
            num_quarter_turns % 4
        ]
        turned_values = np.ascontiguousarray(np.rot90(values, num_quarter_turns % 4))
        x = x - extent_left * resolution
        y = y - extent_below * resolution
        return turned_values, lattice_from_corner(turned_values, x, y, resolution)

    # from here on in cells, from the map's corner
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    corners_x = (0, width * cos, width * cos - height * sin, -height * sin)
    corners_y = (0, width * sin, width * sin + height * cos, height * cos)
    bounds = (min(corners_x), min(corners_y), max(corners_x), max(corners_y))
    lattice = Lattice.cover(bounds, 1.0)
    if lattice.width * lattice.height > MAX_PIXELS:
        raise FormatError(f"the turned map has {lattice.width} × {lattice.height} cells, too many")

    # the place (row, col) of a new cell's centre in the map is the matrix times the new cell's row
    # and column, plus the place of the new cell [0, 0]
    first_x = lattice.x_min + 0.5
    first_y = lattice.y_max - 0.5
    matrix = [[cos, sin], [-sin, cos]]
    first_row = height - 0.5 + sin * first_x - cos * first_y
    first_col = cos * first_x + sin * first_y - 0.5
    turned_values = ndimage.affine_transform(
        values,
        matrix,
        (first_row, first_col),
        lattice.shape,
        order=0,
        mode="grid-constant",
        cval=UNKNOWN,
    )

    covered_shares = np.zeros(
        lattice.shape
    )  # share of each new cell, unless that is occupied already
    occupied_rows, occupied_cols = np.nonzero(values == OCCUPIED)
    for chunk_start in range(0, len(occupied_rows), CELLS_AT_ONCE):
        chunk_slice = slice(chunk_start, chunk_start + CELLS_AT_ONCE)
        map_x = occupied_cols[chunk_slice] + 0.5
        map_y = height - occupied_rows[chunk_slice] - 0.5
        centers = np.stack([cos * map_x - sin * map_y, sin * map_x + cos * map_y], axis=-1)
        _add_covered_shares(covered_shares, turned_values, lattice, centers, cos, sin)
    turned_values[covered_shares >= MIN_COVERED_SHARE] = OCCUPIED
    x = x + lattice.x_min * resolution
    y = y + lattice.bounds[1] * resolution
    return turned_values, lattice_from_corner(turned_values, x, y, resolution)


def lattice_from_corner(values: OccupancyValues, x: float, y: float, cell_size: float) -> Lattice:
    """Return the lattice of a map's cells.

    Args:
        values: the map's values, shape (height, width).
        x: world x of the map's lower left corner [m].
        y: world y of the map's lower left corner [m].
        cell_size: the edge of a cell [m].
    """
    height, width = values.shape
    return Lattice(x, y + height * cell_size, cell_size, width, height)


def _add_covered_shares(
    covered_shares: Float,
    turned_values: OccupancyValues,
    lattice: Lattice,
    centers: Float,
    cos: float,
    sin: float,
) -> None:
    """Add to `covered_shares` the share of each new cell that occupied cells of the map cover.

    An occupied cell is a turned unit square. It overlaps a new cell if along each of the four
    directions of their sides, their centres are nearer than half of both extents together
    (separating axes). The overlap is bounded by the parts of each square's sides that are inside of
    the other square; its area follows from the ends of these parts (Green's theorem).

    Args:
        covered_shares: the share of each new cell that is covered so far, shape (height, width).
        turned_values: the values of the new cells, of the same shape; occupied ones are left out.
        lattice: the lattice of the new cells, with cells of edge 1.
        centers: the centres of some occupied cells in the lattice's frame, shape (n, 2) [cells].
        cos: the cosine of the map's yaw.
        sin: the sine of the map's yaw.
    """
    # half of both extents together, the same along all four directions [cells]
    max_distance = (1.0 + abs(cos) + abs(sin)) / 2
    row, col = lattice.rows_cols(centers)
    for neighbor_row, neighbor_col in np.ndindex(3, 3):
        rows = row + neighbor_row - 1
        cols = col + neighbor_col - 1
        dx = lattice.x_min + cols + 0.5 - centers[:, 0]
        dy = lattice.y_max - rows - 0.5 - centers[:, 1]
        turned_dx = cos * dx + sin * dy
        turned_dy = cos * dy - sin * dx
        is_overlapping = np.max(np.abs([dx, dy, turned_dx, turned_dy]), axis=0) < max_distance
        is_overlapping &= (
            (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
        )
        is_overlapping[is_overlapping] = (
            turned_values[rows[is_overlapping], cols[is_overlapping]] != OCCUPIED
        )
        # from the square's centre to the cell's, along the cell's sides and along the square's
        center_offset = np.stack([dx, dy], axis=-1)[is_overlapping]
        turned_center_offset = np.stack([turned_dx, turned_dy], axis=-1)[is_overlapping]
        # the cell's sides in the square, and the square's in the cell, about the square's centre
        area = _integrate_sides(turned_center_offset, cos, -sin, True)
        area = area + _integrate_sides(-center_offset, cos, sin, False)
        np.add.at(covered_shares, (rows[is_overlapping], cols[is_overlapping]), area)


def _integrate_sides(centers: Float, cos: float, sin: float, is_about_origin: bool) -> Float:
    """Integrate over the parts of turned squares' sides that are inside of a fixed square.

    All squares have edge 1; the fixed one has its centre at 0, 0. Sides are cut by Liang and
    Barsky's algorithm.

    Args:
        centers: the centres of the turned squares, shape (n, 2).
        cos: the cosine of their yaw.
        sin: the sine of their yaw.
        is_about_origin: whether the integral is about 0, 0; else it is about each square's centre.

    Returns:
        For each square, half the sum of the cross products of the ends of these parts, shape (n,).
    """
    integrals = np.zeros(len(centers))
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners = corners @ [[cos, sin], [-sin, cos]]
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side_start = centers + start
        side_vector = end - start
        side_fractions = np.sort(
            [(-0.5 - side_start) / side_vector, (0.5 - side_start) / side_vector], axis=0
        )
        enter_fraction = np.maximum(side_fractions[0].max(axis=1), 0.0)[:, None]
        leave_fraction = np.minimum(side_fractions[1].min(axis=1), 1.0)[:, None]
        first_end = side_start + enter_fraction * side_vector
        second_end = side_start + np.maximum(leave_fraction, enter_fraction) * side_vector
        if not is_about_origin:
            first_end = first_end - centers
            second_end = second_end - centers
        integrals += (first_end[:, 0] * second_end[:, 1] - first_end[:, 1] * second_end[:, 0]) / 2
    return integrals
